//! Appends lines to a file while something goes on that may end at any moment.

use std::{
    fs::File,
    io::Write,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use serde::Serialize;

use crate::output;

/// A file of JSON lines: each is there, whole, as soon as it is added, whatever becomes of this process.
#[derive(Debug)]
pub(crate) struct LineLog {
    path: PathBuf,
    /// `None` once a line could not be written.
    file: Option<File>,
}

impl LineLog {
    /// The log at `path`, after what is there already.
    ///
    /// # Errors
    /// A folder, or what the system says.
    pub(crate) fn open(path: &Path) -> Result<Self> {
        if path.is_dir() {
            bail!("--log {}: is a folder; a file is needed", path.display());
        }
        let file = File::options().append(true).create(true).open(path);
        let file = file.with_context(|| format!("--log {}: cannot write", path.display()))?;
        Ok(Self { path: path.to_owned(), file: Some(file) })
    }

    /// Adds `row`. Where that fails, a warning says so once, and nothing more is added: what is logged goes
    /// on.
    pub(crate) fn add(&mut self, row: &impl Serialize) {
        let Some(file) = &mut self.file else { return };
        let line = serde_json::to_string(row).map_err(std::io::Error::other);
        // One call, so that a line is there whole or not at all.
        let written = line.and_then(|line| file.write_all(format!("{line}\n").as_bytes()));
        if let Err(error) = written {
            let path = self.path.display();
            output::print_status(&format!("warning: --log {path}: {error}; nothing more is logged"));
            self.file = None;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_are_there_at_once_and_after_those_of_before() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("session.jsonl");
        let text = || std::fs::read_to_string(&path).unwrap();
        let mut log = LineLog::open(&path).unwrap();
        log.add(&[1, 2]);
        assert_eq!(text(), "[1,2]\n");
        log.add(&"a\nb");
        LineLog::open(&path).unwrap().add(&3);
        assert_eq!(text(), "[1,2]\n\"a\\nb\"\n3\n");
        let error = LineLog::open(folder.path()).unwrap_err().to_string();
        assert!(error.ends_with("is a folder; a file is needed"), "{error}");
        let error = format!("{:#}", LineLog::open(&folder.path().join("none/x")).unwrap_err());
        assert!(error.contains("--log ") && error.contains("none/x"), "{error}");
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_ends_the_log_and_nothing_else() {
        let mut log = LineLog::open(Path::new("/dev/full")).unwrap();
        log.add(&1);
        assert!(log.file.is_none());
        log.add(&2);
    }
}
