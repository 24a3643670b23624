//! Compares congestion controllers under one scheduler: how full the link is, how long the queue.

use anyhow::Result;
use dgs_quic::{CongestionControl, virtual_time};
use emulator_host::{
    ControllerKind, Nanos, PolicyKind, Rate, Report, SessionConfig, Trace,
    graph::Synthetic,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    simulate,
};
use rayon::prelude::*;

use crate::{
    figures::{Bench, Figure},
    setup::Setup,
};

/// Time after which round trips count: the start is not what is compared.
const SETTLED: Nanos = Nanos::from_s(3);

/// A source and a path.
struct Situation {
    name: &'static str,
    source: Rate,
    path: PathConfig,
}

/// A controller, and what it runs over.
#[derive(Clone, Copy, Debug)]
enum Contender {
    /// One of the emulator's, over its model of QUIC.
    Model(ControllerKind),
    /// One of `quinn`'s own, over `quinn-proto` in virtual time.
    Quinn(CongestionControl),
}

impl Contender {
    fn all() -> impl Iterator<Item = Self> {
        let quinn = [CongestionControl::NewReno, CongestionControl::Cubic, CongestionControl::Bbr];
        ControllerKind::ALL.into_iter().map(Self::Model).chain(quinn.into_iter().map(Self::Quinn))
    }

    /// As in keys of figures.
    fn name(self) -> String {
        match self {
            Self::Model(kind) => kind.name().to_owned(),
            Self::Quinn(control) => format!("quinn-{}", control.name()),
        }
    }
}

/// Links of the rows of the paper's exact rule, Mbit/s.
const EXACT_LINKS: [u64; 3] = [2, 5, 20];
/// Frames of their clip, ten seconds.
const EXACT_FRAMES: u32 = 300;

/// How it is measured.
pub(super) fn protocol(_setup: &Setup) -> String {
    "rows of controllers: a made clip of 30 s under layered, 50 ms each way; 10 Mbit/s over 5 Mbit/s and \
     500 ms of queue (`overload`), 2.5 and 4.5 Mbit/s over the same link (`half`, `ninety`), 10 Mbit/s over \
     5 Mbit/s with 2 % of the datagrams lost independently (`lossy`), 5 Mbit/s over a bursty trace of mean \
     4 Mbit/s (`bursty`); used: share of what the link could carry; round_trip: 95th percentile of the \
     smoothed round trip after 3 s; lost: share of the datagrams; quinn-: quinn's own over quinn-proto in \
     virtual time, of which bbr begins to probe in a phase drawn from the system, so that its figures differ \
     a little from run to run; bbr-paper: the paper's r_send = min(r_cwnd, r_path) exactly, bbr-model: with \
     headroom. controllers.exact: the same two at 2, 5 and 20 Mbit/s and 40 ms of round trip without loss, \
     under a made clip of 10 s of twice the link's rate, layered and deadline-utility"
        .to_owned()
}

fn situations() -> [Situation; 5] {
    let link = Rate::from_mbps(5);
    let path = PathConfig {
        capacity: Capacity::Constant(link),
        queue: QueueLimit { bytes: link.bytes_in(Nanos::from_ms(500)).0, ..QueueLimit::default() },
        delay: Nanos::from_ms(50),
        ..PathConfig::default()
    };
    let bursty = Capacity::Trace(Trace::bursty(5, Nanos::from_s(60)));
    let lossy = PathConfig { loss: LossModel::Iid(0.02), ..path.clone() };
    let fading = PathConfig { capacity: bursty, ..path.clone() };
    let situation =
        |name, kbps, path: &PathConfig| Situation { name, source: Rate::from_kbps(kbps), path: path.clone() };
    [
        situation("overload", 10_000, &path),
        situation("half", 2_500, &path),
        situation("ninety", 4_500, &path),
        situation("lossy", 10_000, &lossy),
        situation("bursty", 5_000, &fading),
    ]
}

/// Adds the rows.
///
/// # Errors
/// A session that is refused.
pub(super) fn run(bench: &mut Bench) -> Result<()> {
    let situations = situations();
    let jobs: Vec<(&Situation, Contender)> = situations
        .iter()
        .flat_map(|situation| Contender::all().map(move |controller| (situation, controller)))
        .collect();
    let reports: Vec<Report> = jobs.par_iter().map(|job| report(job.0, job.1)).collect::<Result<_>>()?;
    for ((situation, controller), report) in jobs.iter().zip(&reports) {
        let key = |what: &str| format!("controllers.{}.{}.{what}", situation.name, controller.name());
        let used = 100.0 * used(&situation.path, report);
        bench.push(Figure::new(key("used"), used, "% of what the link could carry"));
        bench.push(Figure::new(key("round_trip"), late_round_trip(report).as_ms(), "ms"));
        let lost = 100.0 * report.sender.lost as f64 / report.sender.datagrams.max(1) as f64;
        bench.push(Figure::new(key("lost"), lost, "%"));
        bench.push(Figure::new(key("miss"), 100.0 * report.miss_rate, "%"));
    }
    exact(bench)
}

/// Adds the rows of the paper's exact rule, and of the same model with headroom beside it.
fn exact(bench: &mut Bench) -> Result<()> {
    let mut jobs = Vec::new();
    for mbps in EXACT_LINKS {
        for controller in [ControllerKind::BbrPaper, ControllerKind::BbrModel] {
            for policy in [PolicyKind::Layered, PolicyKind::DeadlineUtility] {
                jobs.push((mbps, controller, policy));
            }
        }
    }
    let shares: Vec<f64> = jobs.par_iter().map(|job| exact_share(*job)).collect::<Result<_>>()?;
    for ((mbps, controller, policy), share) in jobs.into_iter().zip(shares) {
        let key = format!("controllers.exact.{mbps}.{}.{}.used", controller.name(), policy.name());
        bench.push(Figure::new(key, 100.0 * share, "% of what the link could carry"));
    }
    Ok(())
}

/// Share of a link of `mbps` Mbit/s that a clip of twice its rate uses.
fn exact_share((mbps, controller, policy): (u64, ControllerKind, PolicyKind)) -> Result<f64> {
    let spec = Synthetic { rate: Rate::from_mbps(2 * mbps), frames: EXACT_FRAMES, ..Synthetic::default() };
    let path = PathConfig { capacity: Capacity::Constant(Rate::from_mbps(mbps)), ..PathConfig::default() };
    let config = SessionConfig { policy, controller, forward: path.clone(), ..SessionConfig::default() };
    Ok(used(&path, &simulate(&spec.build(1)?, &config)?))
}

fn report(situation: &Situation, controller: Contender) -> Result<Report> {
    let graph = Synthetic { rate: situation.source, ..Synthetic::default() }.build(1)?;
    let reverse = PathConfig { delay: situation.path.delay, ..PathConfig::default() };
    let config = SessionConfig {
        policy: PolicyKind::Layered,
        forward: situation.path.clone(),
        reverse,
        ..SessionConfig::default()
    };
    Ok(match controller {
        Contender::Model(controller) => simulate(&graph, &SessionConfig { controller, ..config })?,
        Contender::Quinn(controller) => virtual_time::simulate_with(&graph, &config, controller)?,
    })
}

fn used(path: &PathConfig, report: &Report) -> f64 {
    let could = match &path.capacity {
        Capacity::Trace(trace) => trace.bytes_until(report.duration_ns).0,
        Capacity::Constant(rate) => rate.bytes_in(report.duration_ns).0,
        Capacity::Unlimited => u64::MAX,
    };
    report.boxes.first().map_or(0, |link| link.counts.delivered.bytes) as f64 / could.max(1) as f64
}

fn late_round_trip(report: &Report) -> Nanos {
    let settled = report.samples.iter().filter(|row| row.time_ns > SETTLED);
    let mut round_trips: Vec<Nanos> = settled.map(|row| row.smoothed_rtt_ns).collect();
    round_trips.sort_unstable();
    round_trips.get(round_trips.len() * 95 / 100).copied().unwrap_or(Nanos::ZERO)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_controller_that_waits_for_losses_differs_from_one_that_bounds_the_delay() {
        let overload = &situations()[0];
        let of = |controller| {
            let report = report(overload, Contender::Model(controller)).unwrap();
            (used(&overload.path, &report), late_round_trip(&report))
        };
        let (bounded, waiting) = (of(ControllerKind::Scream), of(ControllerKind::NewReno));
        assert!(bounded.0 > 0.9 && waiting.0 > 0.9, "{bounded:?} {waiting:?}");
        assert!(waiting.1 > bounded.1 + Nanos::from_ms(100), "{bounded:?} {waiting:?}");
    }
    #[test]
    fn quinns_own_controllers_have_rows_of_their_own() {
        let names: Vec<String> = Contender::all().map(Contender::name).collect();
        for name in ["newreno", "cubic", "bbr-paper", "quinn-newreno", "quinn-cubic", "quinn-bbr"] {
            assert!(names.iter().any(|found| found == name), "{name} in {names:?}");
        }
        let overload = &situations()[0];
        let quinn = report(overload, Contender::Quinn(CongestionControl::NewReno)).unwrap();
        assert!(used(&overload.path, &quinn) > 0.9);
    }

    #[test]
    fn the_papers_exact_rule_uses_less_of_a_fast_link_than_the_same_model_with_headroom() {
        let share = |controller| exact_share((5, controller, PolicyKind::Layered)).unwrap();
        let (exact, roomy) = (share(ControllerKind::BbrPaper), share(ControllerKind::BbrModel));
        assert!(exact < 0.8 && roomy > exact + 0.1, "{exact} {roomy}");
    }
}
