//! The error table against the field names in the sources.

use std::{collections::BTreeSet, path::Path};

use codec_core::{Error, ErrorKind};

use crate::{
    refused,
    tables::{Tables, same},
};

/// Fields that the sources name in errors, and fields that the error table names.
pub fn errors(tables: &Tables, found: &mut Vec<String>) {
    let mut code = BTreeSet::new();
    sources(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"), &mut code);
    for (table, prefix) in [
        ("head", "manifest"),
        ("epoch", "epoch"),
        ("window", "window"),
        ("cluster", "cluster"),
        ("motion", "motion"),
        ("repair", "repair"),
    ] {
        code.extend(tables[table].iter().map(|r| format!("{prefix}.{}", r["field"])));
        if !matches!(table, "head" | "motion") {
            code.insert(format!("{prefix}.reserved"));
        }
    }
    let spec: Vec<&str> = tables["errors"].iter().flat_map(|r| r["fields"].split(' ')).collect();
    let once: BTreeSet<String> = spec.iter().map(|&f| f.to_owned()).collect();
    same(found, "errors: each field once", spec.len(), once.len());
    for field in code.difference(&once) {
        found.push(format!("errors: {field} is in the code and not in SPEC.md"));
    }
    for field in once.difference(&code) {
        found.push(format!("errors: {field} is in SPEC.md and not in the code"));
    }
    for error in refused::errors() {
        let (field, kind) = (error.field, error.kind.name());
        let row = tables["errors"].iter().find(|row| row["fields"].split(' ').any(|listed| listed == field));
        let listed = row.is_some_and(|row| row["kinds"].split(", ").any(|listed| listed == kind));
        same(found, &format!("errors: {field} is {kind}"), listed || kind == "short", true);
        if !is_at_odds(error) {
            found.push(format!("errors: {error} says that what was found is allowed"));
        }
    }
    for row in &tables["errors"] {
        for kind in row["kinds"].split(", ").filter(|k| !k.is_empty()) {
            let known = tables["error kinds"].iter().any(|r| r["kind"] == kind);
            same(found, &format!("errors: kind {kind}"), true, known);
        }
    }
}

/// Whether what was found is not what is allowed, or less than what is needed.
fn is_at_odds(error: &Error) -> bool {
    let Error { kind, found, allowed: (low, high), .. } = *error;
    match kind {
        ErrorKind::Short => found < low,
        ErrorKind::Duplicate => found == low && found == high,
        _ => found < low || found > high,
    }
}

/// String literals outside tests and comments that look like field names.
pub fn sources(folder: &Path, fields: &mut BTreeSet<String>) {
    const WHOLE: [&str; 11] = [
        "manifest", "packet", "slice", "extent", "chunk", "body", "pack", "receipt", "frame", "buffer",
        "arena",
    ];
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, fields);
            continue;
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let text = text.split("#[cfg(test)]").next().unwrap();
        for line in text.lines().filter(|l| !l.trim_start().starts_with("//")) {
            for literal in line.split('"').skip(1).step_by(2) {
                let plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_';
                let dotted = literal.split_once('.').is_some_and(|(a, b)| {
                    !a.is_empty() && !b.is_empty() && a.chars().all(plain) && b.chars().all(plain)
                });
                if dotted || WHOLE.contains(&literal) {
                    fields.insert(literal.to_owned());
                }
            }
        }
    }
}
