//! Reads the source tree as text and syntax: lines, public items, cycles between files.
//!
//! `tests/architecture.rs` holds the tree to rules with it, and bench `structure` prints what it counts.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use syn::{Item, Visibility};

#[path = "source/cycles.rs"]
mod cycles;
#[path = "source/imports.rs"]
mod imports;

use self::imports::leaves;
pub use self::{cycles::cycles, imports::imports};

/// Made on the spot and ignored by git.
const IGNORED: [&str; 4] = [".git", "target", "dgs-demo", ".dgs-out"];

/// Texts by path from the root, with `/`, and the names at the top.
#[derive(Clone, Debug, Default)]
pub struct Tree {
    /// Text of every file that is text.
    pub files: BTreeMap<String, String>,
    /// Names of files and folders at the top.
    pub top: BTreeSet<String>,
}

impl Tree {
    /// The tree at `root`. What cannot be read is not in it.
    pub fn of(root: &Path) -> Self {
        let mut tree = Self::default();
        for name in names(root) {
            if !IGNORED.contains(&name.as_str()) && !name.ends_with(".profraw") {
                tree.read(root, &name);
                tree.top.insert(name);
            }
        }
        tree
    }

    fn read(&mut self, root: &Path, name: &str) {
        let path = root.join(name);
        if path.is_dir() {
            for inner in names(&path) {
                // Corpora and artefacts of fuzzing are bytes, not texts.
                if !["corpus", "artifacts", "target"].contains(&inner.as_str()) {
                    self.read(root, &format!("{name}/{inner}"));
                }
            }
        } else if let Ok(text) = std::fs::read_to_string(&path) {
            self.files.insert(name.to_owned(), text);
        }
    }

    /// The text at `path`, empty if there is none.
    pub fn text(&self, path: &str) -> &str {
        self.files.get(path).map_or("", String::as_str)
    }

    /// Path and text of every Rust file.
    pub fn rust(&self) -> impl Iterator<Item = (&str, &str)> {
        self.files.iter().filter(|(p, _)| p.ends_with(".rs")).map(|(p, t)| (p.as_str(), t.as_str()))
    }

    /// Every crate with a library: name and folder, the folder ending with `/` unless it is the root.
    pub fn libraries(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        for (path, text) in &self.files {
            let Some(folder) = path.strip_suffix("Cargo.toml") else { continue };
            if let Some(name) = text.lines().find_map(|line| line.strip_prefix("name = "))
                && self.files.contains_key(&format!("{folder}src/lib.rs"))
            {
                found.push((name.trim_matches('"').to_owned(), folder.to_owned()));
            }
        }
        found
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.filter_map(|entry| entry.file_name().into_string().ok()).collect()
}

/// The part of a Rust file before its inline tests.
pub fn outside_tests(text: &str) -> &str {
    text.split("#[cfg(test)]").next().unwrap_or("")
}

/// Where a line of Rust belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CodeKind {
    /// What is shipped.
    Product,
    /// What measures: package `dgs-lab`.
    Laboratory,
    /// What tests, fuzzing included.
    Tests,
}

/// Lines of Rust per floor that are neither blank nor comment.
pub fn lines(tree: &Tree) -> BTreeMap<CodeKind, usize> {
    let code = |text: &str| {
        text.lines().filter(|line| !line.trim().is_empty() && !line.trim_start().starts_with("//")).count()
    };
    let mut counted = BTreeMap::new();
    for (path, text) in tree.rust() {
        let laboratory = path.starts_with("tests/lab/src/");
        let tests = !laboratory
            && (path.starts_with("tests/") || path.contains("/tests/") || path.ends_with("/tests.rs"));
        let floor = match (laboratory, tests || path.starts_with("fuzz/")) {
            (true, _) => CodeKind::Laboratory,
            (_, true) => CodeKind::Tests,
            _ => CodeKind::Product,
        };
        let outside = code(outside_tests(text));
        *counted.entry(floor).or_default() += outside;
        *counted.entry(CodeKind::Tests).or_default() += code(text) - outside;
    }
    counted
}

/// One of the walks that `tests/lab/WALKS.md` describes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Walk {
    /// Its name, as in the comment before its table.
    pub name: String,
    /// The files entered, in order; a file entered twice is there twice.
    pub files: Vec<String>,
}

impl Walk {
    /// How often each file is entered.
    pub fn entries(&self) -> BTreeMap<&str, usize> {
        let mut entries = BTreeMap::new();
        for file in &self.files {
            *entries.entry(file.as_str()).or_default() += 1;
        }
        entries
    }
}

/// The walks of `tests/lab/WALKS.md`: after a comment `<!-- walk: name -->`, the first cell of each row.
pub fn walks(tree: &Tree) -> Vec<Walk> {
    let mut walks: Vec<Walk> = Vec::new();
    for line in tree.text("tests/lab/WALKS.md").lines() {
        if let Some(name) = line.strip_prefix("<!-- walk: ").and_then(|rest| rest.strip_suffix(" -->")) {
            walks.push(Walk { name: name.to_owned(), files: Vec::new() });
        } else if let Some((file, _)) = line.strip_prefix("| `").and_then(|rest| rest.split_once('`'))
            && let Some(walk) = walks.last_mut()
        {
            walk.files.push(file.to_owned());
        }
    }
    walks
}

/// Items that a user of the crate in `folder` can name: public items of public modules, `internals` left out.
pub fn public_items(tree: &Tree, folder: &str) -> usize {
    fn below(tree: &Tree, src: &str, module: &str, items: &[Item]) -> usize {
        let mut count = 0;
        for item in items {
            let (vis, inner) = match item {
                Item::Mod(m) => (&m.vis, Some(m)),
                Item::Fn(i) => (&i.vis, None),
                Item::Struct(i) => (&i.vis, None),
                Item::Enum(i) => (&i.vis, None),
                Item::Trait(i) => (&i.vis, None),
                Item::Const(i) => (&i.vis, None),
                Item::Static(i) => (&i.vis, None),
                Item::Type(i) => (&i.vis, None),
                Item::Union(i) => (&i.vis, None),
                Item::Use(i) => (&i.vis, None),
                _ => continue,
            };
            if !matches!(vis, Visibility::Public(_)) {
                continue;
            }
            count += match item {
                Item::Use(item) => {
                    let mut names = 0;
                    leaves(&item.tree, &mut Vec::new(), &mut |_, _| names += 1);
                    names
                }
                _ => 1,
            };
            let Some(inner) = inner.filter(|m| m.ident != "internals") else { continue };
            match &inner.content {
                Some((_, items)) => count += below(tree, src, module, items),
                None => count += file(tree, src, &format!("{module}{}", inner.ident)),
            }
        }
        count
    }
    fn file(tree: &Tree, src: &str, module: &str) -> usize {
        let paths = [format!("{src}{module}.rs"), format!("{src}{module}/mod.rs")];
        let text = paths.iter().map(|path| tree.text(path)).find(|text| !text.is_empty());
        let Ok(parsed) = syn::parse_file(outside_tests(text.unwrap_or(""))) else { return 0 };
        let children = if module == "lib" { String::new() } else { format!("{module}/") };
        below(tree, src, &children, &parsed.items)
    }
    file(tree, &format!("{folder}src/"), "lib")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(files: &[(&str, &str)]) -> Tree {
        let files = files.iter().map(|(path, text)| ((*path).to_owned(), (*text).to_owned())).collect();
        Tree { files, ..Tree::default() }
    }

    #[test]
    fn a_walk_is_the_first_cells_of_its_table() {
        let text = "<!-- walk: there -->\n| file | does |\n| --- | --- |\n\
                    | `a.rs` | x |\n| `b.rs` | y |\n| `a.rs` | z |\n";
        let walks = walks(&tree(&[("tests/lab/WALKS.md", text)]));
        assert_eq!(walks[0].files, ["a.rs", "b.rs", "a.rs"]);
        assert_eq!(walks[0].entries(), BTreeMap::from([("a.rs", 2), ("b.rs", 1)]));
    }

    #[test]
    fn only_what_a_user_can_name_is_a_public_item() {
        let files = tree(&[
            ("k/src/lib.rs", "pub mod a;\nmod b;\npub use b::{C, D};\npub(crate) fn f() {}\n"),
            ("k/src/a.rs", "pub fn g() {}\npub mod internals;\nstruct S;\n#[cfg(test)]\npub mod t {}\n"),
            ("k/src/a/internals.rs", "pub fn h() {}\n"),
            ("k/src/b.rs", "pub struct C;\npub struct D;\n"),
        ]);
        assert_eq!(public_items(&files, "k/"), 5, "a, g, internals, C, D");
    }

    #[test]
    fn lines_are_counted_where_they_belong() {
        let counted = lines(&tree(&[
            ("src/lib.rs", "//! Doc.\n\nfn f() {}\n#[cfg(test)]\nmod tests {}\n"),
            ("tests/lab/src/lib.rs", "fn f() {}\n"),
            ("tests/cli.rs", "fn f() {}\n"),
            ("fuzz/src/lib.rs", "fn f() {}\nfn g() {}\n"),
        ]));
        assert_eq!(counted[&CodeKind::Product], 1);
        assert_eq!(counted[&CodeKind::Laboratory], 1);
        assert_eq!(counted[&CodeKind::Tests], 5);
    }
}
