//! Takes from the default scheduler, part by part, what an encoded stream with a start of its own shows. Made
//! graphs have no such start, no parity and no measured gains; what they show too stands in rows of bound.

use anyhow::Result;
use emulator_host::{
    GraphReceiver, Nanos, PacketGraph, PacketIndex, Report, Scheduler, SenderView, SessionConfig,
    graph::{ClosureRule, GraphParts},
    policy::{DeadlineUtility, DeadlineUtilityConfig, PacketStatus, SenderRequirements},
};

use super::paired::{Window, clustered};
use crate::figures::{Bench, Figure};

/// How it is measured.
pub(super) const PROTOCOL: &str = "rows of ablation: the encoded streams with their parity and over the same \
     windows, graph receiver, playout once 95 % of the first base is there (after 5 s at the latest); each \
     without one part of the default scheduler, less the default, paired; utility is of scaled gains in all \
     of them: without_gains schedules by the paper's risk-adjusted utility, without_scaled_gains by gains as \
     measured one by one, without_packets whole groups";

/// The default, or what it is without one part.
pub(super) struct Variant {
    name: &'static str,
    config: DeadlineUtilityConfig,
    /// What it schedules by, if that is not the graph that the session delivers and measures by.
    graph: Option<PacketGraph>,
}

/// The default first, then what it is without, over `graph`; `unscaled` is the same with gains of bases as
/// they were measured.
///
/// # Errors
/// None in practice: the graphs differ from `graph` in what cannot be wrong.
pub(super) fn variants(graph: &PacketGraph, unscaled: PacketGraph) -> Result<Vec<Variant>> {
    let full = DeadlineUtilityConfig::default();
    let by_config = [
        ("deadline-utility", full),
        ("without_opening", DeadlineUtilityConfig { opening: false, ..full }),
        ("without_parity_competes", DeadlineUtilityConfig { parity_competes: false, ..full }),
        ("without_least_saved", DeadlineUtilityConfig { least_saved: 0.0, ..full }),
        ("without_parity_bursts", DeadlineUtilityConfig { parity_bursts: false, ..full }),
        ("without_error_growth", DeadlineUtilityConfig { error_growth: 0.0, ..full }),
        ("without_refresh_after_loss", DeadlineUtilityConfig { refresh_after_loss: full.refresh, ..full }),
        ("without_skip_late", DeadlineUtilityConfig { skip_late: false, ..full }),
        ("without_short_queue", DeadlineUtilityConfig { short_queue: false, ..full }),
        ("without_frame_share", DeadlineUtilityConfig { frame_share: false, ..full }),
    ];
    let by_graph = [
        ("without_gains", by_risk_adjusted(graph)?),
        ("without_scaled_gains", unscaled),
        ("without_packets", by_groups(graph)?),
    ];
    let mut all = Vec::from(by_config.map(|(name, config)| Variant { name, config, graph: None }));
    all.extend(by_graph.map(|(name, graph)| Variant { name, config: full, graph: Some(graph) }));
    Ok(all)
}

/// `graph`, whose groups add what the paper's S(g) goes by.
fn by_risk_adjusted(graph: &PacketGraph) -> Result<PacketGraph> {
    let mut parts = graph.parts().clone();
    parts.groups.iter_mut().for_each(|group| group.utility = group.risk_adjusted);
    Ok(PacketGraph::new(parts)?)
}

/// `graph`, whose groups add nothing before they are whole.
fn by_groups(graph: &PacketGraph) -> Result<PacketGraph> {
    let parts = graph.parts().clone();
    Ok(PacketGraph::new(GraphParts { profile: ClosureRule::AllOrNothing, ..parts })?)
}

/// A scheduler that goes by a graph of its own, of the packets of the session's.
struct OwnGraph<'g> {
    inner: DeadlineUtility,
    graph: &'g PacketGraph,
}

impl Scheduler for OwnGraph<'_> {
    fn name(&self) -> &'static str {
        self.inner.name()
    }

    fn service(&self) -> SenderRequirements {
        self.inner.service()
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        self.inner.next(&SenderView { graph: self.graph, ..*view }, now)
    }

    fn wants_parity(&mut self, view: &SenderView<'_>, parity: PacketIndex, now: Nanos) -> bool {
        self.inner.wants_parity(&SenderView { graph: self.graph, ..*view }, parity, now)
    }

    fn forecast(&self, view: &SenderView<'_>, packet: PacketIndex, now: Nanos) -> Option<(f64, u32)> {
        self.inner.forecast(&SenderView { graph: self.graph, ..*view }, packet, now)
    }

    fn on_status(&mut self, _: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        self.inner.on_status(self.graph, packet, change);
    }
}

/// One run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ablated {
    startup_ms: f64,
    utility: f64,
    base_miss: f64,
}

/// All `variants` over the link of `session`, which delivers `graph`.
pub(super) fn runs(
    variants: &[Variant],
    graph: &PacketGraph,
    session: &SessionConfig,
) -> Result<Vec<Ablated>> {
    let session = SessionConfig { startup: SessionConfig::default().startup, ..session.clone() };
    let of = |variant: &Variant| {
        let report = run(variant, graph, &session)?;
        let startup_ms = report.startup_ms.unwrap_or(session.startup.max_wait.as_ms());
        Ok(Ablated { startup_ms, utility: report.utility, base_miss: report.base_miss_rate })
    };
    variants.iter().map(of).collect()
}

/// What `variant` delivers of `graph`.
fn run(variant: &Variant, graph: &PacketGraph, session: &SessionConfig) -> Result<Report> {
    let own = variant.graph.as_ref().unwrap_or(graph);
    let mut scheduler = OwnGraph { inner: DeadlineUtility::new(own, variant.config), graph: own };
    let mut receiver = GraphReceiver::new(graph, session.buffer_limit);
    Ok(emulator_host::run(graph, session, &mut scheduler, &mut receiver)?)
}

/// Value of a run, name, unit.
type Column = (fn(&Ablated) -> f64, &'static str, &'static str);

const COLUMNS: [Column; 3] = [
    (|run| run.startup_ms, "startup", "ms"),
    (|run| run.utility, "utility", ""),
    (|run| 100.0 * run.base_miss, "base_miss", "%"),
];

/// Adds the rows.
pub(super) fn push(bench: &mut Bench, stream: &str, variants: &[Variant], windows: &[Window<Ablated>]) {
    for (at, Variant { name, .. }) in variants.iter().enumerate() {
        for (of, column, unit) in COLUMNS {
            let less = |window: &Window<Ablated>| {
                of(&window.runs[at]) - if at > 0 { of(&window.runs[0]) } else { 0.0 }
            };
            let mean = clustered(windows, &|all| {
                all.iter().map(|window| less(window)).sum::<f64>() / all.len().max(1) as f64
            });
            let words = if at > 0 { "more, paired" } else { "" };
            let unit =
                [unit, words].into_iter().filter(|word| !word.is_empty()).collect::<Vec<_>>().join(" ");
            let key = format!("ablation.{stream}.{name}.{column}");
            let mut figure = Figure::new(key, mean.0, &unit).runs(windows.len());
            figure.ci95 = Some(mean.1);
            bench.push(figure);
        }
    }
}

#[cfg(test)]
mod tests {
    use emulator_host::{
        Rate,
        graph::Synthetic,
        link::{Capacity, PathConfig},
    };

    use super::*;

    /// A stream over a link that carries half of it.
    fn narrow() -> (PacketGraph, SessionConfig) {
        let (frames, rate, profile) = (90, Rate::from_mbps(1), ClosureRule::Sliced);
        let spec = Synthetic { frames, rate, profile, clusters: 8, repair: Some(8), ..Synthetic::default() };
        let forward =
            PathConfig { capacity: Capacity::Constant(Rate::from_kbps(500)), ..PathConfig::default() };
        (spec.build(3).unwrap(), SessionConfig { forward, ..SessionConfig::default() })
    }

    fn variant(graph: Option<PacketGraph>) -> Variant {
        Variant { name: "made", config: DeadlineUtilityConfig::default(), graph }
    }

    /// With a copy of the session's graph it is the default, byte by byte.
    #[test]
    fn a_graph_of_its_own_decides_what_is_sent_and_nothing_else() {
        let (graph, session) = narrow();
        let default = run(&variant(None), &graph, &session).unwrap();
        let copy = run(&variant(Some(graph.clone())), &graph, &session).unwrap();
        assert_eq!(default.digest, copy.digest);
        // The made table has no Ũ of its own: here it has the opposite order.
        let mut parts = graph.parts().clone();
        parts.groups.iter_mut().for_each(|group| group.risk_adjusted = 1.0 / (0.01 + group.utility.abs()));
        let graph = PacketGraph::new(parts).unwrap();
        let of = |own| run(&variant(Some(own)), &graph, &session).unwrap();
        let [paper, groups] = [by_risk_adjusted(&graph), by_groups(&graph)].map(|own| of(own.unwrap()));
        for other in [&paper, &groups] {
            assert_ne!(default.digest, other.digest);
            assert_eq!(other.sender.refused_choices, 0);
        }
        // It is the utility of the session that is measured.
        assert!(paper.utility < default.utility, "{} {}", paper.utility, default.utility);
    }

    #[test]
    fn every_variant_has_rows_of_its_own_less_the_default() {
        let (graph, _) = narrow();
        let variants = variants(&graph, graph.clone()).unwrap();
        let ablated =
            |at: usize| Ablated { startup_ms: 100.0, utility: 0.9 - 0.01 * at as f64, base_miss: 0.0 };
        let runs: Vec<Ablated> = (0..variants.len()).map(ablated).collect();
        let windows = [Window { family: "made", trace: 0, runs }];
        let mut bench = Bench::new("t", "");
        push(&mut bench, "s", &variants, &windows);
        for (at, Variant { name, .. }) in variants.iter().enumerate() {
            let key = format!("ablation.s.{name}.utility");
            let found: Vec<f64> =
                bench.figures.iter().filter(|figure| figure.key == key).map(|figure| figure.value).collect();
            let wanted = if at == 0 { 0.9 } else { -0.01 * at as f64 };
            assert!(found.len() == 1 && (found[0] - wanted).abs() < 1e-9, "{name}: {found:?}");
        }
    }

    /// Names of the switches of the default scheduler. A field that is added to it does not compile here
    /// until it is named, as a switch or as what is set otherwise.
    macro_rules! switches {
        ($($switch:ident)*; but $($setting:ident)*) => {{
            let full = DeadlineUtilityConfig::default();
            let DeadlineUtilityConfig { $($switch: _,)* $($setting: _,)* } = full;
            [$(stringify!($switch)),*]
        }};
    }

    #[test]
    fn every_switch_of_the_default_scheduler_has_a_row() {
        let (graph, _) = narrow();
        let mut rows: Vec<String> =
            super::super::optimum::schedulers().into_iter().map(|row| row.0).collect();
        let of_streams = variants(&graph, graph.clone()).unwrap();
        rows.extend(of_streams.iter().map(|variant| variant.name.to_owned()));
        let switches = switches! {
            max_queue_delay short_queue empty_path skip_late lost_compete loss_repaired survival rest_only
            headers frame_share credit arrival_from_queue base_weight delay_weight error_growth opening
            parity_competes least_saved parity_bursts refresh_after_loss;
            but viewport refresh refresh_after_move
        };
        for switch in switches {
            // Without it the sender fills a queue as others do.
            let name = if switch == "max_queue_delay" { "own_queue" } else { switch };
            assert!(rows.contains(&format!("without_{name}")), "{switch}: {rows:?}");
        }
        assert!(!rows.contains(&"without_viewport".to_owned()), "or this says nothing");
    }
}
