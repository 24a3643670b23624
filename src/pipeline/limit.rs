//! Says what kept a run from showing more: the link, losses, congestion control, or the deadline.

use emulator_host::{
    Nanos, PacketGraph, Report,
    bound::UpperBound,
    link::{Capacity, PathConfig},
    session::Freezes,
};

use super::link::Link;

/// Share of what the link could carry above which the link is the limit.
const LINK_FULL: f64 = 0.85;
/// Share of the samples with a full window above which congestion control is the limit.
const WINDOW_FULL: f64 = 0.4;
/// A window with less room than this is full.
const DATAGRAM_BYTES: u64 = 1200;
/// A link that can carry less than this, and of which nothing came, carries nothing.
const OPPORTUNITY_BYTES: u64 = 1500;
/// Share of lost datagrams, or of packets that were never sent or came late, from which on they matter.
const NOTABLE: f64 = 0.01;

/// How often what was shown stood still for want of its base, in the run that `report` tells of.
pub(crate) fn freezes(report: &Report, graph: &PacketGraph) -> Freezes {
    let mut freezes = Freezes::new(graph.frame_interval());
    report.frames.iter().for_each(|row| freezes.show(1.0 - row.base_miss));
    freezes
}

/// Datagrams that the link lost on the way to the receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lost {
    /// They found no room in the queue.
    pub queue: u64,
    /// By chance, behind the queue.
    pub way: u64,
}

impl Lost {
    /// What the run that `report` tells of lost.
    pub fn of(report: &Report) -> Self {
        let mut lost = Self { queue: 0, way: 0 };
        for row in report.boxes.iter().filter(|row| row.label.starts_with(DOWN)) {
            let count = if is_queue(&row.label) { &mut lost.queue } else { &mut lost.way };
            *count += row.counts.dropped.datagrams;
        }
        lost
    }

    /// All of them.
    pub fn all(self) -> u64 {
        self.queue + self.way
    }
}

impl std::fmt::Display for Lost {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} datagrams: {} in the queue, {} on the way", self.all(), self.queue, self.way)
    }
}

/// How labels of the boxes towards the receiver begin.
const DOWN: &str = "forward/";

/// Whether a box is the capacity of the link, with its queue.
fn is_queue(label: &str) -> bool {
    label.strip_prefix(DOWN).is_some_and(|name| matches!(name, "rate" | "trace-rate"))
}

impl Link {
    /// A bound on [`Report::utility`] that no schedule passes over this link with playout that starts as it
    /// did in `report`, a run of the model; looser for large graphs, which take no longer
    /// ([`UpperBound::in_bounded_time`]). `None` if playout never began.
    pub fn best_possible(&self, report: &Report, graph: &PacketGraph) -> Option<f64> {
        let start = Nanos((report.startup_ms? * 1e6).round() as u64);
        Some(UpperBound::in_bounded_time(graph, &self.config.forward, start).utility)
    }

    /// What kept the run of `graph` that `report` tells of from showing more, in words.
    pub fn limit(&self, report: &Report, graph: &PacketGraph) -> String {
        limit(report, graph, &self.config.forward)
    }
}

/// The limit over a link that is `path`. A cause is named where the run shows it: that it was there, and that
/// something is missing which it explains.
fn limit(report: &Report, graph: &PacketGraph, path: &PathConfig) -> String {
    let could = path.bytes_until(report.duration_ns).0;
    let capacity_box = report.boxes.iter().find(|row| is_queue(&row.label));
    let delivered = capacity_box.map_or(0, |row| row.counts.delivered.bytes);
    if could < OPPORTUNITY_BYTES && delivered == 0 {
        return "link (it carried nothing)".to_owned();
    }
    let used = delivered as f64 / could.max(1) as f64;
    let used_words = match path.capacity {
        Capacity::Unlimited => "the link has no limit of rate".to_owned(),
        _ => format!("{:.0} % of the link used", 100.0 * used),
    };
    if used >= LINK_FULL {
        return format!("link ({used_words})");
    }
    let (lost, unsent) = (Lost::of(report), unsent(report, graph));
    let packets = graph.packets().len().max(1) as f64;
    let matters = |count: u64| count as f64 >= NOTABLE * packets;
    let lost_share = lost.all() as f64 / report.sender.datagrams.max(1) as f64;
    if report.miss_rate > 0.0 && lost_share >= NOTABLE && lost.all() > unsent {
        return format!("loss ({lost})");
    }
    let full = report.samples.iter().filter(|row| row.in_flight_bytes + DATAGRAM_BYTES > row.window_bytes);
    let full = full.count() as f64 / report.samples.len().max(1) as f64;
    if full >= WINDOW_FULL && matters(unsent) {
        return format!("congestion control ({used_words}, window full {:.0} % of the time)", 100.0 * full);
    }
    let late = report.waste.late_bytes * graph.packets().len() as u64 / graph.total_bytes().max(1);
    if report.miss_rate > 0.0 && matters(unsent + late) {
        let late_bytes = crate::figures::number(report.waste.late_bytes as f64 / 1024.0);
        return format!(
            "deadline ({used_words}; {unsent} packets were not sent in time, {late_bytes} KiB came late)"
        );
    }
    match path.capacity {
        Capacity::Unlimited => "not the link (it has no limit of rate)".to_owned(),
        _ => format!("not the link ({:.0} % used)", 100.0 * used),
    }
}

/// Packets that could have shown something and were never sent: at the end of a run all have expired. Parity
/// and what makes pictures worse do not count.
fn unsent(report: &Report, graph: &PacketGraph) -> u64 {
    let is_wanted = |group: &emulator_host::GroupIndex| graph.groups()[group.at()].utility > 0.0;
    let wanted = graph
        .packets()
        .iter()
        .filter(|packet| packet.parity_of.is_none() && packet.groups.iter().any(is_wanted));
    (wanted.count() as u64).saturating_sub(report.sender.media)
}

#[cfg(test)]
mod tests {
    use emulator_host::{
        Bytes, Nanos, PolicyKind, Rate, SessionConfig,
        graph::Synthetic,
        link::{LightLoad, LossModel, QueueLimit},
        simulate,
        trace::{DelayTrace, Limits},
    };

    use super::*;

    /// The limit of ten seconds at `stream_kbps` over `link_kbps`.
    fn limit_of(stream_kbps: u64, link_kbps: u64, path: &dyn Fn(&mut PathConfig)) -> String {
        let spec = Synthetic { frames: 300, rate: Rate::from_kbps(stream_kbps), ..Synthetic::default() };
        let capacity = Capacity::Constant(Rate::from_kbps(link_kbps));
        let mut forward = PathConfig { capacity, ..PathConfig::default() };
        path(&mut forward);
        let path = forward.clone();
        let mut config = SessionConfig { forward, policy: PolicyKind::Layered, ..SessionConfig::default() };
        config.reverse.delay = config.forward.delay;
        let graph = spec.build(1).unwrap();
        limit(&simulate(&graph, &config).unwrap(), &graph, &path)
    }

    #[test]
    fn each_limit_is_named_where_it_is_known() {
        let lossy = |share: f64| move |path: &mut PathConfig| path.loss = LossModel::Iid(share);
        let link = limit_of(6000, 2000, &|_| ());
        assert!(link.starts_with("link (") && link.ends_with(" of the link used)"), "{link}");
        assert_eq!(limit_of(1000, 0, &|_| ()), "link (it carried nothing)");
        let control = limit_of(20_000, 15_000, &lossy(0.04));
        assert!(control.starts_with("congestion control") && control.contains("window full"), "{control}");
        let loss = limit_of(300, 15_000, &lossy(0.1));
        assert!(loss.starts_with("loss (") && loss.contains(": 0 in the queue, "), "{loss}");
        let idle = limit_of(300, 15_000, &|_| ());
        assert!(idle.starts_with("not the link (") && idle.ends_with(" % used)"), "{idle}");
        // Media of a second is sent two seconds ahead, and takes longer than that.
        let far = limit_of(3000, 15_000, &|path| path.delay = Nanos::from_ms(900));
        assert!(far.starts_with("deadline (") && far.contains("packets were not sent in time"), "{far}");
        let unlimited = limit_of(300, 1, &|path| path.capacity = Capacity::Unlimited);
        assert_eq!(unlimited, "not the link (it has no limit of rate)");
        let short = limit_of(4000, 5000, &|path| path.queue = QueueLimit { bytes: 3000, datagrams: 2 });
        assert!(!short.starts_with("deadline"), "{short}");
    }

    /// The whole stream may be smaller than a datagram.
    #[test]
    fn a_link_that_delivered_a_little_is_used_and_not_dead() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let of_rate = |rate: Rate| {
            let capacity = Capacity::Constant(rate);
            PathConfig { capacity, ..PathConfig::default() }
        };
        let dead = of_rate(Rate(0));
        let config = SessionConfig { forward: dead.clone(), ..SessionConfig::default() };
        let mut report = simulate(&graph, &config).unwrap();
        assert_eq!(limit(&report, &graph, &dead), "link (it carried nothing)");
        let capacity_box = report.boxes.iter_mut().find(|row| is_queue(&row.label)).unwrap();
        capacity_box.counts.delivered.bytes = 640;
        let slow = of_rate(Rate(640 * 8_000_000_000 / report.duration_ns.0));
        assert!(slow.bytes_until(report.duration_ns).0 < OPPORTUNITY_BYTES);
        assert_eq!(limit(&report, &graph, &slow), "link (100 % of the link used)");
        // Bursts after a pause may carry as much again, and more.
        let light = LightLoad { rate: Rate::from_mbps(40), burst: Bytes(30_000), pause: Nanos::from_ms(100) };
        let bursty = PathConfig { light: Some(light), ..slow };
        assert!(!limit(&report, &graph, &bursty).starts_with("link"));
    }

    /// Of more than 4,000 packets, and where delays follow a trace.
    #[test]
    fn the_best_possible_is_known_of_large_graphs_and_over_varying_delays() {
        let spec = Synthetic { frames: 300, rate: Rate::from_mbps(8), ..Synthetic::default() };
        let graph = spec.build(1).unwrap();
        assert!(graph.packets().len() > 4000, "{}", graph.packets().len());
        let delays = DelayTrace::load(b"40\n90\n", Nanos::from_ms(200), &Limits::default()).unwrap();
        let capacity = Capacity::Constant(Rate::from_mbps(1));
        let forward = PathConfig { capacity, delay_trace: Some(delays), ..PathConfig::default() };
        let config = SessionConfig { forward, ..SessionConfig::default() };
        let report = simulate(&graph, &config).unwrap();
        let link = Link { config, description: String::new(), warnings: Vec::new() };
        let best = link.best_possible(&report, &graph).unwrap();
        assert!(report.utility <= best && best < 0.99, "{} {best}", report.utility);
        let never = Report { startup_ms: None, ..report };
        assert_eq!(link.best_possible(&never, &graph), None);
    }
}
