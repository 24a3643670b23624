//! Starts the program of a relay of Media over QUIC, where it is installed.

use std::{
    env,
    io::{Read as _, Write as _},
    net::{Ipv4Addr, TcpStream, UdpSocket},
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
        let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?.port();
        let listen = format!("127.0.0.1:{port}");
        let child = Command::new(program)
            .args(["--listen", &listen, "--web-http-listen", &listen, "--auth-public", "**"])
            .args(["--listen-tls-generate", "localhost"])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        let running = Running(child);
        for _ in 0..ATTEMPTS.0 {
            if let Ok(pin) = pin(port) {
                return Ok(Some(Self { port, pin, _running: running }));
            }
            tokio::time::sleep(ATTEMPTS.1).await;
        }
        bail!("moq-relay says nothing on {listen}")
    }
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
