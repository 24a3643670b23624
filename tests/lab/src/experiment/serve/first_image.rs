//! Measures how long a viewer waits for its first image over a slow link.

use anyhow::{Context, Result};
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use dgs_quic::socket::{ClientConfig, Impairment, NullSink, ServedStream, play};
use emulator_host::{
    Nanos, Rate,
    link::{Capacity, PathConfig, QueueLimit},
};
use tokio::runtime::Runtime;

use super::serving::Serving;
use crate::{
    figures::{Bench, Figure, median},
    setup,
};

/// What the protocol says of it.
pub const PROTOCOL: &str = "first image: synth cloth, 30,000 Gaussians, 60 frames, sockets with an \
     emulated link of 2 Mbit/s and 40 ms of round trip; from the first packet of the handshake to the first \
     frame shown, with 95 % of the base there";
const GAUSSIANS: usize = 30_000;

/// Enters the median of some viewers, one after the other.
pub fn run(bench: &mut Bench, viewers: usize, quiet: Quiet) -> Result<()> {
    let scene =
        pipeline::import(&format!("synth:cloth:{GAUSSIANS}:60"), &setup::scene_args(GAUSSIANS))?.scene;
    let codec = setup::codec_args(ProfileName::Dgs1);
    let options = pipeline::encode_options(&codec, trainer_host::encode::Protection::STANDARD);
    let stream = pipeline::encode(&scene, &options, quiet)?.stream;
    let map = trainer_host::stream::PacketMap::of(&stream)?;
    let offer = ServedStream::new("cloth", &stream, pipeline::graph(&stream, &map, None)?)?;
    let path = PathConfig {
        capacity: Capacity::Constant(Rate::from_mbps(2)),
        queue: QueueLimit { bytes: 62_500, ..QueueLimit::default() },
        // What viewers send is not delayed, so all of the round trip is on the way to them.
        delay: Nanos::from_ms(40),
        ..PathConfig::default()
    };
    let runtime = Runtime::new()?;
    let impairment = Some(Impairment { path, seed: 1 });
    let serving = Serving::start(&runtime, offer, |config| config.impairment = impairment)?;
    let (mut waits, mut reached) = (Vec::new(), 0);
    for _ in 0..viewers {
        let duration = Some(std::time::Duration::from_secs(3));
        let config = ClientConfig { duration, ..serving.client.clone() };
        let report = runtime.block_on(play(&config, &mut NullSink, std::future::pending())).whole()?;
        waits.push(report.startup_ms.context("nothing was shown within 3 s")?);
        reached += usize::from(report.startup_reached);
    }
    serving.stop(&runtime)?;
    bench.push(Figure::new("first_image_ms", median(&waits), "ms").runs(viewers));
    bench.push(Figure::new("first_image_reached", reached as f64, "viewers"));
    bench.push(Figure::new("first_image_manifest_bytes", stream.message().len() as f64, "bytes"));
    Ok(())
}
