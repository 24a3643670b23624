//! Draws plots as SVG text: lines and steps over time in panels that share their axis, and stacked bars.
//!
//! Colours, weights and type come from `page.css` by class, so one drawing serves the light theme, the dark
//! theme and paper. Series differ by marker as well as by colour. Every mark carries a `<title>`, and
//! every series its values in `data-p`, so that the page can show them under the pointer; nothing needs that.
//!
//! A value that is not finite is a gap, never a panic.

mod bars;

use std::fmt::Write as _;

pub use bars::{Bar, Bars};

/// Width of every drawing, in its own units; the page scales it to the column.
const WIDTH: f64 = 1000.0;
/// Room for the labels of the value axis.
const LEFT: f64 = 62.0;
/// Room for half of the last label of the time axis.
const RIGHT: f64 = 18.0;
/// Height of one row of the legend.
const LEGEND_ROW: f64 = 24.0;
/// Room for the label of a panel, above it.
const HEAD: f64 = 32.0;
/// Markers along one series.
const MARKERS: usize = 7;
/// Numbers farther from zero than this are not drawn.
const HUGE: f64 = 1e15;

/// Text as HTML and SVG take it, in elements and in attributes.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            c if c.is_control() && c != '\n' && c != '\t' => out.push(' '),
            c => out.push(c),
        }
    }
    out
}

/// A number for people: `decimals` places, thousands separated by commas, an em dash if it is not finite.
pub fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "—".to_owned();
    }
    let text = format!("{:.decimals$}", value.abs());
    let (whole, part) = text.split_at(text.find('.').unwrap_or(text.len()));
    let negative = value < 0.0 && text.bytes().any(|b| (b'1'..=b'9').contains(&b));
    let mut out = String::from(if negative { "−" } else { "" });
    for (i, digit) in whole.chars().enumerate() {
        if i > 0 && (whole.len() - i) % 3 == 0 {
            out.push(',');
        }
        out.push(digit);
    }
    out + part
}

/// Round numbers that cover a range.
#[derive(Clone, Debug, PartialEq)]
pub struct Ticks {
    /// Rising; at least two. The first is at or below the range, the last at or above it.
    pub values: Vec<f64>,
    /// Places that tell them apart.
    pub decimals: usize,
}

/// Ticks over `low..=high`, about `count` of them, at 1, 2 or 5 times a power of ten. A range that is empty,
/// reversed or not finite is widened first.
pub fn ticks(low: f64, high: f64, count: usize) -> Ticks {
    let tame = |v: f64| if v.is_finite() { v.clamp(-HUGE, HUGE) } else { 0.0 };
    let (mut low, mut high) = (tame(low).min(tame(high)), tame(low).max(tame(high)));
    let size = low.abs().max(high.abs());
    if high - low <= 1e-9 * size || high - low < 1e-9 {
        let pad = if size > 0.0 { 0.05 * size } else { 0.5 };
        (low, high) = (low - pad, high + pad);
    }
    let rough = (high - low) / count.max(1) as f64;
    let power = rough.log10().floor() as i32;
    let unit = 10f64.powi(power);
    let step = [1.0, 2.0, 5.0].iter().map(|m| m * unit).find(|s| *s >= rough * 0.8).unwrap_or(10.0 * unit);
    let first = (low / step + 1e-6).floor();
    let last = (high / step - 1e-6).ceil().max(first + 1.0).min(first + 100.0);
    let values = (0..=(last - first) as usize).map(|i| (first + i as f64) * step).collect();
    Ticks { values, decimals: (-(step.log10() + 1e-9).floor()).clamp(0.0, 9.0) as usize }
}

/// How points become a mark.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Straight from point to point.
    Line,
    /// Each value holds until the next point.
    Step,
    /// As `Step`, shaded down to zero.
    Area,
}

/// What a mark belongs to, which sets its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Hue {
    /// The run at this place; six colours and markers, then again.
    Scheduler(usize),
    /// What runs are compared with: grey and dashed.
    Reference,
    /// The link: a grey area.
    Link,
}

impl Hue {
    /// Its class in `page.css`.
    pub fn class(self) -> String {
        match self {
            Self::Scheduler(i) => format!("s{}", i % 6),
            Self::Reference => "ref".to_owned(),
            Self::Link => "link".to_owned(),
        }
    }
}

/// Values over time.
#[derive(Clone, Debug)]
pub struct Series<'a> {
    /// Name in the legend; equal names share an entry.
    pub name: &'a str,
    /// Colour.
    pub hue: Hue,
    /// Mark.
    pub shape: Shape,
    /// (x, y), x rising. A y that is not finite is a gap; a point whose x is not finite is ignored.
    pub points: Vec<(f64, f64)>,
}

/// One value axis with its series.
#[derive(Clone, Debug)]
pub struct Panel<'a> {
    /// What is drawn, and its unit, for example `PSNR, dB`.
    pub label: &'a str,
    /// Unit behind a value under the pointer.
    pub unit: &'a str,
    /// Places of a value under the pointer.
    pub decimals: usize,
    /// Height of the plotting area.
    pub height: f64,
    /// Values that the axis covers whatever the data are.
    pub covers: &'a [f64],
    /// Series, from back to front.
    pub series: Vec<Series<'a>>,
}

/// Panels above one another over one time axis.
#[derive(Clone, Debug)]
pub struct Plot<'a> {
    /// What a screen reader says.
    pub title: &'a str,
    /// Name and unit of the shared axis.
    pub x_label: &'a str,
    /// Its range.
    pub x: (f64, f64),
    /// From top to bottom.
    pub panels: Vec<Panel<'a>>,
}

/// Where data land: a range of values and the extent of the drawing that it takes.
#[derive(Clone, Copy)]
struct Scale {
    from: (f64, f64),
    to: (f64, f64),
}

impl Scale {
    fn at(self, value: f64) -> f64 {
        let share = (value - self.from.0) / (self.from.1 - self.from.0);
        self.to.0 + share * (self.to.1 - self.to.0)
    }
}

impl Plot<'_> {
    /// The drawing.
    pub fn svg(&self) -> String {
        let tame = |v: f64| if v.is_finite() { v.clamp(-HUGE, HUGE) } else { 0.0 };
        let (from, to) = (tame(self.x.0), tame(self.x.1));
        let x = Scale { from: (from, if to > from { to } else { from + 1.0 }), to: (LEFT, WIDTH - RIGHT) };
        let (legend, mut top) = legend(self.panels.iter().flat_map(|p| &p.series).map(|s| (s.name, s.hue)));
        let mut body = legend;
        let times = ticks(x.from.0, x.from.1, 10);
        let first = top + HEAD;
        for panel in &self.panels {
            top += HEAD;
            panel.draw(&mut body, x, top, &times);
            top += panel.height + 14.0;
        }
        let bottom = top - 14.0;
        for t in times.values.iter().filter(|t| (x.from.0 - 1e-9..=x.from.1 + 1e-9).contains(*t)) {
            let (at, y, text) = (x.at(*t), bottom + 19.0, number(*t, times.decimals));
            let _ = write!(
                body,
                r#"<text class="tick" x="{at:.1}" y="{y:.1}" text-anchor="middle">{text}</text>"#
            );
        }
        let (middle, y) = ((LEFT + WIDTH - RIGHT) / 2.0, bottom + 41.0);
        let text = escape(self.x_label);
        let _ = write!(
            body,
            r#"<text class="axis" x="{middle:.1}" y="{y:.1}" text-anchor="middle">{text}</text>"#
        );
        let _ = write!(body, r#"<path class="rule" d="M0 {first:.1}V{bottom:.1}"/>"#);
        let range = format!("{} {} {} {}", x.from.0, x.from.1, x.to.0, x.to.1);
        svg(&body, bottom + 50.0, self.title, &format!(r#" data-x="{range}""#))
    }
}

impl Panel<'_> {
    /// Grid, label and series at `top`.
    fn draw(&self, out: &mut String, x: Scale, top: f64, times: &Ticks) {
        let values =
            self.series.iter().flat_map(|s| s.points.iter().map(|p| p.1)).chain(self.covers.iter().copied());
        let tame = values.filter(|v| v.is_finite() && v.abs() < HUGE);
        let (low, high) = tame.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
        let ticks = ticks(low, high, (self.height / 38.0).round().max(2.0) as usize);
        let ends = (ticks.values.first().copied(), ticks.values.last().copied());
        let bottom = top + self.height;
        let y = Scale { from: (ends.0.unwrap_or(0.0), ends.1.unwrap_or(1.0)), to: (bottom, top) };
        let label = escape(self.label);
        let _ = write!(out, r#"<g class="panel" data-label="{label}">"#);
        let _ = write!(out, r#"<text class="axis" x="0" y="{:.1}">{label}</text>"#, top - 14.0);
        for t in times.values.iter().filter(|t| (x.from.0 - 1e-9..=x.from.1 + 1e-9).contains(*t)) {
            let _ = write!(out, r#"<path class="grid v" d="M{:.1} {top:.1}V{bottom:.1}"/>"#, x.at(*t));
        }
        for (i, t) in ticks.values.iter().enumerate() {
            let (at, kind, right) = (y.at(*t), if i == 0 { "base" } else { "grid" }, WIDTH - RIGHT);
            let _ = write!(out, r#"<path class="{kind}" d="M{LEFT} {at:.1}H{right}"/>"#);
            let (left, at, text) = (LEFT - 9.0, at + 4.5, number(*t, ticks.decimals));
            let _ =
                write!(out, r#"<text class="tick" x="{left}" y="{at:.1}" text-anchor="end">{text}</text>"#);
        }
        for (i, series) in self.series.iter().enumerate() {
            series.draw(out, (x, y), self, (i, self.series.len()));
        }
        out.push_str("</g>");
    }
}

impl Series<'_> {
    /// The mark, its markers and its values; it is number `place.0` of `place.1`.
    fn draw(&self, out: &mut String, (x, y): (Scale, Scale), panel: &Panel<'_>, place: (usize, usize)) {
        let usable = |v: f64| v.is_finite() && v.abs() < HUGE;
        let points: Vec<(f64, f64)> = self.points.iter().copied().filter(|p| usable(p.0)).collect();
        let (name, class) = (escape(self.name), self.hue.class());
        let step = if self.shape == Shape::Line { "" } else { r#" data-step="1""# };
        let (unit, mut values) = (escape(panel.unit), String::new());
        for p in points.iter().filter(|p| usable(p.1)) {
            let _ = write!(values, "{:.3},{:.*} ", p.0, panel.decimals, p.1);
        }
        let _ = write!(
            out,
            r#"<g class="series {class}" data-n="{name}" data-u="{unit}"{step} data-p="{}"><title>{name}</title>"#,
            values.trim_end()
        );
        // Each piece without a gap is one path.
        let mut pieces: Vec<Vec<(f64, f64)>> = vec![Vec::new()];
        for p in &points {
            match (usable(p.1), pieces.last_mut()) {
                (true, Some(piece)) => piece.push((x.at(p.0), y.at(p.1))),
                (false, Some(piece)) if !piece.is_empty() => {
                    if self.shape != Shape::Line {
                        let level = piece.last().map_or(y.to.0, |last| last.1);
                        piece.push((x.at(p.0), level));
                    }
                    pieces.push(Vec::new());
                }
                _ => {}
            }
        }
        let zero = y.at(0.0).clamp(y.to.1, y.to.0);
        for piece in &pieces {
            let (Some(first), Some(last)) = (piece.first(), piece.last()) else { continue };
            let mut d = format!("M{:.1} {:.1}", first.0, first.1);
            for p in &piece[1..] {
                let _ = match self.shape {
                    Shape::Line => write!(d, "L{:.1} {:.1}", p.0, p.1),
                    Shape::Step | Shape::Area => write!(d, "H{:.1}V{:.1}", p.0, p.1),
                };
            }
            if self.shape == Shape::Area {
                let _ = write!(out, r#"<path class="fill" d="{d}V{zero:.1}H{:.1}Z"/>"#, first.0);
            }
            if piece.len() > 1 {
                let _ = write!(out, r#"<path class="halo" d="{d}"/><path class="line" d="{d}"/>"#);
            } else {
                let _ = write!(out, r#"<circle class="dot" cx="{:.1}" cy="{:.1}" r="3"/>"#, last.0, last.1);
            }
        }
        if let Hue::Scheduler(run) = self.hue {
            let drawn: Vec<(f64, f64)> =
                points.iter().filter(|p| usable(p.1)).map(|p| (x.at(p.0), y.at(p.1))).collect();
            for p in spread(&drawn, (x.to.0, x.to.1), place) {
                marker(out, run, p);
            }
        }
        out.push_str("</g>");
    }
}

/// Up to [`MARKERS`] of `points` (x rising), evenly over the width and staggered by series.
fn spread(points: &[(f64, f64)], (left, right): (f64, f64), (i, of): (usize, usize)) -> Vec<(f64, f64)> {
    let gap = (right - left) / MARKERS as f64;
    let mut chosen: Vec<(f64, f64)> = Vec::new();
    for k in 0..MARKERS {
        let target = left + gap * (k as f64 + (i as f64 + 0.5) / of.max(1) as f64);
        let near = points.iter().min_by(|a, b| (a.0 - target).abs().total_cmp(&(b.0 - target).abs()));
        if let Some(p) = near.filter(|p| (p.0 - target).abs() < gap / 2.0 || points.len() == 1)
            && chosen.last() != Some(p)
        {
            chosen.push(*p);
        }
    }
    chosen
}

/// The marker of run `run` around `(x, y)`.
fn marker(out: &mut String, run: usize, (x, y): (f64, f64)) {
    let d = match run % 6 {
        0 => "m-4.2 0a4.2 4.2 0 1 0 8.4 0a4.2 4.2 0 1 0-8.4 0Z",
        1 => "m-3.8-3.8h7.6v7.6h-7.6Z",
        2 => "m0-5 4.8 8.4h-9.6Z",
        3 => "m0-5.4 5.4 5.4-5.4 5.4-5.4-5.4Z",
        4 => "m0 5 4.8-8.4h-9.6Z",
        _ => "m-1.6-4.8h3.2v3.2h3.2v3.2h-3.2v3.2h-3.2v-3.2h-3.2v-3.2h3.2Z",
    };
    let _ = write!(out, r#"<path class="mark" d="M{x:.1} {y:.1}{d}"/>"#);
}

/// Rows of entries, each name once, and the height they take.
fn legend<'a>(entries: impl Iterator<Item = (&'a str, Hue)>) -> (String, f64) {
    let mut seen: Vec<(&str, Hue)> = Vec::new();
    let (mut out, mut x, mut y) = (String::from(r#"<g class="legend">"#), 0.0, 14.0);
    for (name, hue) in entries {
        if seen.contains(&(name, hue)) {
            continue;
        }
        seen.push((name, hue));
        let width = 46.0 + 8.2 * name.chars().count() as f64 + 18.0;
        if x > 0.0 && x + width > WIDTH {
            (x, y) = (0.0, y + LEGEND_ROW);
        }
        let (class, escaped) = (hue.class(), escape(name));
        let _ = write!(out, r#"<g class="entry series {class}" data-n="{escaped}">"#);
        match hue {
            Hue::Link => {
                let _ = write!(out, r#"<path class="fill" d="M{x:.1} {:.1}h30v12h-30Z"/>"#, y - 10.0);
            }
            _ => {
                let _ = write!(out, r#"<path class="line" d="M{x:.1} {:.1}h30"/>"#, y - 4.0);
            }
        }
        if let Hue::Scheduler(run) = hue {
            marker(&mut out, run, (x + 15.0, y - 4.0));
        }
        let _ = write!(out, r#"<text x="{:.1}" y="{y:.1}">{escaped}</text></g>"#, x + 38.0);
        x += width;
    }
    out.push_str("</g>");
    (out, if seen.is_empty() { 0.0 } else { y + 14.0 })
}

/// `body` as a drawing of `height`.
fn svg(body: &str, height: f64, title: &str, data: &str) -> String {
    let title = escape(title);
    format!(
        r#"<svg class="plot" viewBox="0 0 {WIDTH} {height:.0}" role="img" aria-label="{title}"{data}>{body}</svg>"#
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_rising_and_cover_the_range() {
        let found = ticks(0.0, 1.0, 5);
        assert_eq!(found.values.len(), 6);
        assert_eq!((found.values[0], found.decimals), (0.0, 1));
        for (low, high) in [(0.0, 0.0), (3.0, 3.0), (-7.5, 12.25), (1e-7, 2e-7), (0.0, 9e14), (31.2, 31.4)] {
            for count in [0, 1, 5, 10] {
                let t = ticks(low, high, count);
                assert!(t.values.len() >= 2 && t.values.len() <= 3 * count.max(1) + 3, "{low} {high} {t:?}");
                assert!(t.values.windows(2).all(|w| w[0] < w[1]), "{t:?}");
                let slack = 1e-5 * (t.values[1] - t.values[0]);
                assert!(t.values[0] <= low + slack && *t.values.last().unwrap() >= high - slack, "{t:?}");
            }
        }
        for (low, high) in [(f64::NAN, 1.0), (f64::NEG_INFINITY, f64::INFINITY), (5.0, -5.0)] {
            assert!(ticks(low, high, 5).values.iter().all(|v| v.is_finite()));
        }
    }

    #[test]
    fn numbers_are_grouped_and_gaps_are_dashes() {
        assert_eq!(number(1_234_567.891, 2), "1,234,567.89");
        assert_eq!(number(-0.001, 2), "0.00");
        assert_eq!(number(-12.5, 1), "−12.5");
        assert_eq!(number(999.96, 1), "1,000.0");
        assert_eq!(number(f64::NAN, 1), "—");
        assert_eq!(number(f64::NEG_INFINITY, 0), "—");
    }

    fn plot(points: Vec<(f64, f64)>, shape: Shape) -> String {
        let series = vec![Series { name: "a<b", hue: Hue::Scheduler(0), shape, points }];
        let panel = Panel { label: "PSNR, dB", unit: "dB", decimals: 2, height: 200.0, covers: &[], series };
        Plot { title: "t", x_label: "time, s", x: (0.0, 2.0), panels: vec![panel] }.svg()
    }

    #[test]
    fn gaps_break_lines_and_nothing_that_is_not_finite_is_drawn() {
        let points =
            vec![(0.0, 1.0), (0.5, 2.0), (1.0, f64::NAN), (1.5, 2.0), (2.0, f64::INFINITY), (f64::NAN, 1.0)];
        for shape in [Shape::Line, Shape::Step, Shape::Area] {
            let svg = plot(points.clone(), shape);
            assert!(svg.contains("a&lt;b") && !svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
        assert_eq!(plot(points, Shape::Line).matches(r#"class="dot""#).count(), 1);
    }

    #[test]
    fn a_step_holds_its_value() {
        let svg = plot(vec![(0.0, 0.0), (1.0, 1.0), (2.0, 0.5)], Shape::Step);
        assert!(svg.contains("H522.0V"), "{svg}");
    }

    #[test]
    fn degenerate_drawings_are_drawn() {
        for points in [vec![], vec![(0.0, 0.0)], vec![(1.0, 7.0), (1.0, 7.0)], vec![(f64::NAN, f64::NAN)]] {
            assert!(!plot(points, Shape::Line).contains("NaN"));
        }
        let bars = Bars { title: "", label: "", unit: "bit", keys: &[], rows: Vec::new() };
        assert!(!bars.svg().contains("NaN"));
        let rows = vec![Bar { name: "x", parts: vec![(9, f64::NAN), (0, -1.0)] }];
        assert!(!Bars { rows, ..bars }.svg().contains("NaN"));
    }
}
