//! Measures the player in a browser: time to the first picture, frames per second, bytes, memory; and what it
//! leaves out where it cannot keep up.

mod slow_link;
mod steps;

use std::{io::Write as _, net::Ipv4Addr, thread, time::Instant};

use anyhow::{Context, Result, ensure};
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use dgs_player::Stream;
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
/// Most bytes of player, glue, page and scripts, compressed.
const MAX_BYTES: f64 = 1.5e6;
/// How long frames are counted, seconds.
const COUNTED_S: f64 = 5.0;

/// Plays and counts for `MS` milliseconds: frames and steps of the clock per second; the longest task of the
/// page's thread that the browser reports, which are those of 50 ms and more; the longest time between two
/// turns of a timer of that thread.
const COUNT: &str = "(async () => { const { engine } = player; player.play();\
    const begin = engine.frames, start = performance.now();\
    let [task, wait, steps, going] = [0, 0, 0, true];\
    const seen = new PerformanceObserver((list) =>\
        list.getEntries().forEach((entry) => (task = Math.max(task, entry.duration))));\
    seen.observe({ type: 'longtask' });\
    let last = performance.now();\
    const turn = () => { const now = performance.now(); wait = Math.max(wait, now - last); last = now;\
        if (going) setTimeout(turn, 1); }; turn();\
    const step = () => { steps += 1; if (going) requestAnimationFrame(step); }; step();\
    await new Promise((done) => setTimeout(done, MS)); going = false;\
    const seconds = (performance.now() - start) / 1000;\
    const { scale, degree, cap, share } = player.session.drawn; player.pause();\
    return [(engine.frames - begin) / seconds, steps / seconds, task, wait, scale, degree, cap, share]; })()";

/// What the browser calls its adapter.
const ADAPTER: &str = "(async () => { const { info } = await navigator.gpu.requestAdapter();\
    return [info.vendor, info.architecture, info.device, info.description].filter(Boolean).join(' '); })()";

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let sizes: &[usize] = if setup.quick { &[30_000] } else { &[30_000, 150_000] };
    let runs = if setup.quick { 1 } else { 5 };
    let mut bench = Bench::new(
        "view",
        format!(
            "page and file over HTTP on loopback, headless Chromium with a software adapter (SwiftShader), \
             {}x{} pixels; synth figure of {sizes:?} Gaussians, {FRAMES} frames; frames counted for \
             {COUNTED_S} s of playing, without and with what keeps up (.adapting); first picture from the \
             start of navigation, {runs} runs",
            SIZE[0], SIZE[1]
        ),
    );
    package(&mut bench)?;
    if setup.quick {
        bench.skipped.push("steps of keeping up and the slow link: not with --quick".into());
    } else {
        bench.also(steps::PROTOCOL);
        bench.also(slow_link::PROTOCOL);
        for &gaussians in sizes {
            let file = encoded(gaussians, setup.quiet)?.to_bytes()?;
            steps::run(&mut bench, &gaussians.to_string(), &file, FRAMES as u32)?;
        }
    }
    if Browser::program().is_none() {
        bench.skipped.push("chromium is not installed: no pictures".into());
        return Ok(bench);
    }
    for &gaussians in sizes {
        play(&mut bench, gaussians, runs, setup)?;
    }
    Ok(bench)
}

/// What a browser loads: the page, and all that it and its scripts name, each once.
fn loaded() -> Vec<&'static str> {
    let mut names = vec!["index.html"];
    let mut at = 0;
    while let Some(asset) = names.get(at).copied().and_then(dgs_viewer::asset) {
        at += 1;
        // WebAssembly names nothing.
        let text = std::str::from_utf8(asset.bytes).unwrap_or("");
        for wording in ["\"./", "href=\""] {
            for part in text.split(wording).skip(1) {
                let named = part.split('"').next().unwrap_or("");
                let is_known = named.is_empty() || names.contains(&named);
                if !is_known && dgs_viewer::asset(named).is_some() {
                    names.push(named);
                }
            }
        }
    }
    names
}

/// Bytes of what a browser loads, each file compressed by itself as a server sends it.
fn package(bench: &mut Bench) -> Result<()> {
    let (mut all, mut page) = (0.0, 0.0);
    for name in loaded() {
        let bytes = dgs_viewer::asset(name).with_context(|| format!("{name} is not built in"))?.bytes;
        let gzip = gzipped(bytes)?;
        all += gzip;
        if name.starts_with("dgs_viewer") {
            bench.push(Figure::new(format!("bytes.{name}"), bytes.len() as f64, "bytes"));
            bench.push(Figure::new(format!("gzip_bytes.{name}"), gzip, "bytes"));
        } else {
            page += gzip;
        }
    }
    bench.push(Figure::new("gzip_bytes.page", page, "bytes"));
    bench.push(Figure::new("gzip_bytes.player", all, "bytes").peer("aim", MAX_BYTES, true));
    ensure!(all <= MAX_BYTES, "the player takes {all} bytes compressed; {MAX_BYTES} are allowed");
    Ok(())
}

fn gzipped(bytes: &[u8]) -> Result<f64> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes)?;
    Ok(encoder.finish()?.len() as f64)
}

/// The scene of so many Gaussians.
fn encoded(gaussians: usize, quiet: Quiet) -> Result<Stream> {
    let scene = setup::synth("figure", gaussians, FRAMES)?;
    let options = pipeline::encode_options(&setup::codec_args(ProfileName::Dgs1), Protection::STANDARD);
    Ok(pipeline::encode(&scene, &options, quiet)?.stream)
}

/// One stream in a browser.
fn play(bench: &mut Bench, gaussians: usize, runs: usize, setup: &Setup) -> Result<()> {
    let stream = encoded(gaussians, setup.quiet)?;
    let file = stream.to_bytes()?;
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
    if bench.machine.device.is_none() {
        let name = browser.run(ADAPTER)?;
        bench.machine.device = name.as_str().map(|name| format!("browser: {name}"));
    }
    let ways = [("&worker=off&adapt=off", ".page"), ("&adapt=off", ""), ("", ".adapting")];
    for (query, key) in ways.into_iter().filter(|(_, key)| !setup.quick || *key != ".adapting") {
        browser.go("about:blank")?;
        browser.go(&format!("{address}{query}"))?;
        browser.wait(120, "document.querySelector('dgs-player')?.engine?.frames > 0")?;
        browser.wait(120, "(globalThis.player = document.querySelector('dgs-player')).buffered === 1")?;
        let counted = browser.run(&COUNT.replace("MS", &format!("{}", 1e3 * COUNTED_S)))?;
        let figure = |at: usize| counted[at].as_f64().context("no figure came");
        for (at, name, unit) in [
            (0, "frames_per_s", "1/s"),
            (1, "clock_steps_per_s", "1/s"),
            (2, "longest_task_ms", "ms"),
            (3, "longest_wait_ms", "ms"),
        ] {
            bench.push(Figure::new(format!("{gaussians}{key}.{name}"), figure(at)?, unit));
        }
        if key == ".adapting" {
            let drawn = [(4, "pixels_of_a_side"), (5, "sh_degree"), (6, "level"), (7, "gaussians")];
            for (at, name) in drawn {
                bench.push(Figure::new(format!("{gaussians}{key}.drawn.{name}"), figure(at)?, ""));
            }
        }
    }
    for kind in ["wasm", "device"] {
        let bytes = browser.run(&format!("player.engine.memory.{kind}"))?;
        let bytes = bytes.as_f64().context("no bytes came")?;
        bench.push(Figure::new(format!("{gaussians}.memory.{kind}_mib"), bytes / f64::from(1 << 20), "MiB"));
    }
    ensure!(browser.complaints.is_empty(), "the page complains: {:?}", browser.complaints);
    drop(stop);
    drop(browser);
    if setup.quick {
        return Ok(());
    }
    slow_link::run(bench, gaussians, &stream, SIZE, runs)
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

    /// Nothing that a browser loads is left out of the count.
    #[test]
    fn every_file_of_the_page_is_counted() {
        let names = loaded();
        for folder in ["page", "dist"] {
            let path = format!("{}/../../render-host/viewer/{folder}", env!("CARGO_MANIFEST_DIR"));
            for entry in std::fs::read_dir(path).unwrap() {
                let name = entry.unwrap().file_name().into_string().unwrap();
                let counts = names.iter().filter(|counted| **counted == name).count();
                let is_loaded = !name.ends_with(".d.ts") && name != "sources.txt";
                assert_eq!(counts, usize::from(is_loaded), "{name}");
            }
        }
    }

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
