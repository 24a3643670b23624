//! Sessions over real QUIC in virtual time: they repeat, they end, and they resemble the model.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use dgs_quic::{
    CongestionControl,
    virtual_time::{self, VirtualError},
};
use emulator_host::{
    ControllerKind, Nanos, PacketGraph, PolicyKind, Rate, Report, SessionConfig, Trace,
    graph::Synthetic,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    trace::{DelayTrace, Limits},
};

fn graph(mbps: u64, frames: u32) -> PacketGraph {
    Synthetic { frames, rate: Rate::from_mbps(mbps), ..Synthetic::default() }.build(1).unwrap()
}

fn down(forward: PathConfig) -> SessionConfig {
    SessionConfig { forward, ..SessionConfig::default() }
}

fn hostile() -> PathConfig {
    PathConfig {
        capacity: Capacity::Trace(Trace::bursty(3, Nanos::from_s(60))),
        loss: LossModel::Iid(0.02),
        jitter: Nanos::from_ms(4),
        queue: QueueLimit { bytes: 60_000, ..QueueLimit::default() },
        ..PathConfig::default()
    }
}

fn check_sane(report: &Report, graph: &PacketGraph) {
    assert_eq!(report.frames.len(), graph.frames() as usize);
    assert_eq!((report.sender.refused_choices, report.sender.refused_receipts), (0, 0));
    assert!(report.boxes.iter().all(|row| row.counts.balanced()));
    assert_eq!(report.boxes[0].counts.received.datagrams, report.sender.datagrams);
    assert!(report.startup_ms.is_some());
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let graph = graph(4, 150);
    for (policy, controller) in
        [(PolicyKind::Layered, ControllerKind::NewReno), (PolicyKind::DeadlineUtility, ControllerKind::Cubic)]
    {
        let config = SessionConfig { policy, controller, ..down(hostile()) };
        let run = || virtual_time::simulate(&graph, &config).unwrap();
        let (first, second) = (run(), run());
        check_sane(&first, &graph);
        assert!(first.sender.lost > 0 && first.sender.media > 0);
        assert_eq!(first, second);
        let other = SessionConfig { seed: 2, ..config.clone() };
        assert_ne!(first.digest, virtual_time::simulate(&graph, &other).unwrap().digest);
    }
}

#[test]
fn the_transports_own_controllers_run_by_their_names() {
    let graph = graph(2, 90);
    let config = down(PathConfig::default());
    let by_kind = virtual_time::simulate(&graph, &config).unwrap();
    let by_name = virtual_time::simulate_with(&graph, &config, CongestionControl::NewReno).unwrap();
    assert_eq!(by_kind, by_name);
    let bbr = virtual_time::simulate_with(&graph, &config, CongestionControl::Bbr).unwrap();
    check_sane(&bbr, &graph);
    assert_eq!((bbr.controller.as_str(), by_name.controller.as_str()), ("bbr", "newreno"));
}

/// Over an empty path each takes the delay; all of them arrive, lost or not.
#[test]
fn control_messages_beside_media_are_timed() {
    let graph = graph(1, 150);
    let take = |forward| virtual_time::control_times(&graph, &down(forward), Nanos::from_ms(50)).unwrap();
    let clean =
        take(PathConfig { capacity: Capacity::Constant(Rate::from_mbps(40)), ..PathConfig::default() });
    assert!(clean.len() > 50, "{}", clean.len());
    let (delay, more) = (Nanos::from_ms(20), Nanos::from_ms(40));
    assert!(clean.iter().all(|time| (delay..more).contains(time)), "{clean:?}");
    let lossy = take(PathConfig { loss: LossModel::Iid(0.05), ..PathConfig::default() });
    assert!(lossy.len() + 20 > clean.len() && lossy.iter().any(|time| *time > more), "{lossy:?}");
}

#[test]
fn everything_arrives_on_an_ample_path() {
    let graph = graph(4, 150);
    let queue = QueueLimit { bytes: 10_000_000, datagrams: u32::MAX };
    let ample =
        PathConfig { capacity: Capacity::Constant(Rate::from_mbps(40)), queue, ..PathConfig::default() };
    let config = SessionConfig { policy: PolicyKind::Layered, ..down(ample) };
    let report = virtual_time::simulate(&graph, &config).unwrap();
    check_sane(&report, &graph);
    assert!(report.startup_reached && report.base_miss_rate < 1e-3);
    assert_eq!(report.frames.last().unwrap().miss, 0.0);
    assert_eq!(report.media_bytes, graph.total_bytes());
    assert_eq!(report.sender.lost, 0);
}

#[test]
fn a_clip_without_a_manifest_starts_at_once() {
    let graph = Synthetic { frames: 30, manifest_bytes: 0, ..Synthetic::default() }.build(1).unwrap();
    let report = virtual_time::simulate(&graph, &SessionConfig::default()).unwrap();
    check_sane(&report, &graph);
    assert_eq!((report.buffered_before_manifest, report.sender.control), (0, 0));
}

#[test]
fn the_handshake_takes_a_round_trip_and_a_dead_path_has_none() {
    let took = virtual_time::handshake(&SessionConfig::default()).unwrap();
    assert!((40.0..80.0).contains(&took.as_ms()), "{took}");
    let dead = PathConfig { capacity: Capacity::Constant(Rate(0)), ..PathConfig::default() };
    let error = virtual_time::handshake(&down(dead.clone())).unwrap_err();
    assert!(matches!(error, VirtualError::Handshake { .. }), "{error}");
    // A session whose path dies after the handshake still ends with a report.
    let graph = graph(2, 30);
    let report = virtual_time::simulate(&graph, &down(dead)).unwrap();
    assert_eq!((report.miss_rate, report.startup_reached), (1.0, false));
}

/// A delay is the same written as a number or as a trace that does not change.
#[test]
fn the_handshake_knows_recorded_delays() {
    let graph = graph(1, 90);
    let capacity = Capacity::Constant(Rate::from_kbps(400));
    let typed = PathConfig { capacity, delay: Nanos::from_ms(300), ..PathConfig::default() };
    let delays = DelayTrace::load(b"300\n", Nanos::from_s(1), &Limits::default()).unwrap();
    let recorded = PathConfig { delay: Nanos::ZERO, delay_trace: Some(delays), ..typed.clone() };
    let [typed, recorded] =
        [typed, recorded].map(|forward| virtual_time::simulate(&graph, &down(forward)).unwrap());
    assert_eq!((recorded.startup_ms, recorded.utility), (typed.startup_ms, typed.utility));
}

#[test]
fn what_the_transport_does_not_do_is_refused_by_name() {
    let graph = graph(2, 30);
    let default = SessionConfig::default;
    for (config, field) in [
        (SessionConfig { controller: ControllerKind::BbrModel, ..default() }, "controller"),
        (SessionConfig { access_rate: Some(Rate::from_mbps(1)), ..default() }, "access_rate"),
        (SessionConfig { ack_every: 3, ..default() }, "ack_every"),
        (SessionConfig { max_ack_delay: Nanos::from_ms(5), ..default() }, "max_ack_delay"),
        (SessionConfig { ack_every: 0, ..default() }, "ack_every"),
    ] {
        let error = virtual_time::simulate(&graph, &config).unwrap_err().to_string();
        assert!(error.starts_with(field), "{error}");
    }
}
