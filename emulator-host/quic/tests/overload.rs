//! A source of twice the link's rate fills the link, and not its queue: 10 Mbit/s into 5 Mbit/s, 100 ms round
//! trip, 500 ms of queue, over the model and over real QUIC in virtual time.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use dgs_quic::virtual_time;
use emulator_host::{
    ControllerKind, Nanos, PolicyKind, Rate, Report, SessionConfig,
    graph::Synthetic,
    link::{Capacity, PathConfig, QueueLimit},
    simulate,
};

const LINK: Rate = Rate::from_mbps(5);
/// From here on the start is over.
const BEGIN: Nanos = Nanos::from_s(2);

fn config(policy: PolicyKind, controller: ControllerKind) -> SessionConfig {
    let delay = Nanos::from_ms(50);
    let base = SessionConfig::default();
    SessionConfig {
        policy,
        controller,
        forward: PathConfig {
            capacity: Capacity::Constant(LINK),
            queue: QueueLimit { bytes: 312_500, ..QueueLimit::default() },
            delay,
            ..PathConfig::default()
        },
        reverse: PathConfig { delay, ..base.reverse },
        handshake_rtt: Some(Nanos::from_ms(100)),
        sample_interval: Nanos::from_ms(10),
        ..base
    }
}

fn figures(report: &Report) -> (f64, f64, u64) {
    let delivered = report.boxes[0].counts.delivered.bytes as f64 * 8.0;
    let share = delivered / (LINK.0 as f64 * report.duration_ns.as_ms() * 1e-3);
    let rows = report.samples.iter().filter(|row| row.time_ns >= BEGIN);
    let mut trips: Vec<f64> = rows.map(|row| row.smoothed_rtt_ns.as_ms()).collect();
    trips.sort_by(f64::total_cmp);
    (share, trips[trips.len() * 95 / 100], report.waste.late_bytes)
}

/// The bound on the queue that the default scheduler causes, on the round trip without it.
const FULL: f64 = 100.0 + 100.0;

#[test]
fn the_link_is_full_and_its_queue_is_not() {
    let graph = Synthetic { rate: Rate::from_mbps(10), ..Synthetic::default() }.build(1).unwrap();
    for controller in [ControllerKind::NewReno, ControllerKind::Cubic] {
        let ours = config(PolicyKind::DeadlineUtility, controller);
        let both = [simulate(&graph, &ours).unwrap(), virtual_time::simulate(&graph, &ours).unwrap()];
        for (share, trip, late) in both.iter().map(figures) {
            assert!(
                share >= 0.9 && trip <= FULL * 1.02 && late == 0,
                "{controller:?}: {share} {trip} {late}"
            );
        }
        // A scheduler that leaves the queue to the congestion window is seen to fill it.
        let other = config(PolicyKind::Layered, controller);
        let (share, trip, late) = figures(&virtual_time::simulate(&graph, &other).unwrap());
        assert!(share >= 0.9 && trip > 2.0 * FULL && late > 0, "{controller:?}: {share} {trip} {late}");
    }
}

/// SCReAM bounds the queue itself, over real QUIC as over the model: within its largest target, where NewReno
/// fills the half second that there is.
#[test]
fn scream_bounds_the_queue_whatever_the_scheduler_does() {
    let graph = Synthetic { rate: Rate::from_mbps(10), ..Synthetic::default() }.build(1).unwrap();
    let scream = config(PolicyKind::Layered, ControllerKind::Scream);
    let both = [simulate(&graph, &scream).unwrap(), virtual_time::simulate(&graph, &scream).unwrap()];
    for (share, trip, _) in both.iter().map(figures) {
        assert!(share >= 0.85 && trip <= 2.0 * FULL, "{share} {trip}");
    }
}
