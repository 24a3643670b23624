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
            enter(&mut bench, &format!("model.{key}"), runs, || Ok(simulate(&graph, &config)?))?;
            let quic = || Ok(virtual_time::simulate(&graph, &config)?);
            enter(&mut bench, &format!("quic.{key}"), runs.div_ceil(3), quic)?;
        }
    }
    Ok(bench)
}

fn enter(bench: &mut Bench, key: &str, runs: usize, work: impl Fn() -> Result<Report>) -> Result<()> {
    let (mut seconds, mut events) = (Vec::new(), 0);
    for _ in 0..runs {
        let start = clock::seconds();
        let report = work()?;
        seconds.push(clock::seconds() - start);
        events = packet_events(&report);
    }
    let time = median(&seconds);
    bench.push(Figure::new(format!("sims_per_s.{key}"), 1.0 / time, "1/s and core").runs(runs));
    let figure = Figure::new(format!("event.{key}"), 1e6 * time / events.max(1) as f64, "us");
    bench.push(figure.error(events as f64, "packet events"));
    Ok(())
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
