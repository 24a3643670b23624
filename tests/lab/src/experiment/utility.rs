//! Times the utilities of all groups of a stream: by the engine against every state decoded and rendered
//! alone. What orders of packets by them are worth, `order` measures.

mod order;

use std::time::Instant;

use anyhow::Result;
use dgs::{
    args::ProfileName,
    pipeline::{self, Quiet},
};
use trainer_host::{
    Scene,
    encode::Protection,
    stream::PacketMap,
    utility,
    viewpoint::{Framing, Ring},
};

use crate::{
    figures::{Bench, Figure},
    setup::{Setup, codec_args, load, synth},
};

/// Every so many cells are measured alone; the time is scaled to all.
const EVERY: usize = 40;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "utility",
        format!(
            "D = MSE + 0.20 (1 - SSIM) against the source's own render, default encode of each scene, \
             validation ring at 160x160; contexts: random states, 3 cameras, one frame per span and camera; \
             complete: all else arrived, 8 cameras; peer: each state decoded, rendered and compared alone, \
             every {EVERY}th cell (1 context), its time scaled to all cells and contexts; error: worst \
             mean of those cells, of the largest; {}",
            order::PROTOCOL
        ),
    );
    let samples = if setup.quick { 1000 } else { 10_000 };
    for (key, path) in [("fox", "scenes/gltf-fox/Fox.glb"), ("biker", "scenes/splat-biker/biker.spz")] {
        let Some(path) = setup.data(path, &mut bench)? else { continue };
        if setup.quick && key == "biker" {
            bench.skipped.push(format!("{key}: left out by --quick"));
            continue;
        }
        measure(&mut bench, key, &load(&path, samples)?, setup)?;
    }
    if setup.quick {
        measure(&mut bench, "synth-figure", &synth("figure", 2000, 8)?, setup)?;
    }
    Ok(bench)
}

fn measure(bench: &mut Bench, key: &str, scene: &Scene, setup: &Setup) -> Result<()> {
    let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::NONE);
    let stream = pipeline::encode(scene, &options, Quiet(true))?.stream;
    let (map, received) = (PacketMap::of(&stream)?, stream.receive()?);
    let content = received.content();
    let cameras = Framing::of(scene).ring(Ring::Validation, 3, (160, 160))?;
    let rings = utility::truncation_cameras(scene)?;
    let gain_cameras = utility::gain_cameras(scene)?;
    let (paper, complete) = (utility::UtilityOptions::paper(), utility::UtilityOptions::complete());
    let contexts = if setup.quick { 4 } else { paper.contexts };
    let paper = utility::UtilityOptions { contexts, ..paper };
    bench.push(Figure::new(format!("{key}.groups"), map.groups().len() as f64, "groups"));
    for (name, options, cameras) in [("contexts", paper, &cameras), ("complete", complete, &rings)] {
        let references = utility::References::renders(scene, cameras, &gain_cameras);
        let start = Instant::now();
        let table = utility::measure(&references, &content, &map, &options, &|_| {})?;
        let ours = start.elapsed().as_secs_f64();
        // One context is the first of many: the engine's own answer to it is what is compared.
        let one = utility::UtilityOptions { contexts: 1, ..options.clone() };
        let first = utility::measure(&references, &content, &map, &one, &|_| {})?;
        let start = Instant::now();
        let alone = utility::measure_alone(&references, &content, &map, &one, EVERY)?;
        let share = alone.len() as f64 / map.groups().len().max(1) as f64;
        let contexts = if options.complete { 1.0 } else { options.contexts as f64 };
        let peer = start.elapsed().as_secs_f64() / share * contexts;
        let largest = first.groups.iter().fold(0.0f64, |most, group| most.max(group.mean.abs()));
        let off = |&(group, mean): &(usize, f64)| (first.groups[group].mean - mean).abs() / largest;
        let error = alone.iter().map(off).fold(0.0, f64::max);
        bench.push(
            Figure::new(format!("{key}.{name}"), ours, "s").error(error, "worst mean, of the largest").peer(
                "each state alone",
                peer,
                true,
            ),
        );
        let rate = table.deltas as f64 / ours;
        bench.push(Figure::new(format!("{key}.{name}.rate"), rate, "utilities/s"));
        if !options.complete {
            order::measure(bench, key, scene, &stream, &table)?;
        }
    }
    Ok(())
}
