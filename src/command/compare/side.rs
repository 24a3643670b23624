//! Opens one side of a comparison: frames to be rendered, or pictures that are there.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::File,
    io::BufReader,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::{Image, image_file::claimed_size};

use trainer_host::{
    edit::{self, Similarity, turn_between},
    import::{SEQUENCE_INDEX, SequenceIndex},
};

use crate::{
    args::{Compare, SceneArgs},
    pipeline::{Frames, stem},
};

/// Endings of pictures.
const PICTURES: [&str; 4] = ["png", "jpg", "jpeg", "webp"];

/// What is compared.
pub(super) enum Side {
    /// A scene or a stream.
    Frames(Box<Frames>),
    /// Pictures that are there.
    Pictures(Pictures),
}

/// Pictures in the order of their names, at least one.
pub(super) struct Pictures {
    pub(super) paths: Vec<PathBuf>,
    /// For people: the cameras that they were rendered from, where their folder says.
    pub(super) cameras: Option<String>,
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
            return Ok(Self::Pictures(Pictures { paths: vec![path.to_owned()], cameras: None }));
        }
        if path.is_dir() && !path.join("meta.json").is_file() {
            let paths = pictures_in(path)?;
            if !paths.is_empty() {
                let index = std::fs::read(path.join(SEQUENCE_INDEX)).unwrap_or_default();
                let index: SequenceIndex = serde_json::from_slice(&index).unwrap_or_default();
                return Ok(Self::Pictures(Pictures { paths, cameras: index.cameras }));
            }
        }
        Ok(Self::Frames(Box::new(Frames::open(input, args, level, warn)?)))
    }

    /// Whether it is a stream.
    pub(super) fn is_stream(&self) -> bool {
        matches!(self, Self::Frames(frames) if matches!(**frames, Frames::Stream { .. }))
    }
}

/// Turns scene A into the axes of B, or scene B into those of the stream A, where other directions are up in
/// them, and says so; of two streams, that it does not.
///
/// # Errors
/// Positions that do not stay finite.
pub(super) fn turned_alike(args: &Compare, a: &mut Side, b: &mut Side) -> Result<Option<String>> {
    let (Side::Frames(of_a), Side::Frames(of_b)) = (a, b) else { return Ok(None) };
    let (up_of_a, up_of_b) = (of_a.up(), of_b.up());
    if up_of_a == up_of_b {
        return Ok(None);
    }
    let (a, b) = (&args.a, &args.b);
    let (scene, (name, from), (other, to)) = match (&mut **of_a, &mut **of_b) {
        (Frames::Scene(scene), _) => (scene, (a, up_of_a), (b, up_of_b)),
        (Frames::Stream { .. }, Frames::Scene(scene)) => (scene, (b, up_of_b), (a, up_of_a)),
        (Frames::Stream { .. }, Frames::Stream { .. }) => {
            return Ok(Some(format!(
                "{a} has {up_of_a} up, {b} {up_of_b}: a stream is not turned; dgs convert turns it"
            )));
        }
    };
    let rotation = turn_between(from, to);
    **scene = edit::transform(scene, &Similarity { rotation, ..Similarity::default() })?;
    scene.up = to;
    Ok(Some(format!(
        "{name} is turned: {from} is up in it, {to} in {other}; --up of both leaves axes as they are"
    )))
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

/// Width and height of a picture, pixels.
pub(super) fn size(path: &Path) -> Result<(u32, u32)> {
    let file = File::open(path).with_context(|| format!("{}: cannot read", path.display()))?;
    claimed_size(BufReader::new(file)).with_context(|| path.display().to_string())
}

/// Reads a picture.
pub(super) fn read(path: &Path, background: [f32; 3]) -> Result<Image> {
    Ok(Image::read(path, background)?)
}

/// Pairs of pictures of two folders, and how they were matched: by name where any name is on both sides, else
/// by order.
///
/// # Errors
/// Pictures without a partner.
pub(super) fn pairs(a: &[PathBuf], b: &[PathBuf]) -> Result<(Vec<(PathBuf, PathBuf)>, &'static str)> {
    let (named_a, named_b) = (Named::of(a), Named::of(b));
    let (of_a, of_b): (Vec<_>, Vec<_>) = (
        a.iter().map(|path| (path.clone(), named_b.partner(path))).collect(),
        b.iter().map(|path| (path.clone(), named_a.partner(path))).collect(),
    );
    let is_named = of_a.iter().any(|(_, partner)| partner.is_some());
    if is_named {
        for (side, found) in [("B", &of_a), ("A", &of_b)] {
            let missing: Vec<_> =
                found.iter().filter(|(_, other)| other.is_none()).map(|(path, _)| name_of(path)).collect();
            if let Some(first) = missing.first() {
                let more = missing.len() - 1;
                let more = if more > 0 { format!(" and {more} more") } else { String::new() };
                bail!("{side} has no picture named {first}{more}; pictures of the same names are compared");
            }
        }
    }
    if a.len() != b.len() {
        bail!("A has {} pictures and B {}; as many are needed", a.len(), b.len());
    }
    if is_named {
        let mut taken = BTreeSet::new();
        if let Some((_, Some(twice))) = of_a.iter().find(|(_, partner)| !taken.insert(partner)) {
            bail!("{} goes with two pictures of A; each name is needed once", twice.display());
        }
        let pairs = of_a.into_iter().filter_map(|(path, partner)| Some((path, partner?)));
        return Ok((pairs.collect(), "matched by name"));
    }
    Ok((a.iter().cloned().zip(b.iter().cloned()).collect(), "matched by order"))
}

/// Pictures by their names, with and without endings.
struct Named<'p> {
    names: BTreeMap<String, &'p PathBuf>,
    stems: BTreeMap<String, &'p PathBuf>,
}

impl<'p> Named<'p> {
    fn of(paths: &'p [PathBuf]) -> Self {
        Self {
            names: paths.iter().map(|path| (name_of(path), path)).collect(),
            stems: paths.iter().map(|path| (stem_of(path), path)).collect(),
        }
    }

    /// The picture of the same name as `path`, or else of the same name but for its ending.
    fn partner(&self, path: &Path) -> Option<PathBuf> {
        let found = self.names.get(&name_of(path)).or_else(|| self.stems.get(&stem_of(path)));
        found.map(|&path| path.clone())
    }
}

/// The file name of a picture.
pub(super) fn name_of(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

fn stem_of(path: &Path) -> String {
    stem(&path.to_string_lossy()).to_owned()
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
    fn folders_of_pictures_are_matched_by_name_or_refused() {
        let list = |names: &[&str]| -> Vec<PathBuf> { names.iter().map(PathBuf::from).collect() };
        let (named, other) = (list(&["x/1.png", "x/2.png"]), list(&["y/2.jpg", "y/1.jpg"]));
        let (found, how) = pairs(&named, &other).unwrap();
        assert_eq!(how, "matched by name");
        assert_eq!(found[0], (named[0].clone(), other[1].clone()));
        let (found, how) = pairs(&named, &list(&["y/a.png", "y/b.png"])).unwrap();
        assert_eq!((found[1].1.as_path(), how), (Path::new("y/b.png"), "matched by order"));
        let error = pairs(&named, &list(&["y/2.png", "y/3.png"])).unwrap_err().to_string();
        assert!(error.contains("B has no picture named 1.png"), "{error}");
        let error = pairs(&named, &list(&["y/1.png", "y/2.png", "y/3.png"])).unwrap_err().to_string();
        assert!(error.contains("A has no picture named 3.png"), "{error}");
        let (twice, one) = (list(&["x/1.jpeg", "x/1.webp"]), list(&["y/1.jpg", "y/1.png"]));
        let error = pairs(&twice, &one).unwrap_err().to_string();
        assert!(error.contains("goes with two pictures of A"), "{error}");
        assert!(pairs(&named, &list(&["y/a.png"])).unwrap_err().to_string().contains("as many are needed"));
    }
}
