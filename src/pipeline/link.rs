//! Builds the link of the command line: a capacity trace, scaled to the stream, with its delay, loss and
//! queue.

use std::path::Path;

use anyhow::{Context, Result, bail};
use emulator_host::{
    ControllerKind, Nanos, PacketGraph, Rate, SessionConfig, Trace,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    trace::{self, DelayTrace, Replay},
};

use crate::args::{ControllerName, LinkArgs, TransportName};

/// How long each line of a delay trace holds (LeoCC's recordings of Starlink).
const DELAY_INTERVAL: Nanos = Nanos::from_ms(10);

/// Reads a trace of capacity alone, by content: UCC CSV, mahimahi (one column) or two columns.
///
/// # Errors
/// What the loader refuses, with the file's name; a trace that has delays or losses too.
pub fn read_trace(path: &Path) -> Result<Trace> {
    let replay = read_replay(path)?;
    if replay.delay.is_some() {
        bail!("{}: has delays too; a trace of capacity alone is needed here", path.display());
    }
    Ok(replay.capacity)
}

/// Reads a trace, by content: UCC CSV, mahimahi (one column), two columns, or three or four with delay and
/// loss.
///
/// # Errors
/// What the loader refuses, with the file's name.
pub(crate) fn read_replay(path: &Path) -> Result<Replay> {
    let limits = trace::Limits::default();
    let bytes = trace::read(path, &limits).with_context(|| path.display().to_string())?;
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let first = bytes.split(|b| *b == b'\n').find(|l| !l.trim_ascii().is_empty()).unwrap_or(&[]);
    let columns = first.split(|b| b.is_ascii_whitespace() || *b == b',').filter(|c| !c.is_empty()).count();
    let replay = if matches!(columns, 3 | 4) {
        Replay::load(&name, &bytes, &limits)
    } else if first.starts_with(b"Timestamp") || (columns > 4 && first.contains(&b',')) {
        Trace::ucc(&name, &bytes, trace::Direction::Down, &limits).map(Replay::from)
    } else if columns <= 1 {
        Trace::mahimahi(&name, &bytes, &limits).map(Replay::from)
    } else {
        // The two families differ in which end of its interval a row stands at.
        let holds = if name.contains("pitree") { trace::Holds::Backward } else { trace::Holds::Forward };
        Trace::two_column(&name, &bytes, holds, &limits).map(Replay::from)
    };
    replay.with_context(|| format!("{}: not a usable trace", path.display()))
}

/// Reads one-way delays: a number of milliseconds per line, each for 10 ms.
///
/// # Errors
/// What the loader refuses, with the file's name.
pub(crate) fn read_delays(path: &Path) -> Result<DelayTrace> {
    let limits = trace::Limits::default();
    let bytes = trace::read(path, &limits).with_context(|| path.display().to_string())?;
    DelayTrace::load(&bytes, DELAY_INTERVAL, &limits)
        .with_context(|| format!("{}: not a usable trace of delays", path.display()))
}

/// A link ready to use, and what to say about it.
#[derive(Clone, Debug)]
pub struct Link {
    /// The session without its scheduler.
    pub config: SessionConfig,
    /// Capacity over time.
    pub trace: Trace,
    /// Name, mean rate, delay, loss, for people.
    pub description: String,
    /// Warnings of the trace loader.
    pub warnings: Vec<String>,
}

/// The link as typed, for a stream of `graph`'s size.
///
/// # Errors
/// An unreadable trace, or numbers out of range.
pub fn link(args: &LinkArgs, graph: &PacketGraph) -> Result<Link> {
    let clip_s = f64::from(graph.frames()) * graph.frame_interval().as_s();
    let built_in = args.trace.is_none();
    let mut replay = match &args.trace {
        Some(path) => read_replay(path)?,
        None => Trace::bursty(args.link_seed, Nanos::from_s(60)).into(),
    };
    if let Some(path) = &args.delay_trace {
        if let (Some(_), Some(trace)) = (&replay.delay, &args.trace) {
            bail!("{} has delays, and so has {}; one of them is needed", trace.display(), path.display());
        }
        replay.delay = Some(read_delays(path)?);
    }
    let warnings = replay.capacity.warnings().iter().map(ToString::to_string).collect();
    let replay = match args.trace_offset {
        0.0 => replay,
        offset => replay.starting_at(Nanos((offset * 1e9) as u64))?,
    };
    let Replay { capacity: trace, delay: delay_trace, loss: loss_trace } = replay;
    let scale = match args.scale {
        Some(scale) => scale,
        None if built_in => {
            let wanted = graph.total_bytes() as f64 * 8.0 / clip_s.max(0.1) / args.load;
            wanted / trace.mean_rate().0 as f64
        }
        None => 1.0,
    };
    let trace = scaled(&trace, scale)?;
    let mean = trace.mean_rate();
    let delay = args
        .delay_ms
        .map(Nanos::from_ms)
        .or_else(|| delay_trace.as_ref().map(|_| Nanos::ZERO))
        .or_else(|| trace.base_rtt().map(|rtt| Nanos(rtt.0 / 2)))
        .unwrap_or(Nanos::from_ms(30));
    // Bursts of four packets on average, all lost: stationary share p = enter / (enter + leave).
    let leave_bad = 0.25;
    let burst_loss = args.burst_loss.unwrap_or(if loss_trace.is_some() { 0.0 } else { 0.02 });
    let loss = match burst_loss {
        0.0 => LossModel::None,
        p => LossModel::GilbertElliott {
            enter_bad: p * leave_bad / (1.0 - p),
            leave_bad,
            loss_good: 0.0,
            loss_bad: 1.0,
        },
    };
    let queue = queue_bytes(mean, args.queue_ms);
    let forward = PathConfig {
        capacity: Capacity::Trace(trace.clone()),
        queue: QueueLimit { bytes: queue, ..QueueLimit::default() },
        loss,
        loss_trace: loss_trace.clone(),
        delay,
        delay_trace: delay_trace.clone(),
        ..PathConfig::default()
    };
    let reverse = PathConfig {
        capacity: Capacity::Constant(Rate::from_mbps(2)),
        delay,
        delay_trace: delay_trace.clone(),
        ..PathConfig::default()
    };
    let config = SessionConfig {
        seed: args.link_seed,
        controller: controller(args.controller),
        forward,
        reverse,
        ..SessionConfig::default()
    };
    let description = format!(
        "{} × {scale:.3}, mean {:.2} Mbit/s, {:.0} ms one way{}, queue {} kB, bursts of loss {:.1} %{}{}",
        trace.name(),
        mean.0 as f64 / 1e6,
        delay.as_ms(),
        delay_trace.map_or(String::new(), |delays| {
            format!(" and those of a trace, median {:.0} ms", delays.median().as_ms())
        }),
        queue / 1000,
        100.0 * burst_loss,
        if loss_trace.is_some() { " and those of the trace" } else { "" },
        match args.transport {
            TransportName::Model => "",
            TransportName::Quic => ", over quinn-proto",
        }
    );
    Ok(Link { config, trace, description, warnings })
}

/// Bytes of `ms` milliseconds at `rate`. The floor is two whole datagrams, without which nothing that comes
/// in pairs would pass: on a slow link a larger one would be seconds.
fn queue_bytes(rate: Rate, ms: u64) -> u64 {
    const TWO_DATAGRAMS: u64 = 3_000;
    rate.bytes_in(Nanos::from_ms(ms)).0.max(TWO_DATAGRAMS)
}

/// `trace` with `factor` times the capacity.
fn scaled(trace: &Trace, factor: f64) -> Result<Trace> {
    if factor == 1.0 {
        return Ok(trace.clone());
    }
    // Capacity as rates over 20 ms bins, so that opportunities scale too.
    let period = trace.period();
    let bins = (period.0 / 20_000_000).clamp(1, 2_000_000);
    let steps = capacity_bins(trace, Nanos(20_000_000), bins as usize)
        .into_iter()
        .enumerate()
        .map(|(i, bits_per_s)| trace::Step {
            at: Nanos(i as u64 * 20_000_000),
            rate: Rate((bits_per_s * factor) as u64),
        })
        .collect();
    Ok(Trace::steps(trace.name(), steps, Nanos(bins * 20_000_000))?)
}

/// Mean capacity of the first `bins` bins of `width`, bits/s, the trace repeating.
pub fn capacity_bins(trace: &Trace, width: Nanos, bins: usize) -> Vec<f64> {
    let mut out = vec![0.0; bins];
    let period = trace.period().0.max(1);
    match trace.shape() {
        trace::Shape::Opportunities(at) => {
            let span = width.0 * bins as u64;
            let mut start = 0u64;
            while start < span {
                for t in at.iter().map(|t| t.0 + start).take_while(|&t| t < span) {
                    out[(t / width.0) as usize] += 1500.0 * 8.0 / width.as_s();
                }
                start += period;
            }
        }
        trace::Shape::Steps(steps) => {
            for (i, out) in out.iter_mut().enumerate() {
                // Samples inside the bin are enough: steps are far longer than bins.
                let samples = 4;
                for s in 0..samples {
                    let t = (i as u64 * width.0 + width.0 * s / samples) % period;
                    let at = steps.partition_point(|step| step.at.0 <= t).max(1) - 1;
                    *out += steps[at].rate.0 as f64 / samples as f64;
                }
            }
        }
    }
    out
}

/// The controller of a name.
fn controller(name: ControllerName) -> ControllerKind {
    match name {
        ControllerName::Newreno => ControllerKind::NewReno,
        ControllerName::Cubic => ControllerKind::Cubic,
        ControllerName::BbrModel => ControllerKind::BbrModel,
        ControllerName::Scream => ControllerKind::Scream,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_queue_is_as_long_in_time_on_a_slow_link_as_on_a_fast_one() {
        for kbps in [125, 1_000, 20_000] {
            let bytes = queue_bytes(Rate::from_kbps(kbps), 250);
            let span = Rate::from_kbps(kbps).time_for(emulator_host::Bytes(bytes));
            assert!(span.as_ms() > 249.0 && span.as_ms() <= 251.0, "{kbps} kbit/s: {span}");
        }
        assert_eq!(queue_bytes(Rate::from_kbps(42), 250), 3_000);
    }
}
