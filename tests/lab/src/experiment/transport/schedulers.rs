//! Measures what the schedulers make of an encoded stream: two controllers, measured traces, paired windows.

use anyhow::{Context, Result};
use dgs::{
    args::{ControllerName, LinkArgs, ProfileName},
    pipeline,
};
use emulator_host::{PolicyKind, Report};
use rayon::prelude::*;
use trainer_host::{
    Scene,
    encode::Protection,
    stream::PacketMap,
    utility,
    viewpoint::{Framing, Ring},
};

use super::paired::{Window, clustered};
use crate::{
    figures::{Bench, Figure},
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
         capacity scaled so that the stream is {} times what the clip's time carries on average where it \
         says `scaled`; positive_miss: of groups of positive utility; less_layered: paired; rows of \
         every_trace: both traces; intervals by trace, then window",
        LinkArgs::LOAD
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
    let table = utilities(&scene, &stream, setup)?;
    let graph = pipeline::graph(&stream, &map, Some(&table))?;
    let clip_s = f64::from(graph.frames()) * graph.frame_interval().as_s();
    // Windows of every controller and load over all traces, beside those of each trace.
    let mut together: Vec<(String, Vec<Window<Delivered>>)> = Vec::new();
    for (number, (trace_name, path)) in traces.into_iter().enumerate() {
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
                let results: Result<Vec<Delivered>> = jobs
                    .par_iter()
                    .map(|&(w, policy)| {
                        let mut args = args.clone();
                        args.trace_offset = period * w as f64 / windows as f64;
                        args.link_seed = 1 + w as u64;
                        let link = pipeline::link(&args, &graph)?;
                        let report =
                            pipeline::deliver(&stream, &map, &graph, &link.config, policy, args.transport)?.0;
                        Ok(Delivered::of(&report))
                    })
                    .collect();
                let results = results?;
                let of_windows = results.chunks(POLICIES.len()).map(|runs| Window {
                    family: trace_name,
                    trace: number,
                    runs: runs.to_vec(),
                });
                let of_windows: Vec<Window<Delivered>> = of_windows.collect();
                let controller = whole.config.controller.name();
                let load = if scaled { ".scaled" } else { "" };
                push_rows(bench, &format!("{label}{load}.{controller}"), &of_windows);
                let key = format!("every_trace{load}.{controller}");
                match together.iter_mut().find(|(known, _)| *known == key) {
                    Some((_, windows)) => windows.extend(of_windows),
                    None => together.push((key, of_windows)),
                }
            }
        }
    }
    let has_traces = |windows: &[Window<Delivered>]| windows.iter().any(|w| w.trace != windows[0].trace);
    for (key, windows) in together.iter().filter(|(_, windows)| has_traces(windows)) {
        push_rows(bench, key, windows);
    }
    Ok(())
}

/// What one run delivered.
#[derive(Clone, Copy, Debug)]
struct Delivered {
    /// NaN if playout never began.
    startup_ms: f64,
    startup_reached: bool,
    miss: f64,
    /// Of groups of positive utility.
    positive_miss: f64,
    utility: f64,
    waste_bytes: u64,
}

impl Delivered {
    fn of(report: &Report) -> Self {
        Self {
            startup_ms: report.startup_ms.unwrap_or(f64::NAN),
            startup_reached: report.startup_reached,
            miss: report.miss_rate,
            positive_miss: report.positive_miss_rate,
            utility: report.utility,
            waste_bytes: report.waste.total_bytes(),
        }
    }
}

/// Name, value of a run, unit.
type Column = (&'static str, fn(&Delivered) -> f64, &'static str);

const COLUMNS: [Column; 5] = [
    ("startup", |run| run.startup_ms, "ms"),
    ("miss", |run| 100.0 * run.miss, "%"),
    ("positive_miss", |run| 100.0 * run.positive_miss, "%"),
    ("utility", |run| run.utility, ""),
    ("waste", |run| run.waste_bytes as f64 / 1_048_576.0, "MiB"),
];

/// Adds what each scheduler delivered in `windows`, and what it did less `layered` there.
fn push_rows(bench: &mut Bench, key: &str, windows: &[Window<Delivered>]) {
    let layered = POLICIES.iter().position(|policy| *policy == PolicyKind::Layered).unwrap_or(0);
    for (at, policy) in POLICIES.iter().enumerate() {
        let name = policy.name();
        let failed = windows.iter().filter(|window| !window.runs[at].startup_reached).count();
        if failed > 0 {
            let key = format!("{key}.{name}.startup_not_reached");
            bench.push(Figure::new(key, failed as f64, "windows"));
        }
        for (column, of, unit) in COLUMNS {
            push_mean(bench, (format!("{key}.{name}.{column}"), unit), windows, &|window| {
                of(&window.runs[at])
            });
            if at == layered {
                continue;
            }
            let unit = match unit {
                "" => "paired".to_owned(),
                "%" => "points, paired".to_owned(),
                _ => format!("{unit}, paired"),
            };
            let less = |window: &Window<Delivered>| of(&window.runs[at]) - of(&window.runs[layered]);
            push_mean(bench, (format!("{key}.{name}.{column}_less_layered"), unit.as_str()), windows, &less);
        }
    }
}

/// Adds the mean of `value` over those windows that have one, its interval by trace, then window.
fn push_mean(
    bench: &mut Bench,
    (key, unit): (String, &str),
    windows: &[Window<Delivered>],
    value: &dyn Fn(&Window<Delivered>) -> f64,
) {
    let own: Vec<Window<Delivered>> =
        windows.iter().filter(|window| value(window).is_finite()).cloned().collect();
    let (mean, ci) =
        clustered(&own, &|drawn| drawn.iter().map(|window| value(window)).sum::<f64>() / drawn.len() as f64);
    let mut figure = Figure::new(key, mean, unit).runs(own.len());
    // A single window says nothing of others.
    figure.ci95 = (own.len() > 1).then_some(ci);
    bench.push(figure);
}

/// Utilities of the groups of `stream`, from random states.
///
/// # Errors
/// What measuring refuses.
pub(super) fn utilities(
    scene: &Scene,
    stream: &trainer_host::Stream,
    setup: &Setup,
) -> Result<utility::Table> {
    let cameras = Framing::of(scene).ring(Ring::Validation, 3, (96, 96))?;
    let contexts = if setup.quick { 4 } else { utility::UtilityOptions::paper().contexts };
    let options = utility::UtilityOptions { contexts, ..utility::UtilityOptions::paper() };
    let gain_cameras = utility::gain_cameras(scene)?;
    let references = utility::References::renders(scene, &cameras, &gain_cameras);
    pipeline::utilities(&references, stream, &options, None, setup.quiet, &mut |_| ())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_column_is_paired_with_layered_by_trace() {
        let windows = [0, 0, 1, 1].map(|trace| {
            let own = Delivered {
                startup_ms: 100.0,
                startup_reached: true,
                miss: 0.5,
                positive_miss: 0.4,
                utility: 0.6,
                waste_bytes: 1 << 20,
            };
            let mut runs = vec![own; POLICIES.len()];
            // Layered, the last, differs from the others by trace; once playout never begins.
            runs[4].positive_miss = 0.5 + 0.1 * trace as f64;
            runs[4].utility = 0.5;
            runs[4].startup_ms = if trace == 0 { 80.0 } else { f64::NAN };
            Window { family: "made", trace, runs }
        });
        let mut bench = Bench::new("t", "");
        push_rows(&mut bench, "t", &windows);
        let figure = |key: &str| {
            let key = format!("t.{key}");
            bench.figures.iter().find(|figure| figure.key == key).unwrap_or_else(|| panic!("{key}"))
        };
        let positive = figure("dash.positive_miss_less_layered");
        assert!((positive.value + 15.0).abs() < 1e-9 && positive.unit == "points, paired", "{positive:?}");
        // Two traces, each drawn or not: the interval reaches from one's difference to the other's.
        let [low, high] = positive.ci95.unwrap();
        assert!((low + 20.0).abs() < 1e-9 && (high + 10.0).abs() < 1e-9, "{positive:?}");
        let utility = figure("dash.utility_less_layered");
        assert!((utility.value - 0.1).abs() < 1e-9 && utility.ci95.is_some(), "{utility:?}");
        let startup = figure("dash.startup_less_layered");
        assert_eq!((startup.value, startup.runs), (20.0, Some(2)));
        assert_eq!(figure("dash.waste_less_layered").value, 0.0);
        assert!(bench.figures.iter().all(|figure| !figure.key.starts_with("t.layered.utility_less")));
    }
}
