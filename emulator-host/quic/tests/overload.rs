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

#[test]
fn print_everything() {
    let graph = Synthetic { rate: Rate::from_mbps(10), ..Synthetic::default() }.build(1).unwrap();
    for policy in [PolicyKind::Layered, PolicyKind::DeadlineUtility] {
        for controller in [ControllerKind::NewReno, ControllerKind::Cubic] {
            let config = config(policy, controller);
            let model = figures(&simulate(&graph, &config).unwrap());
            let quic = figures(&virtual_time::simulate(&graph, &config).unwrap());
            println!("{policy:?} {controller:?}: model {model:?} quic {quic:?}");
        }
    }
}

#[test]
fn print_utilities() {
    use emulator_host::{Trace, link::LossModel};
    for (mbps, delay, loss) in [(3, 20, 0.0), (5, 20, 0.01), (8, 20, 0.0), (5, 60, 0.0), (8, 60, 0.01), (5, 5, 0.0)] {
        let graph = Synthetic { frames: 450, rate: Rate::from_mbps(mbps), ..Synthetic::default() }.build(1).unwrap();
        let (mut utility, mut base, mut late, mut n) = (0.0, 0.0, 0, 0.0);
        for seed in 1..=30u64 {
            let mut c = config(PolicyKind::DeadlineUtility, ControllerKind::NewReno);
            c.seed = seed;
            c.forward.capacity = Capacity::Trace(Trace::bursty(seed, Nanos::from_s(60)));
            c.forward.delay = Nanos::from_ms(delay);
            c.reverse.delay = Nanos::from_ms(delay);
            c.handshake_rtt = Some(Nanos::from_ms(2 * delay));
            c.forward.loss = LossModel::Iid(loss);
            let report = simulate(&graph, &c).unwrap();
            utility += report.utility;
            base += report.base_miss_rate;
            late += report.waste.late_bytes;
            n += 1.0;
        }
        println!("{mbps} Mbit/s {delay} ms {loss}: utility {:.4} base miss {:.4} late {late}", utility / n, base / n);
    }
}
