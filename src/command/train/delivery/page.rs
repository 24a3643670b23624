//! Makes the section of a page about fine-tuning for delivery: curves, candidates, damaged states.

use std::fmt::Write as _;

use anyhow::Result;
use trainer_host::train::delivery::{Candidate, Record, Terms};

use super::damage::{Damage, STATES};
use crate::report::{
    html::data_of_png,
    plot::{Hue, Panel, Plot, Series, Shape, escape, number},
};

/// The section about what `record` holds; `damage` is shown where there is any.
///
/// # Errors
/// A picture that cannot be written.
pub(super) fn section(record: &Record, seconds: f64, damage: &Damage) -> Result<String> {
    let registration = &record.registration;
    let mut out = format!(
        "<h2>Fine-tuning for delivery</h2>\n<p>{} of {} updates of variant {} in {:.1} minutes on {}.</p>\n",
        record.objective.len(),
        registration.options.updates,
        registration.options.variant.name(),
        seconds / 60.0,
        escape(&record.device)
    );
    if !record.objective.is_empty() {
        out += &curves(record);
    }
    out += &candidates(record);
    out += &damaged(damage)?;
    let options = serde_json::to_string_pretty(&registration.options)?;
    let _ = write!(
        out,
        "<h3>What was fixed before</h3>\n<table><tr><th>configuration</th><td>{}</td></tr>\n\
         <tr><th>states of validation</th><td>{}</td></tr>\n<tr><th>worlds of all updates</th>\
         <td>{}</td></tr></table>\n\
         <p class=\"note\">Hashes are FNV-1a, 64 bits. Taken is, {}.</p>\n<pre>{}</pre>\n",
        escape(&registration.config_hash),
        escape(&registration.validation_masks),
        escape(&registration.worlds),
        escape(&registration.selection_rule),
        escape(&options)
    );
    Ok(out)
}

/// A term of the objective: its name and its value.
type Term = (&'static str, fn(&Terms) -> f64);

const DISTORTIONS: [Term; 3] = [
    ("E[D], mean over worlds", |terms| terms.expected),
    ("CVaR, the worst worlds", |terms| terms.tail),
    ("D of the complete state", |terms| terms.prefixes[3]),
];
const OTHERS: [Term; 3] = [
    ("M, prefixes that lose", |terms| terms.monotone),
    ("F, change from frame to frame", |terms| terms.temporal),
    ("R, kilobits per Gaussian", |terms| terms.rate),
];

/// The objective, its terms, and what validation saw, over updates.
fn curves(record: &Record) -> String {
    let line = |name, hue, points| Series { name, hue: Hue::Scheduler(hue), shape: Shape::Line, points };
    let of = |values: &[f64]| (1..).zip(values).map(|(update, &v)| (f64::from(update), v)).collect();
    let panel =
        |label, unit, decimals, series| Panel { label, unit, decimals, height: 150.0, covers: &[], series };
    // A term that does not count in the variant is 0 throughout.
    let terms = |of_terms: [Term; 3], first: usize| -> Vec<Series<'_>> {
        let series = (first..).zip(of_terms).map(|(hue, (name, value))| {
            let values: Vec<f64> = record.terms.iter().map(value).collect();
            values.iter().any(|&value| value != 0.0).then(|| line(name, hue, of(&values)))
        });
        series.flatten().collect()
    };
    let seen = |value: fn(&Candidate) -> f64| -> Vec<(f64, f64)> {
        record.candidates.iter().map(|c| (c.updates as f64, value(c))).collect()
    };
    let mut panels = vec![panel("objective", "", 5, vec![line("objective", 0, of(&record.objective))])];
    for (label, series) in [("distortions, D", terms(DISTORTIONS, 0)), ("other terms", terms(OTHERS, 3))] {
        if !series.is_empty() {
            panels.push(panel(label, "", 6, series));
        }
    }
    if !record.candidates.is_empty() {
        let series = vec![
            line("complete state", 0, seen(|candidate| candidate.clean_db)),
            line("0.10 quantile of states with lost packets", 1, seen(|candidate| candidate.p10_db)),
        ];
        panels.push(panel("validation, PSNR, dB", "dB", 2, series));
    }
    let plot = Plot {
        title: "Objective, its terms and validation over updates",
        x_label: "updates",
        x: (0.0, record.objective.len() as f64),
        panels,
    };
    format!("{}\n<p class=\"note\">Terms are before their weights.</p>\n", plot.svg())
}

/// What validation saw of each candidate.
fn candidates(record: &Record) -> String {
    if record.candidates.is_empty() {
        return String::new();
    }
    let mut out =
        "<h3>Candidates</h3>\n<table><tr><th>after update</th><th>0.10 quantile of states with lost \
                   packets, dB</th><th>complete state, dB</th><th>bytes on the wire</th><th>prefixes that \
                   lose</th><th></th></tr>\n"
            .to_owned();
    for (index, candidate) in record.candidates.iter().enumerate() {
        let _ = writeln!(
            out,
            "<tr><td>{}</td><td>{:.2}</td><td>{:.2}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
            candidate.updates,
            candidate.p10_db,
            candidate.clean_db,
            number(candidate.wire_bytes as f64, 0),
            candidate.violations,
            if record.taken == Some(index) { "taken" } else { "" }
        );
    }
    out + "</table>\n"
}

/// One view in damaged states.
fn damaged(damage: &Damage) -> Result<String> {
    let mut out = format!(
        "<h3>Damaged states</h3>\n<img alt=\"from above: what should be seen, the scene as it was given, \
         fine-tuned; each column is a state\" style=\"max-width:100%\" src=\"{}\">\n<p class=\"note\">From \
         above: what should be seen, the scene as it was given, fine-tuned. Columns, in the order of the \
         table: of {STATES} states that a loss leaves, the one whose PSNR before is the median; the same \
         state after.</p>\n<table><tr><th>column</th><th>given, dB</th><th>fine-tuned, dB</th></tr>\n",
        data_of_png(&damage.pictures.to_png()?)
    );
    for (words, [before, after]) in &damage.columns {
        let _ = writeln!(out, "<tr><td>{}</td><td>{before:.2}</td><td>{after:.2}</td></tr>", escape(words));
    }
    Ok(out + "</table>\n")
}
