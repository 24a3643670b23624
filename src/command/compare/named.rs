//! Finds out by names which picture shows what which camera sees.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
};

use crate::pipeline::{listed, shared_end, stem};

/// Pictures and what they are called, each used once at most.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Named {
    /// Of each name, the picture that it is of.
    pub(super) pictures: Vec<Option<PathBuf>>,
    /// What is wrong with pictures that go with no name, or with several, for people.
    pub(super) wrong: Vec<String>,
    /// Whether any picture has the stem of any name.
    pub(super) is_any: bool,
}

/// The pictures of `paths` that each of `names` is of: the end of the path that is the longest in common
/// decides, then the ending.
pub(super) fn by_name(paths: &[PathBuf], names: &[&str]) -> Named {
    // Folders count however a person has come to them.
    let whole = |path: &PathBuf| {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        let folder = folder.canonicalize().unwrap_or_else(|_| folder.to_owned());
        folder.join(file_name(path)).to_string_lossy().into_owned()
    };
    let whole: Vec<String> = paths.iter().map(whole).collect();
    let mut of_stem: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (picture, path) in whole.iter().enumerate() {
        of_stem.entry(stem(path)).or_default().push(picture);
    }
    let mut of_picture = vec![Best::default(); paths.len()];
    let mut of_name = vec![Best::default(); names.len()];
    for (name, text) in names.iter().enumerate() {
        for &picture in of_stem.get(stem(text)).into_iter().flatten() {
            let path = &whole[picture];
            let has_ending = path.rsplit('.').next() == text.rsplit('.').next();
            let likeness = 2 * shared_end(path, text) + usize::from(has_ending);
            if likeness > 1 {
                of_picture[picture].add(likeness, name);
                of_name[name].add(likeness, picture);
            }
        }
    }
    let partner = |name: usize| match of_name[name].found[..] {
        [picture] => (of_picture[picture].found == [name]).then_some(picture),
        _ => None,
    };
    let partners: Vec<Option<usize>> = (0..names.len()).map(partner).collect();
    let mut found = Named {
        pictures: partners.iter().map(|picture| picture.map(|picture| paths[picture].clone())).collect(),
        is_any: of_picture.iter().any(|best| !best.found.is_empty()),
        ..Named::default()
    };
    let taken: BTreeSet<usize> = partners.iter().copied().flatten().collect();
    let mut unnamed = Vec::new();
    for (picture, best) in of_picture.iter().enumerate().filter(|(picture, _)| !taken.contains(picture)) {
        let shown = file_name(&paths[picture]);
        match best.found[..] {
            [] => unnamed.push(shown),
            [name] => found.wrong.push(format!("{shown} is not the only picture of {}", names[name])),
            _ => {
                let several: Vec<&str> = best.found.iter().map(|name| names[*name]).collect();
                found.wrong.push(format!("{shown} may be {}", listed(&several)));
            }
        }
    }
    if !unnamed.is_empty() {
        let unnamed: Vec<&str> = unnamed.iter().map(String::as_str).collect();
        found.wrong.push(format!("nothing is called {}", listed(&unnamed)));
    }
    found
}

/// Who is most like something.
#[derive(Clone, Default)]
struct Best {
    likeness: usize,
    /// All that are as like.
    found: Vec<usize>,
}

impl Best {
    fn add(&mut self, likeness: usize, found: usize) {
        if likeness > self.likeness {
            *self = Self { likeness, found: vec![found] };
        } else if likeness == self.likeness {
            self.found.push(found);
        }
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(paths: &[&str], names: &[&str]) -> Named {
        by_name(&paths.iter().map(PathBuf::from).collect::<Vec<_>>(), names)
    }

    fn pictures(paths: &[&str], names: &[&str]) -> Vec<String> {
        let found = found(paths, names).pictures.into_iter();
        found.map(|picture| picture.map_or_else(String::new, |path| path.display().to_string())).collect()
    }

    #[test]
    fn the_longest_end_in_common_decides_and_each_picture_is_used_once() {
        assert_eq!(
            pictures(&["x/r_1.png", "x/r_2.png"], &["./test/r_2", "./test/r_1"]),
            ["x/r_2.png", "x/r_1.png"]
        );
        let rig = ["left/0001.png", "right/0001.png"];
        assert_eq!(pictures(&["a/right/0001.jpg"], &rig), ["", "a/right/0001.jpg"]);
        assert_eq!(pictures(&["x/1.jpg", "x/1.png"], &["1.png", "2.png"]), ["x/1.png", ""]);
        let either = found(&["photos/0001.png"], &rig);
        assert_eq!(either.wrong, ["0001.png may be left/0001.png, right/0001.png"]);
        assert!(either.is_any && either.pictures == [None, None]);
    }

    #[test]
    fn what_has_no_partner_is_named() {
        let one = found(&["x/r_1.png", "x/r_x.png"], &["r_1", "r_2"]);
        assert_eq!(one.wrong, ["nothing is called r_x.png"]);
        assert!(one.is_any && one.pictures == [Some("x/r_1.png".into()), None]);
        let none = found(&["x/1.png"], &["", "2"]);
        assert!(!none.is_any && none.pictures == [None, None]);
        let twice = found(&["x/1.jpg", "x/1.webp"], &["1"]);
        assert_eq!(
            twice.wrong,
            ["1.jpg is not the only picture of 1", "1.webp is not the only picture of 1"]
        );
    }
}
