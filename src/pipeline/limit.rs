//! Says what kept a run from showing more: the link, congestion control, or the deadline.

use emulator_host::{Report, Trace};

use super::link::Link;

/// Share of what the link could carry above which the link is the limit.
const LINK_FULL: f64 = 0.85;
/// Share of the samples with a full window above which congestion control is the limit.
const WINDOW_FULL: f64 = 0.4;
/// A window with less room than this is full.
const DATAGRAM_BYTES: u64 = 1200;

impl Link {
    /// What kept the run that `report` tells of from showing more, in words.
    pub fn limit(&self, report: &Report) -> String {
        limit(report, &self.trace)
    }
}

/// The limit over a link with the capacity of `trace`.
fn limit(report: &Report, trace: &Trace) -> String {
    // The first box of the downlink is its capacity.
    let moved = report.boxes.first().map_or(0, |link| link.counts.delivered.bytes);
    let could = trace.bytes_until(report.duration_ns).0;
    let used = moved as f64 / could.max(1) as f64;
    let full = report.samples.iter().filter(|row| row.in_flight_bytes + DATAGRAM_BYTES > row.window_bytes);
    let full = full.count() as f64 / report.samples.len().max(1) as f64;
    let used_words = format!("{:.0} % of the link used", 100.0 * used);
    if used >= LINK_FULL {
        format!("link ({used_words})")
    } else if full >= WINDOW_FULL {
        format!("congestion control ({used_words}, window full {:.0} % of the time)", 100.0 * full)
    } else {
        format!("deadline ({used_words}: nothing else could still be shown in time)")
    }
}

#[cfg(test)]
mod tests {
    use emulator_host::{
        PolicyKind, Rate, SessionConfig,
        graph::Synthetic,
        link::{Capacity, LossModel, PathConfig},
        simulate,
        trace::Step,
    };

    use super::*;

    fn limit_of(stream_kbps: u64, link_mbps: u64, loss: f64) -> String {
        let spec = Synthetic { frames: 300, rate: Rate::from_kbps(stream_kbps), ..Synthetic::default() };
        let step = Step { at: emulator_host::Nanos::ZERO, rate: Rate::from_mbps(link_mbps) };
        let trace = Trace::steps("constant", vec![step], emulator_host::Nanos::from_s(1)).unwrap();
        let forward = PathConfig {
            capacity: Capacity::Trace(trace.clone()),
            loss: if loss > 0.0 { LossModel::Iid(loss) } else { LossModel::None },
            ..PathConfig::default()
        };
        let config = SessionConfig { forward, policy: PolicyKind::Layered, ..SessionConfig::default() };
        limit(&simulate(&spec.build(1).unwrap(), &config).unwrap(), &trace)
    }

    #[test]
    fn each_limit_is_named_where_it_is_known() {
        let (link, control, deadline) =
            (limit_of(6000, 2, 0.0), limit_of(20_000, 15, 0.04), limit_of(300, 15, 0.0));
        assert!(link.starts_with("link"), "{link}");
        assert!(control.starts_with("congestion control"), "{control}");
        assert!(deadline.starts_with("deadline"), "{deadline}");
    }
}
