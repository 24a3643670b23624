//! Measures the player in a browser: time to the first picture, frames per second, bytes, memory.

use std::{io::Write as _, net::Ipv4Addr, thread, time::Instant};

use anyhow::{Context, Result, ensure};
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use dgs_quic::http::{HttpConfig, HttpLimits, HttpServer, Site, SiteStream};
use flate2::{Compression, write::GzEncoder};
use tokio::{runtime::Runtime, sync::oneshot};
use trainer_host::encode::Protection;

use crate::{
    browser::Browser,
    figures::{Bench, Figure, median},
    setup::{self, Setup},
};

/// Size of the pictures.
const SIZE: [u32; 2] = [640, 360];
/// Frames of the clips.
const FRAMES: usize = 30;
/// Most bytes of player and glue, compressed.
const MOST_BYTES: f64 = 1.5e6;
/// How long frames are counted, seconds.
const COUNTED_S: f64 = 5.0;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let sizes: &[usize] = if setup.quick { &[30_000] } else { &[30_000, 150_000] };
    let runs = if setup.quick { 1 } else { 5 };
    let mut bench = Bench::new(
        "view",
        format!(
            "page and file over HTTP on loopback, headless Chromium with a software adapter (SwiftShader), \
             {}x{} pixels; synth figure of {sizes:?} Gaussians, {FRAMES} frames; frames counted for \
             {COUNTED_S} s of playing; first picture from the start of navigation, {runs} runs",
            SIZE[0], SIZE[1]
        ),
    );
    package(&mut bench)?;
    if Browser::program().is_none() {
        bench.skipped.push("chromium is not installed: no pictures".into());
        return Ok(bench);
    }
    for &gaussians in sizes {
        play(&mut bench, gaussians, runs, setup.quiet)?;
    }
    Ok(bench)
}

/// Bytes of what a browser loads.
fn package(bench: &mut Bench) -> Result<()> {
    let mut all = 0.0;
    for name in ["dgs_viewer_bg.wasm", "dgs_viewer.js"] {
        let bytes = dgs_viewer::asset(name).with_context(|| format!("{name} is not built in"))?.bytes;
        let gzip = gzipped(bytes)?;
        all += gzip;
        bench.push(Figure::new(format!("bytes.{name}"), bytes.len() as f64, "bytes"));
        bench.push(Figure::new(format!("gzip_bytes.{name}"), gzip, "bytes"));
    }
    bench.push(Figure::new("gzip_bytes.player", all, "bytes").peer("aim", MOST_BYTES, true));
    ensure!(all <= MOST_BYTES, "the player takes {all} bytes compressed; {MOST_BYTES} are allowed");
    Ok(())
}

fn gzipped(bytes: &[u8]) -> Result<f64> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes)?;
    Ok(encoder.finish()?.len() as f64)
}

/// One stream in a browser.
fn play(bench: &mut Bench, gaussians: usize, runs: usize, quiet: Quiet) -> Result<()> {
    let scene = setup::synth("figure", gaussians, FRAMES)?;
    let options = pipeline::encode_options(&setup::codec_args(ProfileName::Dgs1), Protection::STANDARD);
    let file = pipeline::encode(&scene, &options, quiet)?.stream.to_bytes()?;
    bench.push(Figure::new(format!("{gaussians}.file_bytes"), file.len() as f64, "bytes"));
    let (url, stop) = serve(file)?;
    let address = format!("{url}?src=streams/scene.dgs&pixel-ratio=1");
    let mut firsts = Vec::new();
    let mut browser = Browser::open(SIZE[0], SIZE[1])?;
    for _ in 0..runs {
        browser.go("about:blank")?;
        let began = Instant::now();
        browser.go(&address)?;
        browser.wait(120, "document.querySelector('dgs-player')?.engine?.frames > 0")?;
        // What the page itself says, in its own time: this side asks ten times a second only.
        let own = browser.run("document.querySelector('dgs-player').firstFrameMs")?;
        firsts.push(own.as_f64().unwrap_or_else(|| 1e3 * began.elapsed().as_secs_f64()));
    }
    bench.push(Figure::new(format!("{gaussians}.first_picture_ms"), median(&firsts), "ms").runs(runs));
    browser.wait(120, "(globalThis.player = document.querySelector('dgs-player')).buffered === 1")?;
    let counted = "(async () => { const { engine } = player; player.play();\
         const begin = engine.frames, start = performance.now();\
         await new Promise((done) => setTimeout(done, MS));\
         return 1000 * (engine.frames - begin) / (performance.now() - start); })()";
    let rate = browser.run(&counted.replace("MS", &format!("{}", 1e3 * COUNTED_S)))?;
    let rate = rate.as_f64().context("no rate came")?;
    ensure!(rate > 0.0, "{gaussians} Gaussians: nothing was drawn in {COUNTED_S} s");
    bench.push(Figure::new(format!("{gaussians}.frames_per_s"), rate, "1/s"));
    for kind in ["wasm", "device"] {
        let bytes = browser.run(&format!("player.engine.memory.{kind}"))?;
        let bytes = bytes.as_f64().context("no bytes came")?;
        bench.push(Figure::new(format!("{gaussians}.memory.{kind}_mib"), bytes / f64::from(1 << 20), "MiB"));
    }
    ensure!(browser.complaints.is_empty(), "the page complains: {:?}", browser.complaints);
    drop(stop);
    Ok(())
}

/// Serves the page and `file` until what is returned is dropped.
fn serve(file: Vec<u8>) -> Result<(String, oneshot::Sender<()>)> {
    let (web_address, address) = (None, None);
    let stream = SiteStream { name: "scene".to_owned(), address, web_address, file: Some(file.into()) };
    let page = |path: &str| dgs_viewer::asset(path).map(|asset| (asset.bytes, asset.content_type));
    let site = Site::new(page, &[stream], None)?;
    let runtime = Runtime::new()?;
    let (stop, stopped) = oneshot::channel::<()>();
    let config = HttpConfig { bind: (Ipv4Addr::LOCALHOST, 0).into(), limits: HttpLimits::default() };
    let server = runtime.block_on(async { HttpServer::bind(&config, site) })?;
    let url = format!("http://localhost:{}/", server.local_addr()?.port());
    thread::spawn(move || runtime.block_on(server.run(async { stopped.await.unwrap_or(()) })));
    Ok((url, stop))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_repeats_is_small_and_noise_is_not() {
        assert!(gzipped(&[7; 100_000]).unwrap() < 500.0);
        // Xorshift (Marsaglia 2003).
        let mut state = 1u64;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u8
        };
        let noise: Vec<u8> = (0..10_000).map(|_| next()).collect();
        assert!(gzipped(&noise).unwrap() > 5000.0);
    }
}
