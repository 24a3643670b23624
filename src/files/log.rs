//! Appends lines to a file while something goes on that may end at any moment.

use std::{
    fs::File,
    io::{Read, Seek, SeekFrom, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use serde::Serialize;

use crate::output;

/// A file of JSON lines: each is there as soon as it is added, whatever becomes of this process.
#[derive(Debug)]
pub(crate) struct LineLog {
    path: PathBuf,
    /// `None` once a line could not be written.
    file: Option<File>,
}

impl LineLog {
    /// The log at `path`, after the lines that are there already.
    ///
    /// # Errors
    /// A folder, a file that holds something else than lines with the value `key`, or what the system says.
    pub(crate) fn open(path: &Path, key: &str) -> Result<Self> {
        let shown = path.display();
        if path.is_dir() {
            bail!("--log {shown}: is a folder; a file is needed");
        }
        let ends = ends(path).with_context(|| format!("--log {shown}: cannot read"))?;
        if ends.is_some() && !begins_with_row(path, key)? {
            bail!(
                "--log {shown}: holds something else than lines of JSON with a value {key:?}; another file \
                 is needed"
            );
        }
        let file = File::options().append(true).create(true).open(path);
        let mut file = file.with_context(|| format!("--log {shown}: cannot write"))?;
        // A line that a full disk has cut keeps to itself.
        if ends.is_some_and(|[_, last]| last != b'\n') {
            file.write_all(b"\n").with_context(|| format!("--log {shown}: cannot write"))?;
        }
        Ok(Self { path: path.to_owned(), file: Some(file) })
    }

    /// Adds `row`. Where that fails, a warning says so once, and nothing more is added: what is logged goes
    /// on.
    pub(crate) fn add(&mut self, row: &impl Serialize) {
        let Some(file) = &mut self.file else { return };
        let line = serde_json::to_string(row).map_err(std::io::Error::other);
        // One call, so that a process that is killed leaves no part of a line.
        let written = line.and_then(|line| file.write_all(format!("{line}\n").as_bytes()));
        if let Err(error) = written {
            let path = self.path.display();
            output::print_status(&format!("warning: --log {path}: {error}; nothing more is logged"));
            self.file = None;
        }
    }
}

/// Whether the first line of the file at `path` is one that a log has, or the beginning of one, which a full
/// disk has cut.
fn begins_with_row(path: &Path, key: &str) -> Result<bool> {
    let (start, mut found) = (format!("{{\"{key}\":"), Vec::new());
    let file = File::open(path).with_context(|| format!("--log {}: cannot read", path.display()))?;
    file.take(start.len() as u64).read_to_end(&mut found)?;
    Ok(start.as_bytes().starts_with(&found))
}

/// The first and the last byte of the file at `path`; `None` where there is no file, or nothing in it.
pub(super) fn ends(path: &Path) -> std::io::Result<Option<[u8; 2]>> {
    // What is no file, as a terminal or a pipe, has nothing to keep.
    if !path.is_file() || path.metadata()?.len() == 0 {
        return Ok(None);
    }
    let mut file = File::open(path)?;
    let mut ends = [0; 2];
    let [first, last] = &mut ends;
    file.read_exact(std::slice::from_mut(first))?;
    file.seek(SeekFrom::End(-1))?;
    file.read_exact(std::slice::from_mut(last))?;
    Ok(Some(ends))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_there_at_once_and_after_those_of_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.jsonl");
        let text = || std::fs::read_to_string(&path).unwrap();
        let mut log = LineLog::open(&path, "row").unwrap();
        let row = |value: &str| serde_json::json!({ "row": value });
        log.add(&row("1"));
        assert_eq!(text(), "{\"row\":\"1\"}\n");
        log.add(&row("a\nb"));
        LineLog::open(&path, "row").unwrap().add(&row("3"));
        assert_eq!(text(), "{\"row\":\"1\"}\n{\"row\":\"a\\nb\"}\n{\"row\":\"3\"}\n");
        std::fs::write(&path, "{\"row\":").unwrap();
        LineLog::open(&path, "row").unwrap().add(&row("4"));
        assert_eq!(text(), "{\"row\":\n{\"row\":\"4\"}\n", "what was cut keeps to itself");
        let error = LineLog::open(folder.path(), "row").unwrap_err().to_string();
        assert!(error.ends_with("is a folder; a file is needed"), "{error}");
        let error = format!("{:#}", LineLog::open(&folder.path().join("none/x"), "row").unwrap_err());
        assert!(error.contains("--log ") && error.contains("none/x"), "{error}");
    }

    #[test]
    fn what_is_no_log_is_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dgs");
        std::fs::write(&path, b"DGSM\x01").unwrap();
        let error = LineLog::open(&path, "row").unwrap_err().to_string();
        assert!(error.contains("a.dgs: holds something else than lines of JSON"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), b"DGSM\x01");
        // Other JSON is no log either, on one line or on many.
        for other in ["{\n  \"asset\": {}\n}\n", "{\"measured\":{},\"row\":1}"] {
            std::fs::write(&path, other).unwrap();
            assert!(LineLog::open(&path, "row").is_err(), "{other}");
        }
        std::fs::write(&path, "").unwrap();
        LineLog::open(&path, "row").unwrap().add(&1);
        assert_eq!(std::fs::read(&path).unwrap(), b"1\n", "an empty file is none of anybody's");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_ends_the_log_and_nothing_else() {
        let mut log = LineLog::open(Path::new("/dev/full"), "row").unwrap();
        log.add(&1);
        assert!(log.file.is_none());
        log.add(&2);
    }
}
