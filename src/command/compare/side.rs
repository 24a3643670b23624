//! Opens one side of a comparison: frames to be rendered, or pictures that are there.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::Image;

use crate::{args::SceneArgs, pipeline::Frames};

/// Endings of pictures.
const PICTURES: [&str; 4] = ["png", "jpg", "jpeg", "webp"];

/// What is compared.
pub(super) enum Side {
    /// A scene or a stream.
    Frames(Box<Frames>),
    /// Pictures, in the order of their names.
    Pictures(Vec<PathBuf>),
}

impl Side {
    /// Opens `input`: a picture, a folder of pictures, a stream or a scene. Damage is passed to `warn`.
    pub(super) fn open(
        input: &str,
        args: &SceneArgs,
        level: Level,
        warn: &mut dyn FnMut(String),
    ) -> Result<Self> {
        let path = Path::new(input);
        if is_picture(path) {
            return Ok(Self::Pictures(vec![path.to_owned()]));
        }
        if path.is_dir() && !path.join("meta.json").is_file() {
            let pictures = pictures_in(path)?;
            if !pictures.is_empty() {
                return Ok(Self::Pictures(pictures));
            }
        }
        Ok(Self::Frames(Box::new(Frames::open(input, args, level, warn)?)))
    }
}

/// The pictures of a folder, numbers in their names counted as numbers.
fn pictures_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let failed = || format!("{}: cannot read", folder.display());
    let mut pictures = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(failed)? {
        let path = entry.with_context(failed)?.path();
        if is_picture(&path) {
            pictures.push(path);
        }
    }
    pictures.sort_by_cached_key(|path| natural(&path.file_name().unwrap_or_default().to_string_lossy()));
    Ok(pictures)
}

fn is_picture(path: &Path) -> bool {
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    ending.is_some_and(|ending| PICTURES.contains(&ending.as_str())) && !path.is_dir()
}

/// A key by which `a_9` comes before `a_10`: runs of digits by their length first.
fn natural(name: &str) -> Vec<(usize, String)> {
    let mut parts: Vec<(usize, String)> = Vec::new();
    let mut digits = None;
    for c in name.chars() {
        if digits == Some(c.is_ascii_digit())
            && let Some(last) = parts.last_mut()
        {
            last.1.push(c);
        } else {
            parts.push((0, c.to_string()));
        }
        digits = Some(c.is_ascii_digit());
    }
    for (length, text) in &mut parts {
        if text.bytes().all(|b| b.is_ascii_digit()) {
            *text = text.trim_start_matches('0').to_owned();
            *length = text.len();
        }
    }
    parts
}

/// A name without its folders and ending.
pub(super) fn stem(name: &str) -> &str {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    last.rsplit_once('.').map_or(last, |(stem, _)| stem)
}

/// The pictures of `paths` in the order of `names`, matched by name; `None` where names do not say.
pub(super) fn by_name(paths: &[PathBuf], names: &[&str]) -> Option<Vec<PathBuf>> {
    let matching = |name: &&str| {
        let wanted = stem(name);
        let mut found = paths.iter().filter(|path| stem(&path.to_string_lossy()) == wanted);
        let first = found.next()?;
        (found.next().is_none() && !wanted.is_empty()).then(|| first.clone())
    };
    names.iter().map(matching).collect()
}

/// Reads a picture.
pub(super) fn read(path: &Path, background: [f32; 3]) -> Result<Image> {
    Ok(Image::read(path, background)?)
}

/// Pairs of pictures of two folders, in order.
pub(super) fn pairs(a: &[PathBuf], b: &[PathBuf]) -> Result<Vec<(PathBuf, PathBuf)>> {
    if a.len() != b.len() {
        bail!("A has {} pictures and B {}; as many are needed", a.len(), b.len());
    }
    Ok(a.iter().cloned().zip(b.iter().cloned()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_are_numbers() {
        let mut names = ["a_10.png", "a_9.png", "a_009b.png", "a_1.png", "b.png"];
        names.sort_by_cached_key(|name| natural(name));
        assert_eq!(names, ["a_1.png", "a_9.png", "a_009b.png", "a_10.png", "b.png"]);
    }

    #[test]
    fn pictures_are_matched_by_name_where_all_names_say() {
        let paths = ["x/r_1.png", "x/r_2.png"].map(PathBuf::from);
        let found = by_name(&paths, &["./test/r_2", "./test/r_1"]).unwrap();
        assert_eq!(found, ["x/r_2.png", "x/r_1.png"].map(PathBuf::from));
        assert_eq!(by_name(&paths, &["r_1", "r_3"]), None);
        assert_eq!(by_name(&paths, &["", ""]), None);
    }
}
