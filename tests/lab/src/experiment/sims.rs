//! Times whole deliveries on one core: how many per second, and how long one packet event takes.

use anyhow::Result;
use dgs_quic::virtual_time;
use emulator_host::{
    Nanos, PolicyKind, Report, SessionConfig, Trace,
    graph::Synthetic,
    link::{Capacity, PathConfig},
    simulate,
};

use super::clock;
use crate::{
    figures::{Bench, Figure, median},
    setup::Setup,
};

/// Runs the bench.
///
/// # Errors
/// A session that a transport refuses.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "sims",
        "a made clip of 30 s at 5 Mbit/s in packets of up to 1150 bytes over a constant link of 5 Mbit/s \
         and over a bursty trace, 20 ms each way, NewReno; processor time of one thread, median of the runs; \
         a packet event is one datagram that enters or leaves the path in either direction"
            .to_owned(),
    );
    let graph = Synthetic::default().build(1)?;
    let bursty = Capacity::Trace(Trace::bursty(1, Nanos::from_s(60)));
    let runs = if setup.quick { 3 } else { 15 };
    for (link, capacity) in [("constant", PathConfig::default().capacity), ("bursty", bursty)] {
        for policy in PolicyKind::ALL {
            let forward = PathConfig { capacity: capacity.clone(), ..PathConfig::default() };
            let config = SessionConfig { policy, forward, ..SessionConfig::default() };
            let key = format!("{link}.{}", policy.name());
            let model = timed(runs, || Ok(simulate(&graph, &config)?))?;
            let quic = timed(runs.div_ceil(3), || Ok(virtual_time::simulate(&graph, &config)?))?;
            let apart = (model.report.goodput_bps / quic.report.goodput_bps - 1.0).abs();
            enter(&mut bench, &format!("model.{key}"), &model, Some(apart));
            enter(&mut bench, &format!("quic.{key}"), &quic, None);
        }
    }
    Ok(bench)
}

/// Deliveries that were timed; they are all alike.
struct Timed {
    report: Report,
    runs: usize,
    /// Median.
    seconds: f64,
}

fn timed(runs: usize, work: impl Fn() -> Result<Report>) -> Result<Timed> {
    let run = || {
        let start = clock::seconds();
        let report = work()?;
        anyhow::Ok((clock::seconds() - start, report))
    };
    let (first, report) = run()?;
    let mut seconds = vec![first];
    for _ in 1..runs {
        seconds.push(run()?.0);
    }
    Ok(Timed { report, runs, seconds: median(&seconds) })
}

/// The figures of `timed`; `apart` is how far its goodput is from that over quinn-proto.
fn enter(bench: &mut Bench, key: &str, timed: &Timed, apart: Option<f64>) {
    let with_error = |figure: Figure| match apart {
        Some(apart) => figure.error(apart, "relative, goodput against quinn-proto"),
        None => figure,
    };
    let events = packet_events(&timed.report);
    let per_second = Figure::new(format!("sims_per_s.{key}"), 1.0 / timed.seconds, "1/s and core");
    bench.push(with_error(per_second.runs(timed.runs)));
    let event_us = 1e6 * timed.seconds / events.max(1) as f64;
    bench.push(with_error(Figure::new(format!("event.{key}"), event_us, "us").runs(timed.runs)));
    bench.push(Figure::new(format!("events.{key}"), events as f64, "packet events"));
}

/// Datagrams that entered the first box of a direction, and that left its last.
fn packet_events(report: &Report) -> u64 {
    let of = |direction: &str| {
        let boxes = || report.boxes.iter().filter(|row| row.label.starts_with(direction));
        let entered = boxes().next().map_or(0, |row| row.counts.received.datagrams);
        entered + boxes().next_back().map_or(0, |row| row.counts.delivered.datagrams)
    };
    of("forward/") + of("reverse/")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_datagram_of_a_clean_path_is_two_events() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let report = simulate(&graph, &SessionConfig::default()).unwrap();
        let events = packet_events(&report);
        assert!(events > 2 * report.sender.datagrams, "receipts count too: {events}");
        assert!(events <= 4 * report.sender.datagrams, "{events}");
        let mut none = report;
        none.boxes.clear();
        assert_eq!(packet_events(&none), 0);
    }
}
