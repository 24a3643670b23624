//! Measures what the schedulers make of an encoded stream: two controllers, measured traces, paired windows.

use anyhow::{Context, Result};
use dgs::{
    args::{ControllerName, LinkArgs, ProfileName},
    pipeline,
};
use emulator_host::PolicyKind;
use rayon::prelude::*;
use trainer_host::{
    Scene,
    encode::Protection,
    stream::PacketMap,
    utility,
    viewpoint::{Framing, Ring},
};

use crate::{
    figures::{Bench, Figure, bootstrap95, mean},
    setup::{Setup, codec_args, link_args, load, synth},
};

const POLICIES: [PolicyKind; 5] = PolicyKind::ALL;

/// How it is measured.
pub(super) fn protocol(setup: &Setup) -> String {
    let (windows, samples) = size(setup);
    format!(
        "rows of ucc5g and mahimahi: the real encoded stream of fox ({samples} Gaussians) through the real \
         receiver, {windows} windows per trace (starts spread over it), the same windows, losses and seeds \
         for every scheduler; the traces at their own capacity, 2 % loss in bursts, base sets of 16 + 4; \
         capacity scaled so that the stream is 1.6 times what the clip's time carries on average where it \
         says `scaled`"
    )
}

fn size(setup: &Setup) -> (usize, usize) {
    if setup.quick { (3, 3000) } else { (12, 40_000) }
}

/// Adds the rows.
pub(super) fn run(bench: &mut Bench, setup: &Setup) -> Result<()> {
    let (windows, samples) = size(setup);
    let found = setup.data("scenes/gltf-fox/Fox.glb", bench)?;
    let scene = match found {
        Some(path) => load(&path, samples)?,
        None => synth("figure", samples, 60)?,
    };
    let traces = [
        ("ucc5g", "traces/ucc5g/driving/B_2020.01.16_07.26.43.csv"),
        ("mahimahi", "traces/mahimahi_lte/ATT-LTE-driving-2016.down"),
    ];
    let stream = pipeline::encode(
        &scene,
        &pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::STANDARD),
        setup.quiet,
    )?
    .stream;
    let map = PacketMap::of(&stream)?;
    let table = utilities(&scene, &stream, &map, setup)?;
    let graph = pipeline::graph(&stream, &map, Some(&table))?;
    let clip_s = f64::from(graph.frames()) * graph.frame_interval().as_s();
    for (trace_name, path) in traces {
        let path = setup.data(path, bench)?;
        if path.is_none() && trace_name == "mahimahi" {
            continue;
        }
        let label = if path.is_some() { trace_name } else { "built-in" };
        for scaled in [false, true] {
            if path.is_none() && !scaled {
                continue;
            }
            for controller in [ControllerName::Newreno, ControllerName::BbrModel] {
                let mut args = link_args(path.clone());
                args.controller = controller;
                args.burst_loss = Some(0.02);
                let whole = pipeline::link(&args, &graph)?;
                let trace = whole.trace().context("a link that follows a trace")?;
                if scaled && path.is_some() {
                    let wanted = graph.total_bytes() as f64 * 8.0 / clip_s / LinkArgs::LOAD;
                    args.scale = Some(wanted / trace.mean_rate().0 as f64);
                }
                let period = trace.period().as_s();
                let jobs: Vec<(usize, PolicyKind)> =
                    (0..windows).flat_map(|w| POLICIES.map(|p| (w, p))).collect();
                let results: Result<Vec<_>> = jobs
                    .par_iter()
                    .map(|&(w, policy)| {
                        let mut args = args.clone();
                        args.trace_offset = period * w as f64 / windows as f64;
                        args.link_seed = 1 + w as u64;
                        let link = pipeline::link(&args, &graph)?;
                        Ok((
                            policy,
                            pipeline::deliver(&stream, &map, &graph, &link.config, policy, args.transport)?.0,
                        ))
                    })
                    .collect();
                let results = results?;
                let controller = whole.config.controller.name();
                let load = if scaled { ".scaled" } else { "" };
                let miss_of = |policy: PolicyKind| -> Vec<f64> {
                    results.iter().filter(|r| r.0 == policy).map(|r| 100.0 * r.1.miss_rate).collect()
                };
                let layered = miss_of(PolicyKind::Layered);
                for policy in POLICIES {
                    let reports: Vec<_> = results.iter().filter(|r| r.0 == policy).map(|r| &r.1).collect();
                    let column = |f: &dyn Fn(&emulator_host::Report) -> f64| -> Vec<f64> {
                        reports.iter().map(|r| f(r)).collect()
                    };
                    let key = |what: &str| format!("{label}{load}.{controller}.{}.{what}", policy.name());
                    let started: Vec<f64> = reports.iter().filter_map(|r| r.startup_ms).collect();
                    let failed = reports.iter().filter(|r| !r.startup_reached).count();
                    bench.push(Figure::new(key("startup"), mean(&started), "ms").runs(started.len()));
                    if failed > 0 {
                        bench.push(Figure::new(key("startup_not_reached"), failed as f64, "windows"));
                    }
                    let miss = miss_of(policy);
                    let mut figure = Figure::new(key("miss"), mean(&miss), "%").runs(miss.len());
                    figure.ci95 = bootstrap95(&miss, mean, 11);
                    bench.push(figure);
                    if policy != PolicyKind::Layered {
                        let paired: Vec<f64> = miss.iter().zip(&layered).map(|(a, b)| a - b).collect();
                        let mut figure =
                            Figure::new(key("miss_less_layered"), mean(&paired), "points, paired");
                        figure.ci95 = bootstrap95(&paired, mean, 13);
                        bench.push(figure);
                    }
                    bench.push(Figure::new(key("utility"), mean(&column(&|r| r.utility)), ""));
                    let waste = column(&|r| r.waste.total_bytes() as f64 / 1048576.0);
                    bench.push(Figure::new(key("waste"), mean(&waste), "MiB"));
                }
            }
        }
    }
    Ok(())
}

/// Utilities of the groups of `stream`, from random states.
///
/// # Errors
/// What measuring refuses.
pub(super) fn utilities(
    scene: &Scene,
    stream: &trainer_host::Stream,
    map: &PacketMap,
    setup: &Setup,
) -> Result<utility::Table> {
    let cameras = Framing::of(scene).ring(Ring::Validation, 3, (96, 96))?;
    let contexts = if setup.quick { 4 } else { utility::UtilityOptions::paper().contexts };
    let options = utility::UtilityOptions { contexts, ..utility::UtilityOptions::paper() };
    let gain_cameras = utility::gain_cameras(scene)?;
    let references = utility::References::renders(scene, &cameras, &gain_cameras);
    let received = stream.receive()?;
    pipeline::utilities(&references, &received.content(), map, &options, None, setup.quiet, &mut |_| ())
}
