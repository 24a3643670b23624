//! A browser opens a session by WebTransport: it knows the certificate by its pin, and gets what it asks for.
//!
//! Where there is no Chromium the test says so and is skipped; with CI=true it fails there.

use std::{
    path::PathBuf,
    process::{Child, Command, Stdio},
    sync::{Mutex, PoisonError},
    time::Instant,
};

use super::*;
use crate::http::{HttpConfig, HttpLimits, HttpServer, Site, SiteStream};

const PAGE: &[u8] = include_bytes!("browser.html");
/// How long a browser may take on a busy machine.
const LIMIT: Duration = Duration::from_secs(120);

/// What the page has said: it asks for paths that begin with `says/`.
static SAID: Mutex<Vec<String>> = Mutex::new(Vec::new());

fn assets(path: &str) -> Option<(&'static [u8], &'static str)> {
    if let Some(said) = path.strip_prefix("says/") {
        SAID.lock().unwrap_or_else(PoisonError::into_inner).push(said.to_owned());
        return Some((b"", "text/plain"));
    }
    (path == "index.html").then_some((PAGE, "text/html; charset=utf-8"))
}

fn said() -> Vec<String> {
    SAID.lock().unwrap_or_else(PoisonError::into_inner).clone()
}

/// The program, or nothing if there is none.
fn chromium() -> Option<PathBuf> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut places =
        std::env::split_paths(&path).flat_map(|folder| names.iter().map(move |name| folder.join(name)));
    places.find(|place| place.is_file())
}

/// A browser that ends with the test.
struct Browser(Child);

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn a_browser_gets_manifest_and_media_and_hears_refusals() {
    let Some(program) = chromium() else {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "chromium is missing");
        eprintln!("warning: chromium is missing; skipped");
        return;
    };
    let runtime = Runtime::new().unwrap();
    runtime.block_on(async {
        let server = Running::start(ServerLimits::default());
        let Trust::Pin(pin) = &server.trust else { panic!("known by a pin") };
        let listed = SiteStream {
            name: "everything".to_owned(),
            address: None,
            web_address: Some(format!("https://{}/everything", server.address)),
            file: None,
        };
        let site = Site::new(assets, &[listed], Some(*pin)).unwrap();
        let config = HttpConfig { bind: (Ipv4Addr::LOCALHOST, 0).into(), limits: HttpLimits::default() };
        let pages = HttpServer::bind(&config, site).unwrap();
        let url = format!("http://{}/", pages.local_addr().unwrap());
        let (stop, stopped) = oneshot::channel::<()>();
        let pages = tokio::spawn(pages.run(async { drop(stopped.await) }));
        let profile = tempfile::tempdir().unwrap();
        let browser = Command::new(program)
            .args(["--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run"])
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .arg(url)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let browser = Browser(browser);
        let began = Instant::now();
        while !said().iter().any(|said| said.starts_with("end")) {
            assert!(began.elapsed() < LIMIT, "the page has said no more than {:?}", said());
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        drop(browser);
        let wanted = [
            format!("manifest-{}", stream().message().len()),
            "media-3".to_owned(),
            "refused-2-true".to_owned(),
            "wrong-pin".to_owned(),
            "end".to_owned(),
        ];
        stop.send(()).unwrap();
        pages.await.unwrap();
        let (report, viewers) = server.stop().await;
        assert_eq!(said(), wanted, "{report:?} {viewers:?}");
        assert_eq!((report.viewers, report.refused.get("unknown stream")), (1, Some(&1)), "{report:?}");
        let viewer = &viewers[0];
        assert!(viewer.end.contains("is through") && viewer.receipts == 1, "{viewer:?}");
    });
}
