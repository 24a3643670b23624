//! Places schedulers between level order and the best that any could do over the same channel.

use anyhow::Result;
use emulator_host::{
    GraphReceiver, PacketGraph, PolicyKind, Rate, Report, SessionConfig,
    bound::{UpperBound, upper_bound},
    graph::{ClosureRule, Synthetic},
    policy::{DeadlineUtility, DeadlineUtilityConfig, Scheduler},
};
use rayon::prelude::*;

use super::{
    channels::{Channel, LOAD, MIN_BOUND, start},
    paired::{Window, clustered, families},
};
use crate::{
    figures::{Bench, Figure},
    setup::Setup,
};

/// What the default scheduler is compared with, window by window.
const PEERS: [&str; 4] = ["layered", "dash", "dependency", "deadline-utility-paper"];

/// A window whose bound is lower begins with a dead link or has long outages: there the transport, which is
/// the same for all, is most of the distance.
pub(super) const LIVE: f64 = 0.9;

/// A run's utility, its bound by the bytes that arrived, level-0 misses, and forecast.
#[derive(Clone, Debug, Default)]
pub(super) struct Shown {
    utility: f64,
    /// NaN where it is not computed.
    arrived_bound: f64,
    base_miss: f64,
    waste: f64,
    brier: f64,
    base_rate: f64,
    reliability: f64,
}

impl Shown {
    fn of(report: &Report, arrived_bound: f64) -> Self {
        let forecast = report.forecast.clone().unwrap_or_default();
        Self {
            utility: report.utility,
            arrived_bound,
            base_miss: report.base_miss_rate,
            waste: report.waste.total_bytes() as f64 / report.media_bytes.max(1) as f64,
            brier: forecast.brier,
            base_rate: forecast.base_rate_brier,
            reliability: forecast.reliability,
        }
    }
}

/// A kind of graph.
struct Workload {
    name: &'static str,
    spec: Synthetic,
    loss: f64,
}

fn workloads(setup: &Setup) -> Vec<Workload> {
    let frames = if setup.quick { 240 } else { 450 };
    let spec = Synthetic { frames, ..Synthetic::default() };
    let one = Rate::from_mbps(1);
    let all = [
        ("groups-2m", Synthetic { rate: Rate::from_mbps(2), ..spec }, 0.01),
        ("canonical-1m", Synthetic { rate: one, canonical_percent: 60, ..spec }, 0.01),
        ("groups-5m", Synthetic { rate: Rate::from_mbps(5), ..spec }, 0.0),
        ("slices-1m", Synthetic { rate: one, profile: ClosureRule::Sliced, ..spec }, 0.01),
        (
            "slices-02m",
            Synthetic { rate: Rate::from_kbps(200), clusters: 8, profile: ClosureRule::Sliced, ..spec },
            0.02,
        ),
    ];
    let quick = ["canonical-1m", "slices-1m", "slices-02m"];
    let chosen = all.into_iter().filter(|(name, _, _)| !setup.quick || quick.contains(name));
    chosen.map(|(name, spec, loss)| Workload { name, spec, loss }).collect()
}

/// Windows per trace, and steps of the solver.
fn size(setup: &Setup) -> (usize, u32) {
    if setup.quick { (2, 1000) } else { (4, 1500) }
}

/// How it is measured.
pub(super) fn protocol(setup: &Setup) -> String {
    let (windows, steps) = size(setup);
    format!(
        "rows of bound: made graphs (groups: the paper's profile, slices: dgs1's) over {windows} windows of \
         every trace, each scaled so that the stream is {LOAD} times what fits, NewReno, 20 ms one way, \
         drop-tail queue of 500 ms, loss in bursts of three, playout at one time for everyone (1 s, or when \
         the mean rate has carried manifest and first base with \
         a fifth to spare), dead windows left out; bound: linear \
         programme over the same link, {steps} steps; arrived_bound: the same over the bytes that the run's \
         receiver got, in any order, {} steps; share: of the distance from layered to the bound, ratio of \
         means, and what of it is lost because less arrived than the link could carry (delivery) and by \
         the order of what arrived; intervals by trace, then window; settings were chosen over windows that \
         begin between these, with other losses",
        steps / ARRIVED_PART
    )
}

/// Bounds by what arrived take this part of the steps: there is one per scheduler.
pub(super) const ARRIVED_PART: u32 = 3;

/// Schedulers by name: the five, and the default without one of its parts.
pub(super) fn schedulers() -> Vec<(String, Option<PolicyKind>, DeadlineUtilityConfig)> {
    let full = DeadlineUtilityConfig::default();
    let mut all: Vec<_> =
        PolicyKind::ALL.into_iter().map(|kind| (kind.name().to_owned(), Some(kind), full)).collect();
    let without = [
        ("own_queue", DeadlineUtilityConfig { max_queue_delay: None, ..full }),
        ("short_queue", DeadlineUtilityConfig { short_queue: false, ..full }),
        ("empty_path", DeadlineUtilityConfig { empty_path: false, ..full }),
        ("skip_late", DeadlineUtilityConfig { skip_late: false, ..full }),
        ("lost_compete", DeadlineUtilityConfig { lost_compete: false, ..full }),
        ("loss_repaired", DeadlineUtilityConfig { loss_repaired: false, ..full }),
        ("survival", DeadlineUtilityConfig { survival: false, ..full }),
        ("rest_only", DeadlineUtilityConfig { rest_only: false, ..full }),
        ("headers", DeadlineUtilityConfig { headers: false, ..full }),
        ("frame_share", DeadlineUtilityConfig { frame_share: false, ..full }),
        ("credit", DeadlineUtilityConfig { credit: false, ..full }),
        ("arrival_from_queue", DeadlineUtilityConfig { arrival_from_queue: false, ..full }),
        ("base_weight", DeadlineUtilityConfig { base_weight: 0.0, ..full }),
        ("delay_weight", DeadlineUtilityConfig { delay_weight: 0.0, ..full }),
    ];
    all.extend(without.map(|(name, config)| (format!("without_{name}"), None, config)));
    all
}

/// One run.
fn deliver(
    graph: &PacketGraph,
    session: &SessionConfig,
    kind: Option<PolicyKind>,
    config: DeadlineUtilityConfig,
) -> Result<Report> {
    let mut scheduler: Box<dyn Scheduler> = match kind {
        Some(kind) => kind.build(graph),
        None => Box::new(DeadlineUtility::new(graph, config)),
    };
    let mut receiver = GraphReceiver::new(graph, session.buffer_limit);
    Ok(emulator_host::run(graph, session, &mut *scheduler, &mut receiver)?)
}

/// Adds the rows. The last value of every window is the bound.
pub(super) fn run(bench: &mut Bench, setup: &Setup, channels: &[Channel]) -> Result<()> {
    let (windows, steps) = size(setup);
    let schedulers = schedulers();
    for workload in workloads(setup) {
        let graph = workload.spec.build(7)?;
        let jobs: Vec<(usize, usize)> =
            (0..channels.len()).flat_map(|trace| (0..windows).map(move |w| (trace, w))).collect();
        let results: Result<Vec<Option<Window<Shown>>>> = jobs
            .par_iter()
            .map(|(trace, window)| {
                let seed = 1000 * *trace as u64 + *window as u64;
                let channel = &channels[*trace];
                let place = (*window, windows);
                let Some(session) = channel.session(&graph, place, seed, workload.loss)? else {
                    return Ok(None);
                };
                let bound = upper_bound(&graph, &session.forward, start(&graph), steps).utility;
                if bound < MIN_BOUND {
                    return Ok(None);
                }
                let mut runs = Vec::new();
                for (_, kind, config) in &schedulers {
                    let report = deliver(&graph, &session, *kind, *config)?;
                    // The default without one of its parts is compared by utility alone.
                    let arrived = match kind {
                        Some(_) => arrived_bound(&graph, &report, steps, bound),
                        None => f64::NAN,
                    };
                    runs.push(Shown::of(&report, arrived));
                }
                runs.push(Shown { utility: bound, ..Shown::default() });
                Ok(Some(Window { family: channel.family, trace: *trace, runs }))
            })
            .collect();
        let results: Vec<Window<Shown>> = results?.into_iter().flatten().collect();
        let names: Vec<&str> = schedulers.iter().map(|(name, _, _)| name.as_str()).collect();
        push_rows(bench, workload.name, &names, &results);
    }
    Ok(())
}

/// The most utility that the bytes that arrived in the run of `report` show in any order. No more than
/// `bound`, that of the link, which they came over: either solver may stop early.
pub(super) fn arrived_bound(graph: &PacketGraph, report: &Report, steps: u32, bound: f64) -> f64 {
    UpperBound::of_arrivals(graph, report, steps / ARRIVED_PART).utility.min(bound)
}

/// One row per figure and scheduler.
fn push_rows(bench: &mut Bench, workload: &str, names: &[&str], windows: &[Window<Shown>]) {
    let place = |name: &str| names.iter().position(|other| *other == name).unwrap_or(0);
    let layered = place("layered");
    let bound = names.len();
    let mean = |of: &dyn Fn(&Window<Shown>) -> f64| clustered(windows, &|all| average(all, of));
    let mut push = |key: String, (value, ci): (f64, [f64; 2]), unit: &str| {
        let mut figure = Figure::new(format!("bound.{workload}.{key}"), value, unit).runs(windows.len());
        figure.ci95 = Some(ci);
        bench.push(figure);
    };
    push("utility".to_owned(), mean(&|window| window.runs[bound].utility), "at most");
    for (at, name) in names.iter().enumerate() {
        push(format!("{name}.utility"), mean(&|window| window.runs[at].utility), "");
        push(format!("{name}.base_miss"), mean(&|window| 100.0 * window.runs[at].base_miss), "%");
        let has_arrived_bound = windows.iter().all(|window| window.runs[at].arrived_bound.is_finite());
        if has_arrived_bound {
            let words = "utility, at most, of the bytes that arrived";
            push(format!("{name}.arrived_bound"), mean(&|window| window.runs[at].arrived_bound), words);
        }
        if at == layered {
            continue;
        }
        if has_arrived_bound {
            let part = |lost: &dyn Fn(&Window<Shown>) -> f64| {
                clustered(windows, &|all| {
                    let gap = average(all, &|w| w.runs[bound].utility - w.runs[layered].utility);
                    100.0 * average(all, lost) / gap
                })
            };
            let undelivered = part(&|w| w.runs[bound].utility - w.runs[at].arrived_bound);
            push(format!("{name}.lost_to_delivery"), undelivered, "% of the distance");
            let misordered = part(&|w| w.runs[at].arrived_bound - w.runs[at].utility);
            push(format!("{name}.lost_to_order"), misordered, "% of the distance, at most");
        }
        let share = clustered(windows, &|all| {
            let gap = |of: usize| average(all, &|w| w.runs[of].utility - w.runs[layered].utility);
            gap(at) / gap(bound)
        });
        let live: Vec<Window<Shown>> =
            windows.iter().filter(|window| window.runs[bound].utility >= LIVE).cloned().collect();
        if live.len() < windows.len() {
            let share = clustered(&live, &|all| {
                let gap = |of: usize| average(all, &|w| w.runs[of].utility - w.runs[layered].utility);
                gap(at) / gap(bound)
            });
            let words =
                format!("% of the distance, in the {} windows whose bound is above {LIVE}", live.len());
            push(format!("{name}.share_live"), (100.0 * share.0, share.1.map(|end| 100.0 * end)), &words);
        }
        push(format!("{name}.share"), (100.0 * share.0, share.1.map(|end| 100.0 * end)), "% of the distance");
    }
    let ours = place("deadline-utility");
    push("deadline-utility.waste".to_owned(), mean(&|w| 100.0 * w.runs[ours].waste), "% of bytes");
    push("deadline-utility.brier".to_owned(), mean(&|w| w.runs[ours].brier), "");
    push("deadline-utility.brier_base_rate".to_owned(), mean(&|w| w.runs[ours].base_rate), "");
    push("deadline-utility.reliability".to_owned(), mean(&|w| w.runs[ours].reliability), "");
    for other in PEERS {
        let at = place(other);
        let gain = |window: &Window<Shown>| window.runs[ours].utility - window.runs[at].utility;
        push(format!("deadline-utility.less_{other}"), mean(&gain), "utility, paired");
    }
    for other in PEERS {
        let at = place(other);
        let gain = |window: &Window<Shown>| window.runs[ours].utility - window.runs[at].utility;
        let [better, surely, worse, of] = families(windows, &gain);
        let key = format!("bound.{workload}.deadline-utility.families_over_{other}");
        let words = format!("of {of} families better, {surely} beyond doubt, {worse} worse beyond doubt");
        bench.push(Figure::new(key, better as f64, &words));
    }
}

fn average<T>(windows: &[&Window<T>], of: &dyn Fn(&Window<T>) -> f64) -> f64 {
    windows.iter().map(|window| of(window)).sum::<f64>() / windows.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is lost to delivery and to order is what is left of the share, and only where it was computed.
    #[test]
    fn the_distance_is_divided_among_delivery_and_order() {
        let names =
            ["dash", "deadline-utility", "deadline-utility-paper", "dependency", "layered", "without"];
        let windows = [0, 1].map(|trace| {
            let shown = |utility, arrived_bound| Shown { utility, arrived_bound, ..Shown::default() };
            let mut runs = vec![shown(0.7, 0.8); 4];
            runs.extend([shown(0.5, 0.6), shown(0.65, f64::NAN), shown(0.9, 0.0)]);
            Window { family: "made", trace, runs }
        });
        let mut bench = Bench::new("t", "");
        push_rows(&mut bench, "w", &names, &windows);
        let value = |key: &str| {
            let figure = bench.figures.iter().find(|figure| figure.key == format!("bound.w.{key}"));
            figure.map(|figure| (figure.value * 1e6).round() / 1e6)
        };
        assert_eq!(value("dash.share"), Some(50.0));
        assert_eq!(value("dash.lost_to_delivery"), Some(25.0));
        assert_eq!(value("dash.lost_to_order"), Some(25.0));
        assert_eq!(value("layered.arrived_bound"), Some(0.6));
        assert_eq!((value("layered.share"), value("without.arrived_bound")), (None, None));
        assert_eq!(value("without.share"), Some(37.5));
    }
}
