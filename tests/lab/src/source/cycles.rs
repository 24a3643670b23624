//! Finds files of a crate that need each other in a circle.

use std::collections::{BTreeMap, BTreeSet};

use syn::{Item, visit::Visit};

use super::{
    Tree,
    imports::{Import, imports},
    outside_tests,
};

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
pub fn cycles(tree: &Tree, folder: &str) -> Vec<Vec<String>> {
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
    let mut cycles = BTreeSet::new();
    for (file, beyond) in &reached {
        if beyond.contains(*file) {
            let members = beyond.iter().filter(|other| reached.get(other).is_some_and(|r| r.contains(*file)));
            cycles.insert(members.map(|path| path.join("::")).collect::<Vec<_>>());
        }
    }
    cycles.into_iter().collect()
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
        assert!(cycles(&tree(&straight), "").is_empty());
        let mut bent = tree(&straight);
        bent.files.insert("src/a.rs".into(), "pub struct A;\nfn f() { crate::b::f() }\n".into());
        assert_eq!(cycles(&bent, ""), [["a", "b"]]);
        // A parent that calls its child, whose types are the parent's.
        let family = tree(&[
            ("src/lib.rs", "mod a;\n"),
            ("src/a.rs", "mod c;\npub struct A;\nfn f() { c::g() }\n"),
            ("src/a/c.rs", "use super::A;\npub fn g() {}\n#[cfg(test)]\nmod tests { use crate::x; }\n"),
        ]);
        assert_eq!(cycles(&family, ""), [["a", "a::c"]]);
    }

    /// What a file takes through a parent that only names it, whatever the name, is no need of the parent.
    #[test]
    fn names_lead_to_the_file_that_declares_the_thing() {
        let files = [
            ("src/lib.rs", "mod p;\n"),
            ("src/p.rs", "mod a;\nmod b;\npub use a::{A as Renamed, *};\nuse b::f;\nfn g() { f() }\n"),
            ("src/p/a.rs", "pub struct A;\npub struct Other;\n"),
            ("src/p/b.rs", "use super::{Other, Renamed};\nuse crate::p;\npub fn f(_: p::Renamed) {}\n"),
        ];
        assert!(cycles(&tree(&files), "").is_empty(), "{:?}", cycles(&tree(&files), ""));
        // What the parent declares itself is a need of the parent, also through its name and in macros.
        for taken in ["use super::g;\n", "fn h() { p::g() }\n", "fn h() { print!(\"{}\", super::g()) }\n"] {
            let mut bent = tree(&files);
            bent.files.entry("src/p/b.rs".into()).or_default().push_str(taken);
            assert_eq!(cycles(&bent, ""), [["p", "p::b"]], "{taken}");
        }
    }
}
