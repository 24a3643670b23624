//! Classes, symbol streams, entropy tables, bodies and float functions against the code.

use std::collections::{BTreeMap, BTreeSet};

use codec_core::{
    ErrorKind,
    internals::{
        ids::Level,
        layout, math,
        quant::Class,
        rans::{family, lanes, table},
        wire::manifest::{Track, stream},
    },
};

use crate::{
    manifest::small_table,
    tables::{Tables, at, in_order, number, same},
};

pub fn classes(tables: &Tables, found: &mut Vec<String>) {
    same(found, "classes", tables["classes"].len(), Class::COUNT);
    for (class, row) in Class::ALL.into_iter().zip(&tables["classes"]) {
        let spec = (
            row["class"].clone(),
            number(&row["index"]) as usize,
            number(&row["components"]) as usize,
            number(&row["first level"]) as u8,
            number(&row["harmonic degree"]) as u8,
            row["moves"] == "yes",
        );
        let code = (
            format!("{class:?}"),
            class.index(),
            class.components(),
            class.first_level().get(),
            class.sh_degree(),
            class.index() < Class::MOVING,
        );
        same(found, "class", spec, code);
    }
    let row = |name: &str| {
        let row = tables["streams"].iter().find(|r| r["stream"] == name).unwrap();
        let first = number(&row["first"]) as usize;
        (first, (first..first + number(&row["count"]) as usize).collect::<BTreeSet<_>>())
    };
    let levels = || Level::ALL.into_iter();
    let canonical: BTreeSet<usize> =
        Class::ALL.into_iter().flat_map(|c| levels().map(move |l| stream::canonical(c, l))).collect();
    same(found, "canonical streams", row("canonical").1, canonical);
    let starts: BTreeSet<usize> = Class::ALL.into_iter().map(stream::start).collect();
    same(found, "start streams", row("start").1, starts);
    let kinds = [None, Some(Track::Rigid), Some(Track::Affine)];
    for (k, kind) in kinds.into_iter().enumerate() {
        for band in 0..4 {
            same(found, "track stream", row("track").0 + k * 4 + band, stream::track(kind, band));
        }
    }
    same(found, "track streams", row("track").1.len(), 3 * (stream::TRACK_BANDS.len() - 1));
    let moving = || Class::ALL.into_iter().take(Class::MOVING);
    let coefficients: BTreeSet<usize> = moving()
        .flat_map(|c| levels().skip(1).flat_map(move |l| (0..3).map(move |k| stream::coefficient(c, l, k))))
        .collect();
    same(found, "coefficient streams", row("coefficient").1, coefficients);
    for class in Class::ALL {
        for level in Level::ALL {
            let (c, l) = (class.index(), level.index());
            same(found, "canonical stream", row("canonical").0 + c * 4 + l, stream::canonical(class, level));
            if c < Class::MOVING && l > 0 {
                for k in [0usize, 1, 5] {
                    let wanted = row("coefficient").0 + (c * 3 + l - 1) * 2 + usize::from(k > 0);
                    same(found, "coefficient stream", wanted, stream::coefficient(class, level, k));
                }
            }
        }
    }
    let starts: BTreeSet<usize> = moving().map(stream::coefficient_start).collect();
    same(found, "coefficient starts", row("coefficient start").1, starts);
    let (n, t, r, h) = (5, 7, 3, layout::rest_len(2));
    for (row, code) in tables["paper symbols"].iter().zip(layout::paper::symbols(n, t, r, h)) {
        let value: usize = row["symbols per Gaussian"]
            .split('+')
            .map(|term| {
                let term = term.trim();
                let (factor, variable) = match term.chars().last() {
                    Some('F') => (&term[..term.len() - 1], t),
                    Some('R') => (&term[..term.len() - 1], r),
                    Some('H') => (&term[..term.len() - 1], h),
                    _ => (term, 1),
                };
                variable * if factor.is_empty() { 1 } else { number(factor) as usize }
            })
            .sum();
        same(found, &format!("paper level {}", row["level"]), n * value, code);
    }
}

pub fn coding(tables: &Tables, found: &mut Vec<String>) {
    let mut written = Vec::new();
    small_table().write(|b| written.extend_from_slice(b));
    for (field, wanted) in
        [("raw_bits", vec![2]), ("first", vec![127]), ("count", vec![3]), ("escape", vec![8, 0])]
    {
        same(found, &format!("table.{field}"), at(&tables["table"], field, &written), Some(wanted));
    }
    let mut named = Vec::new();
    table::Table::named(7).unwrap().write(|b| named.extend_from_slice(b));
    let first = tables["named table"].iter().map(|r| (number(&r["offset"]), number(&r["width"])));
    same(found, "named table", first.collect::<Vec<_>>(), vec![(0, 1), (1, 1)]);
    same(found, "named table", number(&tables["named table"][0]["allowed"]), named[0].into());
    same(found, "named table", named[1], 7);
    let ratios: Vec<u64> = tables["ratios"].iter().map(|r| number(&r["ratio"])).collect();
    same(found, "ratios", ratios, family::RATIOS.iter().map(|&r| r.into()).collect());
    for (kind, first, count) in [
        ("geometric", 0, family::SCALES),
        ("heavy", family::HEAVY, family::SCALES),
        ("three", family::THREE, family::THREES),
    ] {
        let row = tables["family"].iter().find(|r| r["kind"] == kind).unwrap();
        same(found, kind, (number(&row["first"]), number(&row["count"])), (first.into(), count.into()));
    }
    let frequency = tables["table"].iter().find(|r| r["field"] == "frequency").unwrap();
    same(found, "table.frequency", number(&frequency["offset"]) as usize, table::TABLE_HEADER_BYTES);
    same(found, "table.frequency", vec![0, 4, 0, 0, 0xf8, 3], written[table::TABLE_HEADER_BYTES..].to_vec());
    for kind in [
        ErrorKind::Short,
        ErrorKind::Illegal,
        ErrorKind::Unknown,
        ErrorKind::Checksum,
        ErrorKind::Contradiction,
        ErrorKind::Duplicate,
        ErrorKind::Capacity,
    ] {
        let row = tables["error kinds"].iter().find(|r| r["kind"] == kind.name());
        same(found, kind.name(), row.map(|r| number(&r["index"]) as usize), Some(kind.index()));
    }
    same(found, "error kinds", tables["error kinds"].len(), ErrorKind::COUNT);
}

/// The two functions from the spec's words and coefficients, bit for bit.
pub fn floats(tables: &Tables, found: &mut Vec<String>) {
    let coefficients: Vec<f32> = tables["exp"].iter().map(|r| r["coefficient"].parse().unwrap()).collect();
    let exp = |x: f32| {
        let x = x.clamp(-80.0, 80.0);
        let scaled = x * std::f32::consts::LOG2_E;
        let n = (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32;
        let r = (x - n as f32 * 0.693_359_4) + n as f32 * 2.121_944_4e-4;
        let p = coefficients.iter().skip(1).fold(coefficients[0], |p, c| p * r + c);
        p * f32::from_bits(((n + 127) as u32) << 23)
    };
    let powers: Vec<f64> = tables["cos"].iter().map(|r| r["coefficient"].parse().unwrap()).collect();
    let cos = |a: u32, b: u32| {
        let (a, b) = (u64::from(a % (2 * b)), u64::from(b));
        let a = if a > b { 2 * b - a } else { a };
        let (a, sign) = if 2 * a > b { (b - a, -1.0) } else { (a, 1.0) };
        if 2 * a == b {
            return 0.0;
        }
        let x = std::f64::consts::PI * a as f64 / b as f64;
        let s = x * x;
        (sign * powers.iter().skip(1).fold(powers[0], |p, c| p * s + c)) as f32
    };
    for i in -1000i16..=1000 {
        let x = f32::from(i) * 0.0837;
        same(found, &format!("exp({x})"), exp(x).to_bits(), math::exp(x).to_bits());
    }
    for b in 1..130u32 {
        for a in 0..4 * b {
            same(found, &format!("cospi({a}, {b})"), cos(a, b).to_bits(), math::cos_pi(a, b).to_bits());
        }
    }
}

/// A body of three values, one escaped, with two raw bits each: the spec's order and widths.
pub fn lane_body(tables: &Tables, found: &mut Vec<String>) {
    let mut frequency = [0u16; 256];
    (frequency[0], frequency[128]) = (1, 2047);
    let symbols = [lanes::Symbols::new(&table::Table::new(frequency, 2).unwrap())];
    let mut out = [0u8; 64];
    let run = [lanes::TableRun { table: 0, len: 3 }];
    let len = lanes::encode(&[1, 0x1234, 3], &run, &symbols, &mut out).unwrap().len;
    let parts = lanes::Parts::of(&out[..len], 3, 6).unwrap();
    same(found, "body: raw bits", parts.plane[0] & 0x3f, 0b11_00_01);
    let expected = BTreeMap::from([
        ("tail", vec![1]),
        ("lengths", {
            let lengths = parts.state.iter().rev().fold(0, |l, x| l << 4 | (x.ilog2() - 15));
            (lengths as u16).to_le_bytes().to_vec()
        }),
        ("words", vec![]),
        ("escapes", vec![0x34, 0x12]),
        ("plane", parts.plane.to_vec()),
    ]);
    in_order(&tables["body"], "body", &expected, &out[..len], found);
}
