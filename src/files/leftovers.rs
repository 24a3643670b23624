//! A leftover is a temporary file or folder whose process was killed: whoever next writes there removes it.
//!
//! Who writes under a temporary name locks it, and the system unlocks what a killed process had locked: what
//! has such a name, is not locked and is not brand-new is nobody's. Where locks or folders that can be opened
//! are missing, leftovers stay. A process that a person interrupts leaves none: it knows what it has not
//! finished.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File},
    io,
    path::{Path, PathBuf},
    process::{Child, ChildStdin, Command, ExitStatus},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

/// Age from which a name counts as left over: longer than its process takes from making to locking it.
const SETTLED: Duration = Duration::from_secs(2);
/// Random letters and digits between the ends of a temporary name.
const RANDOM: usize = 6;

/// What this process has under temporary names now. Whoever makes such a name holds this meanwhile, so that
/// [`remove_unfinished`] finds it.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // Names go in and out whole, whoever panics.
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A temporary name that is in use as long as this lives.
#[derive(Debug)]
pub(super) struct Unfinished(PathBuf);

impl Unfinished {
    /// What `make` makes under a temporary name, and that name's use.
    ///
    /// # Errors
    /// Those of `make`.
    pub(super) fn make<T: AsRef<Path>>(make: impl FnOnce() -> io::Result<T>) -> io::Result<(T, Self)> {
        let mut unfinished = unfinished();
        let made = make()?;
        let path = made.as_ref().to_owned();
        unfinished.insert(path.clone());
        Ok((made, Self(path)))
    }
}

/// As long as this lives nobody interrupts the process; once somebody has, whoever asks for it waits for the
/// end of the process. For steps of which no half may stay.
pub(super) fn uninterrupted() -> MutexGuard<'static, impl Sized> {
    unfinished()
}

impl Drop for Unfinished {
    fn drop(&mut self) {
        unfinished().remove(&self.0);
    }
}

/// Programs that write under temporary names of this process, by their numbers.
static WRITERS: Mutex<BTreeMap<u32, Child>> = Mutex::new(BTreeMap::new());

fn writers() -> MutexGuard<'static, BTreeMap<u32, Child>> {
    WRITERS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A program that writes under a temporary name of this process. It is ended where this is dropped before its
/// end, so that nothing is written to what is then removed, nor under its name again.
#[derive(Debug)]
pub(crate) struct Writer(u32);

impl Writer {
    /// Starts `command`; with it the pipe to its standard input, where there is one.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn start(command: &mut Command) -> io::Result<(Self, Option<ChildStdin>)> {
        // Held from before its start: a process that is ended meanwhile ends it, too.
        let mut writers = writers();
        let mut child = command.spawn()?;
        let (id, pipe) = (child.id(), child.stdin.take());
        writers.insert(id, child);
        Ok((Self(id), pipe))
    }

    /// How it has ended; `None` while it runs. Whoever asks while the process is being ended waits for that.
    ///
    /// # Errors
    /// What the system says.
    pub(crate) fn ended(&self) -> io::Result<Option<ExitStatus>> {
        writers().get_mut(&self.0).map_or(Ok(None), Child::try_wait)
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        if let Some(mut child) = writers().remove(&self.0) {
            end(&mut child);
        }
    }
}

fn end(child: &mut Child) {
    // One that has ended by itself is as good.
    let _ = child.kill().and_then(|()| child.wait());
}

/// Removes what this process has under temporary names, and ends the programs that write there. For the last
/// moment of a process: who then makes or gives up a temporary name waits for its end.
pub(crate) fn remove_unfinished() {
    let mut writers = writers();
    writers.values_mut().for_each(end);
    // Held to the end: nobody finds a program ended and takes that for its failure.
    std::mem::forget(writers);
    let unfinished = unfinished();
    for path in unfinished.iter() {
        // What is not there any more was given its name; what cannot be removed, a later write removes.
        let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    }
    std::mem::forget(unfinished);
}

/// Says that this process is at work on `file`, until it is closed.
pub(super) fn hold(file: &File) {
    // Without a lock the file is as whole, and only what is left of it after a kill is not recognised.
    let _ = file.try_lock();
}

/// As [`hold`], for a folder.
pub(super) fn hold_folder(folder: &Path) -> Option<File> {
    let opened = File::open(folder).ok()?;
    hold(&opened);
    Some(opened)
}

/// Removes from `folder` what is left over under temporary names from `prefix` to `suffix`. What cannot be
/// read or removed stays: it harms nobody.
pub(super) fn remove(folder: &Path, prefix: &str, suffix: &str) {
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = entry.file_name();
        let Some(name) = name.to_str() else { continue };
        let random = name.strip_prefix(prefix).and_then(|rest| rest.strip_suffix(suffix));
        let is_temporary = random.is_some_and(|random| {
            random.len() == RANDOM && random.bytes().all(|b| b.is_ascii_alphanumeric())
        });
        if is_temporary {
            remove_unless_used(&entry.path());
        }
    }
}

fn remove_unless_used(path: &Path) {
    let Ok(found) = fs::symlink_metadata(path) else { return };
    let settled = found.modified().ok().and_then(|at| at.elapsed().ok()).is_some_and(|age| age >= SETTLED);
    if !settled || found.is_symlink() {
        return;
    }
    let Ok(opened) = File::open(path) else { return };
    if opened.try_lock().is_err() {
        return;
    }
    let _ = if found.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
}

#[cfg(test)]
mod tests {
    use std::time::SystemTime;

    use super::*;

    /// Makes `path` as old as what a killed process left an hour ago.
    fn age(path: &Path) {
        let then = SystemTime::now() - Duration::from_secs(3600);
        File::open(path).unwrap().set_modified(then).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn a_program_that_is_not_waited_for_is_ended() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("late");
        let started = |script: &str| {
            let mut shell = Command::new("sh");
            shell.args(["-c", script, "sh"]).arg(&path).stdin(std::process::Stdio::piped());
            Writer::start(&mut shell).unwrap()
        };
        // As ffmpeg does, it writes once there is no more to read.
        let (writer, pipe) = started("read line; echo late > \"$1\"");
        assert_eq!(writer.ended().unwrap(), None);
        drop(writer);
        drop(pipe);
        std::thread::sleep(Duration::from_millis(200));
        assert!(!path.exists());
        let (writer, pipe) = started("read line; echo late > \"$1\"");
        drop(pipe);
        while writer.ended().unwrap().is_none() {
            std::thread::sleep(Duration::from_millis(5));
        }
        assert!(path.exists());
    }

    #[cfg(unix)]
    #[test]
    fn what_nobody_writes_is_removed_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let [left, used, young, other, target] =
            [".a.dgs.Ab3xY9.part", ".a.dgs.used12.part", ".a.dgs.young1.part", ".b.dgs.Ab3xY9.part", "a.dgs"];
        let [notes, linked] = [".a.dgs.notes.part", ".a.dgs.linked.part"];
        for name in [left, used, young, other, target, notes] {
            fs::write(at(name), name).unwrap();
        }
        let frames = at(".a.dgs.frames.part");
        fs::create_dir(&frames).unwrap();
        fs::write(frames.join("f_0.ply"), "half").unwrap();
        std::os::unix::fs::symlink(at(target), at(linked)).unwrap();
        [left, used, other, target, notes].iter().for_each(|name| age(&at(name)));
        age(&frames);
        let user = File::open(at(used)).unwrap();
        hold(&user);
        remove(folder.path(), ".a.dgs.", ".part");
        assert!(!at(left).exists() && !frames.exists(), "nobody's");
        for name in [used, young, other, target, notes, linked] {
            assert!(fs::symlink_metadata(at(name)).is_ok(), "{name}");
        }
        // Its process was killed: the system lets go of the lock.
        drop(user);
        remove(folder.path(), ".a.dgs.", ".part");
        assert!(!at(used).exists());
    }

    #[cfg(unix)]
    #[test]
    fn a_later_write_removes_what_an_earlier_one_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dgs");
        let left = super::super::temporary(&path).unwrap().0.keep().unwrap().1;
        age(&left);
        super::super::write(&path, b"whole").unwrap();
        let names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        assert_eq!(names, ["a.dgs"]);
    }
}
