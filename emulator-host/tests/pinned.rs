//! Pins whole runs: one number per scheduler and controller, on a clean and on a hostile path.
//!
//! A change says that behaviour changed. The numbers hold in debug and release and on every machine.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use emulator_host::{
    ControllerKind, PacketGraph, PolicyKind, SessionConfig, Trace,
    clock::Nanos,
    graph::{ClosureRule, Synthetic},
    link::{Capacity, LossModel, PathConfig, QueueLimit, Reordering},
    simulate,
};

/// Digest of the whole serialised report, so that counters and frames are pinned beside datagrams.
fn whole(graph: &PacketGraph, config: &SessionConfig) -> u64 {
    let report = simulate(graph, config).unwrap();
    let text = serde_json::to_string(&report).unwrap();
    text.bytes()
        .fold(0xcbf2_9ce4_8422_2325, |sum, byte| (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

fn hostile() -> PathConfig {
    PathConfig {
        capacity: Capacity::Trace(Trace::bursty(11, Nanos::from_s(60))),
        loss: LossModel::GilbertElliott { enter_bad: 0.01, leave_bad: 0.3, loss_good: 0.001, loss_bad: 0.6 },
        jitter: Nanos::from_ms(4),
        reorder: Some(Reordering { probability: 0.02, extra: Nanos::from_ms(20) }),
        queue: QueueLimit { bytes: 60_000, datagrams: 64 },
        ..PathConfig::default()
    }
}

#[test]
fn every_scheduler_and_controller_runs_as_pinned() {
    let spec =
        Synthetic { frames: 120, profile: ClosureRule::Sliced, repair: Some(4), ..Synthetic::default() };
    let graph = spec.build(11).unwrap();
    let mut found = String::new();
    for (path, forward) in [("clean", PathConfig::default()), ("hostile", hostile())] {
        for controller in ControllerKind::ALL {
            for policy in PolicyKind::ALL {
                let forward = forward.clone();
                let config = SessionConfig { policy, controller, forward, seed: 11, ..Default::default() };
                let (policy, controller) = (policy.name(), controller.name());
                found += &format!("{path} {controller} {policy} {:016x}\n", whole(&graph, &config));
            }
        }
    }
    assert_eq!(found, include_str!("pinned.txt"));
}
