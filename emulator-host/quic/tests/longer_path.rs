//! A path that becomes longer while a session lasts is followed, over the model and over real QUIC.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use dgs_quic::virtual_time;
use emulator_host::{
    GraphReceiver, Nanos, PacketGraph, PacketIndex, PolicyKind, Rate, Scheduler, SenderView, SessionConfig,
    graph::Synthetic,
    link::PathConfig,
    policy::{PacketStatus, SenderRequirements},
    run,
    trace::{DelayTrace, Limits},
};

/// Writes down the smallest round trip that a scheduler sees.
struct Recording {
    inner: Box<dyn Scheduler + Send>,
    seen: Vec<(Nanos, Nanos)>,
}

impl Scheduler for Recording {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn service(&self) -> SenderRequirements {
        self.inner.service()
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        self.seen.push((now, view.minimum_rtt));
        self.inner.next(view, now)
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        self.inner.on_status(graph, packet, change);
    }
}

/// 20 ms each way, and towards the viewer 60 ms more from 15 s on.
fn longer() -> PathConfig {
    let delays = "0\n".repeat(15) + &"60\n".repeat(60);
    let trace = DelayTrace::load(delays.as_bytes(), Nanos::from_s(1), &Limits::default()).unwrap();
    PathConfig { delay_trace: Some(trace), ..PathConfig::default() }
}

#[test]
fn the_smallest_round_trip_follows_a_path_that_becomes_longer() {
    let clip = Synthetic { frames: 1200, rate: Rate::from_kbps(500), ..Synthetic::default() };
    let graph = clip.build(1).unwrap();
    let config = SessionConfig { forward: longer(), ..SessionConfig::default() };
    for over_quic in [false, true] {
        let mut scheduler = Recording { inner: PolicyKind::DeadlineUtility.build(&graph), seen: Vec::new() };
        let mut endpoint = GraphReceiver::new(&graph, config.buffer_limit);
        if over_quic {
            virtual_time::run(&graph, &config, &mut scheduler, &mut endpoint).unwrap();
        } else {
            run(&graph, &config, &mut scheduler, &mut endpoint).unwrap();
        }
        let between = |from: u64, to: u64| {
            let seen = scheduler.seen.iter().filter(|(at, _)| (from..to).contains(&(at.0 / 1_000_000_000)));
            seen.map(|(_, round_trip)| *round_trip).collect::<Vec<Nanos>>()
        };
        let (before, after) = (between(5, 15), between(28, 38));
        assert!(!before.is_empty() && !after.is_empty(), "over QUIC: {over_quic}");
        let (shorter, longer) = (Nanos::from_ms(40), Nanos::from_ms(100));
        assert!(before.iter().all(|found| (shorter..longer).contains(found)), "{over_quic}: {before:?}");
        assert!(after.iter().all(|found| *found >= longer), "{over_quic}: {after:?}");
    }
}
