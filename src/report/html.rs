//! Writes the page as one HTML document that needs nothing else: style, script and images are inside it.
//!
//! Without scripts everything is there but values under the pointer and enlarged images. Missing and not
//! finite numbers are em dashes. Equal pages give equal bytes.

mod bytes;
mod elements;
mod merits;
mod strips;

use std::fmt::Write as _;

use self::elements::{count, figure, kib};
use super::{
    Page, SchedulerRun, Shown,
    plot::{Hue, Panel, Plot, Series, Shape, escape, number},
};

const STYLE: &str = include_str!("page.css");
/// Forbids every request.
const POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
/// Values under the pointer, one series in focus, enlarged images.
const SCRIPT: &str = include_str!("page.js");

/// The complete document.
pub fn page(page: &Page) -> String {
    let title = escape(&page.title);
    let mut out = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" \
         content=\"width=device-width, initial-scale=1\"><meta http-equiv=\"Content-Security-Policy\" \
         content=\"{POLICY}\"><title>{title} · dgs</title>\n<style>{STYLE}</style></head>\n<body><main>\n\
         <header><h1>{title}</h1>\n<p class=\"lead\">{}</p></header>\n",
        summary(page)
    );
    merits::headline(&mut out, &page.runs);
    plots(&mut out, page);
    strips::strips(&mut out, page);
    bytes::ledger(&mut out, &page.ledger);
    out += "<h2>Protocol</h2>\n";
    pairs(&mut out, page.protocol.iter().map(|(k, v)| (k.as_str(), v.as_str())));
    out += "<h2>Notes</h2>\n";
    if page.notes.is_empty() {
        out += "<p class=\"note\">None.</p>\n";
    } else {
        let items: String = page.notes.iter().map(|n| format!("<li>{}</li>", escape(n))).collect();
        let _ = writeln!(out, "<ul>{items}</ul>");
    }
    out += "<h2>Machine</h2>\n";
    let cores = page.machine.cores.to_string();
    let device = page.machine.device.as_deref().unwrap_or("—");
    let machine = [("processor", page.machine.cpu.as_str()), ("cores", &cores), ("graphics device", device)];
    pairs(&mut out, machine.into_iter());
    out += "<footer class=\"note\">Written by <code>dgs</code>. This file needs nothing else and asks for \
        nothing.\
            </footer>\n</main>\n<script>\n";
    out + SCRIPT + "</script></body></html>\n"
}

/// What a reader sees, in one paragraph made of the page's own numbers.
fn summary(page: &Page) -> String {
    let l = &page.ledger;
    let mut out = format!(
        "A dynamic scene of {} Gaussians and {} frames was encoded once, to {} KiB on the wire, and sent \
         over the same emulated link by {}. Each frame shows, at its deadline, whatever had arrived in \
         usable form \
         by then; nothing waits.",
        count(l.gaussians),
        count(l.frames),
        number(l.wire() / 1024.0, 1),
        match page.runs.len() {
            0 => "no scheduler".to_owned(),
            1 => "one scheduler".to_owned(),
            n => format!("{n} schedulers in turn"),
        }
    );
    let finite = page.runs.iter().filter(|r| r.mean_psnr_db.is_finite());
    let mut ranked: Vec<&SchedulerRun> = finite.collect();
    ranked.sort_by(|a, b| b.mean_psnr_db.total_cmp(&a.mean_psnr_db));
    if let Some(best) = ranked.first() {
        let (name, mean) = (escape(&best.name), number(best.mean_psnr_db, 2));
        let _ = write!(out, " Mean image quality was highest under <strong>{name}</strong>, {mean} dB PSNR");
        if let Some(worst) = ranked.last().filter(|_| ranked.len() > 1) {
            let (name, mean) = (escape(&worst.name), number(worst.mean_psnr_db, 2));
            let _ = write!(out, ", and lowest under {name}, {mean} dB");
        }
        out.push('.');
    }
    let complete: Vec<f64> = page.complete_psnr_db.iter().copied().filter(|v| v.is_finite()).collect();
    if !complete.is_empty() {
        let mean = complete.iter().sum::<f64>() / complete.len() as f64;
        let _ = write!(out, " With every packet delivered in time it would be {} dB.", number(mean, 2));
    }
    out
}

/// Names and values.
fn pairs<'a>(out: &mut String, pairs: impl Iterator<Item = (&'a str, &'a str)>) {
    out.push_str("<table class=\"pairs\"><tbody>\n");
    let mut empty = true;
    for (name, value) in pairs {
        empty = false;
        let _ = writeln!(out, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(value));
    }
    if empty {
        out.push_str("<tr><th>—</th><td>—</td></tr>\n");
    }
    out.push_str("</tbody></table>\n");
}

/// A drawing under its heading.
/// Series of all runs over time.
fn series<'a>(
    runs: &'a [SchedulerRun],
    shape: Shape,
    points: impl Fn(&'a SchedulerRun) -> Vec<(f64, f64)> + 'a,
) -> impl Iterator<Item = Series<'a>> {
    let one = move |(i, r)| Series {
        name: SchedulerRun::name(r),
        hue: Hue::Scheduler(i),
        shape,
        points: points(r),
    };
    runs.iter().enumerate().map(one)
}

impl SchedulerRun {
    fn name(&self) -> &str {
        &self.name
    }

    /// A value of each row of the delivery, over seconds.
    fn rows(&self, value: fn(&emulator_host::report::FrameRow) -> f64) -> Vec<(f64, f64)> {
        self.delivery.frames.iter().map(|f| (f.time_ns.as_s(), value(f))).collect()
    }
}

/// Everything over time.
fn plots(out: &mut String, page: &Page) {
    const TIME: &str = "time since the session began, s";
    let shown = page.runs.iter().flat_map(|r| r.frames.iter().filter_map(|f| f.time_s));
    let rows = page.runs.iter().flat_map(|r| r.delivery.frames.iter().map(|f| f.time_ns.as_s()));
    let end = shown.chain(rows).filter(|t| t.is_finite()).fold(0.0, f64::max);
    let link = page.capacity_mbps.iter().map(|c| c.0).filter(|t| t.is_finite()).fold(0.0, f64::max);
    let end = [end * 1.01, link, 1.0].into_iter().find(|t| *t > 0.0).unwrap_or(1.0);
    let draw = |title: &str, panels| Plot { title, x_label: TIME, x: (0.0, end), panels }.svg();

    out.push_str("<h2>Over time</h2>\n");
    out.push_str(
        "<p class=\"note hint\">Point at a plot for its values, at a legend entry to single it out.</p>\n",
    );
    let mut quality: Vec<Series<'_>> = Vec::new();
    // Frames of the complete state have no playout time of their own: they take the earliest run's.
    let start = |r: &SchedulerRun| r.frames.iter().filter_map(|f| f.time_s).fold(f64::INFINITY, f64::min);
    let earliest = page.runs.iter().filter(|r| start(r).is_finite());
    let earliest = earliest.min_by(|a, b| start(a).total_cmp(&start(b)));
    if let Some(run) = earliest {
        let psnr = |f: &Shown| page.complete_psnr_db.get(f.frame as usize).copied().unwrap_or(f64::NAN);
        let points = run.frames.iter().filter_map(|f| Some((f.time_s?, psnr(f)))).collect();
        quality.push(Series { name: "complete state", hue: Hue::Reference, shape: Shape::Line, points });
    }
    // A frame that was never shown is a gap where the one before it was.
    let psnr = |r: &SchedulerRun| {
        let point = |last: &mut f64, f: &Shown| match f.time_s {
            Some(t) => {
                *last = t;
                Some((t, f.psnr_db))
            }
            None => Some((*last, f64::NAN)),
        };
        r.frames.iter().scan(f64::NAN, point).collect()
    };
    quality.extend(series(&page.runs, Shape::Line, psnr));
    let mut capacity: Vec<(f64, f64)> = page.capacity_mbps.iter().copied().filter(|c| c.0 <= end).collect();
    if let Some(last) = capacity.last().copied() {
        capacity.push((end, last.1));
    }
    let capacity =
        vec![Series { name: "link capacity", hue: Hue::Link, shape: Shape::Area, points: capacity }];
    let panel = |label, unit, decimals, height, covers, series| Panel {
        label,
        unit,
        decimals,
        height,
        covers,
        series,
    };
    let says = format!(
        "PSNR of each shown frame against the source’s own render, dB; a line begins when its playout does. \
         The dashed line is the state with every packet delivered{}. Below, what the link could carry.",
        earliest.map_or(String::new(), |r| format!(", at the playout times of {}", escape(&r.name)))
    );
    let panels = vec![
        panel("PSNR, dB", "dB", 2, 280.0, &[], quality),
        panel("Link capacity, Mbit/s", "Mbit/s", 2, 84.0, &[0.0], capacity),
    ];
    figure(out, "Image quality", &says, &draw("PSNR and link capacity over time", panels));

    let all = series(&page.runs, Shape::Step, |r| r.rows(|f| 100.0 * f.miss)).collect();
    let base = series(&page.runs, Shape::Step, |r| r.rows(|f| 100.0 * f.base_miss)).collect();
    let panels = vec![
        panel("Deadline miss, all levels, % of active groups", "%", 1, 190.0, &[0.0], all),
        panel("Deadline miss, level 0 only, % of active groups", "%", 1, 110.0, &[0.0, 10.0], base),
    ];
    let says =
        "Share of the groups active at each frame whose closure was not usable when the frame was shown.";
    figure(out, "Deadline misses", says, &draw("Deadline misses over time", panels));

    let utility = series(&page.runs, Shape::Step, |r| r.rows(|f| f.utility)).collect();
    let panels = vec![panel("Utility, share of what is on offer (1 = all)", "", 3, 190.0, &[1.0], utility)];
    let says = "Utility of what was usable over the positive utility of the groups active at each frame.";
    figure(out, "Utility", says, &draw("Utility over time", panels));

    let bytes = page.runs.iter().flat_map(|r| r.delivery.frames.iter().map(|f| f.usable_bytes));
    let large = bytes.max().unwrap_or(0) >= 10 << 20;
    let (label, unit) =
        if large { ("Usable bytes so far, MiB", "MiB") } else { ("Usable bytes so far, KiB", "KiB") };
    let usable = series(&page.runs, Shape::Step, |r| {
        r.rows(if large { |f| kib(f.usable_bytes) / 1024.0 } else { |f| kib(f.usable_bytes) })
    });
    let panels = vec![panel(label, unit, if large { 2 } else { 1 }, 190.0, &[0.0], usable.collect())];
    let says =
        "Bytes of distinct packets that could be shown by each playout time, whatever frame they belong to.";
    figure(out, "Usable bytes", says, &draw("Cumulative usable bytes over time", panels));
}
