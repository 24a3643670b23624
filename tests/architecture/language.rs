//! Counts what the glossary and the style of this project rule out, room by room.
//!
//! Each room has a ceiling per rule. A ceiling only ever goes down; that of public items follows what users
//! can do.

use std::collections::{BTreeMap, BTreeSet};

use syn::{Item, Visibility, visit::Visit};

use crate::source::{Tree, cycles, imports, public_items};

/// What is counted, in the order of [`CEILINGS`].
const RULES: [&str; 9] = [
    "names outside the glossary",
    "comments outside the glossary",
    "files longer than 500 lines",
    "lines wider than 110 columns",
    "modules as mod.rs",
    "imports out of order (std, other crates, this crate; one item per crate)",
    "types across files whose name says nothing",
    "files in cycles",
    "public items",
];

/// Words that names are not made of; the glossary says what stands for them.
const NAMES: [&str; 44] = [
    "luck",
    "unheard",
    "farewell",
    "vouched",
    "retreat",
    "bend",
    "stretch",
    "stretches",
    "menu",
    "menus",
    "selector",
    "selectors",
    "mixed",
    "stratum",
    "strata",
    "kit",
    "kits",
    "judge",
    "judges",
    "worth",
    "gauge",
    "lot",
    "lots",
    "proto",
    "film",
    "sieve",
    "scaffold",
    "looks",
    "told",
    "asked",
    "held",
    "carried",
    "kept",
    "shot",
    "shots",
    "intake",
    "thrifty",
    "cheap",
    "dimmed",
    "faded",
    "crowd",
    "helper",
    "util",
    "misc",
];

/// Crates of others, whose names are not ours to choose.
const CRATES: [&str; 5] =
    ["futures_util", "http_body_util", "hyper_util", "quinn_proto", "web_transport_proto"];

/// Words that comments do not use either: plain English has none of them in this sense.
const METAPHORS: [&str; 13] = [
    "stretch",
    "stretches",
    "menu",
    "menus",
    "stratum",
    "strata",
    "kit",
    "gauge",
    "sieve",
    "scaffold",
    "thrifty",
    "judge",
    "film",
];

/// Types that say nothing without a qualifying word.
const BARE: [&str; 9] = ["Row", "Case", "Part", "Output", "Found", "Room", "Outcome", "Run", "Intake"];
/// Types that say something only with their module before them.
const MODULES: [&str; 2] = ["Options", "Kind"];

/// A number per rule.
type Counts = [usize; RULES.len()];

/// Each room and the most it may count.
const CEILINGS: [(&str, Counts); 16] = [
    ("", [0, 1, 0, 7, 0, 0, 0, 0, 125]),
    ("codec-core/", [0, 0, 0, 0, 0, 0, 0, 0, 26]),
    ("codec-core/capi/", [0, 0, 0, 0, 0, 0, 0, 0, 46]),
    ("codec-core/embedded/", [0, 0, 0, 0, 0, 0, 0, 0, 12]),
    ("codec-core/player/", [0, 0, 0, 0, 0, 0, 0, 0, 22]),
    ("codec-core/simd/", [0, 0, 0, 0, 0, 0, 0, 0, 9]),
    ("emulator-host/", [0, 0, 0, 0, 0, 0, 0, 0, 164]),
    ("emulator-host/quic/", [0, 0, 0, 0, 0, 0, 0, 0, 29]),
    ("fuzz/", [0, 0, 0, 0, 0, 0, 0, 0, 37]),
    ("render-host/", [0, 0, 0, 0, 0, 0, 0, 0, 240]),
    ("render-host/video/", [0, 0, 0, 0, 0, 0, 0, 0, 3]),
    ("render-host/viewer/", [0, 0, 0, 0, 0, 0, 0, 0, 25]),
    ("render-host/window/", [0, 0, 0, 0, 0, 0, 0, 0, 11]),
    ("tests/lab/", [0, 0, 0, 13, 0, 0, 0, 0, 50]),
    ("trainer-host/", [0, 0, 0, 0, 0, 0, 0, 0, 333]),
    ("trainer-host/python/", [0, 0, 0, 0, 0, 0, 0, 0, 0]),
];

/// The room of a file: the longest folder of [`CEILINGS`] that it lies in.
fn room(path: &str) -> &'static str {
    let inside = CEILINGS.iter().map(|ceiling| ceiling.0).filter(|room| path.starts_with(room));
    inside.max_by_key(|room| room.len()).unwrap_or("")
}

/// The words of a name: `first_block` and `FirstBlock` are both `first`, `block`.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    for c in name.chars() {
        if (c == '_' || c.is_uppercase()) && words.last().is_some_and(|word| !word.is_empty()) {
            words.push(String::new());
        }
        if let Some(word) = words.last_mut().filter(|_| c.is_alphanumeric()) {
            word.extend(c.to_lowercase());
        }
    }
    // An upper-case constant falls apart into letters; it is read again as one.
    if words.iter().all(|word| word.len() <= 1) {
        return name.to_lowercase().split('_').map(str::to_owned).collect();
    }
    words
}

/// Names outside the glossary.
struct Names(Vec<String>);

impl<'ast> Visit<'ast> for Names {
    fn visit_ident(&mut self, name: &'ast syn::Ident) {
        let words = words(&name.to_string());
        // A held-out camera is a term of the field.
        let term = words.windows(2).any(|pair| pair == ["held", "out"]);
        let is_crate = CRATES.contains(&name.to_string().as_str());
        if !term && !is_crate && words.iter().any(|word| NAMES.contains(&word.as_str())) {
            self.0.push(name.to_string());
        }
    }
}

/// Whether the comment on `line` uses a word of [`METAPHORS`].
fn speaks_in_metaphors(line: &str) -> bool {
    let Some((_, comment)) = line.split_once("//") else { return false };
    comment.split(|c: char| !c.is_alphabetic()).any(|word| METAPHORS.contains(&word.to_lowercase().as_str()))
}

/// Whether the imports at the top of `file` are out of order.
fn is_disordered(file: &syn::File) -> bool {
    let mut classes = Vec::new();
    let mut roots = BTreeSet::new();
    for item in &file.items {
        let Item::Use(item) = item else { continue };
        let root = match &item.tree {
            syn::UseTree::Path(path) => path.ident.to_string(),
            _ => return true,
        };
        let class = match root.as_str() {
            "std" | "core" | "alloc" => 0,
            "crate" | "self" | "super" => 2,
            _ => 1,
        };
        if matches!(item.vis, Visibility::Inherited) && item.attrs.is_empty() {
            classes.push(class);
            if !roots.insert(root) {
                return true;
            }
        }
    }
    !classes.is_sorted()
}

/// Types of `file` that are visible elsewhere under a name that says nothing, and imports of such.
fn bare(file: &syn::File) -> usize {
    let declared = file.items.iter().filter(|item| {
        let (vis, name) = match item {
            Item::Struct(item) => (&item.vis, &item.ident),
            Item::Enum(item) => (&item.vis, &item.ident),
            Item::Type(item) => (&item.vis, &item.ident),
            Item::Trait(item) => (&item.vis, &item.ident),
            _ => return false,
        };
        !matches!(vis, Visibility::Inherited) && BARE.contains(&name.to_string().as_str())
    });
    let imports = imports(file);
    let imported = imports.iter().filter(|import| {
        !import.public && import.path.last().is_some_and(|name| MODULES.contains(&name.as_str()))
    });
    declared.count() + imported.count()
}

/// What every room counts.
fn counts(tree: &Tree) -> BTreeMap<&'static str, Counts> {
    let mut counts: BTreeMap<&'static str, Counts> =
        CEILINGS.iter().map(|ceiling| (ceiling.0, [0; RULES.len()])).collect();
    for (path, text) in tree.rust() {
        let Some(count) = counts.get_mut(room(path)) else { continue };
        count[1] += text.lines().filter(|line| speaks_in_metaphors(line)).count();
        count[2] += usize::from(text.lines().count() > 500);
        count[3] += text.lines().filter(|line| line.chars().count() > 110).count();
        count[4] += usize::from(path.ends_with("/mod.rs") && !path.ends_with("tests/support/mod.rs"));
        let Ok(file) = syn::parse_file(text) else { continue };
        let mut names = Names(Vec::new());
        names.visit_file(&file);
        count[0] += names.0.len();
        count[5] += usize::from(is_disordered(&file));
        count[6] += bare(&file);
    }
    for (_, folder) in tree.libraries() {
        if let Some(count) = counts.get_mut(room(&folder)) {
            count[7] += cycles(tree, &folder).iter().map(Vec::len).sum::<usize>();
            count[8] += public_items(tree, &folder);
        }
    }
    counts
}

/// Where a room is above its ceiling.
pub fn above(tree: &Tree) -> Vec<String> {
    let counts = counts(tree);
    let mut found = Vec::new();
    for (room, ceiling) in CEILINGS {
        for (rule, name) in RULES.iter().enumerate() {
            let (count, most) = (counts[room][rule], ceiling[rule]);
            if count > most {
                let room = if room.is_empty() { "src/ and tests/" } else { room };
                found.push(format!("{room}: {count} {name}; at most {most} are allowed"));
                found.extend(places(tree, if room == "src/ and tests/" { "" } else { room }, rule));
            }
        }
    }
    found
}

/// Where in `of_room` a rule counts, so that whoever reads the failure finds it.
fn places(tree: &Tree, of_room: &str, rule: usize) -> Vec<String> {
    let mut found = Vec::new();
    for (path, text) in tree.rust().filter(|(path, _)| room(path) == of_room) {
        let Ok(file) = syn::parse_file(text) else { continue };
        let mut names = Names(Vec::new());
        names.visit_file(&file);
        let lines = |counts: &dyn Fn(&str) -> bool| {
            let numbered = text.lines().enumerate().filter(|(_, line)| counts(line));
            numbered.map(|(index, _)| (index + 1).to_string()).collect::<Vec<_>>()
        };
        let here = match rule {
            0 => names.0,
            1 => lines(&speaks_in_metaphors),
            2 if text.lines().count() > 500 => vec![text.lines().count().to_string()],
            3 => lines(&|line| line.chars().count() > 110),
            5 if is_disordered(&file) => vec!["imports".to_owned()],
            6 if bare(&file) > 0 => vec![bare(&file).to_string()],
            _ => Vec::new(),
        };
        if !here.is_empty() {
            found.push(format!("    {path}: {}", here.join(", ")));
        }
    }
    for (_, folder) in tree.libraries().into_iter().filter(|(_, folder)| rule == 7 && room(folder) == of_room)
    {
        found.extend(cycles(tree, &folder).iter().map(|circle| format!("    {}", circle.join(" -> "))));
    }
    found
}

#[test]
fn no_room_is_above_its_ceiling() {
    let tree = crate::tree();
    let found = above(&tree);
    for (room, counts) in counts(&tree) {
        println!("    ({room:?}, {counts:?}),");
    }
    assert!(found.is_empty(), "{}", found.join("\n"));
}

/// A tree with nothing to count but one public item.
fn small() -> Tree {
    let files = [
        ("Cargo.toml", "[package]\nname = \"dgs\"\n"),
        ("src/lib.rs", "//! Walks.\n\nmod added;\n\npub fn f() {}\n"),
    ];
    let files = files.map(|(path, text)| (path.to_owned(), text.to_owned()));
    Tree { files: files.into(), ..Tree::default() }
}

/// Each change is counted under its rule, once.
#[test]
fn what_is_ruled_out_is_counted() {
    let long = "//\n".repeat(501);
    let wide = format!("// {}\n", "x".repeat(108));
    let public = "pub struct Added;\n";
    for (rule, files) in [
        (0, [("src/added.rs", "fn first_menu() {}\n")].as_slice()),
        (0, &[("src/added.rs", "struct FirstMenu;\n")]),
        (0, &[("src/added.rs", "const MENU: u8 = 0;\n")]),
        (1, &[("src/added.rs", "//! The Menu.\n")]),
        (2, &[("src/added.rs", long.as_str())]),
        (3, &[("src/added.rs", wide.as_str())]),
        (4, &[("src/added/mod.rs", "\n")]),
        (5, &[("src/added.rs", "use crate::a;\n\nuse std::io;\n")]),
        (5, &[("src/added.rs", "use std::io;\nuse std::fmt;\n")]),
        (6, &[("src/added.rs", "pub(crate) struct Row;\n")]),
        (6, &[("src/added.rs", "use crate::encode::{self, Options};\n")]),
        (7, &[("src/added.rs", "use crate::again::f;\n"), ("src/again.rs", "use crate::added::g;\n")]),
        (8, &[("src/lib.rs", public)]),
    ] {
        let good = small();
        let mut bent = good.clone();
        for (path, text) in files {
            bent.files.entry((*path).to_owned()).or_default().push_str(text);
        }
        let (before, after) = (counts(&good)[""], counts(&bent)[""]);
        assert!(after[rule] > before[rule], "{}: {files:?}", RULES[rule]);
        let others = (0..RULES.len()).filter(|&other| other != rule);
        assert!(others.clone().all(|other| after[other] == before[other]), "{files:?} is counted twice");
    }
}

/// Words that only look like it are left alone.
#[test]
fn plain_english_and_terms_of_the_field_are_left_alone() {
    let good = small();
    let mut tree = good.clone();
    let text = "//! What was told, held and kept.\nuse std::io;\n\nuse a::b;\n\nuse crate::c::{self, d};\n\n\
                struct Row;\nfn held_out_kitchen(worthy: &str) -> &str { \"menu\" }\n";
    tree.files.insert("src/added.rs".into(), text.into());
    assert_eq!(counts(&good), counts(&tree));
}
