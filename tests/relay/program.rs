//! Starts the relay's own program, where it is installed.

use std::{
    env, fs,
    net::{Ipv4Addr, TcpStream, UdpSocket},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::Duration,
};

use dgs_quic::socket::{Identity, Pin};
use tempfile::TempDir;

/// `.ci/run` installs it here, below the folder of builds.
const INSTALLED: &str = "moq/bin/moq-relay";

/// A relay that runs until it is dropped.
pub struct Program {
    pub port: u16,
    pub pin: Pin,
    child: Child,
    _folder: TempDir,
}

impl Program {
    /// A relay on this machine that grants everything to everybody; `None` where none is installed, which in
    /// CI is a failure.
    pub async fn start() -> Option<Self> {
        let Some(program) = program() else {
            assert!(env::var_os("CI").is_none_or(|ci| ci != "true"), "moq-relay is missing");
            eprintln!("no moq-relay here (.ci/run installs it): nothing is tested across a relay");
            return None;
        };
        let folder = tempfile::tempdir().unwrap();
        let [certificate, key] = ["cert.pem", "key.pem"].map(|file| folder.path().join(file));
        let made = rcgen::generate_simple_self_signed(["127.0.0.1".to_owned()]).unwrap();
        fs::write(&certificate, made.cert.pem()).unwrap();
        fs::write(&key, made.signing_key.serialize_pem()).unwrap();
        let pin = Identity::read(&certificate, &key).unwrap().pin();
        let port = free_port();
        let child = Command::new(program)
            .args(["--listen", &format!("127.0.0.1:{port}"), "--auth-public", "**"])
            .args(["--web-http-listen", &format!("127.0.0.1:{port}")])
            .args(["--listen-tls-cert".as_ref(), certificate.as_os_str()])
            .args(["--listen-tls-key".as_ref(), key.as_os_str()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let relay = Self { port, pin, child, _folder: folder };
        relay.wait().await;
        Some(relay)
    }

    /// It is there when it answers over TCP, which it listens to last.
    async fn wait(&self) {
        for _ in 0..600 {
            if TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).is_ok() {
                return;
            }
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        panic!("moq-relay does not listen");
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn free_port() -> u16 {
    UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap().port()
}

/// Beside the builds, or on the path of programs.
fn program() -> Option<PathBuf> {
    let builds = env::var_os("CARGO_TARGET_DIR")
        .map_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("target"), PathBuf::from);
    let folders = env::var_os("PATH").unwrap_or_default();
    let found = env::split_paths(&folders).map(|folder| folder.join("moq-relay"));
    [builds.join(INSTALLED)].into_iter().chain(found).find(|program| program.is_file())
}
