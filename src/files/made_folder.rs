//! Makes a folder for what is to come, which goes again where nothing came.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};

use super::{check_folder, frames::check_can_make, or_here};

/// A folder that holds what is written into it; at the end of this it goes, with those that were made for it,
/// if that is nothing.
#[derive(Debug)]
pub(crate) struct MadeFolder {
    /// What was not there, the innermost first.
    made: Vec<PathBuf>,
}

impl MadeFolder {
    /// Refuses a `folder` that is not there and cannot be made: asked before the work. Nothing is made.
    ///
    /// # Errors
    /// A file where a folder is needed, or a folder that cannot be written to.
    pub(crate) fn check(folder: &Path) -> Result<()> {
        if folder.exists() {
            return check_folder(folder);
        }
        check_can_make(folder).with_context(|| format!("{}: cannot make", folder.display()))
    }

    /// Makes `folder`, if it is not there, and those that it lies in.
    ///
    /// # Errors
    /// What the system says, with the path.
    pub(crate) fn make(folder: &Path) -> Result<Self> {
        let missing = folder.ancestors().take_while(|folder| !or_here(folder).exists());
        let made = Self { made: missing.map(Path::to_owned).collect() };
        fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        Ok(made)
    }
}

impl Drop for MadeFolder {
    fn drop(&mut self) {
        for folder in &self.made {
            // The system removes no folder that holds anything.
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_made_for_nothing_goes_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let (outer, inner) = (folder.path().join("outer"), folder.path().join("outer/inner"));
        drop(MadeFolder::make(&inner).unwrap());
        assert!(!outer.exists() && folder.path().exists());
        fs::create_dir(&outer).unwrap();
        drop(MadeFolder::make(&inner).unwrap());
        assert!(!inner.exists() && outer.exists(), "one that was there stays");
        let made = MadeFolder::make(&inner).unwrap();
        fs::write(inner.join("file"), b"x").unwrap();
        drop(made);
        assert!(inner.join("file").exists());
        let error = format!("{:#}", MadeFolder::check(&inner.join("file/report")).unwrap_err());
        assert!(error.contains("file/report: cannot make: ") && error.contains("is a file"), "{error}");
        let error = MadeFolder::check(&inner.join("file")).unwrap_err().to_string();
        assert!(error.ends_with("file: is a file; a folder is needed"), "{error}");
        MadeFolder::check(&folder.path().join("new/report")).unwrap();
        assert!(!folder.path().join("new").exists(), "asking makes nothing");
    }
}
