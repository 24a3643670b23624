//! Writes files whole or not at all.
//!
//! A file is written under a temporary name in the folder that it will be in, synced, and then given its
//! name: whoever opens it finds what was there before or all of what is new, also after a full disk or a
//! killed process. A folder of frames is treated likewise, and says in its `sequence.json` that it is whole.
//! What a killed process left under a temporary name, whoever next writes there removes; a process that a
//! person interrupts removes it itself.

mod frames;
mod leftovers;
mod log;
mod made_folder;

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use tempfile::NamedTempFile;

use self::leftovers::Unfinished;
pub(crate) use self::{
    frames::{FrameFolder, FrameKind},
    leftovers::{Writer, remove_unfinished},
    log::LineLog,
    made_folder::MadeFolder,
};
use crate::output;

/// `path` for people and for JSON, which holds no other text than Unicode: what is none is shown as
/// `\u{fffd}`.
pub(crate) fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// Whether `path` is standard output: `-`, or what the system calls it.
pub(crate) fn is_standard_output(path: &Path) -> bool {
    ["-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"].iter().any(|name| path == Path::new(name))
}

/// Refuses a name that [`write()`] could not write: asked before the work that makes the bytes.
///
/// # Errors
/// The name of a folder, or a file in a folder that is not there or cannot be written to.
pub fn check(path: &Path) -> Result<()> {
    if path == Path::new("-") {
        bail!("-: is not written to standard output; name a file (./- is one)");
    }
    match fs::metadata(path) {
        Ok(found) if found.is_dir() => bail!("{}: is a folder; a file is needed", path.display()),
        // A device or a pipe is written to as it is.
        Ok(found) if !found.is_file() => return Ok(()),
        // It would be replaced by another of its name: what a person has write-protected stays.
        Ok(_) => drop(
            fs::OpenOptions::new()
                .write(true)
                .open(path)
                .with_context(|| format!("{}: cannot be written", path.display()))?,
        ),
        _ if path.as_os_str().as_encoded_bytes().ends_with(b"/") => {
            bail!("{}: names a folder; a file is needed", path.display())
        }
        _ => {}
    }
    temporary(path).map(drop)
}

/// As [`check`], for JSON: a file that holds something else is not replaced by it.
///
/// # Errors
/// As [`check`]; a file that begins like no JSON.
pub(crate) fn check_json(path: &Path) -> Result<()> {
    check(path)?;
    let ends = log::ends(path).with_context(|| format!("{}: cannot read", path.display()))?;
    if ends.is_some_and(|[first, _]| !b"{[".contains(&first)) {
        bail!("{}: is there, and no JSON, which is written here; name another file", path.display());
    }
    Ok(())
}

/// As [`check`], for a stream, which may go to standard output: its name ends in `.dgs`, and it is none of
/// `others`, which are read or written besides.
///
/// # Errors
/// As [`check`]; another ending; a file that is one of `others`.
pub(crate) fn check_stream(path: &Path, others: &[&Path]) -> Result<()> {
    if is_standard_output(path) {
        return Ok(());
    }
    check(path)?;
    // A device or a pipe is called what it is called.
    let is_device = fs::metadata(path).is_ok_and(|found| !found.is_file());
    if !is_device && path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("dgs")) {
        bail!("{}: a stream is written here; the ending .dgs is allowed", path.display());
    }
    check_apart(path, others)
}

/// Refuses a name with a number in it as other tools count files by, `f_%03d.png`: one file would get it.
pub(crate) fn check_no_pattern(path: &Path) -> Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    // Not the escapes of addresses, which have two digits: `my%20dog.png`.
    let counts = |rest: &str| {
        let after = rest.trim_start_matches(|c: char| c.is_ascii_digit());
        after.starts_with('d') && (rest.starts_with('0') || rest.len() - after.len() < 2)
    };
    if name.split('%').skip(1).any(counts) && !path.exists() {
        bail!("{}: is one file; for one per frame name a folder, without an ending", path.display());
    }
    Ok(())
}

/// Refuses a name that is one of `endings` (with their dots) and nothing else, such as `.ply`: it is meant as
/// an ending, and would be a folder's name.
pub(crate) fn check_no_bare_ending<'e>(
    path: &Path,
    endings: impl IntoIterator<Item = &'e str>,
) -> Result<()> {
    let Some(name) = path.file_name().filter(|_| !path.is_dir()) else { return Ok(()) };
    match endings.into_iter().find(|ending| name.eq_ignore_ascii_case(ending)) {
        Some(ending) => {
            bail!("{}: is an ending without a name; name{ending} is a file, {name:?} none", path.display())
        }
        None => Ok(()),
    }
}

/// Refuses to write a file that is one of `others`, which are read or written besides, or a folder that one
/// of them is in.
///
/// # Errors
/// That `path` is one of them, or which one is in it.
pub(crate) fn check_apart(path: &Path, others: &[&Path]) -> Result<()> {
    if is_standard_output(path) {
        return Ok(());
    }
    let resolved = without_links(path);
    let is_path = |other: &&&Path| without_links(other) == resolved;
    // A device or a pipe is what it is called.
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        return Ok(());
    }
    if others.iter().any(|other| is_path(&other)) {
        bail!("{}: is read or written besides; name another file", path.display());
    }
    let is_inside = |other: &&&Path| {
        fs::canonicalize(other).is_ok_and(|other| resolved.is_dir() && other.starts_with(&resolved))
    };
    match others.iter().find(is_inside) {
        Some(other) => bail!(
            "{}: holds {}, which is read or written besides; name another folder",
            path.display(),
            other.display()
        ),
        None => Ok(()),
    }
}

/// `path` without links; of a file that is not there yet, what its folder is without them.
fn without_links(path: &Path) -> PathBuf {
    let in_folder = || Some(fs::canonicalize(folder_of(path)).ok()?.join(path.file_name()?));
    fs::canonicalize(path).ok().or_else(in_folder).unwrap_or_else(|| path.to_owned())
}

/// Writes `bytes` as `path`: all of them, or what was there before stays.
///
/// # Errors
/// What the system says, with the path.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    if is_standard_output(path) {
        return output::print_bytes(bytes);
    }
    let failed = || format!("{}: cannot write", path.display());
    if fs::metadata(path).is_ok_and(|found| !found.is_file() && !found.is_dir()) {
        return fs::write(path, bytes).with_context(failed);
    }
    let mut pending = PendingFile::begin(path)?;
    pending.file().write_all(bytes).with_context(failed)?;
    pending.finish()
}

/// Writes `bytes` as `path` and `beside` as the file that it refers to: both, or what was there before stays.
///
/// # Errors
/// What the system says, with the path; a `path` that is a device or a pipe, which has nothing beside it.
pub(crate) fn write_pair(path: &Path, bytes: &[u8], beside: (&Path, &[u8])) -> Result<()> {
    let pending = |path: &Path, bytes: &[u8]| {
        let mut pending = PendingFile::begin(path)?;
        let synced = pending.file().write_all(bytes).and_then(|()| pending.file().sync_all());
        synced.with_context(|| format!("{}: cannot write", path.display()))?;
        Ok::<_, anyhow::Error>(pending)
    };
    let (first, second) = (pending(beside.0, beside.1)?, pending(path, bytes)?);
    let failed = || format!("{}: cannot write", path.display());
    for pending in [&first, &second] {
        keep_permissions(pending.file.as_file(), &pending.target).with_context(failed)?;
    }
    let renamed = {
        // Nobody interrupts between the two. What refers to the other comes last, so that whoever finds it
        // finds both.
        let _uninterrupted = leftovers::uninterrupted();
        fs::rename(first.path(), &first.target).and_then(|()| fs::rename(second.path(), &second.target))
    };
    renamed.and_then(|()| sync_folder(folder_of(&second.target))).with_context(failed)
}

/// Refuses a file that [`write_pair`] would write beside `path`, and that nobody named; asked before the
/// work.
///
/// # Errors
/// As [`check`]; a file that is there without `path`, so that it is of something else, unless `overwrite`; a
/// `path` that is a device or a pipe.
pub(crate) fn check_beside(path: &Path, beside: &Path, overwrite: bool) -> Result<()> {
    if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
        bail!("{}: is no file; a file is needed, as {} goes beside it", path.display(), beside.display());
    }
    check(beside)?;
    if !overwrite && fs::symlink_metadata(path).is_err() && fs::symlink_metadata(beside).is_ok() {
        bail!("{}: is there, and goes beside {}; --overwrite replaces it", beside.display(), path.display());
    }
    Ok(())
}

/// A file on its way: under a temporary name beside its own until [`PendingFile::finish`], and removed if it
/// is never finished.
#[derive(Debug)]
pub struct PendingFile {
    file: NamedTempFile,
    unfinished: Unfinished,
    target: PathBuf,
}

impl PendingFile {
    /// Begins a file that will be `path`.
    ///
    /// # Errors
    /// As [`check`], or a `path` that is a device or a pipe.
    pub fn begin(path: &Path) -> Result<Self> {
        check(path)?;
        if fs::metadata(path).is_ok_and(|found| !found.is_file()) {
            bail!("{}: is no file; a file is needed", path.display());
        }
        // A link stays a link: what it leads to is replaced.
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let (file, unfinished) = temporary(&target)?;
        Ok(Self { file, unfinished, target })
    }

    /// The file under its temporary name, to write to.
    pub fn file(&mut self) -> &mut fs::File {
        self.file.as_file_mut()
    }

    /// The temporary name, for a program that writes to it.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// What the system says, with the path; what was there before then stays.
    pub fn finish(self) -> Result<()> {
        let Self { file, unfinished, target } = self;
        let failed = || format!("{}: cannot write", target.display());
        keep_permissions(file.as_file(), &target).with_context(failed)?;
        file.as_file().sync_all().with_context(failed)?;
        file.persist(&target).map_err(|e| e.error).with_context(failed)?;
        drop(unfinished);
        sync_folder(folder_of(&target)).with_context(failed)
    }
}

/// Gives `file` the permissions of what it will replace, where there is something.
fn keep_permissions(file: &fs::File, target: &Path) -> io::Result<()> {
    fs::metadata(target).map_or(Ok(()), |existing| file.set_permissions(existing.permissions()))
}

/// A temporary file beside `path`.
fn temporary(path: &Path) -> Result<(NamedTempFile, Unfinished)> {
    let folder = folder_of(path);
    check_folder(folder)?;
    let (prefix, suffix) = affixes(path);
    leftovers::remove(folder, &prefix, suffix);
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(suffix);
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let failed = || format!("{}: cannot write in this folder", folder.display());
    let (file, unfinished) = Unfinished::make(|| builder.tempfile_in(folder)).with_context(failed)?;
    leftovers::hold(file.as_file());
    Ok((file, unfinished))
}

/// What temporary names beside `path` start and end with.
fn affixes(path: &Path) -> (String, &'static str) {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    (format!(".{name}."), ".part")
}

/// The folder that `path` is in.
fn folder_of(path: &Path) -> &Path {
    path.parent().map_or(Path::new("."), or_here)
}

/// The folder of this name; the name of the one that a relative path begins in is empty.
fn or_here(folder: &Path) -> &Path {
    if folder.as_os_str().is_empty() { Path::new(".") } else { folder }
}

fn check_folder(folder: &Path) -> Result<()> {
    match fs::metadata(folder) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => {
            bail!("{}: no such folder; make it first", folder.display())
        }
        Err(e) => Err(e).with_context(|| format!("{}: cannot read", folder.display())),
        Ok(found) if !found.is_dir() => bail!("{}: is a file; a folder is needed", folder.display()),
        Ok(_) => Ok(()),
    }
}

/// Makes the names in `folder` last.
fn sync_folder(folder: &Path) -> io::Result<()> {
    // Elsewhere folders cannot be opened, and renaming is left to the system.
    if cfg!(unix) { fs::File::open(folder)?.sync_all() } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use trainer_host::import::{SEQUENCE_INDEX, SequenceIndex};

    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    fn frames(target: &Path, overwrite: bool, texts: &[&str]) -> Result<usize> {
        let mut folder = FrameFolder::create(target, FrameKind::Scene, overwrite)?;
        for (i, text) in texts.iter().enumerate() {
            folder.add(format!("f_{i}.ply"), text.as_bytes())?;
        }
        folder.finish(overwrite)
    }

    #[test]
    fn frames_are_replaced_by_their_like_alone() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("clip");
        frames(&target, false, &["a"]).unwrap();
        let error = FrameFolder::check(&target, FrameKind::Pictures, true).unwrap_err().to_string();
        assert!(
            error.contains("holds f_0.ply, which is a frame of a scene; --overwrite replaces pictures alone"),
            "{error}"
        );
        assert!(FrameFolder::create(&target, FrameKind::Pictures, true).is_err());
        FrameFolder::check(&target, FrameKind::Scene, true).unwrap();
    }

    #[test]
    fn json_replaces_json_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        check_json(&path).unwrap();
        for (text, is_json) in [("", true), ("{\"a\": 1}", true), ("[]", true), ("ply\n", false)] {
            fs::write(&path, text).unwrap();
            assert_eq!(check_json(&path).is_ok(), is_json, "{text}");
            assert_eq!(fs::read_to_string(&path).unwrap(), text, "asking changes nothing");
        }
    }

    #[test]
    fn a_file_is_replaced_and_nothing_is_left_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dgs");
        check(&path).unwrap();
        assert!(names(folder.path()).is_empty(), "asking leaves nothing");
        write(&path, b"one").unwrap();
        write(&path, b"two").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"two");
        assert_eq!(names(folder.path()), ["a.dgs"]);
    }

    #[test]
    fn names_that_cannot_be_written_are_refused_beforehand() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("file"), b"x").unwrap();
        for (name, says) in
            [("", "is a folder"), ("nowhere/a.dgs", "nowhere: no such folder"), ("file/a.dgs", "file")]
        {
            let path = folder.path().join(name);
            let error = format!("{:#}", check(&path).unwrap_err());
            assert!(error.contains(says), "{error}");
            assert!(write(&path, b"x").is_err(), "{name}");
        }
    }

    #[test]
    fn of_two_files_neither_is_half_written() {
        let folder = tempfile::tempdir().unwrap();
        let (path, beside) = (folder.path().join("a.gltf"), folder.path().join("a.bin"));
        check_beside(&path, &beside, false).unwrap();
        write_pair(&path, b"text", (&beside, b"data")).unwrap();
        assert_eq!((fs::read(&path).unwrap(), fs::read(&beside).unwrap()), (b"text".into(), b"data".into()));
        // The two of an earlier run are replaced as one file would be; a file of another name's is not.
        check_beside(&path, &beside, false).unwrap();
        let another = folder.path().join("another.gltf");
        let error = check_beside(&another, &beside, false).unwrap_err().to_string();
        assert!(error.contains("a.bin: is there") && error.contains("--overwrite"), "{error}");
        check_beside(&another, &beside, true).unwrap();
        write_pair(&path, b"TEXT", (&beside, b"DATA")).unwrap();
        assert_eq!(fs::read(&beside).unwrap(), b"DATA");
        // A name that cannot be written leaves the other as it was.
        assert!(write_pair(folder.path(), b"x", (&beside, b"x")).is_err());
        assert_eq!(fs::read(&beside).unwrap(), b"DATA");
        assert_eq!(names(folder.path()), ["a.bin", "a.gltf"]);
    }

    #[cfg(unix)]
    #[test]
    fn modes_and_links_stay() {
        use std::os::unix::fs::{PermissionsExt, symlink};
        let folder = tempfile::tempdir().unwrap();
        let (path, link, plain) =
            (folder.path().join("a"), folder.path().join("link"), folder.path().join("plain"));
        fs::write(&path, b"old").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).unwrap();
        symlink("a", &link).unwrap();
        write(&link, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
        assert_eq!(mode(&path), 0o640);
        // A new file is as readable as any other new file.
        fs::write(&plain, b"x").unwrap();
        write(&folder.path().join("b"), b"x").unwrap();
        assert_eq!(mode(&folder.path().join("b")), mode(&plain));
        // A device is written to, never replaced.
        check(Path::new("/dev/null")).unwrap();
        write(Path::new("/dev/null"), b"gone").unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());
    }

    #[test]
    fn a_folder_of_frames_appears_whole() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("new/frames");
        let mut half = FrameFolder::create(&target, FrameKind::Scene, false).unwrap();
        half.add("f_0.ply".into(), b"zero").unwrap();
        assert!(!target.exists(), "not before it is finished");
        drop(half);
        assert!(names(&folder.path().join("new")).is_empty(), "a half made folder is removed");
        assert_eq!(frames(&target, false, &["zero", "one"]).unwrap(), 2);
        assert_eq!(names(&target), ["f_0.ply", "f_1.ply", SEQUENCE_INDEX]);
        let index: SequenceIndex =
            serde_json::from_slice(&fs::read(target.join(SEQUENCE_INDEX)).unwrap()).unwrap();
        assert!(index.complete && index.frames == 2 && index.files == ["f_0.ply", "f_1.ply"]);
    }

    #[test]
    fn a_used_folder_is_refused_or_replaced_whole() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("frames");
        frames(&target, false, &["a", "b", "c"]).unwrap();
        let error = frames(&target, false, &["d"]).unwrap_err().to_string();
        assert!(error.contains("holds 4 files") && error.contains("--overwrite"), "{error}");
        frames(&target, true, &["d"]).unwrap();
        assert_eq!(names(&target), ["f_0.ply", SEQUENCE_INDEX], "no frame of before is left");
        assert_eq!(names(folder.path()), ["frames"]);
        // What is not ours is never removed.
        fs::write(target.join("notes.txt"), b"mine").unwrap();
        let error = frames(&target, true, &["e"]).unwrap_err().to_string();
        assert!(error.contains("notes.txt"), "{error}");
        assert_eq!(fs::read(target.join("f_0.ply")).unwrap(), b"d");
    }
}
