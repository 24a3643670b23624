//! Measures a server and its viewers over loopback: goodput, loss, processor time, memory, startup; then its
//! first image over a slow link, the sender under overload, and subscribers of a relay.

mod first_image;
mod overload;
mod relay;
pub(super) mod serving;

use std::{
    cell::Cell,
    rc::Rc,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, ensure};
use dgs::{
    args::{CodecArgs, ProfileName, SceneArgs},
    pipeline::{self, Quiet},
};
use dgs_quic::socket::{ClientConfig, NullSink, PlayReport, ServedStream, ServerReport, ViewerReport, play};
use tokio::runtime::{Builder, Runtime};

use self::serving::Serving;
use crate::{
    figures::{Bench, Figure, median},
    setup::{self, Setup},
};

/// All viewers together, bits per second.
const RATE_BPS: f64 = 50e6;
/// Frames of the clip.
const FRAMES: usize = 60;
/// Coarseness at which the stream is large for its Gaussians.
const COARSENESS: f32 = 0.01;
/// Name of the server's threads: their processor time is read by it.
const THREADS: &str = "dgs-bench-serve";

/// How much is measured.
struct Sizes {
    viewers: usize,
    gaussians: usize,
    frames_per_second: f64,
}

/// What came of it.
struct Measured {
    played: Vec<PlayReport>,
    server: ServerReport,
    viewers: Vec<ViewerReport>,
    seconds: f64,
    server_seconds: Option<f64>,
    bytes: Option<f64>,
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let sizes = if setup.quick {
        Sizes { viewers: 10, gaussians: 45_000, frames_per_second: 30.0 }
    } else {
        Sizes { viewers: 100, gaussians: 20_000, frames_per_second: 5.5 }
    };
    let mut bench = Bench::new(
        "serve",
        format!(
            "{} viewers at once over loopback, each bounded to its part of 50 Mbit/s; synth cloth, {} \
             Gaussians, {FRAMES} frames at {} fps, coarseness {COARSENESS}, deadline-utility without \
             measured utilities; clients in the same process, on threads of their own. {}. {}. {}",
            sizes.viewers,
            sizes.gaussians,
            sizes.frames_per_second,
            first_image::PROTOCOL,
            overload::PROTOCOL,
            relay::PROTOCOL
        ),
    );
    let measured = measure(&sizes, setup.quiet)?;
    check(&sizes, &measured)?;
    report(&mut bench, &sizes, &measured);
    first_image::run(&mut bench, if setup.quick { 3 } else { 15 }, setup.quiet)?;
    overload::run(&mut bench)?;
    relay::run(&mut bench, setup.quiet)?;
    Ok(bench)
}

/// Every viewer must have been served, and every datagram must have been what it should be.
fn check(sizes: &Sizes, measured: &Measured) -> Result<()> {
    ensure!(
        measured.played.len() == sizes.viewers && measured.server.viewers == sizes.viewers as u64,
        "{} viewers played and {} were served; there are {}",
        measured.played.len(),
        measured.server.viewers,
        sizes.viewers
    );
    for (played, viewer) in measured.played.iter().zip(&measured.viewers) {
        ensure!(played.shown_count == FRAMES as u64, "{} of {FRAMES} frames were shown", played.shown_count);
        ensure!(
            played.refused == 0 && viewer.refused_receipts == 0,
            "{} datagrams and {} receipts were refused",
            played.refused,
            viewer.refused_receipts
        );
    }
    Ok(())
}

fn report(bench: &mut Bench, sizes: &Sizes, measured: &Measured) {
    let Measured { played, viewers, seconds, .. } = measured;
    let sum = |values: &mut dyn Iterator<Item = u64>| values.sum::<u64>() as f64;
    let received = sum(&mut played.iter().map(|played| played.received_bytes));
    let sent_packets = sum(&mut viewers.iter().map(|viewer| viewer.packets));
    let arrived = sum(&mut played.iter().map(|played| played.packets + played.duplicates));
    // Each viewer's own time: the last to come starts later than the first.
    let rate = viewers.iter().map(|viewer| viewer.media_bytes as f64 * 8.0 / viewer.seconds.max(1e-3));
    let all = |value: &dyn Fn(&PlayReport) -> f64| played.iter().map(value).collect::<Vec<_>>();
    let late: Vec<f64> = played.iter().flat_map(|p| p.shown.iter().map(|shown| shown.late_ms)).collect();
    bench.push(Figure::new("viewers", sizes.viewers as f64, "viewers").runs(1));
    bench.push(Figure::new("goodput_mbps", received * 8e-6 / seconds, "Mbit/s"));
    bench.push(Figure::new("offered_mbps", rate.sum::<f64>() * 1e-6, "Mbit/s"));
    bench.push(Figure::new("loss_percent", 100.0 * (1.0 - arrived / sent_packets.max(1.0)), "%"));
    match measured.server_seconds {
        Some(cpu) => {
            bench.push(Figure::new("server_cpu_share", cpu / seconds, "cores"));
            let per = cpu * 1e6 / sent_packets.max(1.0);
            bench.push(Figure::new("server_us_per_packet", per, "us"));
        }
        None => bench.skipped.push("processor time: this system does not tell (/proc/self/task)".into()),
    }
    match measured.bytes {
        Some(bytes) => {
            let each = bytes / 1024.0 / sizes.viewers as f64;
            bench.push(Figure::new("memory_kib_per_viewer_and_client", each, "KiB"));
        }
        None => bench.skipped.push("memory: this system does not tell (/proc/self/status)".into()),
    }
    bench.push(Figure::new("startup_ms", median(&all(&|p| p.startup_ms.unwrap_or(f64::NAN))), "ms"));
    bench.push(Figure::new("late_ms", median(&late), "ms"));
    bench.push(Figure::new(
        "base_miss_percent",
        100.0 * dgs::figures::mean(&all(&|p| p.base_miss_rate)),
        "%",
    ));
    bench.push(Figure::new("levels_of_4", dgs::figures::mean(&all(&|p| p.mean_levels)), "levels"));
}

fn measure(sizes: &Sizes, quiet: Quiet) -> Result<Measured> {
    let offer = offer(sizes, quiet)?;
    let threads = |name: &str| Builder::new_multi_thread().enable_all().thread_name(name).build();
    let (server_side, client_side) = (threads(THREADS)?, threads("dgs-bench-play")?);
    let rate = Some((RATE_BPS / sizes.viewers as f64) as u64);
    let serving = Serving::start(&server_side, offer, |config| {
        let limits = &mut config.limits;
        (limits.max_viewers, limits.max_viewers_per_address) = (sizes.viewers, sizes.viewers);
        limits.max_rate_bps = rate;
    })?;
    let before = (resident_bytes(), thread_seconds(THREADS));
    let start = Instant::now();
    let (played, bytes) = watch(&client_side, &serving.client, sizes.viewers)?;
    let seconds = start.elapsed().as_secs_f64();
    let server_seconds = thread_seconds(THREADS).zip(before.1).map(|(after, before)| after - before);
    let (server, viewers) = serving.stop(&server_side)?;
    let bytes = bytes.zip(before.0).map(|(after, before)| after - before);
    Ok(Measured { played, server, viewers, seconds, server_seconds, bytes })
}

/// All viewers play the clip; their reports, and the memory of the process while they do.
fn watch(runtime: &Runtime, config: &ClientConfig, viewers: usize) -> Result<(Vec<PlayReport>, Option<f64>)> {
    let task = |config: ClientConfig| async move {
        play(&config, &mut NullSink, std::future::pending()).await.whole()
    };
    let tasks: Vec<_> = (0..viewers).map(|_| task(config.clone())).collect();
    runtime.block_on(async {
        // Players are not sent between threads once they play; one thread carries them all.
        let local = tokio::task::LocalSet::new();
        let tasks: Vec<_> = tasks.into_iter().map(|task| local.spawn_local(task)).collect();
        let peak = Rc::new(Cell::new(resident_bytes()));
        let seen = Rc::clone(&peak);
        let watching = local.spawn_local(async move {
            loop {
                tokio::time::sleep(Duration::from_millis(100)).await;
                seen.set(resident_bytes().zip(seen.get()).map(|(now, peak)| now.max(peak)));
            }
        });
        let played = async {
            let mut played = Vec::new();
            for task in tasks {
                played.push(task.await.context("a viewer failed")??);
            }
            watching.abort();
            anyhow::Ok((played, peak.get()))
        };
        local.run_until(played).await
    })
}

/// The stream that everybody watches.
fn offer(sizes: &Sizes, quiet: Quiet) -> Result<ServedStream> {
    let args = SceneArgs { fps: Some(sizes.frames_per_second), ..setup::scene_args(sizes.gaussians) };
    let scene = pipeline::import(&format!("synth:cloth:{}:{FRAMES}", sizes.gaussians), &args)?.scene;
    let codec = CodecArgs {
        coarseness: COARSENESS,
        pictures: Some(0),
        window_frames: Some(15),
        ..setup::codec_args(ProfileName::Dgs1)
    };
    let options = pipeline::encode_options(&codec, trainer_host::encode::Protection::STANDARD);
    let stream = pipeline::encode(&scene, &options, quiet)?.stream;
    let map = trainer_host::stream::PacketMap::of(&stream)?;
    let graph = pipeline::graph(&stream, &map, None)?;
    Ok(ServedStream::new("cloth", &stream, graph)?)
}

/// Bytes of this process in memory.
fn resident_bytes() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmRSS:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<f64>().ok()? * 1024.0)
}

/// Processor seconds of this process's threads of this name.
fn thread_seconds(name: &str) -> Option<f64> {
    /// Clock ticks per second, as Linux shows them to programs.
    const TICKS: f64 = 100.0;
    let mut ticks = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("stat")).ok()?;
        let (head, tail) = text.rsplit_once(')')?;
        if head.split_once('(').is_some_and(|(_, comm)| comm == name) {
            let fields: Vec<&str> = tail.split_whitespace().collect();
            ticks += fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?;
        }
    }
    Some(ticks / TICKS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured() -> Measured {
        let played = PlayReport { shown_count: FRAMES as u64, packets: 90, ..PlayReport::default() };
        let viewer = ViewerReport {
            address: ([127, 0, 0, 1], 1).into(),
            stream: "cloth".to_owned(),
            scheduler: "deadline-utility",
            seconds: 2.0,
            rounds: 1,
            packets: 100,
            media_bytes: 100_000,
            retransmitted: 0,
            parity: 0,
            lost: 10,
            receipts: 50,
            located: false,
            refused_receipts: 0,
            rtt_ms: 1.0,
            end: String::new(),
        };
        let server = ServerReport { viewers: 1, ..ServerReport::default() };
        Measured {
            played: vec![played],
            server,
            viewers: vec![viewer],
            seconds: 2.0,
            server_seconds: Some(0.5),
            bytes: None,
        }
    }

    #[test]
    fn what_is_missing_is_found_and_what_was_lost_is_counted() {
        let sizes = Sizes { viewers: 1, gaussians: 1, frames_per_second: 30.0 };
        let good = measured();
        check(&sizes, &good).unwrap();
        let mut bench = Bench::new("serve", "");
        report(&mut bench, &sizes, &good);
        let value = |key: &str| bench.figures.iter().find(|figure| figure.key == key).unwrap().value;
        assert!((value("loss_percent") - 10.0).abs() < 1e-9);
        assert_eq!((value("server_cpu_share"), value("server_us_per_packet")), (0.25, 5000.0));
        for spoil in [
            |m: &mut Measured| m.played[0].shown_count -= 1,
            |m: &mut Measured| m.played[0].refused = 1,
            |m: &mut Measured| m.viewers[0].refused_receipts = 1,
            |m: &mut Measured| m.server.viewers = 0,
        ] {
            let mut bad = measured();
            spoil(&mut bad);
            assert!(check(&sizes, &bad).is_err());
        }
    }
}
