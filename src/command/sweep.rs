//! Runs the designs of configuration files, and joins their results: `dgs sweep`, `dgs sweep merge`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use emulator_host::sweep::{Comparison, Summary, Sweep};
use serde_json::json;

use crate::{
    args::{SweepAction, SweepArgs, SweepMerge},
    output::VerbOutput,
    pipeline::Quiet,
    progress::Progress,
    sweep::{self, Config, Finished, Folder, Origin, Shard},
};

/// Runs the verb.
pub fn run(args: &SweepArgs, quiet: Quiet) -> Result<VerbOutput> {
    if let Some(SweepAction::Merge(args)) = &args.action {
        return merge(args);
    }
    // The parser demands both where no action is named.
    let (config, out) = args.config.as_deref().zip(args.out.as_deref()).context("CONFIG and --out")?;
    let beside = config.parent().unwrap_or(Path::new("."));
    let config = Config::read(config, args.traces.as_deref().unwrap_or(beside))?;
    let sweep = Sweep::new(config.design)?;
    let (text, outline, digests) = (config.text, config.outline, config.digests);
    let folder = Folder::open(out, &Origin { text, outline, digests }, !args.no_trajectories)?;
    let mut pool = rayon::ThreadPoolBuilder::new();
    if let Some(threads) = args.threads {
        pool = pool.num_threads(threads);
    }
    let whole = sweep.blocks() * sweep.simulations_per_block();
    let progress = Progress::new(&format!("{whole} simulations"), quiet.0);
    let shard = args.shard.unwrap_or(Shard::WHOLE);
    let progressed = pool.build()?.install(|| sweep::run(&sweep, &folder, shard, &progress))?;
    drop(progress);
    let finished = folder.finish(config.baseline.name())?;
    if let Finished::Lacks { batches, reason } = &finished
        && shard == Shard::WHOLE
    {
        bail!("{batches} of {} batches are not whole after all were run: {reason}", folder.batches());
    }
    let (summary, missing) = (finished.summary(), finished.missing());
    let estimate = progressed.estimate(whole);
    let mut text = format!(
        "{whole} simulations of {} frames in {} batches; {} of {} batches of this share were there\n",
        sweep.frames(),
        folder.batches(),
        progressed.found,
        progressed.batches
    );
    if let Some(estimate) = &estimate {
        text += &format!("  {estimate}\n");
    }
    text += &said(summary, missing);
    let json = json!({
        "simulations": whole,
        "run": progressed.simulations(),
        "wall_s": progressed.wall.as_secs_f64(),
        "batches_missing": missing,
        "estimate": estimate,
        "summary": summary,
    });
    Ok(VerbOutput { text, json, warnings: config.warnings, damaged: false })
}

fn merge(args: &SweepMerge) -> Result<VerbOutput> {
    let first = args.folders.first().context("a folder of results is needed")?;
    let origin = Origin::of(first)?;
    for other in &args.folders {
        origin.check(first, other)?;
    }
    let folder = Folder::open(&args.out, &origin, false)?;
    let mut lines = String::new();
    for other in &args.folders {
        lines += &format!("{}: {} batches\n", other.display(), folder.take(other)?);
    }
    let finished = folder.finish(origin.outline.baseline.name())?;
    let (summary, missing) = (finished.summary(), finished.missing());
    lines += &said(summary, missing);
    let (without, there) = folder.without_trajectories();
    let warnings = match without {
        0 => Vec::new(),
        without if without == there => Vec::new(),
        without => vec![format!("{}: {without} of {there} batches have no trajectories", args.out.display())],
    };
    let json = json!({ "batches_missing": missing, "summary": summary });
    Ok(VerbOutput { text: lines, json, warnings, damaged: missing > 0 })
}

/// The summary, or why there is none.
fn said(summary: Option<&Summary>, missing: usize) -> String {
    let Some(summary) = summary else {
        return format!("  no summary yet: {missing} batches are missing\n");
    };
    let mut text = format!(
        "  means (positive_miss: groups of positive utility alone); in brackets the paired difference from \
         {}{}\n",
        summary.baseline,
        if summary.comparisons.iter().any(has_interval) {
            " with its 95 % interval, by trace, then window"
        } else {
            "; a single window gives no interval"
        }
    );
    let mut condition = "";
    for comparison in &summary.comparisons {
        if comparison.condition != condition {
            condition = &comparison.condition;
            text += &format!("  {condition}\n");
        }
        text += &line(comparison, &summary.baseline);
    }
    text
}

fn has_interval(comparison: &Comparison) -> bool {
    comparison.mean.values().any(|estimate| estimate.low.is_some())
}

fn line(comparison: &Comparison, baseline: &str) -> String {
    let column = |name: &str, scale: f64, digits: usize| {
        let mean = comparison.mean[name].mean * scale;
        if comparison.scheduler == baseline {
            return format!("{name} {mean:.digits$}");
        }
        let less = comparison.less_baseline[name];
        let difference = less.mean * scale;
        let interval = less.low.zip(less.high).map_or(String::new(), |(low, high)| {
            format!(": {:+.digits$} to {:+.digits$}", low * scale, high * scale)
        });
        format!("{name} {mean:.digits$} [{difference:+.digits$}{interval}]")
    };
    let not_reached = match comparison.startup_not_reached {
        0 => String::new(),
        count => format!(", startup not reached in {count}"),
    };
    format!(
        "    {:10} {:22}  {} ms  {} %  {} %  {}  [{} runs{not_reached}]\n",
        comparison.controller,
        comparison.scheduler,
        column("startup_ms", 1.0, 0),
        column("miss", 100.0, 2),
        column("positive_miss", 100.0, 2),
        column("utility", 1.0, 4),
        comparison.simulations
    )
}
