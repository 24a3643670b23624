//! Writes the section that says where the bytes went.

use std::fmt::Write as _;

use trainer_host::encode::Ledger;

use super::elements::{count, figure};
use crate::report::plot::{Bar, Bars, number};

/// The ledger as tables and bars.
pub(super) fn ledger(out: &mut String, l: &Ledger) {
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
            "<tr class=\"{class}\"><th>{name}</th><td>{size}</td><td>{part}</td><td \
                class=\"meter\">{meter}</td>\
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
            "<tr><th>{name}</th><td>{value}</td><td class=\"text\">{unit}</td><td \
                class=\"text\">{says}</td></tr>"
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
    let says = "Estimated entropy-coded payload, thousands of bits, largest attribute first; at the right \
        its total and \
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
