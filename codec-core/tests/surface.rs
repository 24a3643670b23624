//! Counts what a user of this crate meets: the public items outside `internals`.

#![allow(clippy::unwrap_used, reason = "a test's helpers fail like tests")]

use std::path::Path;

/// Most public items outside `internals`: modules, types, functions, methods, constants, re-exports.
const MOST: usize = 80;

/// Files whose items are in reach without `internals`; of other files single names are re-exported.
const FRONT: [&str; 7] = [
    "lib.rs",
    "caps.rs",
    "player.rs",
    "internals/error.rs",
    "internals/footprint.rs",
    "internals/gaussian.rs",
    "internals/up.rs",
];

fn source(name: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src").join(name)).unwrap()
}

/// Public items that `text` declares before its tests; fields and variants belong to their types.
fn declared(text: &str) -> usize {
    let text = text.split("#[cfg(test)]").next().unwrap_or("");
    let kinds = ["fn ", "const ", "struct ", "enum ", "type ", "trait ", "static ", "mod "];
    let is_item = |line: &&str| {
        let rest = line.trim_start().strip_prefix("pub ");
        rest.is_some_and(|rest| kinds.iter().any(|kind| rest.starts_with(kind)))
    };
    text.lines().filter(is_item).count()
}

/// Names that `text` re-exports: those of its `pub use` that are no modules on the way to others.
fn exported(text: &str) -> usize {
    let statements = text.split("pub use ").skip(1).filter_map(|rest| rest.split(';').next());
    let is_name = |word: &&str| word.starts_with(|c: char| c.is_ascii_uppercase());
    statements.flat_map(|s| s.split(|c: char| !c.is_alphanumeric() && c != '_')).filter(is_name).count()
}

#[test]
fn a_user_meets_few_items_and_the_rest_is_internal() {
    let open: Vec<String> = source("lib.rs")
        .lines()
        .filter_map(|line| Some(line.strip_prefix("pub mod ")?.trim_end_matches([';', '{', ' ']).to_owned()))
        .collect();
    assert_eq!(open, ["internals", "player", "file"]);
    let count: usize = FRONT.map(|name| declared(&source(name)) + exported(&source(name))).iter().sum();
    println!("{count} public items outside `internals`");
    assert!(count <= MOST, "{count} public items outside `internals`, at most {MOST}");
    assert!(count > 40, "{count}: the counter sees them");
}

#[test]
fn every_kind_of_item_is_counted() {
    let text = "pub struct A;\n    pub const fn b() {}\npub(crate) fn c() {}\npub use x::{D, y::{self, E}};\n\
                // pub fn f\n#[cfg(test)]\npub fn g() {}\n";
    assert_eq!((declared(text), exported(text)), (2, 2));
}
