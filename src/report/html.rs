//! The page as one HTML document that needs nothing else: style, script and images are inside it.
//!
//! Without scripts everything is there but values under the pointer and enlarged images. Missing and not
//! finite numbers are em dashes. Equal pages give equal bytes.

use std::fmt::Write as _;

use render_host::Image;
use trainer_host::encode::Ledger;

use super::plot::{Bar, Bars, Hue, Panel, Plot, Series, Shape, escape, number};
use super::{Page, Picture, Run, Shown, Strip};

const STYLE: &str = include_str!("page.css");
/// Forbids every request.
const POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'";
/// Values under the pointer, one series in focus, enlarged images.
const SCRIPT: &str = r"
document.documentElement.classList.add('js');
const make = (tag, text, to) => { const e = document.createElement(tag); e.textContent = text; to.append(e); return e; };
const tip = make('div', '', document.body); tip.className = 'tip'; tip.hidden = true;
for (const svg of document.querySelectorAll('svg.plot[data-x]')) {
  const [x0, x1, left, right] = svg.dataset.x.split(' ').map(Number), rule = svg.querySelector('.rule');
  for (const t of svg.querySelectorAll('g.series > title')) t.remove();
  const panels = [...svg.querySelectorAll('.panel')].map(p => ({ label: p.dataset.label,
    series: [...p.querySelectorAll('.series')].map(s => ({ ...s.dataset, colour: getComputedStyle(s).getPropertyValue('--c'),
      at: s.dataset.p.split(' ').filter(v => v).map(v => v.split(',')) })) }));
  const hide = () => { tip.hidden = true; rule.style.visibility = 'hidden'; };
  svg.addEventListener('pointerleave', hide);
  svg.addEventListener('pointermove', e => {
    const m = svg.getScreenCTM(), px = (e.clientX - m.e) / m.a;
    if (px < left || px > right) return hide();
    const time = x0 + (px - left) / (right - left) * (x1 - x0), slack = (x1 - x0) / 100;
    tip.textContent = ''; make('b', time.toFixed(2) + ' s', tip);
    const table = make('table', '', tip);
    for (const p of panels) {
      if (panels.length > 1) { const r = make('tr', '', table); r.className = 'head'; make('td', p.label, r).colSpan = 2; }
      for (const s of p.series) {
        let i = -1;
        while (i + 1 < s.at.length && +s.at[i + 1][0] <= time) i++;
        if (!s.step && i + 1 < s.at.length && (i < 0 || s.at[i + 1][0] - time < time - s.at[i][0])) i++;
        const v = s.at[i], near = v && (s.step && i + 1 < s.at.length || Math.abs(v[0] - time) < Math.max(slack, .12));
        const r = make('tr', '', table), n = make('td', s.n, r), dot = document.createElement('i');
        dot.className = 'swatch'; dot.style.background = s.colour; n.prepend(dot);
        make('td', near ? v[1] + ' ' + s.u : '—', r);
      }
    }
    rule.style.visibility = 'visible'; rule.setAttribute('transform', 'translate(' + px + ' 0)'); tip.hidden = false;
    const w = tip.offsetWidth, room = document.documentElement.clientWidth;
    tip.style.left = (e.clientX + 18 + w > room ? e.clientX - w - 18 : e.clientX + 18) + scrollX + 'px';
    tip.style.top = e.clientY + 14 + scrollY + 'px';
  });
  for (const entry of svg.querySelectorAll('.entry')) {
    const mark = on => { svg.classList.toggle('focus', on);
      for (const s of svg.querySelectorAll('.series')) s.classList.toggle('on', on && s.dataset.n === entry.dataset.n); };
    entry.addEventListener('pointerenter', () => mark(true)); entry.addEventListener('pointerleave', () => mark(false));
  }
}
const box = make('dialog', '', document.body), big = make('img', '', box), says = make('p', '', box);
let row = [], at = 0;
const show = i => { at = (i + row.length) % row.length; big.src = row[at].src; says.textContent = row[at].alt; };
for (const strip of document.querySelectorAll('.strip')) for (const kind of ['shot', 'map']) {
  const all = [...strip.querySelectorAll('img.' + kind)];
  all.forEach((img, i) => img.addEventListener('click', () => { row = all; show(i); box.showModal(); }));
}
box.addEventListener('click', () => box.close());
box.addEventListener('keydown', e => { const d = { ArrowLeft: -1, ArrowRight: 1 }[e.key]; if (d) { show(at + d); e.preventDefault(); } });
";

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
    value: fn(&Run) -> f64,
}

/// The headline table.
#[rustfmt::skip]
const COLUMNS: [Column; 10] = [
    Column { name: "Startup", unit: "ms", better: Better::Down, decimals: 0, value: |r| r.delivery.startup_ms.unwrap_or(f64::NAN) },
    Column { name: "Deadline miss", unit: "% of groups", better: Better::Down, decimals: 1, value: |r| 100.0 * r.delivery.miss_rate },
    Column { name: "Base miss", unit: "% of groups", better: Better::Down, decimals: 1, value: |r| 100.0 * r.delivery.base_miss_rate },
    Column { name: "Utility", unit: "share, 0–1", better: Better::Up, decimals: 3, value: |r| r.delivery.utility },
    Column { name: "Mean PSNR", unit: "dB", better: Better::Up, decimals: 2, value: |r| r.mean_psnr_db },
    Column { name: "Worst 10 %", unit: "PSNR, dB", better: Better::Up, decimals: 2, value: |r| r.tail_psnr_db },
    Column { name: "SSIM", unit: "0–1", better: Better::Up, decimals: 4, value: |r| r.mean_ssim },
    Column { name: "Flicker", unit: "10⁻³ of range", better: Better::Down, decimals: 2, value: |r| 1e3 * r.flicker },
    Column { name: "Usable goodput", unit: "Mbit/s", better: Better::Up, decimals: 2, value: |r| r.delivery.usable_goodput_bps / 1e6 },
    Column { name: "Wasted", unit: "KiB", better: Better::Down, decimals: 1, value: |r| kib(r.delivery.waste.total_bytes()) },
];

/// A row of the delivery details: what, unit, and the text of a run's value.
type Detail = (&'static str, &'static str, fn(&Run) -> String);

/// What the headline leaves out.
#[rustfmt::skip]
const DETAILS: [Detail; 22] = [
    ("Congestion controller", "", |r| escape(&r.delivery.controller)),
    ("Seed of the path", "", |r| r.delivery.seed.to_string()),
    ("Session length", "s", |r| number(r.delivery.duration_ns.as_s(), 3)),
    ("Frames shown / all", "frames", |r| format!("{} / {}", r.frames.iter().filter(|f| f.time_s.is_some()).count(), r.frames.len())),
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
    ("Control · pings", "datagrams", |r| format!("{} · {}", count(r.delivery.sender.control), count(r.delivery.sender.pings))),
    ("Declared lost · spuriously", "packets", |r| format!("{} · {}", count(r.delivery.sender.lost), count(r.delivery.sender.spurious))),
    ("Probe timeouts", "times", |r| count(r.delivery.sender.probe_timeouts)),
    ("Recovered from parity", "packets", |r| count(r.delivery.recovered)),
    ("Arrived before the manifest", "packets", |r| count(r.delivery.buffered_before_manifest)),
    ("Digest of the run", "", |r| format!("<code>{:016x}</code>", r.delivery.digest)),
];

fn kib(bytes: u64) -> f64 {
    bytes as f64 / 1024.0
}

fn count(n: u64) -> String {
    number(n as f64, 0)
}

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
    headline(&mut out, &page.runs);
    plots(&mut out, page);
    strips(&mut out, page);
    rate(&mut out, &page.ledger);
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
    out += "<footer class=\"note\">Written by <code>dgs</code>. This file needs nothing else and asks for nothing.\
            </footer>\n</main>\n<script>";
    out + SCRIPT + "</script></body></html>\n"
}

/// What a reader sees, in one paragraph made of the page's own numbers.
fn summary(page: &Page) -> String {
    let l = &page.ledger;
    let mut out = format!(
        "A dynamic scene of {} Gaussians and {} frames was encoded once, to {} KiB on the wire, and sent \
         over the same emulated link by {}. Each frame shows, at its deadline, whatever had arrived in usable form \
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
    let mut ranked: Vec<&Run> = finite.collect();
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

/// Every scheduler's figures of merit, the best of each column marked.
fn headline(out: &mut String, runs: &[Run]) {
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
        let class = Hue::Run(i).class();
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
        "</tbody></table></div>\n<p class=\"note\">↑ higher is better, ↓ lower is better; the best of each column is \
         highlighted. A miss is a group active at a frame whose closure was not usable at its deadline; base \
         counts level 0 only. Utility is the usable share of the positive utility on offer. A frame that was \
         never shown counts as missed, and as background in the image metrics. Worst 10 % is the mean PSNR of \
         the worst tenth of frames. Flicker is the mean absolute difference between shown and source \
         frame-to-frame changes. Wasted bytes arrived and showed nothing.</p>\n",
    );
    for run in runs.iter().filter(|r| r.delivery.startup_ms.is_some() && !r.delivery.startup_reached) {
        let name = escape(&run.name);
        let _ = writeln!(
            out,
            "<p class=\"note\">{name} began because its wait was over, not its threshold reached.</p>"
        );
    }
    out.push_str("<details><summary>Delivery in detail, waste by kind</summary><div class=\"scroll\"><table class=\"wide\">");
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
fn best(column: &Column, runs: &[Run]) -> Option<String> {
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
fn waste(run: &Run) -> String {
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
fn figure(out: &mut String, heading: &str, says: &str, svg: &str) {
    let _ = writeln!(
        out,
        "<figure class=\"figure\"><h3>{heading}</h3><p class=\"note\">{says}</p>{svg}</figure>"
    );
}

/// Series of all runs over time.
fn series<'a>(
    runs: &'a [Run],
    shape: Shape,
    points: impl Fn(&'a Run) -> Vec<(f64, f64)> + 'a,
) -> impl Iterator<Item = Series<'a>> {
    let one = move |(i, r)| Series { name: Run::name(r), hue: Hue::Run(i), shape, points: points(r) };
    runs.iter().enumerate().map(one)
}

impl Run {
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
    let start = |r: &Run| r.frames.iter().filter_map(|f| f.time_s).fold(f64::INFINITY, f64::min);
    let earliest = page.runs.iter().filter(|r| start(r).is_finite());
    let earliest = earliest.min_by(|a, b| start(a).total_cmp(&start(b)));
    if let Some(run) = earliest {
        let psnr = |f: &Shown| page.complete_psnr_db.get(f.frame as usize).copied().unwrap_or(f64::NAN);
        let points = run.frames.iter().filter_map(|f| Some((f.time_s?, psnr(f)))).collect();
        quality.push(Series { name: "complete state", hue: Hue::Reference, shape: Shape::Line, points });
    }
    // A frame that was never shown is a gap where the one before it was.
    let psnr = |r: &Run| {
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

/// Frames side by side.
fn strips(out: &mut String, page: &Page) {
    out.push_str("<h2>Frames side by side</h2>\n");
    if page.strips.is_empty() {
        out.push_str("<p class=\"note\">No frames were picked.</p>\n");
        return;
    }
    out.push_str(
        "<p class=\"note\">The source’s own render, then what each scheduler showed at that frame’s deadline; PSNR \
         against the source, the best of each row highlighted. <span class=\"hint\">Click an image to enlarge it, \
         then flip along its row with ← and →.</span></p>\n<div class=\"strips\"><p class=\"toggle\"><label>\
         <input type=\"checkbox\" id=\"maps\" checked>Error maps</label><span class=\"scale\">no error <i></i> full \
         scale or more; mean absolute difference of r, g, b</span></p>\n",
    );
    for strip in &page.strips {
        let texts = strip.shown.iter().filter_map(|p| p.psnr_db).filter(|v| v.is_finite());
        let best = texts.reduce(f64::max).map(|v| number(v, 2));
        let columns = 1 + strip.shown.len();
        let _ = write!(
            out,
            "<div class=\"scroll\"><div class=\"strip\" style=\"--n:{columns}\"><h3>Frame {}</h3>",
            strip.frame
        );
        picture(out, strip, &strip.reference, None, None);
        for (i, shown) in strip.shown.iter().enumerate() {
            picture(out, strip, shown, Some(i), best.as_deref());
        }
        out.push_str("</div></div>\n");
    }
    out.push_str("</div>\n");
}

/// An image under its caption, its error map below it.
fn picture(out: &mut String, strip: &Strip, picture: &Picture, run: Option<usize>, best: Option<&str>) {
    let caption = escape(&picture.caption);
    let psnr = picture.psnr_db.map_or("—".to_owned(), |v| number(v, 2));
    let swatch = run.map_or(String::new(), |i| format!(r#"<i class="swatch {}"></i>"#, Hue::Run(i).class()));
    let score = match run {
        None if picture.psnr_db.is_none() => "reference".to_owned(),
        _ if best == Some(&psnr) => format!("<b>{psnr} dB</b>"),
        _ => format!("{psnr} dB"),
    };
    let _ = write!(out, "<figure><figcaption>{swatch}{caption}<span>{score}</span></figcaption>");
    let about = format!("frame {}, {caption}, {psnr} dB", strip.frame);
    embed(out, &picture.image, "shot", &about);
    if let Some(error) = &picture.error {
        embed(out, error, "map", &format!("error map of {about}"));
    }
    out.push_str("</figure>");
}

/// The image itself, or a dash where there is none.
fn embed(out: &mut String, image: &Image, class: &str, about: &str) {
    let Ok(png) = image.to_png() else {
        let _ = write!(out, r#"<div class="none {class}">—</div>"#);
        return;
    };
    let (width, height, data) = (image.width(), image.height(), base64(&png));
    let _ = write!(
        out,
        r#"<img class="{class}" width="{width}" height="{height}" alt="{about}" loading="lazy" decoding="async" src="data:image/png;base64,{data}">"#
    );
}

/// RFC 4648, padded.
fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let at = |i: usize| u32::from(three.get(i).copied().unwrap_or(0));
        let bits = at(0) << 16 | at(1) << 8 | at(2);
        for i in 0..4 {
            let letter = char::from(LETTERS[(bits >> (18 - 6 * i) & 63) as usize]);
            out.push(if i > three.len() { '=' } else { letter });
        }
    }
    out
}

/// Where the bytes went.
fn rate(out: &mut String, l: &Ledger) {
    let wire = l.wire();
    let share = |bytes: f64| if wire > 0.0 { 100.0 * bytes / wire } else { f64::NAN };
    out.push_str(
        "<h2>Where the bytes went</h2>\n<div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Part</th>",
    );
    out.push_str("<th>Size<small>bytes</small></th><th>Of the wire<small>%</small></th>");
    out.push_str("<th class=\"meter\"></th><th class=\"text\">What it is</th></tr></thead><tbody>\n");
    let group = |out: &mut String, name: &str| {
        let _ = writeln!(out, "<tr class=\"group\"><th colspan=\"5\">{name}</th></tr>");
    };
    let row = |out: &mut String, class: &str, (name, bytes, says): (&str, f64, &str)| {
        let (size, part) = (number(bytes, 0), number(share(bytes), 1));
        let wide = if share(bytes).is_finite() { share(bytes).clamp(0.0, 100.0) } else { 0.0 };
        let meter = if class == "part" && wide > 0.0 {
            format!("<i style=\"width:{wide:.2}%\"></i>")
        } else {
            String::new()
        };
        let _ = writeln!(
            out,
            "<tr class=\"{class}\"><th>{name}</th><td>{size}</td><td>{part}</td><td class=\"meter\">{meter}</td>\
             <td class=\"text\">{says}</td></tr>"
        );
    };
    group(out, "Before packets");
    row(out, "", ("Raw symbols", l.raw_symbols, "two bytes each"));
    row(
        out,
        "",
        ("Empirical entropy", l.empirical_entropy, "order 0 under the model’s contexts, tables free"),
    );
    row(out, "", ("Monolithic stream", l.monolithic, "the same symbols entropy-coded without packets"));
    group(out, "On the wire");
    row(out, "part", ("Payload", l.payload, "entropy-coded bodies as packetised"));
    row(out, "part", ("Headers", l.headers, "of packets and slices"));
    row(out, "part", ("Dependencies", l.dependencies, "explicit dependency words"));
    row(out, "part", ("CRC", l.crc, "of media packets"));
    row(out, "part", ("Parity", l.parity, "parity packets, whole"));
    row(out, "part", ("Manifest", l.manifest, "the DGSM message"));
    row(out, "sum", ("Wire total", wire, "all packets and the manifest"));
    out.push_str("</tbody></table></div>\n");
    let premium = if l.monolithic > 0.0 { 100.0 * l.robustness_premium() } else { f64::NAN };
    let per = |n: u64, v: f64| if n > 0 { v } else { f64::NAN };
    let facts = [
        (
            "Packetisation overhead",
            "%",
            number(100.0 * l.packetisation_overhead(), 1),
            "headers, dependencies and CRC in media packets",
        ),
        ("Robustness premium", "%", number(premium, 1), "wire total over the monolithic stream, less one"),
        (
            "Rate",
            "bits/Gaussian",
            number(per(l.gaussians, l.bits_per_gaussian()), 2),
            "wire total, manifest included",
        ),
        ("Rate", "bytes/frame", number(per(l.frames, l.bytes_per_frame()), 1), "wire total over frames"),
        ("Gaussians", "count", count(l.gaussians), "over all epochs"),
        ("Frames", "count", count(l.frames), ""),
        ("Symbols", "count", count(l.symbols), "coded"),
        ("Media packets", "count", count(l.packets), ""),
        ("Parity packets", "count", count(l.parity_packets), ""),
        ("Clamped values", "count", count(l.saturated), "did not fit their symbol"),
    ];
    out.push_str("<div class=\"scroll\"><table class=\"wide\"><thead><tr><th>Derived</th><th>Value</th>");
    out.push_str("<th class=\"text\">Unit</th><th class=\"text\">What it is</th></tr></thead><tbody>\n");
    for (name, unit, value, says) in facts {
        let _ = writeln!(
            out,
            "<tr><th>{name}</th><td>{value}</td><td class=\"text\">{unit}</td><td class=\"text\">{says}</td></tr>"
        );
    }
    out.push_str("</tbody></table></div>\n");
    shares(out, l);
}

/// Payload by attribute and level.
fn shares(out: &mut String, l: &Ledger) {
    if l.shares.is_empty() {
        out.push_str("<p class=\"note\">Payload by attribute and level: —</p>\n");
        return;
    }
    let top = l.shares.iter().map(|s| usize::from(s.level)).max().unwrap_or(0).min(15);
    let keys: Vec<String> =
        (0..=top).map(|i| if i == 0 { "level 0 (base)".to_owned() } else { format!("level {i}") }).collect();
    let mut rows: Vec<Bar<'_>> = Vec::new();
    for share in &l.shares {
        let part = (usize::from(share.level).min(top), share.bits / 1e3);
        match rows.iter_mut().find(|r| r.name == share.attribute) {
            Some(row) => row.parts.push(part),
            None => rows.push(Bar { name: share.attribute, parts: vec![part] }),
        }
    }
    rows.iter_mut().for_each(|r| r.parts.sort_by_key(|p| p.0));
    let total = |r: &Bar<'_>| r.parts.iter().map(|p| p.1).filter(|v| v.is_finite()).sum::<f64>();
    rows.sort_by(|a, b| total(b).total_cmp(&total(a)));
    let says = "Estimated entropy-coded payload, thousands of bits, largest attribute first; at the right its total and \
                its share of all payload bits.";
    let svg = Bars {
        title: "Payload bits by attribute and level",
        label: "payload, kbit",
        unit: "kbit",
        keys: &keys,
        rows,
    };
    figure(out, "Payload by attribute and level", says, &svg.svg());
}

#[cfg(test)]
mod tests {
    use super::base64;

    #[test]
    fn base64_pads() {
        let texts = ["", "TQ==", "TWE=", "TWFu", "TWFu/w=="];
        let bytes: [&[u8]; 5] = [b"", b"M", b"Ma", b"Man", b"Man\xff"];
        for (text, bytes) in texts.iter().zip(bytes) {
            assert_eq!(base64(bytes), *text);
        }
    }
}
