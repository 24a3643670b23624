//! Prints the stress table: every hard case with its time, its error against f64, and what it broke.

use std::{fmt::Write as _, time::Instant};

use anyhow::Result;
use dgs::output::print;
use render_host::{Renderer, Workspace};

use crate::{
    figures::{Bench, Figure, median, number},
    setup::Setup,
    stress::{self, StressCase, Verdict, cases, refusals},
};

/// Times of one case, ms.
#[derive(Default)]
struct Times {
    forward: f64,
    gradients: f64,
    worlds: f64,
}

/// A family's worst.
#[derive(Default)]
struct Family {
    name: &'static str,
    cases: usize,
    times: Times,
    slowest: String,
    worst: Verdict,
    non_finite: u64,
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (million, runs) = if setup.quick { (20_000, 3) } else { (1_000_000, 3) };
    let mut bench = Bench::new(
        "stress",
        format!(
            "dgs_lab::stress::cases, crowds of {million}: CPU renderer, its gradients (MSE + 0.2 (1 - \
             SSIM)) and its counterfactual engine (5 worlds alone, strict and fast, and utilities of {} \
             groups) per case, medians of {runs} runs; error against the f64 reference at the same \
             settings as a share of the largest value (clear: pixels away from any threshold); fast: \
             relative error of sums of squares",
            stress::GROUPS
        ),
    );
    let mut families: Vec<Family> = Vec::new();
    let mut broken = Vec::new();
    let mut csv = String::from(
        "family,case,forward_ms,gradients_ms,counterfactual_ms,max_clear,max_close,psnr_db,near_share,fast_error,\
         gradients_that_overflow\n",
    );
    for case in cases(million) {
        let (times, verdict, non_finite) = examine(&case, runs)?;
        if !families.iter().any(|f| f.name == case.family) {
            families.push(Family { name: case.family, ..Family::default() });
        }
        let Some(family) = families.iter_mut().find(|f| f.name == case.family) else { continue };
        let total = |t: &Times| t.forward + t.gradients + t.worlds;
        let (d, Times { forward, gradients, worlds }) = (&verdict.difference, &times);
        let _ = writeln!(
            csv,
            "{},{},{forward:.3},{gradients:.3},{worlds:.3},{:.3e},{:.3e},{:.2},{:.5},{:.3e},{non_finite}",
            case.family.replace(',', ";"),
            case.name.replace(',', ";"),
            d.max_clear / verdict.largest,
            d.max_close / verdict.largest,
            d.psnr_db,
            verdict.close_share,
            verdict.fast_error
        );
        family.cases += 1;
        family.non_finite += non_finite;
        if total(&times) >= total(&family.times) {
            (family.times, family.slowest) = (times, case.name.clone());
        }
        broken.extend(verdict.complaints.iter().map(|c| format!("{}, {c}", case.family)));
        family.take(&verdict);
    }
    setup.write("stress.csv", &csv)?;
    if !setup.quiet.0 {
        print(&format!("{}\n", table(&families)))?;
    }
    for f in &families {
        let key = f.name.replace([' ', ','], "-");
        let figure = Figure::new(format!("{key}.forward"), f.times.forward, "ms");
        bench
            .push(figure.error(f.worst.difference.max_clear, "share of the largest value, clear").runs(runs));
        let figure = Figure::new(format!("{key}.gradients"), f.times.gradients, "ms");
        bench.push(figure.error(f.non_finite as f64, "gradients left f32 and are 0").runs(runs));
        let figure = Figure::new(format!("{key}.counterfactual"), f.times.worlds, "ms");
        bench.push(figure.error(f.worst.fast_error, "relative, fast sums").runs(runs));
        bench.push(Figure::new(format!("{key}.psnr_vs_f64"), f.worst.difference.psnr_db, "dB"));
        bench.push(Figure::new(format!("{key}.pixels_near_a_threshold"), f.worst.close_share, "share"));
    }
    subnormal(&mut bench, runs)?;
    let refused = refusals();
    broken.extend(
        refused.iter().filter(|r| !r.holds()).map(|r| format!("{} takes {}: {:?}", r.api, r.what, r.error)),
    );
    if !setup.quiet.0 {
        for r in &refused {
            let error = r.error.as_deref().unwrap_or("TAKEN");
            print(&format!("  refused by {:20} {:28} {error}\n", r.api, r.what))?;
        }
        print("\n")?;
    }
    bench.push(Figure::new("cases", families.iter().map(|f| f.cases).sum::<usize>() as f64, ""));
    bench.push(Figure::new("refusals", refused.len() as f64, ""));
    bench.push(Figure::new("broken_promises", broken.len() as f64, ""));
    anyhow::ensure!(broken.is_empty(), "{} promises are broken:\n{}", broken.len(), broken.join("\n"));
    Ok(bench)
}

/// Times where transmittances would decay below what f32 holds as normal numbers, beside those of the same
/// discs so faint that none does: subnormal numbers take a processor up to thirty times as long.
fn subnormal(bench: &mut Bench, runs: usize) -> Result<()> {
    let [decaying, faint] = [0.5, 0.005].map(stress::discs);
    let mut times: [Vec<f64>; 6] = Default::default();
    for _ in 0..runs {
        for (which, case) in [&decaying, &faint].into_iter().enumerate() {
            let (mut renderer, mut workspace) = (Renderer::new(), Workspace::new());
            let mut timed = |at: usize, start: Instant| {
                times[2 * at + which].push(1000.0 * start.elapsed().as_secs_f64())
            };
            let start = Instant::now();
            case.forward(&mut renderer)?;
            timed(0, start);
            let start = Instant::now();
            case.gradients(&mut workspace)?;
            timed(1, start);
            let start = Instant::now();
            case.worlds()?;
            timed(2, start);
        }
    }
    for (name, times) in ["forward", "gradients", "counterfactual"].iter().zip(times.as_chunks::<2>().0) {
        let [decaying, faint] = [&times[0], &times[1]].map(|times| median(times));
        let figure = Figure::new(format!("subnormal.{name}"), decaying, "ms");
        bench.push(figure.peer("the same discs, faint", faint, true).runs(runs));
    }
    Ok(())
}

fn examine(case: &StressCase, runs: usize) -> Result<(Times, Verdict, u64)> {
    let (mut renderer, mut workspace) = (Renderer::new(), Workspace::new());
    let mut times: [Vec<f64>; 3] = Default::default();
    let mut timed = |which: usize, start: Instant| times[which].push(1000.0 * start.elapsed().as_secs_f64());
    let mut last = None;
    for _ in 0..runs {
        let start = Instant::now();
        let rendered = case.forward(&mut renderer)?;
        timed(0, start);
        let start = Instant::now();
        let gradients = case.gradients(&mut workspace)?;
        timed(1, start);
        let start = Instant::now();
        let worlds = case.worlds()?;
        timed(2, start);
        last = Some(stress::StressOutcome { rendered, gradients, worlds });
    }
    let [forward, gradients, worlds] = times.map(|t| median(&t));
    let times = Times { forward, gradients, worlds };
    let Some(outcome) = last else { return Ok((times, Verdict::default(), 0)) };
    let verdict = case.check(&outcome, &case.truth()?);
    Ok((times, verdict, outcome.gradients.non_finite))
}

impl Family {
    fn take(&mut self, verdict: &Verdict) {
        let worse = |a: f64, b: f64| if b.total_cmp(&a).is_gt() { b } else { a };
        let (all, one) = (&mut self.worst, &verdict.difference);
        let first = self.cases == 1;
        all.difference.max_clear = worse(all.difference.max_clear, one.max_clear / verdict.largest);
        all.difference.max_close = worse(all.difference.max_close, one.max_close / verdict.largest);
        // As if the largest value were the data range.
        let psnr_db = one.psnr_db + 20.0 * verdict.largest.log10();
        all.difference.psnr_db = if first { psnr_db } else { all.difference.psnr_db.min(psnr_db) };
        all.fast_error = worse(all.fast_error, verdict.fast_error);
        all.close_share = worse(all.close_share, verdict.close_share);
        all.complaints.extend_from_slice(&verdict.complaints);
    }
}

fn table(families: &[Family]) -> String {
    let mut out = format!(
        "{:30}{:>6}{:>10}{:>10}{:>8}{:>8}{:>9}{:>10}{:>10}{:>10}{:>8}  {}\n",
        "family",
        "cases",
        "max err",
        "near thr.",
        "PSNR",
        "near %",
        "fast err",
        "fwd ms",
        "grad ms",
        "cf ms",
        "overfl.",
        "slowest case"
    );
    for f in families {
        let Family { name, cases, times, slowest, worst, non_finite } = f;
        let d = &worst.difference;
        out += &format!(
            "{name:30}{cases:>6}{:>10.1e}{:>10.1e}{:>8.1}{:>8.2}{:>9.1e}{:>10}{:>10}{:>10}{non_finite:>8}  \
                {slowest}{}\n",
            d.max_clear,
            d.max_close,
            d.psnr_db,
            100.0 * worst.close_share,
            worst.fast_error,
            number(times.forward),
            number(times.gradients),
            number(times.worlds),
            if worst.complaints.is_empty() { "" } else { "  BROKEN" },
        );
    }
    out
}
