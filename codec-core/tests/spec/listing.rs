//! The annotated stream of `SPEC.md` section 3 against the file, what it unpacks to and what it shows.

use std::{fmt::Write as _, path::Path};

use codec_core::Gaussian;

use crate::{
    session::{Received, Session, parts, unpacked},
    tables::{TableRow, Tables, number, same},
};

/// Where the listed numbers and the stream differ.
pub fn differences(tables: &Tables, found: &mut Vec<String>) {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/conformance/one.dgs");
    let file = std::fs::read(file).unwrap();
    let (message, packets) = parts(&file);
    whole(&tables["one.dgs"], &file, found);
    named(&tables["one.dgs body"], &unpacked(message), found);
    let base = Session::open(message).after(&packets[..1]);
    let all = Session::open(message).after(&packets);
    symbols(&tables["one.dgs symbols"], &all, found);
    for (column, received) in [("after packet 0", &base), ("after all packets", &all)] {
        let shown = received.frames[0].0[0];
        for row in &tables["one.dgs Gaussian"] {
            let what = format!("one.dgs {} {column}", row["value"]);
            same(found, &what, row[column].clone(), attribute(&shown, &row["value"]));
        }
    }
}

/// The bytes of a row, and whether it goes on to the next.
fn bytes(row: &TableRow) -> (Vec<u8>, bool) {
    let listed = row["bytes"].trim_end_matches('…').split_whitespace();
    let listed = listed.map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect();
    (listed, row["bytes"].ends_with('…'))
}

/// Rows follow each other to the end of `file`.
fn whole(rows: &[TableRow], file: &[u8], found: &mut Vec<String>) {
    let next = rows.iter().skip(1).map(|row| number(&row["offset"]) as usize).chain([file.len()]);
    for (row, next) in rows.iter().zip(next) {
        let offset = number(&row["offset"]) as usize;
        let (listed, goes_on) = bytes(row);
        same(found, &format!("one.dgs at {offset}"), &listed[..], &file[offset..offset + listed.len()]);
        let end = offset + listed.len();
        same(found, &format!("one.dgs row {offset} ends"), if goes_on { next } else { end }, next);
    }
}

/// Rows ascend in `body`, and what they leave out is zero.
fn named(rows: &[TableRow], body: &[u8], found: &mut Vec<String>) {
    let mut rest = body.to_vec();
    let mut end = 0;
    for row in rows {
        let offset = number(&row["offset"]) as usize;
        let (listed, _) = bytes(row);
        let stop = offset + listed.len();
        same(found, &format!("one.dgs body at {offset}"), &listed[..], &body[offset..stop]);
        same(found, &format!("one.dgs body: {offset} ascends"), true, offset >= end);
        rest[offset..stop].fill(0);
        end = stop;
    }
    same(found, "one.dgs body: first byte that no row names", None, rest.iter().position(|&b| b != 0));
}

/// Symbols of the one Gaussian, level after level, and the indices of section 7.2.
fn symbols(rows: &[TableRow], received: &Received, found: &mut Vec<String>) {
    const CLASSES: [(&str, usize); 5] =
        [("Position", 3), ("Scale", 3), ("Rotation", 3), ("Opacity", 1), ("Sh0", 3)];
    let symbols = &received.symbols;
    let mut indices = vec![0i32; 13];
    for level in 0..4 {
        let own = &symbols[13 * level..13 * (level + 1)];
        // Every quantiser of the stream has ratios of 3, and the cluster's centre is 0.
        indices.iter_mut().zip(own).for_each(|(q, &s)| *q = *q * 3 + i32::from(s));
        let own: Vec<i32> = own.iter().map(|&s| s.into()).collect();
        compare(&rows[level], &own, found);
    }
    compare(&rows[4], &indices, found);

    fn compare(row: &TableRow, values: &[i32], found: &mut Vec<String>) {
        let mut at = 0;
        for (class, components) in CLASSES {
            let text: Vec<String> = values[at..at + components].iter().map(i32::to_string).collect();
            at += components;
            let what = format!("one.dgs {class} at level {}", row["level"]);
            same(found, &what, row[class].clone(), text.join(" "));
        }
    }
}

/// Values of an attribute as shortest decimals.
fn attribute(gaussian: &Gaussian, name: &str) -> String {
    let values: &[f32] = match name {
        "position" => &gaussian.position,
        "scale" => &gaussian.scale,
        "rotation" => &gaussian.rotation,
        "opacity" => &[gaussian.opacity],
        _ => &gaussian.sh0,
    };
    let mut text = String::new();
    for value in values {
        write!(text, "{value} ").unwrap();
    }
    text.trim_end().to_owned()
}
