//! `SPEC.md`'s tables: reads them, and notes where they and the code differ.

use std::{collections::BTreeMap, path::Path};

/// A row by column name.
pub type TableRow = BTreeMap<String, String>;
/// Tables by name.
pub type Tables = BTreeMap<String, Vec<TableRow>>;

pub fn text() -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("SPEC.md")).unwrap()
}

/// All tables that follow a `<!-- table: NAME -->` line: rows by column name.
pub fn tables(text: &str) -> Tables {
    let mut tables = Tables::new();
    let mut lines = text.lines();
    while let Some(line) = lines.next() {
        let Some(name) = line.strip_prefix("<!-- table: ").and_then(|l| l.strip_suffix(" -->")) else {
            continue;
        };
        let cells = |line: &str| -> Vec<String> {
            line.trim_matches('|').split('|').map(|c| c.trim().to_owned()).collect()
        };
        let columns = cells(lines.next().unwrap());
        lines.next();
        let rows = lines.by_ref().take_while(|l| l.starts_with('|'));
        let rows = rows.map(|l| {
            let cells = cells(l);
            assert_eq!(cells.len(), columns.len(), "{name}: {l}");
            columns.iter().cloned().zip(cells).collect()
        });
        assert!(tables.insert(name.to_owned(), rows.collect()).is_none(), "{name} twice");
    }
    tables
}

pub fn same<T: PartialEq + std::fmt::Debug>(found: &mut Vec<String>, what: &str, spec: T, code: T) {
    if spec != code {
        found.push(format!("{what}: SPEC.md says {spec:?}, the code {code:?}"));
    }
}

pub fn number(text: &str) -> u64 {
    let parsed = match text.strip_prefix("0x") {
        Some(hex) => u64::from_str_radix(hex, 16),
        None => match text.strip_prefix("0b") {
            Some(bits) => u64::from_str_radix(bits, 2),
            None => text.parse(),
        },
    };
    parsed.unwrap_or(u64::MAX)
}

/// `a..=b` as numbers, if that is all there is.
pub fn range(text: &str) -> Option<(u64, u64)> {
    let (low, high) = text.split_once("..=")?;
    let (low, high) = (number(low), number(high));
    (low != u64::MAX && high != u64::MAX).then_some((low, high))
}

/// Checks that rows follow each other without gaps and that widths fit types; returns the end.
pub fn contiguous(rows: &[TableRow], name: &str, found: &mut Vec<String>) -> usize {
    let mut end = 0;
    for row in rows {
        let field = &row["field"];
        same(found, &format!("{name}.{field}: offset"), number(&row["offset"]), end as u64);
        let width = number(&row["width"]) as usize;
        let by_type = match row.get("type").map_or("", String::as_str) {
            "u8" => Some(1),
            "u16" | "i16" => Some(2),
            "u24" | "3 × u8" => Some(3),
            "u32" | "f32" => Some(4),
            _ => None,
        };
        same(found, &format!("{name}.{field}: width"), width, by_type.unwrap_or(width));
        end += width;
    }
    end
}

/// The bytes that `field`'s row names.
pub fn at(rows: &[TableRow], field: &str, bytes: &[u8]) -> Option<Vec<u8>> {
    let row = rows.iter().find(|r| r["field"] == field)?;
    let offset = number(&row["offset"]) as usize;
    bytes.get(offset..offset + number(&row["width"]) as usize).map(<[u8]>::to_vec)
}

/// The spec's rows, in its order and with its fixed widths, give exactly the written bytes.
pub fn in_order(
    rows: &[TableRow],
    name: &str,
    expected: &BTreeMap<&str, Vec<u8>>,
    written: &[u8],
    found: &mut Vec<String>,
) {
    let mut bytes = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        let field = row["field"].as_str();
        same(found, &format!("{name}: order"), number(&row["order"]), i as u64);
        let part = expected.get(field).cloned().unwrap_or_default();
        let width = number(&row["width"]);
        if width != u64::MAX {
            same(found, &format!("{name}.{field}: width"), width, part.len() as u64);
        }
        bytes.extend(part);
    }
    same(found, name, bytes, written.to_vec());
    same(found, &format!("{name}: rows"), rows.len(), expected.len());
}
