//! Measures two subscribers of a relay of Media over QUIC, one behind a link that carries half of the stream.

use std::{path::Path, time::Duration};

use anyhow::{Context, Result, bail};
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use dgs_quic::{
    moq::{PublishConfig, play, publish},
    socket::{
        ClientConfig, Locator, NullSink, PlayReport, Scheme, ServedStream, Trust, message::StreamChoice,
    },
};
use emulator_host::{
    Bytes, Nanos, PacketGraph, Rate,
    link::{Capacity, PathConfig, QueueLimit},
};
use tokio::runtime::Runtime;

use crate::{
    figures::{Bench, Figure},
    relay::{link::Link, program::Program},
    setup,
};

/// What the protocol says of it.
pub const PROTOCOL: &str = "relay: moq-relay on this machine, synth cloth, 20,000 Gaussians, 90 frames in \
     windows of 30, a publisher and two subscribers for 9 s, one of them behind an emulated link of half of \
     the stream's rate and 40 ms";
const GAUSSIANS: usize = 20_000;
const NAME: &str = "cloth";
/// How long is played: three times the clip.
const SECONDS: u64 = 9;

/// Enters what both subscribers saw.
pub fn run(bench: &mut Bench, quiet: Quiet) -> Result<()> {
    let (offer, graph) = offer(quiet)?;
    let clip = graph.frame_interval().times(graph.frames().into());
    let rate = Rate::over(Bytes(graph.total_bytes()), clip);
    let played = Runtime::new()?.block_on(measure(&offer, rate))?;
    let Some((wide, narrow)) = played else {
        bench.skipped.push("relay: moq-relay is not installed here; .ci/run installs it".to_owned());
        return Ok(());
    };
    bench.push(Figure::new("relay.stream_kbps", rate.0 as f64 * 1e-3, "kbit/s"));
    for (path, report) in [("wide", &wide), ("narrow", &narrow)] {
        let figure =
            |key: &str, value: f64, unit: &str| Figure::new(format!("relay.{path}.{key}"), value, unit);
        bench.push(figure("frames", report.shown_count as f64, "frames"));
        bench.push(figure("levels_of_4", report.mean_levels, "levels"));
        bench.push(figure("base_miss_percent", 100.0 * report.base_miss_rate, "%"));
        bench.push(figure("kib", report.received_bytes as f64 / 1024.0, "KiB"));
        bench.push(figure("startup_ms", report.startup_ms.unwrap_or(f64::NAN), "ms"));
    }
    Ok(())
}

fn offer(quiet: Quiet) -> Result<(ServedStream, PacketGraph)> {
    let args = setup::scene_args(GAUSSIANS);
    let scene = pipeline::import(&format!("synth:cloth:{GAUSSIANS}:90"), &args)?.scene;
    let codec = dgs::args::CodecArgs {
        pictures: Some(0),
        window_frames: Some(30),
        ..setup::codec_args(ProfileName::Dgs1)
    };
    let options = pipeline::encode_options(&codec, trainer_host::encode::Protection::STANDARD);
    let stream = pipeline::encode(&scene, &options, quiet)?.stream;
    let map = trainer_host::stream::PacketMap::of(&stream)?;
    let graph = pipeline::graph(&stream, &map, None)?;
    Ok((ServedStream::new(NAME, &stream, graph.clone())?, graph))
}

/// The subscriber at the relay, and the one behind a link of half of `rate`; `None` without a relay.
async fn measure(offer: &ServedStream, rate: Rate) -> Result<Option<(PlayReport, PlayReport)>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let Some(relay) = Program::start(&root).await? else { return Ok(None) };
    let path = PathConfig {
        capacity: Capacity::Constant(rate.scaled(1, 2)),
        queue: QueueLimit { bytes: 62_500, ..QueueLimit::default() },
        delay: Nanos::from_ms(40),
        ..PathConfig::default()
    };
    let link = Link::start(relay.port, &path, 1).await?;
    let trust = Trust::Pin(relay.pin);
    let address = |port| Locator {
        scheme: Scheme::Moq,
        host: "127.0.0.1".to_owned(),
        port,
        stream: StreamChoice::Name(NAME.to_owned()),
        pin: None,
    };
    let subscriber = |port| {
        let duration = Some(Duration::from_secs(SECONDS));
        ClientConfig { loops: true, duration, ..ClientConfig::new(address(port), trust.clone()) }
    };
    let (wide, narrow) = (subscriber(relay.port), subscriber(link.port));
    let (mut one, mut other) = (NullSink, NullSink);
    let both = async {
        tokio::join!(
            play(&wide, &mut one, std::future::pending()),
            play(&narrow, &mut other, std::future::pending())
        )
    };
    let config = PublishConfig::new(address(relay.port), trust.clone());
    let offers = std::slice::from_ref(offer);
    tokio::select! {
        published = publish(&config, offers, std::future::pending(), |_| ()) => {
            published.context("publishing ended")?;
            bail!("publishing ended before the subscribers");
        }
        (wide, narrow) = both => Ok(Some((wide.whole()?, narrow.whole()?))),
    }
}
