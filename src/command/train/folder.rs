//! Names the files of a training, and opens the folder they are in.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::{args::train::Train, files, pipeline};

/// Files in the folder of a training.
pub(super) struct Folder {
    pub(super) checkpoint: PathBuf,
    pub(super) stream: PathBuf,
    /// Where `dgs stream` finds the utilities of `stream`.
    pub(super) utility: PathBuf,
    /// The epochs of a training in parts.
    pub(super) epochs: PathBuf,
    pub(super) log: PathBuf,
    pub(super) preview: PathBuf,
    pub(super) report: PathBuf,
    /// What was fixed before fine-tuning for delivery.
    pub(super) registration: PathBuf,
    /// What came of it.
    pub(super) delivery: PathBuf,
}

impl Folder {
    pub(super) fn of(out: &Path) -> Self {
        let file = |name: &str| out.join(name);
        Self {
            checkpoint: file("checkpoint.dgst"),
            utility: pipeline::utility_path(&file("scene.dgs")),
            stream: file("scene.dgs"),
            epochs: file("epochs.json"),
            log: file("log.csv"),
            preview: file("preview.png"),
            report: file("report.html"),
            registration: file("registration.json"),
            delivery: file("delivery.json"),
        }
    }

    /// Makes the folder, or refuses one that is in use.
    pub(super) fn open(&self, args: &Train) -> Result<()> {
        let out = &args.out;
        std::fs::create_dir_all(out)
            .with_context(|| format!("{}: cannot make this folder", out.display()))?;
        if args.resume && !self.checkpoint.is_file() && !self.epochs.is_file() {
            bail!("{}: no such checkpoint; train without --resume first", self.checkpoint.display());
        }
        let used = self.checkpoint.exists() || self.stream.exists() || self.epochs.exists();
        if !args.resume && !args.overwrite && used {
            bail!("{}: holds a training; --resume goes on with it, --overwrite replaces it", out.display());
        }
        let Self { checkpoint, stream, utility, epochs, log, preview, report, registration, delivery } = self;
        for path in [checkpoint, stream, utility, epochs, log, preview, report, registration, delivery] {
            files::check(path)?;
        }
        if !args.resume && epochs.exists() {
            // Another training would go on with them.
            std::fs::remove_file(epochs).with_context(|| epochs.display().to_string())?;
        }
        Ok(())
    }
}
