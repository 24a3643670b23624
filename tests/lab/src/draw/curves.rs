//! Draws curves of quality against size as a self-contained SVG: a logarithmic axis to the right, a linear
//! one upward, a line with markers per curve, names beside their last points and in a legend.
//!
//! Points that are not finite or not above 0 to the right are left out.

use std::fmt::Write as _;

use dgs::report::plot::{escape, ticks};

const WIDTH: f64 = 1000.0;
const HEIGHT: f64 = 640.0;
const LEFT: f64 = 72.0;
const RIGHT: f64 = 190.0;
const TOP: f64 = 76.0;
const BOTTOM: f64 = 60.0;
/// Colours that also differ in lightness.
const COLOURS: [&str; 10] = [
    "#1b1b1b", "#2b6cb0", "#c05621", "#2f855a", "#97266d", "#b7791f", "#4c51bf", "#718096", "#e53e3e",
    "#38b2ac",
];

const STYLE: &str = "svg{background:#fff;font-family:system-ui,sans-serif;font-size:12px;fill:#222}\
.t{font-size:17px;font-weight:600}.s,.k{fill:#555}.g{stroke:#e6e6e6}.b{stroke:#999;fill:none}\
.c{fill:none;stroke-linejoin:round}.w{font-weight:600}";

/// One line.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Its name.
    pub name: String,
    /// Size, above 0, and quality.
    pub points: Vec<(f64, f64)>,
}

/// The drawing.
#[derive(Clone, Debug)]
pub struct Curves<'a> {
    /// Heading.
    pub title: &'a str,
    /// Line below it.
    pub subtitle: &'a str,
    /// Name and unit of the axis to the right.
    pub x_label: &'a str,
    /// Name and unit of the upward axis.
    pub y_label: &'a str,
    /// The lines; the first is drawn last and heaviest.
    pub curves: Vec<Curve>,
}

impl Curves<'_> {
    /// The drawing as SVG text.
    pub fn svg(&self) -> String {
        let fits = |p: &&(f64, f64)| p.0 > 0.0 && p.0.is_finite() && p.1.is_finite();
        // Colour, name, points as they are drawn.
        type Line<'c> = (usize, &'c str, Vec<(f64, f64)>);
        let curves: Vec<Line<'_>> = self
            .curves
            .iter()
            .enumerate()
            .map(|(i, c)| {
                let mut points: Vec<_> = c.points.iter().filter(fits).map(|p| (p.0.log10(), p.1)).collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                (i, c.name.as_str(), points)
            })
            .collect();
        let all = || curves.iter().flat_map(|c| &c.2);
        let ends = |f: fn(&(f64, f64)) -> f64, least: f64| {
            let (low, high) =
                all().map(f).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            if low > high {
                return (0.0, 1.0);
            }
            let pad = (0.04 * (high - low)).max(least);
            (low - pad, high + pad)
        };
        let (x_low, x_high) = ends(|p| p.0, 0.05);
        let (y_low, y_high) = ends(|p| p.1, 0.5);
        let x = |v: f64| LEFT + (v - x_low) / (x_high - x_low) * (WIDTH - LEFT - RIGHT);
        let y = |v: f64| HEIGHT - BOTTOM - (v - y_low) / (y_high - y_low) * (HEIGHT - TOP - BOTTOM);
        let mut out = format!(
            r##"<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}" height="{HEIGHT}" role="img"><title>{0}</title><style>{STYLE}</style><rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/><text class="t" x="20" y="28">{0}</text><text class="s" x="20" y="48">{1}</text>"##,
            escape(self.title),
            escape(self.subtitle)
        );
        let (right, floor) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        for decade in (x_low.floor() as i32)..=(x_high.ceil() as i32) {
            for m in 1..10 {
                let value = f64::from(m) * 10f64.powi(decade);
                let at = value.log10();
                if !(x_low..=x_high).contains(&at) {
                    continue;
                }
                let _ = write!(out, r#"<path class="g" d="M{0:.1} {TOP}V{floor}"/>"#, x(at));
                if matches!(m, 1 | 2 | 5) {
                    let (at, low) = (x(at), floor + 18.0);
                    let _ = write!(
                        out,
                        r#"<text class="k" x="{at:.1}" y="{low}" text-anchor="middle">{value}</text>"#
                    );
                }
            }
        }
        for value in ticks(y_low, y_high, 10).values {
            if (y_low..=y_high).contains(&value) {
                let at = y(value);
                let _ = write!(
                    out,
                    r#"<path class="g" d="M{LEFT} {at:.1}H{right}"/><text class="k" x="{:.1}" y="{:.1}" text-anchor="end">{value}</text>"#,
                    LEFT - 8.0,
                    at + 4.0
                );
            }
        }
        let _ = write!(
            out,
            r#"<rect class="b" x="{LEFT}" y="{TOP}" width="{}" height="{}"/><text class="k" x="{:.1}" y="{:.1}" text-anchor="middle">{}</text><text class="k" x="20" y="{:.1}">{}</text>"#,
            right - LEFT,
            floor - TOP,
            (LEFT + right) / 2.0,
            HEIGHT - 16.0,
            escape(self.x_label),
            TOP - 10.0,
            escape(self.y_label)
        );
        for (i, name, points) in curves.iter().rev() {
            let colour = COLOURS[i % COLOURS.len()];
            let heavy = if *i == 0 { 3.0 } else { 1.6 };
            let mut d = String::new();
            for (k, p) in points.iter().enumerate() {
                let _ = write!(d, "{}{:.1} {:.1}", if k == 0 { 'M' } else { 'L' }, x(p.0), y(p.1));
            }
            let _ = write!(out, r#"<path class="c" d="{d}" stroke="{colour}" stroke-width="{heavy}"/>"#);
            for p in points {
                let text = format!("{}: {:.1}, {:.2}", escape(name), 10f64.powf(p.0), p.1);
                let _ = write!(
                    out,
                    r##"<circle cx="{:.1}" cy="{:.1}" r="{:.1}" fill="{colour}" stroke="#fff"><title>{text}</title></circle>"##,
                    x(p.0),
                    y(p.1),
                    2.0 + heavy
                );
            }
        }
        for (i, name, _) in &curves {
            let colour = COLOURS[i % COLOURS.len()];
            let at = TOP + 14.0 + 22.0 * *i as f64;
            let (from, text) = (right + 14.0, right + 42.0);
            let _ = write!(
                out,
                r#"<path class="c" d="M{from} {at}h20" stroke="{colour}" stroke-width="3"/><text class="w" x="{text}" y="{:.1}">{}</text>"#,
                at + 4.0,
                escape(name)
            );
        }
        out + "</svg>\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_finite_point_is_marked_and_every_curve_named() {
        let curve = |name: &str, points: &[(f64, f64)]| Curve { name: name.into(), points: points.to_vec() };
        let drawing = Curves {
            title: "a < b",
            subtitle: "",
            x_label: "bits",
            y_label: "dB",
            curves: vec![
                curve("one", &[(100.0, 40.0), (200.0, 45.0), (0.0, 3.0)]),
                curve("two", &[(1000.0, f64::NAN), (900.0, 44.0)]),
            ],
        };
        let svg = drawing.svg();
        assert_eq!(svg.matches("<circle").count(), 3);
        assert!(svg.contains(">one</text>") && svg.contains(">two</text>") && svg.contains("a &lt; b"));
        assert!(!svg.contains("NaN") && !svg.contains("inf"));
        let empty = Curves { curves: vec![curve("none", &[])], ..drawing };
        assert!(!empty.svg().contains("NaN"));
    }
}
