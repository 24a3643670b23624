//! Says which trace files results are of: a digest of each, beside the results.
//!
//! A configuration names its trace files and does not hold them. A file that has changed since gives other
//! simulations under the same configuration, so their contents are compared too.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use codec_core::internals::digest::Digest;
use emulator_host::trace;

use crate::files;

const FILE: &str = "traces.txt";

/// A digest of each trace file by its name in the configuration.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Digests(BTreeMap<String, String>);

impl Digests {
    /// The file of the digests of the results in `folder`.
    pub(super) fn path(folder: &Path) -> PathBuf {
        folder.join(FILE)
    }

    /// The digests of the results in `folder`; `None` where there are none.
    ///
    /// # Errors
    /// A file that cannot be read, or a line that is no digest and name.
    pub(super) fn read(folder: &Path) -> Result<Option<Self>> {
        let path = Self::path(folder);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(error).with_context(|| path.display().to_string()),
        };
        let mut digests = BTreeMap::new();
        for (number, line) in (1..).zip(text.lines()) {
            let (digest, name) = line.split_once("  ").with_context(|| {
                format!("{}: line {number} is {line:?}, allowed is DIGEST  NAME", path.display())
            })?;
            digests.insert(name.to_owned(), digest.to_owned());
        }
        Ok(Some(Self(digests)))
    }

    /// Writes them into `folder`.
    ///
    /// # Errors
    /// What the system says, with the path.
    pub(super) fn write(&self, folder: &Path) -> Result<()> {
        let lines: String = self.0.iter().map(|(name, digest)| format!("{digest}  {name}\n")).collect();
        files::write(&Self::path(folder), lines.as_bytes())
    }

    /// Adds the file that the configuration calls `name` and that lies at `path`.
    ///
    /// # Errors
    /// What the system says, with the path.
    pub(super) fn enter(&mut self, name: &str, path: &Path) -> Result<()> {
        if self.0.contains_key(name) {
            return Ok(());
        }
        let bytes =
            trace::read(path, &trace::Limits::default()).with_context(|| path.display().to_string())?;
        let digest = Digest::new().bytes(&bytes).get();
        self.0.insert(name.to_owned(), format!("{digest:016x}-{}", bytes.len()));
        Ok(())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// A file whose content differs from that in `other`, or that only one of both has.
    pub(super) fn difference<'a>(&'a self, other: &'a Self) -> Option<&'a str> {
        let mut names = self.0.keys().chain(other.0.keys());
        names.find(|name| self.0.get(*name) != other.0.get(*name)).map(String::as_str)
    }
}
