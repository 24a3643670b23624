//! Starts the program of a relay of Media over QUIC, where it is installed.

use std::{
    env,
    io::{Read as _, Write as _},
    net::{Ipv4Addr, TcpListener, TcpStream, UdpSocket},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::Duration,
};

use anyhow::{Context, Result, bail};
use dgs_quic::socket::Pin;

/// `.ci/run` installs it here, below the folder of builds.
const INSTALLED: &str = "moq/bin/moq-relay";
/// How often, and with what pause, a relay that starts is tried.
const ATTEMPTS: (u32, Duration) = (600, Duration::from_millis(50));
/// Numbers of ports that are tried: another program may take one before the relay does.
const MAX_NUMBERS: u32 = 16;

/// A relay that runs until it is dropped.
pub struct Program {
    /// UDP port on this machine.
    pub port: u16,
    /// SHA-256 of its certificate.
    pub pin: Pin,
    _running: Running,
}

/// A process that ends with this.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Program {
    /// A relay on this machine that grants everything to everybody; `None` where none is installed below
    /// the folder of builds of the repository at `root`, or on the path of programs.
    ///
    /// # Errors
    /// A relay that does not start.
    pub async fn start(root: &Path) -> Result<Option<Self>> {
        let Some(program) = find(root) else { return Ok(None) };
        for _ in 0..MAX_NUMBERS {
            if let Some(port) = free_number()?
                && let Some(started) = Self::on(&program, port).await?
            {
                return Ok(Some(started));
            }
        }
        bail!("moq-relay has ended at once on each of {MAX_NUMBERS} ports, or none of them was free")
    }

    /// On `port`; `None` where the program has ended.
    async fn on(program: &Path, port: u16) -> Result<Option<Self>> {
        let listen = format!("127.0.0.1:{port}");
        let child = Command::new(program)
            .args(["--listen", &listen, "--web-http-listen", &listen, "--auth-public", "**"])
            .args(["--listen-tls-generate", "localhost"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        let mut running = Running(child);
        for _ in 0..ATTEMPTS.0 {
            let pin = pin(port);
            // Whoever has answered then is another program.
            if running.0.try_wait()?.is_some() {
                return Ok(None);
            }
            if let Ok(pin) = pin {
                return Ok(Some(Self { port, pin, _running: running }));
            }
            tokio::time::sleep(ATTEMPTS.1).await;
        }
        bail!("moq-relay says nothing on {listen}")
    }
}

/// A number that is free for datagrams and for connections, if the next that the system chooses is.
fn free_number() -> Result<Option<u16>> {
    let datagrams = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let port = datagrams.local_addr()?.port();
    Ok(TcpListener::bind((Ipv4Addr::LOCALHOST, port)).is_ok().then_some(port))
}

/// The pin, which the relay says over HTTP.
fn pin(port: u16) -> Result<Pin> {
    let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, port))?;
    stream.set_read_timeout(Some(Duration::from_secs(5)))?;
    stream.write_all(b"GET /certificate.sha256 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n")?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer)?;
    let pin = answer.lines().map(str::trim).find_map(|line| line.parse().ok());
    pin.context("moq-relay says no pin")
}

/// Below the builds, or on the path of programs.
fn find(root: &Path) -> Option<PathBuf> {
    let builds = env::var_os("CARGO_TARGET_DIR").map_or_else(|| root.join("target"), PathBuf::from);
    let folders = env::var_os("PATH").unwrap_or_default();
    let named = env::split_paths(&folders).map(|folder| folder.join("moq-relay"));
    [builds.join(INSTALLED)].into_iter().chain(named).find(|program| program.is_file())
}
