//! Writes the table of every scheduler's figures of merit.

use std::fmt::Write as _;

use super::elements::{count, kib};
use crate::{
    figures::frozen,
    report::{
        SchedulerRun,
        plot::{Hue, escape, number},
    },
};

/// Which way a column is better.
#[derive(Clone, Copy)]
enum Better {
    Up,
    Down,
}

/// One figure of merit of a run.
struct Column {
    name: &'static str,
    unit: &'static str,
    better: Better,
    decimals: usize,
    value: fn(&SchedulerRun) -> f64,
}

/// The headline table.
#[rustfmt::skip]
const COLUMNS: [Column; 11] = [
    Column { name: "Mean PSNR", unit: "dB", better: Better::Up, decimals: 2, value: |r| r.mean_psnr_db },
    Column { name: "Worst 10 %", unit: "PSNR, \
        dB", better: Better::Up, decimals: 2, value: |r| r.tail_psnr_db },
    Column { name: "D", unit: "10⁻³", better: Better::Down, decimals: 2, value: |r| 1e3 * r.distortion },
    Column { name: "SSIM", unit: "0–1", better: Better::Up, decimals: 4, value: |r| r.mean_ssim },
    Column { name: "Flicker", unit: "10⁻³ of \
        range", better: Better::Down, decimals: 2, value: |r| 1e3 * r.flicker },
    Column { name: "Frozen", unit: "frames", better: Better::Down, decimals: 0, value: |r| r.frozen_frames as f64 },
    Column { name: "Startup", unit: "ms", better: Better::Down, decimals: 0, value: |r| r.delivery.startup_ms.unwrap_or(f64::NAN) },
    Column { name: "Deadline miss", unit: "% of \
        groups", better: Better::Down, decimals: 1, value: |r| 100.0 * r.delivery.miss_rate },
    Column { name: "Base miss", unit: "% of \
        groups", better: Better::Down, decimals: 1, value: |r| 100.0 * r.delivery.base_miss_rate },
    Column { name: "Utility", unit: "share, \
        0–1", better: Better::Up, decimals: 3, value: |r| r.delivery.utility },
    Column { name: "Wasted", unit: "KiB", better: Better::Down, decimals: 1, value: |r| kib(r.delivery.waste.total_bytes()) },
];

/// A row of the delivery details: what, unit, and the text of a run's value.
type Detail = (&'static str, &'static str, fn(&SchedulerRun) -> String);

/// What the headline leaves out.
#[rustfmt::skip]
const DETAILS: [Detail; 24] = [
    ("Congestion controller", "", |r| escape(&r.delivery.controller)),
    ("Seed of the path", "", |r| r.delivery.seed.to_string()),
    ("Utility that no schedule passes", "share, 0–1", |r| number(r.utility_bound.unwrap_or(f64::NAN), 3)),
    ("Freezes", "", |r| frozen(r.freezes, r.frozen_frames)),
    ("Session length", "s", |r| number(r.delivery.duration_ns.as_s(), 3)),
    ("Frames shown / all", "frames", |r| format!("{} / \
        {}", r.frames.iter().filter(|f| f.time_s.is_some()).count(), r.frames.len())),
    ("Media that arrived", "KiB", |r| number(kib(r.delivery.media_bytes), 1)),
    ("Goodput", "Mbit/s", |r| number(r.delivery.goodput_bps / 1e6, 2)),
    ("Usable goodput", "Mbit/s", |r| number(r.delivery.usable_goodput_bps / 1e6, 2)),
    ("Wasted: too late", "KiB", |r| number(kib(r.delivery.waste.late_bytes), 1)),
    ("Wasted: closure incomplete", "KiB", |r| number(kib(r.delivery.waste.outside_closure_bytes), 1)),
    ("Wasted: duplicate", "KiB", |r| number(kib(r.delivery.waste.duplicate_bytes), 1)),
    ("Wasted: unused repair", "KiB", |r| number(kib(r.delivery.waste.unused_repair_bytes), 1)),
    ("Wasted: buffer full", "KiB", |r| number(kib(r.delivery.waste.refused_bytes), 1)),
    ("Datagrams sent", "datagrams", |r| count(r.delivery.sender.datagrams)),
    ("Media packets, first time", "packets", |r| count(r.delivery.sender.media)),
    ("Media packets, again", "packets", |r| count(r.delivery.sender.retransmitted)),
    ("Parity packets", "packets", |r| count(r.delivery.sender.parity)),
    ("Control · pings", "datagrams", |r| format!("{} · \
        {}", count(r.delivery.sender.control), count(r.delivery.sender.pings))),
    ("Declared lost · spuriously", "packets", |r| format!("{} · \
        {}", count(r.delivery.sender.lost), count(r.delivery.sender.spurious))),
    ("Probe timeouts", "times", |r| count(r.delivery.sender.probe_timeouts)),
    ("Recovered from parity", "packets", |r| count(r.delivery.recovered)),
    ("Arrived before the manifest", "packets", |r| count(r.delivery.buffered_before_manifest)),
    ("Digest of the run", "", |r| format!("<code>{:016x}</code>", r.delivery.digest)),
];

/// Every scheduler's figures of merit, the best of each column marked.
pub(super) fn headline(out: &mut String, runs: &[SchedulerRun]) {
    out.push_str("<h2>Schedulers compared</h2>\n");
    if runs.is_empty() {
        out.push_str("<p class=\"note\">No scheduler was run.</p>\n");
        return;
    }
    out.push_str("<div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Scheduler</th>");
    for c in &COLUMNS {
        let (arrow, says) = match c.better {
            Better::Up => ("↑", "higher is better"),
            Better::Down => ("↓", "lower is better"),
        };
        let _ = write!(out, r#"<th title="{says}">{}<small>{arrow} {}</small></th>"#, c.name, c.unit);
    }
    out.push_str("</tr></thead><tbody>\n");
    let best: Vec<Option<String>> = COLUMNS.iter().map(|c| best(c, runs)).collect();
    for (i, run) in runs.iter().enumerate() {
        let class = Hue::Scheduler(i).class();
        let _ = write!(out, r#"<tr><th><i class="swatch {class}"></i>{}</th>"#, escape(&run.name));
        for (c, best) in COLUMNS.iter().zip(&best) {
            let text = number((c.value)(run), c.decimals);
            let class = if best.as_ref() == Some(&text) { r#" class="best""# } else { "" };
            let title = match c.name {
                "Wasted" => format!(r#" title="{}""#, waste(run)),
                "Startup" if text == "—" => r#" title="playout never started""#.to_owned(),
                "Startup" if !run.delivery.startup_reached => {
                    r#" title="the wait was over before the threshold was reached""#.to_owned()
                }
                _ => String::new(),
            };
            let _ = write!(out, "<td{class}{title}>{text}</td>");
        }
        out.push_str("</tr>\n");
    }
    out.push_str(
        "</tbody></table></div>\n<p class=\"note\">↑ higher is better, ↓ lower is better; the best of each \
            column is \
         highlighted. A miss is a group active at a frame whose closure was not usable at its deadline; base \
         counts level 0 only. Utility is the usable share of the positive utility on offer. A frame that was \
         never shown counts as missed, and as background in the image metrics. Worst 10 % is the mean PSNR \
         of the worst tenth of frames, D the mean of MSE + 0.20 (1 − SSIM). Flicker is the mean absolute \
         difference between shown and source frame-to-frame changes. Frozen frames stood still for want of \
         their base. Wasted bytes arrived and showed nothing.</p>\n",
    );
    let limit = |run: &SchedulerRun| format!("{} by {}", escape(&run.name), escape(&run.limit));
    let limits: Vec<String> = runs.iter().map(limit).collect();
    let _ = writeln!(out, "<p class=\"note\">What limited each run: {}.</p>", limits.join("; "));
    for run in runs.iter().filter(|r| r.delivery.startup_ms.is_some() && !r.delivery.startup_reached) {
        let name = escape(&run.name);
        let _ = writeln!(
            out,
            "<p class=\"note\">{name} began because its wait was over, not its threshold reached.</p>"
        );
    }
    out.push_str(
        "<details><summary>Delivery in detail, waste by kind</summary><div class=\"scroll\"><table \
        class=\"wide\">",
    );
    let names: String = runs.iter().map(|r| format!("<th>{}</th>", escape(&r.name))).collect();
    let _ =
        writeln!(out, "<thead><tr><th>Quantity</th>{names}<th class=\"text\">Unit</th></tr></thead><tbody>");
    for (name, unit, value) in &DETAILS {
        let cells: String = runs.iter().map(|r| format!("<td>{}</td>", value(r))).collect();
        let _ = writeln!(out, "<tr><th>{name}</th>{cells}<td class=\"text\">{unit}</td></tr>");
    }
    out.push_str("</tbody></table></div></details>\n");
}

/// The text of the column's best value, unless all runs share it.
fn best(column: &Column, runs: &[SchedulerRun]) -> Option<String> {
    let values: Vec<f64> = runs.iter().map(column.value).filter(|v| v.is_finite()).collect();
    let best = values.iter().copied().reduce(|a, b| match column.better {
        Better::Up => a.max(b),
        Better::Down => a.min(b),
    })?;
    let text = number(best, column.decimals);
    let shared = runs.len() > 1 && runs.iter().all(|r| number((column.value)(r), column.decimals) == text);
    (!shared).then_some(text)
}

/// Waste by kind, for a tooltip.
fn waste(run: &SchedulerRun) -> String {
    let w = &run.delivery.waste;
    let kinds = [
        ("too late", w.late_bytes),
        ("closure incomplete", w.outside_closure_bytes),
        ("duplicate", w.duplicate_bytes),
        ("unused repair", w.unused_repair_bytes),
        ("buffer full", w.refused_bytes),
    ];
    let parts: Vec<String> = kinds.iter().map(|(k, b)| format!("{k} {} KiB", number(kib(*b), 1))).collect();
    parts.join(" · ")
}
