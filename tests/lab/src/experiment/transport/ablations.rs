//! Takes from the default scheduler what only an encoded stream with a start of its own can show: the rule
//! that opens it, parity that competes, forecasts whose error grows.

use anyhow::Result;
use emulator_host::{
    GraphReceiver, PacketGraph, SessionConfig,
    policy::{DeadlineUtility, DeadlineUtilityConfig},
};

use super::paired::{Window, clustered};
use crate::figures::{Bench, Figure};

/// How it is measured.
pub(super) const PROTOCOL: &str = "rows of ablation: the encoded streams with their parity and over the same \
     windows, graph receiver, playout once 95 % of the first base is there (after 5 s at the latest); each \
     without one part of the default scheduler, less the default, paired";

/// The default first, then what it is without.
fn variants() -> [(&'static str, DeadlineUtilityConfig); 5] {
    let full = DeadlineUtilityConfig::default();
    [
        ("deadline-utility", full),
        ("without_opening", DeadlineUtilityConfig { opening: false, ..full }),
        ("without_parity_competes", DeadlineUtilityConfig { parity_competes: false, ..full }),
        ("without_error_growth", DeadlineUtilityConfig { error_growth: 0.0, ..full }),
        ("without_refresh_after_loss", DeadlineUtilityConfig { refresh_after_loss: full.refresh, ..full }),
    ]
}

/// One run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ablated {
    startup_ms: f64,
    utility: f64,
    base_miss: f64,
}

/// All variants over the link of `session`.
pub(super) fn runs(graph: &PacketGraph, session: &SessionConfig) -> Result<Vec<Ablated>> {
    let session = SessionConfig { startup: SessionConfig::default().startup, ..session.clone() };
    let run = |config| {
        let mut receiver = GraphReceiver::new(graph, session.buffer_limit);
        let mut scheduler = DeadlineUtility::new(graph, config);
        let report = emulator_host::run(graph, &session, &mut scheduler, &mut receiver)?;
        let startup_ms = report.startup_ms.unwrap_or(session.startup.max_wait.as_ms());
        Ok(Ablated { startup_ms, utility: report.utility, base_miss: report.base_miss_rate })
    };
    variants().into_iter().map(|(_, config)| run(config)).collect()
}

/// Value of a run, name, unit.
type Column = (fn(&Ablated) -> f64, &'static str, &'static str);

const COLUMNS: [Column; 3] = [
    (|run| run.startup_ms, "startup", "ms"),
    (|run| run.utility, "utility", ""),
    (|run| 100.0 * run.base_miss, "base_miss", "%"),
];

/// Adds the rows.
pub(super) fn push(bench: &mut Bench, stream: &str, windows: &[Window<Ablated>]) {
    for (at, (variant, _)) in variants().into_iter().enumerate() {
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
            let key = format!("ablation.{stream}.{variant}.{column}");
            let mut figure = Figure::new(key, mean.0, &unit).runs(windows.len());
            figure.ci95 = Some(mean.1);
            bench.push(figure);
        }
    }
}
