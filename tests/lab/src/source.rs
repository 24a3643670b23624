//! Reads the source tree as text and syntax: lines, public items, circles between files.
//!
//! `tests/architecture.rs` holds the tree to rules with it, and bench `structure` prints what it counts.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

use syn::{Item, UseTree, Visibility, visit::Visit};

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
pub enum Floor {
    /// What is shipped.
    Product,
    /// What measures: package `dgs-lab`.
    Laboratory,
    /// What tests, fuzzing included.
    Tests,
}

/// Lines of Rust per floor that are neither blank nor comment.
pub fn lines(tree: &Tree) -> BTreeMap<Floor, usize> {
    let code = |text: &str| {
        text.lines().filter(|line| !line.trim().is_empty() && !line.trim_start().starts_with("//")).count()
    };
    let mut counted = BTreeMap::new();
    for (path, text) in tree.rust() {
        let laboratory = path.starts_with("tests/lab/src/");
        let tests = !laboratory
            && (path.starts_with("tests/") || path.contains("/tests/") || path.ends_with("/tests.rs"));
        let floor = match (laboratory, tests || path.starts_with("fuzz/")) {
            (true, _) => Floor::Laboratory,
            (_, true) => Floor::Tests,
            _ => Floor::Product,
        };
        let outside = code(outside_tests(text));
        *counted.entry(floor).or_default() += outside;
        *counted.entry(Floor::Tests).or_default() += code(text) - outside;
    }
    counted
}

/// One `use` of one name: the path as written, the name it gets, and whether that name is public.
#[derive(Clone, Debug)]
pub struct Import {
    /// Segments, for example `crate`, `receiver`, `Cell`; the last is `*` for a glob.
    pub path: Vec<String>,
    /// The name from there on: the last segment, or what stands after `as`.
    pub name: String,
    /// Whether it is a `pub use` of any reach.
    pub public: bool,
}

/// Every name that the `use` items of `item`'s file bring in, tests left out.
pub fn imports(file: &syn::File) -> Vec<Import> {
    let mut found = Vec::new();
    for item in &file.items {
        if let Item::Use(item) = item {
            let public = !matches!(item.vis, Visibility::Inherited);
            leaves(&item.tree, &mut Vec::new(), &mut |path, name| {
                // `a::{self}` names the module `a`.
                let path = path.strip_suffix(&["self".to_owned()]).filter(|p| !p.is_empty()).unwrap_or(path);
                let name = match name {
                    "self" => path.last().cloned().unwrap_or_default(),
                    name => name.to_owned(),
                };
                found.push(Import { path: path.to_vec(), name, public });
            });
        }
    }
    found
}

/// Calls `found` with the path of every leaf of `tree` and the name that it gets.
fn leaves(tree: &UseTree, path: &mut Vec<String>, found: &mut dyn FnMut(&[String], &str)) {
    let mut leaf = |last: String, name: &str| {
        path.push(last);
        found(path, name);
        path.pop();
    };
    match tree {
        UseTree::Path(step) => {
            path.push(step.ident.to_string());
            leaves(&step.tree, path, found);
            path.pop();
        }
        UseTree::Name(name) => leaf(name.ident.to_string(), &name.ident.to_string()),
        UseTree::Rename(name) => leaf(name.ident.to_string(), &name.rename.to_string()),
        UseTree::Glob(_) => leaf("*".to_owned(), "*"),
        UseTree::Group(group) => group.items.iter().for_each(|tree| leaves(tree, path, found)),
    }
}

/// The module path of a file below `src/`, for example `rans/table.rs` → `rans`, `table`.
fn module(file: &str) -> Vec<String> {
    let file = file.trim_end_matches(".rs").trim_end_matches("/mod");
    file.split('/').filter(|step| !["lib", "main"].contains(step)).map(str::to_owned).collect()
}

/// Paths of code outside `use`, for example `child::run` or `crate::figures::mean`.
struct Paths(Vec<Vec<String>>);

impl<'ast> Visit<'ast> for Paths {
    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.segments.len() > 1 {
            self.0.push(path.segments.iter().map(|s| s.ident.to_string()).collect());
        }
        syn::visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, call: &'ast syn::Macro) {
        self.0.extend(paths_in_text(&call.tokens.to_string()));
        syn::visit::visit_macro(self, call);
    }

    fn visit_item_mod(&mut self, module: &'ast syn::ItemMod) {
        // Inline modules are tests here, or small; their names would not resolve from this file.
        if module.content.is_none() {
            syn::visit::visit_item_mod(self, module);
        }
    }
}

/// Paths of at least two segments in the tokens of a macro call, string literals included: a path in
/// a literal is rare, and one too many shows at once.
fn paths_in_text(tokens: &str) -> Vec<Vec<String>> {
    let joined = tokens.replace(" ::", "::").replace(":: ", "::");
    let words = joined.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'));
    let paths = words.map(|word| word.split("::").map(str::to_owned).collect::<Vec<_>>());
    paths.filter(|path| path.len() > 1 && path.iter().all(|step| !step.is_empty())).collect()
}

/// The names of the items that `file` declares itself.
fn declared(file: &syn::File) -> BTreeSet<String> {
    let names = file.items.iter().filter_map(|item| match item {
        Item::Fn(item) => Some(&item.sig.ident),
        Item::Struct(item) => Some(&item.ident),
        Item::Enum(item) => Some(&item.ident),
        Item::Trait(item) => Some(&item.ident),
        Item::Const(item) => Some(&item.ident),
        Item::Static(item) => Some(&item.ident),
        Item::Type(item) => Some(&item.ident),
        Item::Union(item) => Some(&item.ident),
        _ => None,
    });
    names.map(ToString::to_string).collect()
}

/// What one file of a crate imports, names by path and declares.
struct Module {
    imports: Vec<Import>,
    paths: Vec<Vec<String>>,
    declared: BTreeSet<String>,
}

/// What a path leads to.
#[derive(Clone, Debug, PartialEq, Eq)]
enum Target {
    /// A module as a whole: the path went no further.
    Module(Vec<String>),
    /// Something that the file of this module declares.
    Item(Vec<String>),
}

/// The files of one crate by module path; the root is the empty path.
struct Modules(BTreeMap<Vec<String>, Module>);

impl Modules {
    fn of(tree: &Tree, folder: &str) -> Self {
        let mut modules = BTreeMap::new();
        let src = format!("{folder}src/");
        for (path, text) in tree.rust().filter(|(p, _)| p.starts_with(&src)) {
            let inside = &path[src.len()..];
            let is_apart = inside.starts_with("bin/") || inside == "main.rs" || inside.ends_with("tests.rs");
            if is_apart {
                continue;
            }
            let Ok(file) = syn::parse_file(outside_tests(text)) else { continue };
            let mut paths = Paths(Vec::new());
            for item in file.items.iter().filter(|item| !matches!(item, Item::Use(_))) {
                paths.visit_item(item);
            }
            let (imports, declared) = (imports(&file), declared(&file));
            modules.insert(module(inside), Module { imports, paths: paths.0, declared });
        }
        Self(modules)
    }

    /// What `path`, written in `from`, leads to, through imports and re-exports; none outside the crate.
    fn target(&self, from: &[String], path: &[String], depth: usize) -> Option<Target> {
        let mut at: Vec<String> = from.to_vec();
        let (head, mut rest) = path.split_first()?;
        match head.as_str() {
            "crate" => at.clear(),
            "super" => {
                at.pop()?;
            }
            "self" => {}
            name => match self.inside(from, name, depth)? {
                Target::Module(module) => at = module,
                item => return Some(item),
            },
        }
        while let Some((step, beyond)) = rest.split_first() {
            if step == "super" {
                at.pop()?;
            } else {
                match self.inside(&at, step, depth) {
                    Some(Target::Module(module)) => at = module,
                    Some(item) => return Some(item),
                    // Declared by a macro, or brought in from another crate: it belongs to where it is named.
                    None => return Some(Target::Item(at)),
                }
            }
            rest = beyond;
        }
        Some(Target::Module(at))
    }

    /// What `name` means inside the module `at`: a child, an item of its own, or what an import brings in.
    fn inside(&self, at: &[String], name: &str, depth: usize) -> Option<Target> {
        let child = [at, &[name.to_owned()]].concat();
        if self.0.contains_key(&child) {
            return Some(Target::Module(child));
        }
        let module = self.0.get(at)?;
        if module.declared.contains(name) {
            return Some(Target::Item(at.to_vec()));
        }
        if depth == 8 {
            return None;
        }
        let named = module.imports.iter().find(|import| import.name == name && import.path != [name]);
        if let Some(import) = named {
            return self.target(at, &import.path, depth + 1);
        }
        let globs = module.imports.iter().filter_map(|import| import.path.strip_suffix(&["*".to_owned()]));
        globs.filter(|glob| !glob.is_empty()).find_map(|glob| match self.target(at, glob, depth + 1)? {
            Target::Module(opened) if opened != at => self.inside(&opened, name, depth + 1),
            _ => None,
        })
    }

    /// What each file needs of others. A re-export is a name for something, no need; neither is the name of
    /// a module: what is taken from the module is.
    fn needs(&self) -> BTreeMap<Vec<String>, BTreeSet<Vec<String>>> {
        let mut needs = BTreeMap::new();
        for (from, module) in &self.0 {
            let used = module.imports.iter().filter(|import| !import.public).map(|import| &import.path);
            let targets = used.chain(&module.paths).filter_map(|path| self.target(from, path, 0));
            let files = targets.filter_map(|target| match target {
                Target::Item(file) => Some(file),
                Target::Module(_) => None,
            });
            needs.insert(from.clone(), files.filter(|to| to != from).collect::<BTreeSet<_>>());
        }
        needs
    }
}

/// Files of the crate in `folder` that need each other in a circle: each circle the names of its files.
pub fn circles(tree: &Tree, folder: &str) -> Vec<Vec<String>> {
    let needs = Modules::of(tree, folder).needs();
    let reach = |start: &Vec<String>| {
        let mut seen = BTreeSet::new();
        let mut ahead: Vec<&Vec<String>> = needs[start].iter().collect();
        while let Some(next) = ahead.pop() {
            if seen.insert(next.clone()) {
                ahead.extend(needs.get(next).into_iter().flatten());
            }
        }
        seen
    };
    let reached: BTreeMap<&Vec<String>, BTreeSet<Vec<String>>> =
        needs.keys().map(|file| (file, reach(file))).collect();
    let mut circles = BTreeSet::new();
    for (file, beyond) in &reached {
        if beyond.contains(*file) {
            let members = beyond.iter().filter(|other| reached.get(other).is_some_and(|r| r.contains(*file)));
            circles.insert(members.map(|path| path.join("::")).collect::<Vec<_>>());
        }
    }
    circles.into_iter().collect()
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
    fn two_files_that_need_each_other_are_a_circle_and_a_re_export_is_not() {
        let straight = [
            ("src/lib.rs", "pub mod a;\npub mod b;\npub use a::A;\n"),
            ("src/a.rs", "pub struct A;\n"),
            ("src/b.rs", "use crate::A;\nfn f(_: A) {}\n"),
        ];
        assert!(circles(&tree(&straight), "").is_empty());
        let mut bent = tree(&straight);
        bent.files.insert("src/a.rs".into(), "pub struct A;\nfn f() { crate::b::f() }\n".into());
        assert_eq!(circles(&bent, ""), [["a", "b"]]);
        // A parent that calls its child, whose types are the parent's.
        let family = tree(&[
            ("src/lib.rs", "mod a;\n"),
            ("src/a.rs", "mod c;\npub struct A;\nfn f() { c::g() }\n"),
            ("src/a/c.rs", "use super::A;\npub fn g() {}\n#[cfg(test)]\nmod tests { use crate::x; }\n"),
        ]);
        assert_eq!(circles(&family, ""), [["a", "a::c"]]);
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
        assert_eq!(counted[&Floor::Product], 1);
        assert_eq!(counted[&Floor::Laboratory], 1);
        assert_eq!(counted[&Floor::Tests], 5);
    }
}
