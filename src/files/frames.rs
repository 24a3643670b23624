//! Writes a folder of frames whole or not at all: it has a temporary name until all of them are there.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use tempfile::TempDir;
use trainer_host::import::{SEQUENCE_INDEX, SequenceIndex};

use super::{affixes, check_folder, folder_of, leftovers, leftovers::Unfinished, or_here, sync_folder};

/// Refuses a `target` that cannot be made, with the folders that it lies in; nothing is made.
///
/// # Errors
/// A file where a folder is needed, or a folder that cannot be written to.
pub(super) fn check_can_make(target: &Path) -> Result<()> {
    let ancestors = folder_of(target).ancestors();
    let existing = ancestors.map(or_here).find(|folder| folder.exists()).unwrap_or(Path::new("."));
    check_folder(existing)?;
    let failed = || format!("{}: cannot write in this folder", existing.display());
    let _uninterrupted = leftovers::uninterrupted();
    tempfile::Builder::new().prefix(&affixes(target).0).tempfile_in(existing).with_context(failed)?;
    Ok(())
}

/// What the frames of a folder are: with `--overwrite`, those of one kind do not replace those of the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameKind {
    /// Files of Gaussians, `.ply`.
    Scene,
    /// Pictures.
    Pictures,
}

impl FrameKind {
    fn of(name: &str) -> Self {
        let is_ply = Path::new(name).extension().is_some_and(|ending| ending.eq_ignore_ascii_case("ply"));
        if is_ply { Self::Scene } else { Self::Pictures }
    }

    /// One of them, and several, for people.
    const fn names(self) -> [&'static str; 2] {
        match self {
            Self::Scene => ["a frame of a scene", "frames of scenes"],
            Self::Pictures => ["a picture", "pictures"],
        }
    }
}

/// A folder of frames on its way: under a temporary name beside its own until [`FrameFolder::finish`].
#[derive(Debug)]
pub(crate) struct FrameFolder {
    target: PathBuf,
    /// Removed if it is never finished.
    temporary: TempDir,
    _unfinished: Unfinished,
    /// Says that somebody is at work on it.
    _hold: Option<fs::File>,
    index: SequenceIndex,
    kind: FrameKind,
}

impl FrameFolder {
    /// Refuses a `target` that [`FrameFolder::create`] would: asked before the work that makes the frames.
    /// Nothing is made.
    ///
    /// # Errors
    /// As [`FrameFolder::create`].
    pub(crate) fn check(target: &Path, kind: FrameKind, overwrite: bool) -> Result<()> {
        check_unused(target, kind, overwrite)?;
        check_can_make(target)
    }

    /// Begins a folder that will be `target`. A `target` that holds anything is refused; with `overwrite`
    /// one that holds the frames of its `sequence.json`, of this `kind`, and nothing else will be replaced.
    ///
    /// # Errors
    /// A `target` that is in use, or cannot be made.
    pub(crate) fn create(target: &Path, kind: FrameKind, overwrite: bool) -> Result<Self> {
        check_unused(target, kind, overwrite)?;
        let folder = folder_of(target);
        fs::create_dir_all(folder)
            .with_context(|| format!("{}: cannot make this folder", folder.display()))?;
        let (prefix, suffix) = affixes(target);
        leftovers::remove(folder, &prefix, suffix);
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix).suffix(suffix);
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        let made = Unfinished::make(|| builder.tempdir_in(folder));
        let (temporary, _unfinished) =
            made.with_context(|| format!("{}: cannot write in this folder", folder.display()))?;
        let hold = leftovers::hold_folder(temporary.path());
        let index = SequenceIndex::default();
        let frames = Self { target: target.to_owned(), temporary, _unfinished, _hold: hold, index, kind };
        // Until all frames are there, the index says that some are missing.
        frames.write_index()?;
        Ok(frames)
    }

    /// Adds a frame: a file of this name, which no other has.
    ///
    /// # Errors
    /// A name that is taken; what the system says, with the path.
    pub(crate) fn add(&mut self, name: String, bytes: &[u8]) -> Result<()> {
        if self.temporary.path().join(&name).exists() {
            bail!(
                "{}: holds a file called {name} already; each needs a name of its own",
                self.target.display()
            );
        }
        self.put(&name, bytes)?;
        self.index.files.push(name);
        Ok(())
    }

    /// Says of pictures, for people, which cameras they are rendered from.
    pub(crate) fn name_cameras(&mut self, description: String) {
        self.index.cameras = Some(description);
    }

    /// Says of scenes how fast they play, and whether row `i` of each frame is row `i` of the next.
    pub(crate) fn name_clip(&mut self, frames_per_second: f64, identity_stored: bool) {
        (self.index.frames_per_second, self.index.identity_stored) =
            (Some(frames_per_second), identity_stored);
    }

    /// Gives the folder its name, and says how many frames it holds.
    ///
    /// # Errors
    /// What the system says, with the path; what was there before then stays.
    pub(crate) fn finish(mut self, overwrite: bool) -> Result<usize> {
        let failed = || format!("{}: cannot write", self.target.display());
        self.index.frames = self.index.files.len();
        self.index.complete = true;
        self.write_index()?;
        sync_folder(self.temporary.path()).with_context(failed)?;
        check_unused(&self.target, self.kind, overwrite)?;
        let folder = folder_of(&self.target);
        // Between its old frames and its new ones the folder would have none.
        let _uninterrupted = leftovers::uninterrupted();
        let replaced = if self.target.exists() {
            let aside = tempfile::Builder::new().prefix(&affixes(&self.target).0).tempdir_in(folder);
            let aside = aside.with_context(failed)?;
            fs::rename(&self.target, aside.path().join("replaced")).with_context(failed)?;
            Some(aside)
        } else {
            None
        };
        if let Err(error) = fs::rename(self.temporary.path(), &self.target) {
            put_back(replaced, &self.target)?;
            return Err(error).with_context(failed);
        }
        sync_folder(folder).with_context(failed)?;
        Ok(self.index.frames)
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<()> {
        let path = self.temporary.path().join(name);
        let put = || -> io::Result<()> {
            // A folder is not removed while a file is added: it would stay for that.
            let uninterrupted = leftovers::uninterrupted();
            let mut file = fs::File::create(&path)?;
            drop(uninterrupted);
            file.write_all(bytes)?;
            file.sync_all()
        };
        put().with_context(|| format!("{}: cannot write {name}", self.target.display()))
    }

    fn write_index(&self) -> Result<()> {
        self.put(SEQUENCE_INDEX, &serde_json::to_vec_pretty(&self.index)?)
    }
}

/// Gives what was moved into `aside` its name again.
///
/// # Errors
/// Where it is, if that fails.
fn put_back(aside: Option<TempDir>, target: &Path) -> Result<()> {
    let Some(aside) = aside else { return Ok(()) };
    let moved = aside.path().join("replaced");
    fs::rename(&moved, target).map_err(|error| {
        let _ = aside.keep();
        anyhow::anyhow!(
            "{}: cannot write: {error}; what it held before is in {}",
            target.display(),
            moved.display()
        )
    })
}

/// Refuses a folder that holds anything, unless it is to be overwritten and holds only its frames.
fn check_unused(folder: &Path, kind: FrameKind, overwrite: bool) -> Result<()> {
    if folder == Path::new("-") {
        bail!("-: standard output is no folder; name one (./- is one)");
    }
    let entries = match fs::read_dir(folder) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(()),
        Err(e) => {
            return Err(e).with_context(|| format!("{}: not a folder to write frames to", folder.display()));
        }
        Ok(entries) => entries,
    };
    let names: io::Result<Vec<String>> =
        entries.map(|entry| entry.map(|e| e.file_name().to_string_lossy().into_owned())).collect();
    let names = names.with_context(|| format!("{}: cannot read", folder.display()))?;
    if names.is_empty() {
        return Ok(());
    }
    if !overwrite {
        bail!(
            "{}: holds {} files already; name another folder, or replace the frames in it with --overwrite",
            folder.display(),
            names.len()
        );
    }
    let index = fs::read(folder.join(SEQUENCE_INDEX)).unwrap_or_default();
    let index: SequenceIndex = serde_json::from_slice(&index).unwrap_or_default();
    if let Some(other) = index.files.iter().find(|name| FrameKind::of(name) != kind) {
        let ([found, _], [_, replaced]) = (FrameKind::of(other).names(), kind.names());
        bail!(
            "{}: holds {other}, which is {found}; --overwrite replaces {replaced} alone: name another folder",
            folder.display()
        );
    }
    match names.iter().find(|name| *name != SEQUENCE_INDEX && !index.files.contains(name)) {
        None => Ok(()),
        Some(other) => bail!(
            "{}: holds {other}, which is no frame of its {SEQUENCE_INDEX}; only a folder of frames alone is \
             replaced",
            folder.display()
        ),
    }
}
