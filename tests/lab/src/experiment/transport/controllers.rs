//! Compares congestion controllers under one scheduler: how full the link is, how long the queue.

use anyhow::Result;
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

/// How it is measured.
pub(super) fn protocol(_setup: &Setup) -> String {
    "rows of controllers: a made clip of 30 s under layered, 50 ms each way; 10 Mbit/s over 5 Mbit/s and \
     500 ms of queue (`overload`), 2.5 and 4.5 Mbit/s over the same link (`half`, `ninety`), 10 Mbit/s over \
     5 Mbit/s with 2 % of the datagrams lost independently (`lossy`), 5 Mbit/s over a bursty trace of mean \
     4 Mbit/s (`bursty`); used: share of what the link could carry; round_trip: 95th percentile of the \
     smoothed round trip after 3 s; lost: share of the datagrams"
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
    let jobs: Vec<(&Situation, ControllerKind)> = situations
        .iter()
        .flat_map(|situation| ControllerKind::ALL.map(|controller| (situation, controller)))
        .collect();
    let reports: Vec<Report> = jobs.par_iter().map(|job| report(job.0, job.1)).collect::<Result<_>>()?;
    for ((situation, controller), report) in jobs.iter().zip(&reports) {
        let key = |what: &str| format!("controllers.{}.{}.{what}", situation.name, controller.name());
        let used = 100.0 * used(situation, report);
        bench.push(Figure::new(key("used"), used, "% of what the link could carry"));
        bench.push(Figure::new(key("round_trip"), late_round_trip(report).as_ms(), "ms"));
        let lost = 100.0 * report.sender.lost as f64 / report.sender.datagrams.max(1) as f64;
        bench.push(Figure::new(key("lost"), lost, "%"));
        bench.push(Figure::new(key("miss"), 100.0 * report.miss_rate, "%"));
    }
    Ok(())
}

fn report(situation: &Situation, controller: ControllerKind) -> Result<Report> {
    let graph = Synthetic { rate: situation.source, ..Synthetic::default() }.build(1)?;
    let reverse = PathConfig { delay: situation.path.delay, ..PathConfig::default() };
    let config = SessionConfig {
        policy: PolicyKind::Layered,
        controller,
        forward: situation.path.clone(),
        reverse,
        ..SessionConfig::default()
    };
    Ok(simulate(&graph, &config)?)
}

fn used(situation: &Situation, report: &Report) -> f64 {
    let could = match &situation.path.capacity {
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
            let report = report(overload, controller).unwrap();
            (used(overload, &report), late_round_trip(&report))
        };
        let (bounded, waiting) = (of(ControllerKind::Scream), of(ControllerKind::NewReno));
        assert!(bounded.0 > 0.9 && waiting.0 > 0.9, "{bounded:?} {waiting:?}");
        assert!(waiting.1 > bounded.1 + Nanos::from_ms(100), "{bounded:?} {waiting:?}");
    }
}
