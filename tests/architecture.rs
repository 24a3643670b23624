//! Checks the map: who may depend on whom, what codec-core does without, what has no place here.
//!
//! Rules run over a [`Tree`] of texts, so that each is also shown a tree that breaks it. Names and style are
//! in `architecture/language.rs`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

#[path = "architecture/language.rs"]
mod language;
#[path = "lab/src/source.rs"]
#[allow(dead_code, reason = "bench `structure` uses the rest")]
mod source;

use std::{collections::BTreeSet, path::Path};

use source::{Tree, outside_tests};

/// Package, folder, and the workspace crates it must depend on: no more, no fewer.
const ARROWS: [(&str, &str, &[&str]); 15] = [
    (
        "dgs-lab",
        "tests/lab/",
        &[
            "codec-core",
            "codec-simd",
            "dgs",
            "dgs-player",
            "dgs-quic",
            "dgs-video",
            "dgs-viewer",
            "emulator-host",
            "render-host",
            "trainer-host",
        ],
    ),
    (
        "dgs",
        "",
        &[
            "codec-core",
            "codec-simd",
            "dgs-player",
            "dgs-quic",
            "dgs-video",
            "dgs-viewer",
            "dgs-window",
            "emulator-host",
            "render-host",
            "trainer-host",
        ],
    ),
    ("trainer-host", "trainer-host/", &["codec-core", "codec-simd", "dgs-player", "render-host"]),
    ("dgs-python", "trainer-host/python/", &["codec-core", "dgs-player", "render-host", "trainer-host"]),
    ("render-host", "render-host/", &["codec-core"]),
    ("dgs-video", "render-host/video/", &["render-host"]),
    ("dgs-viewer", "render-host/viewer/", &["codec-core", "dgs-player", "render-host"]),
    ("dgs-window", "render-host/window/", &["codec-core", "dgs-player", "dgs-viewer", "render-host"]),
    ("emulator-host", "emulator-host/", &["codec-core"]),
    ("dgs-quic", "emulator-host/quic/", &["codec-core", "dgs-player", "emulator-host"]),
    ("fuzz", "fuzz/", &["codec-core", "dgs-player", "dgs-quic", "emulator-host", "trainer-host"]),
    ("codec-core", "codec-core/", &[]),
    ("codec-simd", "codec-core/simd/", &["codec-core"]),
    ("codec-capi", "codec-core/capi/", &["codec-core"]),
    ("dgs-player", "codec-core/player/", &["codec-core", "codec-simd"]),
];

/// Who may be used by whose tests beyond the arrows: the C program is linked with the C ABI.
const TESTED: [(&str, &str); 1] = [("dgs-lab", "codec-capi")];

/// Everything that lies at the top, and whether it must.
const TOP: [(&str, bool); 17] = [
    (".ci", true),
    (".gitignore", true),
    ("CHANGELOG.md", true),
    ("Cargo.lock", true),
    ("Cargo.toml", true),
    ("LICENSE", true),
    ("README.md", false),
    ("clippy.toml", true),
    ("rust-toolchain.toml", false),
    ("rustfmt.toml", true),
    ("codec-core", true),
    ("emulator-host", true),
    ("fuzz", true),
    ("render-host", true),
    ("src", true),
    ("tests", true),
    ("trainer-host", true),
];

/// Crates that must not ask a clock.
const LIBRARIES: [&str; 9] = [
    "codec-core",
    "codec-core/capi",
    "codec-core/player",
    "render-host",
    "render-host/video",
    "render-host/viewer",
    "trainer-host",
    "trainer-host/python",
    "emulator-host",
];

/// Files that may hold `unsafe`. The kernels of codec-simd have a safe twin that they are tested
/// against, other SIMD goes through a safe crate; driver facts, pointers of a C program,
/// the stack of a microcontroller and a symbol that must not be called have none.
const UNSAFE: [&str; 10] = [
    "codec-core/capi/src/ffi.rs",
    "codec-core/capi/src/ffi/tests.rs",
    "codec-core/embedded/src/linked.rs",
    "codec-core/embedded/src/stack.rs",
    "codec-core/simd/src/kernel.rs",
    "codec-core/simd/src/kernel/avx2.rs",
    "codec-core/simd/src/kernel/avx512.rs",
    "codec-core/simd/src/kernel/galois.rs",
    "codec-core/simd/src/kernel/spread.rs",
    "render-host/src/gpu/vulkan.rs",
];

/// Names that say nothing about what is inside.
const EMPTY_NAMES: [&str; 8] = ["utils", "util", "common", "helpers", "helper", "misc", "shared", "stuff"];

/// Lines without comments, with their number from 1.
fn code(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.split("//").next().unwrap_or("")))
        .filter(|(_, line)| !line.trim().is_empty())
}

/// Whether a line has `unsafe` as a keyword: before a block, an item or an attribute's bracket.
fn is_unsafe(line: &str) -> bool {
    const WORD: &str = "unsafe";
    line.match_indices(WORD).any(|(at, _)| {
        let before = line[..at].chars().next_back().is_some_and(|c| c.is_alphanumeric() || c == '_');
        let after = &line[at + WORD.len()..];
        let item =
            ["{", "fn ", "impl", "trait ", "extern "].iter().any(|i| after.trim_start().starts_with(i));
        let spaced = after.is_empty() || (after.starts_with([' ', '{']) && item);
        !before && (spaced || after.starts_with('('))
    })
}

/// Names under `[dependencies]` (or, if `dev`, `[dev-dependencies]`), targets included.
fn dependencies(manifest: &str, dev: bool) -> BTreeSet<String> {
    let mut names = BTreeSet::new();
    let mut inside = false;
    for line in manifest.lines().map(|l| l.split('#').next().unwrap_or("").trim()) {
        if let Some(section) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
            let is_dev = section.contains("dev-dependencies");
            let is_normal = section.ends_with("dependencies") && !section.starts_with("workspace");
            inside = if dev { is_dev } else { is_normal && !is_dev };
            // `[dependencies.name]`
            let wanted = if dev { "dev-dependencies." } else { "dependencies." };
            if let Some(name) = section.strip_prefix(wanted) {
                names.insert(name.to_owned());
            }
        } else if inside && let Some((name, _)) = line.split_once('=') {
            names.insert(name.trim().split('.').next().unwrap_or("").to_owned());
        }
    }
    names
}

type Rule = fn(&Tree, &mut Vec<String>);

const RULES: [Rule; 10] =
    [arrows, lints, no_std, top, names, unsafe_code, machine_paths, clocks, licence_and_recipe, walked_files];

fn broken(tree: &Tree) -> Vec<String> {
    let mut found = Vec::new();
    RULES.iter().for_each(|rule| rule(tree, &mut found));
    found
}

fn arrows(tree: &Tree, found: &mut Vec<String>) {
    let members: BTreeSet<&str> = ARROWS.iter().map(|a| a.0).collect();
    for (package, folder, allowed) in ARROWS {
        let manifest = tree.text(&format!("{folder}Cargo.toml"));
        if !manifest.contains(&format!("name = \"{package}\"")) {
            found.push(format!("{folder}Cargo.toml is not the manifest of {package}"));
        }
        let allowed: BTreeSet<&str> = allowed.iter().copied().collect();
        let ours = |names: BTreeSet<String>| -> BTreeSet<String> {
            names.into_iter().filter(|n| members.contains(n.as_str())).collect()
        };
        let normal = ours(dependencies(manifest, false));
        if !normal.iter().map(String::as_str).eq(allowed.iter().copied()) {
            found.push(format!("{package} depends on {normal:?}; the map says {allowed:?}"));
        }
        for dev in ours(dependencies(manifest, true)) {
            if !allowed.contains(dev.as_str()) && !TESTED.contains(&(package, dev.as_str())) {
                found.push(format!("tests of {package} depend on {dev}; the map says {allowed:?}"));
            }
        }
    }
    let listed = ARROWS.iter().filter(|a| !a.1.is_empty()).map(|a| a.1.trim_end_matches('/'));
    for member in listed {
        if !tree.text("Cargo.toml").contains(&format!("\"{member}\"")) {
            found.push(format!("{member} is not a workspace member"));
        }
    }
}

fn lints(tree: &Tree, found: &mut Vec<String>) {
    for (package, folder, _) in ARROWS {
        let manifest = tree.text(&format!("{folder}Cargo.toml"));
        if !manifest.split("[lints]").nth(1).is_some_and(|l| l.trim_start().starts_with("workspace = true")) {
            found.push(format!("{package} does not take the workspace's lints"));
        }
    }
}

fn no_std(tree: &Tree, found: &mut Vec<String>) {
    let root = tree.text("codec-core/src/lib.rs");
    for attribute in ["#![no_std]", "#![forbid(unsafe_code)]"] {
        if !root.contains(attribute) {
            found.push(format!("codec-core/src/lib.rs lacks {attribute}"));
        }
    }
    // A file of tests alone is there only under `cfg(test)`; its module says so.
    let tests = |path: &str| path.ends_with("/tests.rs");
    for (path, text) in tree.rust().filter(|(p, _)| p.starts_with("codec-core/src/") && !tests(p)) {
        for (line, code) in code(outside_tests(text)) {
            for banned in ["extern crate", "std::", "alloc::"] {
                if code.contains(banned) {
                    found.push(format!("{path}:{line}: {banned} in codec-core"));
                }
            }
        }
        if code(text).any(|(_, code)| code.contains("extern crate alloc")) {
            found.push(format!("{path}: extern crate alloc"));
        }
    }
}

fn top(tree: &Tree, found: &mut Vec<String>) {
    for name in &tree.top {
        if !TOP.iter().any(|t| t.0 == name) {
            found.push(format!("{name} has no place at the top"));
        }
    }
    for (name, _) in TOP.iter().filter(|t| t.1) {
        if !tree.top.contains(*name) {
            found.push(format!("{name} is missing at the top"));
        }
    }
}

fn names(tree: &Tree, found: &mut Vec<String>) {
    for (path, text) in tree.rust() {
        for part in path.split('/') {
            if EMPTY_NAMES.contains(&part.trim_end_matches(".rs")) {
                found.push(format!("{path}: {part} is a name for nothing"));
            }
        }
        for (line, code) in code(text) {
            let declared = code.trim_start().trim_start_matches("pub ").trim_start_matches("pub(crate) ");
            let Some(name) = declared.strip_prefix("mod ") else { continue };
            let name = name.trim_end_matches([';', '{', ' ']);
            if EMPTY_NAMES.contains(&name) {
                found.push(format!("{path}:{line}: module {name}"));
            }
        }
    }
}

fn unsafe_code(tree: &Tree, found: &mut Vec<String>) {
    for (path, text) in tree.rust().filter(|(p, _)| !UNSAFE.contains(p) && *p != "tests/architecture.rs") {
        for (line, _) in code(text).filter(|(_, code)| is_unsafe(code)) {
            found.push(format!("{path}:{line}: unsafe"));
        }
    }
    let root = tree.text("Cargo.toml");
    if !root.contains("unsafe_code = \"deny\"") && !root.contains("unsafe_code = \"forbid\"") {
        found.push("the workspace does not deny unsafe code".into());
    }
}

fn machine_paths(tree: &Tree, found: &mut Vec<String>) {
    // Put together here, so that this line does not find itself.
    let homes = ["home", "root", "Users", "work", "mnt"].map(|name| format!("/{name}/"));
    for (path, text) in &tree.files {
        for (i, line) in text.lines().enumerate() {
            for home in &homes {
                let starts = |at: usize| {
                    line[..at]
                        .chars()
                        .next_back()
                        .is_none_or(|c| !(c.is_alphanumeric() || "._-)/".contains(c)))
                };
                if line.match_indices(home.as_str()).any(|(at, _)| starts(at)) {
                    found.push(format!("{path}:{}: names a place on one machine ({home})", i + 1));
                }
            }
        }
    }
}

fn clocks(tree: &Tree, found: &mut Vec<String>) {
    for library in LIBRARIES {
        let config = tree.text(&format!("{library}/clippy.toml"));
        for banned in ["std::time::Instant::now", "std::time::SystemTime::now"] {
            if !config.contains(&format!("path = \"{banned}\"")) {
                found.push(format!("{library}/clippy.toml does not ban {banned}"));
            }
        }
    }
    for wanted in ["disallowed_methods", "iter_over_hash_type"] {
        if !tree.text("Cargo.toml").contains(&format!("{wanted} = \"deny\"")) {
            found.push(format!("the workspace does not deny {wanted}"));
        }
    }
}

fn licence_and_recipe(tree: &Tree, found: &mut Vec<String>) {
    for part in ["Apache License", "Version 2.0, January 2004", "END OF TERMS AND CONDITIONS"] {
        if !tree.text("LICENSE").contains(part) {
            found.push(format!("LICENSE lacks {part:?}"));
        }
    }
    if !tree.text(".ci/run").contains("set -euo pipefail") {
        found.push(".ci/run does not stop at errors".into());
    }
}

fn walked_files(tree: &Tree, found: &mut Vec<String>) {
    let walks = source::walks(tree);
    if walks.len() != 2 {
        found.push(format!("tests/lab/WALKS.md describes {} walks, not 2", walks.len()));
    }
    for walk in walks {
        let missing = walk.files.iter().filter(|file| !tree.files.contains_key(*file));
        found.extend(missing.map(|file| format!("tests/lab/WALKS.md: {}: {file} does not exist", walk.name)));
    }
}

fn tree() -> Tree {
    Tree::of(Path::new(env!("CARGO_MANIFEST_DIR")))
}

#[test]
fn the_map_holds() {
    let found = broken(&tree());
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// Each change breaks one rule, and is found.
#[test]
fn a_broken_map_is_found() {
    let good = tree();
    let append = |path: &'static str, text: &'static str| {
        move |tree: &mut Tree| tree.files.entry(path.to_owned()).or_default().push_str(text)
    };
    let replace = |path: &'static str, from: &'static str, to: &'static str| {
        move |tree: &mut Tree| {
            let text = tree.text(path).replace(from, to);
            assert_ne!(text, tree.text(path), "{path} holds {from}");
            tree.files.insert(path.to_owned(), text);
        }
    };
    type Change = Box<dyn Fn(&mut Tree)>;
    let changes: Vec<(Change, &str)> = vec![
        (
            Box::new(append("render-host/Cargo.toml", "\n[dependencies]\nemulator-host.workspace = true\n")),
            "render-host depends on",
        ),
        (
            Box::new(append(
                "codec-core/Cargo.toml",
                "\n[dev-dependencies]\ntrainer-host.workspace = true\n",
            )),
            "tests of codec-core depend on trainer-host",
        ),
        (
            Box::new(append("codec-core/Cargo.toml", "\n[dependencies.render-host]\nworkspace = true\n")),
            "codec-core depends on",
        ),
        (
            Box::new(replace("trainer-host/Cargo.toml", "render-host.workspace = true", "")),
            "trainer-host depends on",
        ),
        (Box::new(replace("fuzz/Cargo.toml", "[lints]", "[nothing]")), "fuzz does not take"),
        (Box::new(replace("codec-core/src/lib.rs", "#![no_std]", "")), "lacks #![no_std]"),
        (Box::new(append("codec-core/src/new.rs", "fn f() { std::process::abort() }\n")), "new.rs:1: std::"),
        (
            Box::new(append("codec-core/src/new.rs", "#[cfg(test)]\nmod t { extern crate alloc; }\n")),
            "extern crate alloc",
        ),
        (Box::new(|tree| assert!(tree.top.insert("notes.txt".into()))), "notes.txt has no place"),
        (Box::new(|tree| assert!(tree.top.remove("LICENSE"))), "LICENSE is missing"),
        (Box::new(append("render-host/src/utils.rs", "\n")), "utils.rs is a name for nothing"),
        (Box::new(append("src/lib.rs", "\nmod helpers;\n")), "module helpers"),
        (Box::new(append("render-host/src/lib.rs", "\nfn f() { unsafe { g() } }\n")), "unsafe"),
        (
            Box::new(|tree| {
                let line = format!("const DATA: &str = \"/{}/somebody/data\";\n", "home");
                tree.files.insert("src/data.rs".into(), line);
            }),
            "src/data.rs:1: names a place on one machine",
        ),
        (
            Box::new(replace(
                "emulator-host/clippy.toml",
                "std::time::Instant::now",
                "std::time::Instant::elapsed",
            )),
            "emulator-host/clippy.toml does not ban",
        ),
        (Box::new(replace("LICENSE", "Version 2.0, January 2004", "")), "LICENSE lacks"),
        (Box::new(replace("tests/lab/WALKS.md", "stage/sort.rs", "stage/none.rs")), "none.rs does not exist"),
    ];
    for (change, named) in changes {
        let mut tree = good.clone();
        change(&mut tree);
        let found = broken(&tree);
        assert!(found.iter().any(|f| f.contains(named)), "{named}: {found:?}");
    }
    // Words and comments that only look like it are left alone.
    let mut tree = good;
    tree.files.insert(
        "src/fine.rs".into(),
        "// unsafe\nconst F: &str = \"a\"; // std::mem\nfn unsafely() {}\n".into(),
    );
    assert!(!broken(&tree).iter().any(|f| f.contains("src/fine.rs")));
}
