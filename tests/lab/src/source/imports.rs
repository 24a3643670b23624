//! Reads the `use` items of a file.

use syn::{Item, UseTree, Visibility};

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
pub(super) fn leaves(tree: &UseTree, path: &mut Vec<String>, found: &mut dyn FnMut(&[String], &str)) {
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
