//! Streams are encoded once and served with the player's page while a test runs.

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::Ipv4Addr,
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::OnceLock,
    thread,
};

use clap::Parser;
use codec_core::Footprint;
use dgs::{
    args::{Cli, Verb},
    pipeline::{self, Quiet},
};
use dgs_player::Stream;
use dgs_quic::http::{HttpConfig, HttpLimits, HttpServer, Site, SiteStream};
use tokio::{runtime::Runtime, sync::oneshot};

/// A stream whose pictures are compared, and one that comes in several ranges. Few Gaussians, since browsers
/// in tests draw on the processor, and fine steps, so that they take many bytes.
pub const SMALL: (&str, usize) = ("small", 1000);
pub const LARGE: (&str, usize) = ("large", 2500);

/// One second of a synthetic figure; the small one is drawn with footprint pixel, as trained scenes are.
pub fn stream((_, gaussians): (&str, usize)) -> Stream {
    static STREAMS: [OnceLock<Stream>; 2] = [OnceLock::new(), OnceLock::new()];
    let slot = &STREAMS[usize::from(gaussians == LARGE.1)];
    slot.get_or_init(|| {
        let flags = ["dgs", "demo", "--pictures", "2", "--coarseness", "0.02"];
        let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
        let mut scene =
            pipeline::import(&format!("synth:figure:{gaussians}:30"), &args.source).unwrap().scene;
        if gaussians == SMALL.1 {
            scene.footprint = Footprint::Pixel;
        }
        let options = pipeline::encode_options(&args.codec, trainer_host::encode::Protection::STANDARD);
        pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream
    })
    .clone()
}

/// A server of the page, as `dgs view` is one. It stops when this is dropped.
pub struct Served {
    port: u16,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<thread::JoinHandle<()>>,
}

impl Served {
    pub fn start() -> Self {
        Self::files([SMALL, LARGE].map(|which| (which.0, stream(which).to_bytes().unwrap())))
    }

    /// Of files, each with its name.
    pub fn files<const COUNT: usize>(files: [(&str, Vec<u8>); COUNT]) -> Self {
        let streams = files.map(|(name, bytes)| SiteStream {
            name: name.to_owned(),
            address: None,
            web_address: None,
            file: Some(bytes.into()),
        });
        let site = Site::new(page, &streams, None).unwrap();
        let (stop, stopped) = oneshot::channel();
        let (say, said) = std::sync::mpsc::channel();
        let thread = thread::spawn(move || {
            Runtime::new().unwrap().block_on(async {
                let bind = (Ipv4Addr::LOCALHOST, 0).into();
                let config = HttpConfig { bind, limits: HttpLimits::default() };
                let server = HttpServer::bind(&config, site).unwrap();
                say.send(server.local_addr().unwrap().port()).unwrap();
                server.run(async { stopped.await.unwrap_or(()) }).await;
            });
        });
        Self { port: said.recv().unwrap(), stop: Some(stop), thread: Some(thread) }
    }

    pub fn url(&self) -> String {
        format!("http://localhost:{}/", self.port)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// The page, and under `plain/` once more, as a server of plain files has it: no streams are listed.
fn page(path: &str) -> Option<(&'static [u8], &'static str)> {
    let plain = path.strip_prefix("plain/");
    if plain.is_some_and(|name| name.is_empty() || name == "index.html") {
        let page = include_bytes!("../../render-host/viewer/page/index.html");
        return Some((page, "text/html; charset=utf-8"));
    }
    dgs_viewer::asset(plain.unwrap_or(path)).map(|asset| (asset.bytes, asset.content_type))
}

/// The program itself, serving a stream live on an emulated link.
pub struct Live {
    /// Address of its page.
    pub page: String,
    server: Child,
    said: BufReader<ChildStdout>,
    /// Open for as long as it serves, or until [`Live::end`].
    input: Option<ChildStdin>,
    _folder: tempfile::TempDir,
}

/// For pages that are held up at their first picture: a server must not think them gone.
const PATIENT: [&str; 2] = ["--idle", "120"];

/// A scene as `dgs encode` encodes it with `flags`.
pub fn encoded(scene: &str, flags: &[&str]) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.dgs");
    let mut encode = Command::new(env!("CARGO_BIN_EXE_dgs"));
    let status =
        encode.args(["encode", scene, "--out"]).stdout(Stdio::null()).arg(&file).args(flags).status();
    assert!(status.unwrap().success());
    std::fs::read(file).unwrap()
}

impl Live {
    /// With `flags` besides.
    pub fn start(flags: &[&str]) -> Self {
        Self::serving("small.dgs", "127.0.0.1:0", flags, &[])
    }

    /// At the `address` of one that was stopped.
    pub fn at(address: &str) -> Self {
        Self::serving("small.dgs", address, &PATIENT, &[])
    }

    /// What it listens on.
    pub fn address(&self) -> String {
        self.page.trim_start_matches("http://").trim_end_matches('/').to_owned()
    }

    /// Of a stream that is still being written: `bytes` so far.
    pub fn growing(bytes: &[u8]) -> Self {
        Self::serving("-", "127.0.0.1:0", &PATIENT, bytes)
    }

    fn serving(input: &str, listen: &str, flags: &[&str], written: &[u8]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("small.dgs"), stream(SMALL).to_bytes().unwrap()).unwrap();
        let mut server = Command::new(env!("CARGO_BIN_EXE_dgs"))
            .current_dir(folder.path())
            .args(["serve", input, "--listen", listen])
            .args(flags)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut stdin = server.stdin.take().unwrap();
        stdin.write_all(written).unwrap();
        let mut said = BufReader::new(server.stdout.take().unwrap());
        let (mut address, mut page) = (String::new(), String::new());
        said.read_line(&mut address).unwrap();
        said.read_line(&mut page).unwrap();
        assert!(page.starts_with("http://"), "dgs serve has ended: {:?}, {address:?}", server.wait());
        Self { page: page.trim().to_owned(), server, said, input: Some(stdin), _folder: folder }
    }

    /// Goes on writing the stream.
    pub fn write(&mut self, bytes: &[u8]) {
        let input = self.input.as_mut().unwrap();
        input.write_all(bytes).unwrap();
        input.flush().unwrap();
    }

    /// Nothing more is written.
    pub fn end(&mut self) {
        self.input = None;
    }

    /// What it says of its viewers at the end.
    pub fn stop(mut self) -> String {
        let id = self.server.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
        let mut rest = String::new();
        self.said.read_to_string(&mut rest).unwrap();
        assert!(self.server.wait().unwrap().success());
        rest
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        // It has ended already, unless a test failed.
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
