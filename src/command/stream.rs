//! Streams a scene by one scheduler over one link: `dgs stream`.

use anyhow::Result;
use serde_json::json;

use crate::{
    args::StreamArgs,
    figures::number,
    files,
    output::VerbOutput,
    pipeline::{self, Delivered, Quiet, Sendable},
};

/// Runs the verb.
pub fn run(args: &StreamArgs, quiet: Quiet) -> Result<VerbOutput> {
    if let Some(out) = &args.out {
        files::check(out)?;
    }
    let mut warnings = Vec::new();
    let Sendable { stream, map, graph } =
        pipeline::sendable(&args.input, &args.scene, &args.codec, quiet, &mut |w| warnings.push(w))?;
    let link = pipeline::link(&args.link, &graph)?;
    warnings.extend(link.warnings.iter().cloned());
    let policy = pipeline::policy(args.policy);
    let Delivered { report, shown, arrived } =
        pipeline::delivered(&stream, &map, &graph, &link.config, policy, args.link.transport)?;
    let startup = report.startup_ms.map_or("never".to_owned(), |ms| format!("{ms:.0} ms"));
    let mut text = format!(
        "{} over {}\n  startup {startup}, miss {:.1} % (base {:.1} %), utility {:.3}\n  \
         limited by {}\n  \
         goodput {} kbit/s, usable {} kbit/s, wasted {:.1} KiB, {} of {} frames shown, {} recovered by \
         repair\n",
        report.policy,
        link.description,
        100.0 * report.miss_rate,
        100.0 * report.base_miss_rate,
        report.utility,
        link.limit(&report),
        number(report.goodput_bps / 1000.0),
        number(report.usable_goodput_bps / 1000.0),
        report.waste.total_bytes() as f64 / 1024.0,
        shown.len(),
        graph.frames(),
        report.recovered
    );
    let limit = link.limit(&report);
    let mut json =
        json!({ "link": link.description, "limit": limit, "report": report, "warnings": warnings });
    if let Some(out) = &args.out {
        let count = arrived.iter().filter(|arrived| **arrived).count();
        files::write(out, &stream.with_packets(|id| arrived[id]).to_bytes()?)?;
        text += &format!("what arrived, {count} of {} packets → {}\n", arrived.len(), out.display());
        json["out"] = json!(out);
        json["arrived_packets"] = json!(count);
    }
    Ok(VerbOutput { text, json, warnings, damaged: false })
}
