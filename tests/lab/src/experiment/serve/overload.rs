//! Measures a source of twice the link's rate in virtual time: the link is to be full, its queue not.

use anyhow::{Result, ensure};
use dgs_quic::virtual_time;
use emulator_host::{
    ControllerKind, Nanos, PacketGraph, PolicyKind, Rate, Report, SessionConfig,
    graph::Synthetic,
    link::{Capacity, PathConfig, QueueLimit},
    simulate,
};

use crate::figures::{Bench, Figure};

/// What the protocol says of it.
pub const PROTOCOL: &str = "overload: 30 s of 10 Mbit/s (synthetic; deadline-utility, and by name layered) \
     into 5 Mbit/s with 100 ms of round trip and 500 ms of queue, over the model and over quinn-proto, both \
     in virtual time; utilisation counts every byte that left the link over the whole run, the round trip is \
     the smoothed one every 10 ms from 2 s on; control: messages of 200 bytes, one every 50 ms over \
     quinn-proto beside the media, from being written until they are read";
const LINK: Rate = Rate::from_mbps(5);
const SOURCE: Rate = Rate::from_mbps(10);
const DELAY: Nanos = Nanos::from_ms(50);
/// Half a second at the link's rate.
const QUEUE_BYTES: u64 = 312_500;
/// Time from one control message to the next.
const MESSAGES: Nanos = Nanos::from_ms(50);
/// From here on the start is over.
const BEGIN: Nanos = Nanos::from_s(2);

/// The schedulers, and what follows the controller in keys of theirs.
const POLICIES: [(PolicyKind, &str); 2] =
    [(PolicyKind::DeadlineUtility, ""), (PolicyKind::Layered, ".layered")];

/// Enters the rows of both transports under both controllers that both have and both schedulers.
pub fn run(bench: &mut Bench) -> Result<()> {
    let graph = Synthetic { rate: SOURCE, ..Synthetic::default() }.build(1)?;
    for controller in [ControllerKind::NewReno, ControllerKind::Cubic] {
        for (policy, suffix) in POLICIES {
            let config = config(controller, policy);
            let key = |transport: &str| format!("overload.{transport}.{}{suffix}", controller.name());
            enter(bench, &key("model"), &simulate(&graph, &config)?, &graph)?;
            enter(bench, &key("quic"), &virtual_time::simulate(&graph, &config)?, &graph)?;
            let times = virtual_time::control_times(&graph, &config, MESSAGES)?;
            enter_control(bench, &key("quic"), &times)?;
        }
    }
    Ok(())
}

fn config(controller: ControllerKind, policy: PolicyKind) -> SessionConfig {
    let base = SessionConfig::default();
    SessionConfig {
        controller,
        policy,
        forward: PathConfig {
            capacity: Capacity::Constant(LINK),
            queue: QueueLimit { bytes: QUEUE_BYTES, ..QueueLimit::default() },
            delay: DELAY,
            ..PathConfig::default()
        },
        reverse: PathConfig { delay: DELAY, ..base.reverse },
        handshake_rtt: Some(DELAY + DELAY),
        sample_interval: Nanos::from_ms(10),
        ..base
    }
}

fn enter(bench: &mut Bench, key: &str, report: &Report, graph: &PacketGraph) -> Result<()> {
    ensure!(
        report.frames.len() == graph.frames() as usize && report.sender.refused_choices == 0,
        "{key}: {} frames of {}, {} choices refused",
        report.frames.len(),
        graph.frames(),
        report.sender.refused_choices
    );
    let Some(link) = report.boxes.first() else { anyhow::bail!("{key}: a path has boxes") };
    let delivered = link.counts.delivered.bytes as f64 * 8.0;
    let share = delivered / (LINK.0 as f64 * report.duration_ns.as_ms() * 1e-3);
    let after = report.samples.iter().filter(|row| row.time_ns >= BEGIN);
    let mut trips: Vec<f64> = after.map(|row| row.smoothed_rtt_ns.as_ms()).collect();
    trips.sort_by(f64::total_cmp);
    let percentile = |at: usize| trips.get(trips.len() * at / 100).copied().unwrap_or(f64::NAN);
    bench.push(Figure::new(format!("{key}.utilisation_percent"), 100.0 * share, "%").runs(1));
    bench.push(Figure::new(format!("{key}.rtt_p95_ms"), percentile(95), "ms"));
    bench.push(Figure::new(format!("{key}.rtt_p99_ms"), percentile(99), "ms"));
    bench.push(Figure::new(format!("{key}.bytes_after_deadline"), report.waste.late_bytes as f64, "bytes"));
    bench.push(Figure::new(format!("{key}.base_miss_percent"), 100.0 * report.base_miss_rate, "%"));
    Ok(())
}

/// Enters how long control messages took.
fn enter_control(bench: &mut Bench, key: &str, times: &[Nanos]) -> Result<()> {
    ensure!(times.len() >= 500, "{key}: only {} control messages arrived in 30 s", times.len());
    let mut times: Vec<f64> = times.iter().map(|time| time.as_ms()).collect();
    times.sort_by(f64::total_cmp);
    for at in [50, 99] {
        let time = times.get(times.len() * at / 100).copied().unwrap_or(f64::NAN);
        bench.push(Figure::new(format!("{key}.control_p{at}_ms"), time, "ms"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unfinished_run_is_found() {
        let graph = Synthetic { frames: 30, rate: SOURCE, ..Synthetic::default() }.build(1).unwrap();
        let config = config(ControllerKind::NewReno, PolicyKind::DeadlineUtility);
        let good = simulate(&graph, &config).unwrap();
        let mut bench = Bench::new("serve", "");
        enter(&mut bench, "x", &good, &graph).unwrap();
        assert!(
            bench.figures.iter().any(|figure| figure.key == "x.utilisation_percent" && figure.value > 50.0)
        );
        let mut bad = good;
        bad.frames.pop();
        assert!(enter(&mut bench, "x", &bad, &graph).is_err());
    }
    #[test]
    fn layered_has_rows_of_its_own() {
        let mut bench = Bench::new("serve", "");
        run(&mut bench).unwrap();
        let late = |key: &str| {
            let key = format!("overload.{key}.bytes_after_deadline");
            bench.figures.iter().find(|figure| figure.key == key).map(|figure| figure.value)
        };
        let control =
            bench.figures.iter().find(|figure| figure.key == "overload.quic.newreno.control_p99_ms");
        assert!(control.is_some_and(|figure| (50.0..200.0).contains(&figure.value)), "{control:?}");
        for transport in ["model", "quic"] {
            assert_eq!(late(&format!("{transport}.newreno")), Some(0.0));
            assert!(late(&format!("{transport}.newreno.layered")).is_some_and(|bytes| bytes > 0.0));
        }
    }
}
