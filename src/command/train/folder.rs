//! Names the files of a training, and opens the folder they are in.

use std::{
    collections::BTreeMap,
    fs::{DirEntry, File, TryLockError},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};

use crate::{args::train::Train, files, pipeline};

/// The file of options of the encoder, which is there before the first step.
const ENCODER: &str = "encoder.json";

/// The folder of a training that is under way.
pub(super) struct Opened {
    /// Where it is, if it was made for this training.
    made: Option<PathBuf>,
    /// Keeps others out.
    _lock: Option<File>,
}

impl Drop for Opened {
    fn drop(&mut self) {
        self.remove_bare();
    }
}

impl Opened {
    /// Removes a folder that was made for nothing.
    pub(super) fn remove_bare(&self) {
        let Some(out) = &self.made else { return };
        let is_bare =
            |entry: std::io::Result<DirEntry>| entry.is_ok_and(|entry| entry.file_name() == ENCODER);
        if std::fs::read_dir(out).is_ok_and(|mut entries| entries.all(is_bare)) {
            // What cannot be removed stays: why the training ended is what matters.
            let _ = std::fs::remove_file(out.join(ENCODER));
            let _ = std::fs::remove_dir(out);
        }
    }
}

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
    /// Options of the encoder that `stream` is made with.
    pub(super) encoder: PathBuf,
    /// What ranks of the temporal basis came to, and the one that was taken.
    pub(super) ranks: PathBuf,
    /// What was fixed before fine-tuning for delivery.
    pub(super) registration: PathBuf,
    /// Fine-tuning for delivery, to go on with.
    pub(super) tuning: PathBuf,
    /// Its updates.
    pub(super) delivery_log: PathBuf,
    /// What came of it.
    pub(super) delivery: PathBuf,
}

/// Where epoch `number` of the training in `out` is trained.
pub(super) fn epoch_folder(out: &Path, number: usize) -> PathBuf {
    out.join(format!("epoch-{number}"))
}

/// The folders of the epochs that the training in `out` has.
fn epoch_folders(out: &Path) -> impl Iterator<Item = PathBuf> {
    (0..).map(|number| epoch_folder(out, number)).take_while(|folder| folder.is_dir())
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
            encoder: file(ENCODER),
            ranks: file("ranks.json"),
            registration: file("registration.json"),
            tuning: file("delivery.dgst"),
            delivery_log: file("delivery.csv"),
            delivery: file("delivery.json"),
        }
    }

    /// Whether fine-tuning for delivery was begun in it.
    pub(super) fn has_fine_tuning(&self) -> bool {
        self.ranks.is_file() || self.tuning.is_file()
    }

    /// Refuses, before anything is read or made, a folder that is in use or has nothing to go on with.
    pub(super) fn check(&self, args: &Train) -> Result<()> {
        let out = &args.out;
        let begun = [&self.checkpoint, &self.epochs, &self.ranks, &self.tuning];
        if args.resume && !begun.iter().any(|file| file.is_file()) {
            bail!("{}: no such checkpoint; train without --resume first", self.checkpoint.display());
        }
        if !out.is_dir() && out.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("dgs")) {
            bail!("{}: several files are written, among them scene.dgs: name a folder", out.display());
        }
        let _lock = if out.is_dir() { lock(out)? } else { None };
        self.check_used(args)
    }

    /// Refuses a folder that holds a training where nothing is said of it.
    fn check_used(&self, args: &Train) -> Result<()> {
        let out = &args.out;
        let begun = [&self.checkpoint, &self.epochs, &self.ranks, &self.tuning];
        let used = self.stream.exists() || begun.iter().any(|file| file.exists());
        if !args.resume && !args.overwrite && used {
            bail!("{}: holds a training; --resume goes on with it, --overwrite replaces it", out.display());
        }
        Ok(())
    }

    /// Makes the folder, or refuses one that is in use. No other training opens it while what this returns
    /// lives; a folder that was made, and has nothing of the training in the end, goes with it.
    pub(super) fn open(&self, args: &Train) -> Result<Opened> {
        self.check(args)?;
        let out = &args.out;
        let is_new = !out.exists();
        std::fs::create_dir_all(out)
            .with_context(|| format!("{}: cannot make this folder", out.display()))?;
        let opened = Opened { made: is_new.then(|| out.clone()), _lock: lock(out)? };
        // Another may have ended in between.
        self.check_used(args)?;
        self.files().into_iter().try_for_each(files::check)?;
        let of_epochs = epoch_folders(out).map(|epoch| Self::of(&epoch)).collect::<Vec<_>>();
        let all = || std::iter::once(self).chain(&of_epochs).flat_map(Self::files);
        let read =
            [Some(Path::new(&args.input)), args.options.as_deref(), args.delivery.as_ref().map(Path::new)];
        let read: Vec<&Path> = read.into_iter().flatten().collect();
        all().try_for_each(|file| files::check_apart(file, &read))?;
        let is_free = args.resume || args.overwrite || is_of_training(&self.encoder);
        if let Some(file) = all().find(|file| !is_free && file.exists()) {
            bail!(
                "{}: is there already, and a training writes a file of that name: name another folder, or \
                 --overwrite",
                file.display()
            );
        }
        if args.resume {
            return Ok(opened);
        }
        // What is left of another training would be taken for a part of this one.
        for file in all().filter(|file| file.is_file()) {
            std::fs::remove_file(file).with_context(|| file.display().to_string())?;
        }
        for epoch in epoch_folders(out).collect::<Vec<_>>() {
            // A folder in which somebody has put more stays.
            let _ = std::fs::remove_dir(&epoch);
        }
        Ok(opened)
    }

    fn files(&self) -> [&Path; 13] {
        let Self { checkpoint, stream, utility, epochs, log, preview, report, encoder, .. } = self;
        let Self { ranks, registration, tuning, delivery_log, delivery, .. } = self;
        [
            checkpoint,
            stream,
            utility,
            epochs,
            log,
            preview,
            report,
            encoder,
            ranks,
            registration,
            tuning,
            delivery_log,
            delivery,
        ]
        .map(PathBuf::as_path)
    }
}

/// Locks folder `out` until what this returns is gone; the system does that where a process is killed. None
/// where folders cannot be locked.
fn lock(out: &Path) -> Result<Option<File>> {
    let Ok(folder) = File::open(out) else { return Ok(None) };
    match folder.try_lock() {
        Ok(()) => Ok(Some(folder)),
        Err(TryLockError::WouldBlock) => {
            bail!("{}: another dgs train is at work in it; another --out is needed", out.display())
        }
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Whether `file` holds options of the encoder: all that a training leaves that is killed before its first
/// checkpoint.
fn is_of_training(file: &Path) -> bool {
    let options = std::fs::read(file).unwrap_or_default();
    let options: BTreeMap<String, String> = serde_json::from_slice(&options).unwrap_or_default();
    options.contains_key("--encoding-loss")
}

#[cfg(test)]
mod tests {
    use super::{super::parsed, *};

    fn opened(out: &Path, typed: &[&str]) -> Result<()> {
        let out_text = out.display().to_string();
        let args = parsed(["synth:balls", "-o", &out_text].into_iter().chain(typed.iter().copied()));
        Folder::of(out).open(&args).map(drop)
    }

    /// Files of other verbs, and of the person, stay where nobody says that they may go.
    #[test]
    fn files_of_others_are_neither_removed_nor_replaced() {
        for name in ["delivery.json", "registration.json", "report.html", "log.csv"] {
            let folder = tempfile::tempdir().unwrap();
            let file = folder.path().join(name);
            std::fs::write(&file, "mine").unwrap();
            let error = opened(folder.path(), &[]).unwrap_err().to_string();
            assert!(error.contains(name) && error.contains("--overwrite"), "{error}");
            assert_eq!(std::fs::read(&file).unwrap(), b"mine");
            opened(folder.path(), &["--overwrite"]).unwrap();
            assert!(!file.exists());
        }
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
        opened(folder.path(), &[]).unwrap();
        // What is read is not written, whatever may be replaced.
        let options = folder.path().join("delivery.json");
        std::fs::write(&options, "{}").unwrap();
        let typed = ["--overwrite", "--delivery", options.to_str().unwrap()];
        let error = opened(folder.path(), &typed).unwrap_err().to_string();
        assert!(error.contains("read or written besides") && options.exists(), "{error}");
    }

    /// A folder that was there stays, as does one that has more than options of the encoder.
    #[test]
    fn a_folder_that_was_made_for_nothing_goes() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("new");
        let out_text = out.display().to_string();
        let args = parsed(["synth:balls", "-o", &out_text]);
        let left = |file: &str| {
            let opened = Folder::of(&out).open(&args).unwrap();
            std::fs::write(out.join(file), "{}").unwrap();
            drop(opened);
            out.exists()
        };
        assert!(!left("encoder.json"), "nothing was trained");
        assert!(left("checkpoint.dgst"));
        std::fs::remove_file(out.join("checkpoint.dgst")).unwrap();
        assert!(left("encoder.json"), "it was there before");
    }

    #[test]
    fn a_training_that_has_hardly_begun_begins_anew() {
        let folder = tempfile::tempdir().unwrap();
        let encoder = folder.path().join("encoder.json");
        std::fs::write(&encoder, r#"{"--encoding-loss": "0.1"}"#).unwrap();
        std::fs::write(folder.path().join("log.csv"), "").unwrap();
        opened(folder.path(), &[]).unwrap();
        std::fs::write(&encoder, r#"{"of": "another"}"#).unwrap();
        assert!(opened(folder.path(), &[]).is_err());
    }
}
