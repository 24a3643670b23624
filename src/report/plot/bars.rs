//! Draws stacked horizontal bars.

use std::fmt::Write as _;

use super::{HUGE, Scale, WIDTH, escape, number, svg, ticks};

/// One row of [`Bars`].
#[derive(Clone, Debug)]
pub struct Bar<'a> {
    /// Name at its left.
    pub name: &'a str,
    /// (place in [`Bars::keys`], value), drawn in this order; values that are not positive take no room.
    pub parts: Vec<(usize, f64)>,
}

/// Stacked horizontal bars.
#[derive(Clone, Debug)]
pub struct Bars<'a> {
    /// What a screen reader says.
    pub title: &'a str,
    /// Name and unit of the value axis.
    pub label: &'a str,
    /// Unit behind a value.
    pub unit: &'a str,
    /// What the shades mean, from dark to light.
    pub keys: &'a [String],
    /// Rows, from top to bottom.
    pub rows: Vec<Bar<'a>>,
}

impl Bars<'_> {
    /// The drawing.
    pub fn svg(&self) -> String {
        const NAMES: f64 = 150.0;
        const TOTALS: f64 = 150.0;
        let room = |v: f64| if v.is_finite() && v > 0.0 { v.min(HUGE) } else { 0.0 };
        let total = |row: &Bar<'_>| row.parts.iter().map(|p| room(p.1)).sum::<f64>();
        let all: f64 = self.rows.iter().map(total).sum();
        let ticks = ticks(0.0, self.rows.iter().map(total).fold(0.0, f64::max), 6);
        let ticks = if all > 0.0 { ticks } else { super::ticks(0.0, 1.0, 6) };
        let end = ticks.values.last().copied().unwrap_or(1.0);
        let x = Scale { from: (0.0, end), to: (NAMES, WIDTH - TOTALS) };
        let mut out = String::from(r#"<g class="legend">"#);
        let mut at = NAMES;
        for (i, key) in self.keys.iter().enumerate() {
            let _ = write!(out, r#"<path class="part l{}" d="M{at:.1} 3h22v13h-22Z"/>"#, i.min(5));
            let _ = write!(out, r#"<text x="{:.1}" y="14">{}</text>"#, at + 30.0, escape(key));
            at += 52.0 + 8.2 * key.chars().count() as f64;
        }
        out.push_str("</g>");
        let top = 34.0;
        let bottom = top + 26.0 * self.rows.len() as f64;
        for t in &ticks.values {
            let (at, kind) = (x.at(*t), if *t == 0.0 { "base" } else { "grid" });
            let _ = write!(out, r#"<path class="{kind}" d="M{at:.1} {top}V{bottom:.1}"/>"#);
            let (y, text) = (bottom + 19.0, number(*t, ticks.decimals));
            let _ = write!(
                out,
                r#"<text class="tick" x="{at:.1}" y="{y:.1}" text-anchor="middle">{text}</text>"#
            );
        }
        for (i, row) in self.rows.iter().enumerate() {
            let (y, name, mut sum) = (top + 26.0 * i as f64 + 4.0, escape(row.name), 0.0);
            let right = NAMES - 10.0;
            let _ = write!(
                out,
                r#"<text class="name" x="{right}" y="{:.1}" text-anchor="end">{name}</text>"#,
                y + 13.5
            );
            for (key, value) in &row.parts {
                let (from, to) = (x.at(sum), x.at(sum + room(*value)));
                sum += room(*value);
                let (shade, what) = (key.min(&5), self.keys.get(*key).map_or("", String::as_str));
                let text = format!("{name}, {}: {} {}", escape(what), number(*value, 1), escape(self.unit));
                let d = format!("M{from:.1} {y:.1}H{to:.1}v18H{from:.1}Z");
                let _ = write!(out, r#"<path class="part l{shade}" d="{d}"><title>{text}</title></path>"#);
            }
            let share = if all > 0.0 { 100.0 * sum / all } else { f64::NAN };
            let text = format!("{} {} · {} %", number(sum, 1), escape(self.unit), number(share, 1));
            let _ = write!(
                out,
                r#"<text class="tick" x="{:.1}" y="{:.1}">{text}</text>"#,
                x.at(sum) + 8.0,
                y + 13.5
            );
        }
        let (middle, y) = ((NAMES + WIDTH - TOTALS) / 2.0, bottom + 41.0);
        let text = escape(self.label);
        let _ = write!(
            out,
            r#"<text class="axis" x="{middle:.1}" y="{y:.1}" text-anchor="middle">{text}</text>"#
        );
        svg(&out, bottom + 50.0, self.title, "")
    }
}
