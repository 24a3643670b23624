//! Draws named points over two logarithmic axes as a self-contained SVG, with their Pareto front:
//! the points that no other beats in both directions, where smaller is better.
//!
//! Every point is labelled. A label stands beside its point where there is room, else farther off with a
//! thin line between. A point that is not finite is left out; one at 0 lies on the floor of the axis.

use std::fmt::Write as _;

use dgs::report::plot::escape;

const WIDTH: f64 = 1100.0;
const HEIGHT: f64 = 720.0;
const LEFT: f64 = 92.0;
const RIGHT: f64 = 150.0;
const TOP: f64 = 96.0;
const BOTTOM: f64 = 66.0;
/// Width of a letter of a label, and height of its line.
const LETTER: (f64, f64) = (6.4, 14.0);
/// Colours that also differ in lightness, one per group.
const COLOURS: [&str; 9] =
    ["#1b1b1b", "#2b6cb0", "#c05621", "#2f855a", "#97266d", "#b7791f", "#4c51bf", "#718096", "#0d9488"];

const STYLE: &str = "svg{background:#fff;font-family:system-ui,sans-serif;font-size:12px;fill:#222}\
.t{font-size:17px;font-weight:600}.s,.k{fill:#555}.g{stroke:#e6e6e6}.m{stroke:#f3f3f3}.b{stroke:#999;fill:none}\
.f{stroke:#d69e2e;stroke-width:2.2;fill:none;stroke-linejoin:round}.l{stroke:#aaa;stroke-width:.7}.o{font-weight:700}";

/// A named point.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Label.
    pub name: String,
    /// Place in [`Scatter::groups`].
    pub group: usize,
    /// Above 0.
    pub x: f64,
    /// 0 or above.
    pub y: f64,
}

/// The drawing.
#[derive(Clone, Debug)]
pub struct Scatter<'a> {
    /// Heading.
    pub title: &'a str,
    /// Line below it.
    pub subtitle: &'a str,
    /// Name and unit of the axis to the right.
    pub x_label: &'a str,
    /// Name and unit of the upward axis.
    pub y_label: &'a str,
    /// What the colours mean.
    pub groups: &'a [&'a str],
    /// The points.
    pub points: Vec<Point>,
}

/// For each of `points` (x, y), whether no other is at most as large in both and smaller in one. Points
/// that are not finite are on no front.
pub fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let finite = |p: &(f64, f64)| p.0.is_finite() && p.1.is_finite();
    let beats = |a: &(f64, f64), b: &(f64, f64)| a.0 <= b.0 && a.1 <= b.1 && a != b;
    points.iter().map(|p| finite(p) && !points.iter().any(|q| finite(q) && beats(q, p))).collect()
}

/// A logarithmic range and where it lands.
struct Axis {
    low: f64,
    high: f64,
    from: f64,
    to: f64,
}

impl Axis {
    /// Covers the positive of `values`, and room below them where some are 0.
    fn new(values: impl Iterator<Item = f64> + Clone, from: f64, to: f64, least_decades: f64) -> Self {
        let positive = values.clone().filter(|v| *v > 0.0);
        let (low, high) = positive.fold((f64::INFINITY, 0.0f64), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low.log10(), high.log10()) } else { (-1.0, 0.0) };
        let pad = (0.5 * (least_decades - (high - low))).max(0.06 * (high - low));
        let floor = if values.into_iter().any(|v| v <= 0.0) { 0.7 } else { 0.0 };
        Self { low: low - pad - floor, high: high + pad, from, to }
    }

    fn at(&self, value: f64) -> f64 {
        let log = if value > 0.0 { value.log10().max(self.low) } else { self.low };
        self.from + (log - self.low) / (self.high - self.low) * (self.to - self.from)
    }

    /// Round values inside, and whether each is worth a label.
    fn ticks(&self) -> Vec<(f64, bool)> {
        let few = self.high - self.low < 2.5;
        let decades = (self.low.floor() as i32)..=(self.high.ceil() as i32);
        let all = decades.flat_map(|d| (1..10).map(move |m| (m, f64::from(m) * 10f64.powi(d))));
        let inside = all.filter(|(_, v)| (self.low..=self.high).contains(&v.log10()));
        inside.map(|(m, v)| (v, m == 1 || few && matches!(m, 2 | 3 | 5 | 7))).collect()
    }
}

/// A rectangle that a label or a marker takes: left, top, right, bottom.
#[derive(Clone, Copy)]
struct Taken([f64; 4]);

impl Taken {
    fn overlap(&self, other: &Self) -> f64 {
        let (a, b) = (&self.0, &other.0);
        (a[2].min(b[2]) - a[0].max(b[0])).max(0.0) * (a[3].min(b[3]) - a[1].max(b[1])).max(0.0)
    }
}

impl Scatter<'_> {
    /// The drawing as SVG text.
    pub fn svg(&self) -> String {
        let points: Vec<&Point> =
            self.points.iter().filter(|p| p.x.is_finite() && p.x > 0.0 && p.y.is_finite()).collect();
        let x = Axis::new(points.iter().map(|p| p.x), LEFT, WIDTH - RIGHT, 0.4);
        let y = Axis::new(points.iter().map(|p| p.y), HEIGHT - BOTTOM, TOP, 1.0);
        let on = front(&points.iter().map(|p| (p.x, p.y)).collect::<Vec<_>>());
        let mut out = format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img"><title>{0}</title><style>{STYLE}</style><rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/><text class="t" x="20" y="28">{0}</text><text class="s" x="20" y="48">{1}</text>"##,
            escape(self.title),
            escape(self.subtitle)
        );
        self.grid(&mut out, &x, &y, points.iter().any(|p| p.y <= 0.0));
        let mut line: Vec<(f64, f64)> =
            points.iter().zip(&on).filter(|(_, on)| **on).map(|(p, _)| (x.at(p.x), y.at(p.y))).collect();
        line.sort_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((first, rest)) = line.split_first() {
            // A staircase: what is reached at each time.
            let mut d = format!("M{:.1} {TOP}V{:.1}", first.0, first.1);
            for p in rest {
                let _ = write!(d, "H{:.1}V{:.1}", p.0, p.1);
            }
            let _ = write!(out, r#"<path class="f" d="{d}H{:.1}"/>"#, WIDTH - RIGHT);
        }
        let places: Vec<(f64, f64)> = points.iter().map(|p| (x.at(p.x), y.at(p.y))).collect();
        self.labels(&mut out, &points, &places, &on);
        // The first on top.
        for ((point, (px, py)), on) in points.iter().zip(&places).zip(&on).rev() {
            let colour = COLOURS[point.group % COLOURS.len()];
            let (r, ring) = if *on { (6.0, "#d69e2e") } else { (4.5, "#fff") };
            let text = format!("{}: {:.3e}, {:.3e}", escape(&point.name), point.x, point.y);
            let _ = write!(
                out,
                r#"<circle cx="{px:.1}" cy="{py:.1}" r="{r}" fill="{colour}" stroke="{ring}" stroke-width="1.8"><title>{text}</title></circle>"#
            );
        }
        out + "</svg>\n"
    }

    fn grid(&self, out: &mut String, x: &Axis, y: &Axis, zeros: bool) {
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for (value, labelled) in x.ticks() {
            let (at, class) = (x.at(value), if labelled { "g" } else { "m" });
            let _ = write!(out, r#"<path class="{class}" d="M{at:.1} {TOP}V{bottom}"/>"#);
            if labelled {
                let (text, y) = (short(value), bottom + 18.0);
                let _ =
                    write!(out, r#"<text class="k" x="{at:.1}" y="{y}" text-anchor="middle">{text}</text>"#);
            }
        }
        for (value, labelled) in y.ticks() {
            let (at, class) = (y.at(value), if labelled { "g" } else { "m" });
            let _ = write!(out, r#"<path class="{class}" d="M{LEFT} {at:.1}H{right}"/>"#);
            if labelled {
                let (text, x, at) = (short(value), LEFT - 8.0, at + 4.0);
                let _ = write!(out, r#"<text class="k" x="{x}" y="{at:.1}" text-anchor="end">{text}</text>"#);
            }
        }
        let _ = write!(out, r#"<path class="b" d="M{LEFT} {TOP}V{bottom}H{right}"/>"#);
        if zeros {
            let x = LEFT - 8.0;
            let _ = write!(out, r#"<text class="k" x="{x}" y="{bottom}" text-anchor="end">0</text>"#);
        }
        let (middle, low) = ((LEFT + right) / 2.0, HEIGHT - 22.0);
        let label = escape(self.x_label);
        let _ = write!(out, r#"<text x="{middle}" y="{low}" text-anchor="middle">{label}</text>"#);
        let (middle, label) = ((TOP + bottom) / 2.0, escape(self.y_label));
        let _ = write!(
            out,
            r#"<text transform="translate(24 {middle}) rotate(-90)" text-anchor="middle">{label}</text>"#
        );
        let mut at = 20.0;
        for (group, name) in self.groups.iter().enumerate() {
            let colour = COLOURS[group % COLOURS.len()];
            let _ = write!(out, r#"<circle cx="{:.1}" cy="70" r="5" fill="{colour}"/>"#, at + 5.0);
            let _ = write!(out, r#"<text x="{:.1}" y="74">{}</text>"#, at + 15.0, escape(name));
            at += 36.0 + LETTER.0 * name.chars().count() as f64;
        }
        let _ = write!(
            out,
            r#"<path class="f" d="M{at:.1} 70h26"/><text x="{:.1}" y="74">Pareto front</text>"#,
            at + 32.0
        );
    }

    /// Places each label where it covers least, and the nearest such place; those of the front first.
    fn labels(&self, out: &mut String, points: &[&Point], places: &[(f64, f64)], on: &[bool]) {
        let dot = |(x, y): (f64, f64)| Taken([x - 6.0, y - 6.0, x + 6.0, y + 6.0]);
        let mut taken: Vec<Taken> = places.iter().copied().map(dot).collect();
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by_key(|&i| !on[i]);
        for i in order {
            let (px, py) = places[i];
            let width = LETTER.0 * points[i].name.chars().count() as f64;
            let mut best: Option<(f64, f64, f64, f64)> = None;
            for ring in 0..14 {
                let reach = 10.0 + 13.0 * f64::from(ring);
                for step in 0..16 {
                    let (s, c) = (f64::from(step) * std::f64::consts::TAU / 16.0).sin_cos();
                    // The label's near end, or its middle above and below.
                    let (ax, ay) = (px + reach * c, py + reach * s);
                    let left = ax - width * (0.5 - 0.5 * c);
                    let area =
                        Taken([left - 2.0, ay - 0.6 * LETTER.1, left + width + 2.0, ay + 0.4 * LETTER.1]);
                    let [l, t, r, b] = area.0;
                    let outside = l < LEFT || r > WIDTH || t < TOP - 10.0 || b > HEIGHT - BOTTOM - 2.0;
                    let covered: f64 = taken.iter().map(|t| t.overlap(&area)).sum();
                    let cost = covered * 3.0 + reach + if outside { 1e4 } else { 0.0 };
                    if best.is_none_or(|b| cost < b.0) {
                        best = Some((cost, left, ay, reach));
                    }
                }
            }
            let Some((_, left, y, reach)) = best else { continue };
            taken.push(Taken([left - 2.0, y - 0.6 * LETTER.1, left + width + 2.0, y + 0.4 * LETTER.1]));
            if reach > 20.0 {
                let near = px.clamp(left, left + width);
                let _ = write!(out, r#"<path class="l" d="M{px:.1} {py:.1}L{near:.1} {y:.1}"/>"#);
            }
            let class = if on[i] { r#" class="o""# } else { "" };
            let (y, name) = (y + 3.5, escape(&points[i].name));
            let _ = write!(
                out,
                r##"<text{class} x="{left:.1}" y="{y:.1}" stroke="#fff" stroke-width="3" paint-order="stroke" textLength="{width:.1}" lengthAdjust="spacing">{name}</text>"##
            );
        }
    }
}

/// A tick: plain where that is short.
fn short(value: f64) -> String {
    if (0.01..10_000.0).contains(&value) {
        format!("{value:.4}").trim_end_matches('0').trim_end_matches('.').to_owned()
    } else {
        format!("{value:.0e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_what_nothing_beats() {
        let points = [
            (1.0, 5.0),
            (2.0, 2.0),
            (3.0, 2.0),
            (4.0, 0.0),
            (2.0, 2.0),
            (f64::NAN, 0.0),
            (0.5, f64::INFINITY),
        ];
        assert_eq!(front(&points), [true, true, false, true, true, false, false]);
        assert!(front(&[]).is_empty());
        // A point moved onto a better place joins; one moved away leaves.
        assert_eq!(front(&[(1.0, 1.0), (2.0, 2.0)]), [true, false]);
        assert_eq!(front(&[(1.0, 1.0), (0.9, 2.0)]), [true, true]);
    }

    fn drawn(points: &[(f64, f64)]) -> String {
        let point = |(i, &(x, y)): (usize, &(f64, f64))| Point { name: format!("a<{i}"), group: i, x, y };
        let points = points.iter().enumerate().map(point).collect();
        Scatter { title: "t&t", subtitle: "", x_label: "ms", y_label: "e", groups: &["one", "two"], points }
            .svg()
    }

    #[test]
    fn every_finite_point_is_drawn_and_labelled() {
        let svg = drawn(&[(1.0, 1e-3), (10.0, 0.0), (f64::NAN, 1.0), (0.0, 1.0), (5.0, f64::INFINITY)]);
        assert_eq!(svg.matches("<circle").count(), 2 + 2);
        assert!(svg.contains("a&lt;0") && svg.contains("a&lt;1") && svg.contains("t&amp;t"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        for points in [&[][..], &[(1.0, 0.0)], &[(1.0, 1.0), (1.0, 1.0)], &[(1e-9, 1e9), (1e9, 1e-9)]] {
            assert!(!drawn(points).contains("NaN"));
        }
    }

    #[test]
    fn labels_of_crowded_points_do_not_cover_each_other() {
        let points: Vec<(f64, f64)> =
            (0..30).map(|i| (10.0 + 0.01 * f64::from(i), 1e-3 * (1.0 + 0.02 * f64::from(i)))).collect();
        let svg = drawn(&points);
        let labels: Vec<Taken> = svg
            .split("<text")
            .filter(|t| t.contains("textLength"))
            .map(|t| {
                let value = |key: &str| {
                    t.split(key)
                        .nth(1)
                        .and_then(|v| v.split('"').next())
                        .and_then(|v| v.parse::<f64>().ok())
                        .unwrap()
                };
                let (x, y, w) = (value(" x=\""), value(" y=\""), value("textLength=\""));
                Taken([x, y - 9.0, x + w, y + 2.0])
            })
            .collect();
        assert_eq!(labels.len(), 30);
        for (i, a) in labels.iter().enumerate() {
            assert!(labels[..i].iter().all(|b| a.overlap(b) < 1.0), "label {i}");
        }
    }
}
