//! Keeps the results of a sweep in a folder: batches that are there whole or not at all, and what follows.

use std::{
    fs,
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use emulator_host::{
    report::FrameRow,
    sweep::{Summary, Trial, summary},
};

use super::trajectory;
use crate::files;

/// Blocks of one batch: few, so that little is lost with a killed process and shards are of equal size.
const BLOCKS: u64 = 4;
const CONFIG: &str = "sweep.toml";
const RUNS: &str = "runs.jsonl";
const SUMMARY: &str = "summary.json";

/// A folder of results of one configuration.
#[derive(Clone, Debug)]
pub(crate) struct Folder {
    path: PathBuf,
    blocks: u64,
    trajectories: bool,
}

impl Folder {
    /// Opens or makes `path` for the configuration `text` of `blocks` blocks.
    ///
    /// # Errors
    /// A folder of another configuration, or one that cannot be made.
    pub(crate) fn open(path: &Path, text: &str, blocks: u64, trajectories: bool) -> Result<Self> {
        for folder in [path.to_owned(), path.join("runs"), path.join("trajectories")] {
            let failed = || format!("{}: cannot make this folder", folder.display());
            fs::create_dir_all(&folder).with_context(failed)?;
        }
        let config = path.join(CONFIG);
        match fs::read_to_string(&config) {
            Ok(found) if found == text => {}
            Ok(_) => {
                bail!("{}: results of another configuration; another folder is needed", config.display())
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                files::write(&config, text.as_bytes())?;
            }
            Err(error) => return Err(error).with_context(|| config.display().to_string()),
        }
        Ok(Self { path: path.to_owned(), blocks, trajectories })
    }

    /// The configuration of the results in `path`.
    ///
    /// # Errors
    /// A folder without one.
    pub(crate) fn config(path: &Path) -> Result<String> {
        let config = path.join(CONFIG);
        fs::read_to_string(&config)
            .with_context(|| format!("{}: no results of a sweep here", config.display()))
    }

    /// Batches of the whole design.
    pub(crate) fn batches(&self) -> u64 {
        self.blocks.div_ceil(BLOCKS)
    }

    /// Blocks of `batch`.
    pub(super) fn blocks_of(&self, batch: u64) -> Range<u64> {
        batch * BLOCKS..((batch + 1) * BLOCKS).min(self.blocks)
    }

    fn runs(&self, batch: u64) -> PathBuf {
        self.path.join(format!("runs/{batch:05}.jsonl"))
    }

    fn trajectories(&self, batch: u64) -> PathBuf {
        self.path.join(format!("trajectories/{batch:05}.parquet"))
    }

    /// Whether `batch` is there. Its runs are written last, so they say that all of it is.
    pub(super) fn has(&self, batch: u64) -> bool {
        self.runs(batch).is_file() && (!self.trajectories || self.trajectories(batch).is_file())
    }

    /// Writes `batch`; how many bytes.
    pub(super) fn write(&self, batch: u64, trials: &[(Trial, Vec<FrameRow>)]) -> Result<u64> {
        let mut bytes = 0;
        if self.trajectories {
            let table = trajectory::parquet(trials).context("writing trajectories")?;
            files::write(&self.trajectories(batch), &table)?;
            bytes += table.len() as u64;
        }
        let mut lines = String::new();
        for (trial, _) in trials {
            lines += &serde_json::to_string(trial)?;
            lines.push('\n');
        }
        files::write(&self.runs(batch), lines.as_bytes())?;
        Ok(bytes + lines.len() as u64)
    }

    /// Copies the batches of `other` that this folder lacks; how many.
    ///
    /// # Errors
    /// A batch that is in both and differs, or a file that cannot be copied.
    pub(crate) fn take(&self, other: &Path) -> Result<u64> {
        let other = Self { path: other.to_owned(), trajectories: false, ..self.clone() };
        let mut taken = 0;
        for batch in (0..self.batches()).filter(|batch| other.has(*batch)) {
            let fresh = !self.runs(batch).is_file();
            copy(&other.trajectories(batch), &self.trajectories(batch))?;
            copy(&other.runs(batch), &self.runs(batch))?;
            taken += u64::from(fresh);
        }
        Ok(taken)
    }

    /// Batches that are not there.
    pub(crate) fn missing(&self) -> Vec<u64> {
        (0..self.batches()).filter(|batch| !self.has(*batch)).collect()
    }

    /// Writes what follows from all batches: every simulation in order, and the summary against `baseline`.
    /// `None` while a batch is missing.
    ///
    /// # Errors
    /// A batch that cannot be read, with its name and line.
    pub(crate) fn finish(&self, baseline: &str) -> Result<Option<Summary>> {
        if !self.missing().is_empty() {
            return Ok(None);
        }
        let (mut text, mut trials) = (String::new(), Vec::<Trial>::new());
        for batch in 0..self.batches() {
            let path = self.runs(batch);
            let lines = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
            for (number, line) in (1..).zip(lines.lines()) {
                let trial: Trial = serde_json::from_str(line)
                    .with_context(|| format!("{}: line {number}: not a simulation", path.display()))?;
                if trial.simulation != trials.len() as u64 {
                    let (found, allowed) = (trial.simulation, trials.len());
                    bail!("{}: line {number}: simulation is {found}, allowed {allowed}", path.display());
                }
                trials.push(trial);
            }
            text += &lines;
        }
        let summary = summary(&trials, baseline);
        files::write(&self.path.join(RUNS), text.as_bytes())?;
        let mut json = serde_json::to_vec_pretty(&summary)?;
        json.push(b'\n');
        files::write(&self.path.join(SUMMARY), &json)?;
        Ok(Some(summary))
    }
}

/// Copies `from`, if it is there, to `to`; if `to` is there too, they must be the same.
fn copy(from: &Path, to: &Path) -> Result<()> {
    if !from.is_file() {
        return Ok(());
    }
    let bytes = fs::read(from).with_context(|| from.display().to_string())?;
    if to.is_file() {
        if fs::read(to).with_context(|| to.display().to_string())? != bytes {
            bail!("{} and {} are the same batch and differ", from.display(), to.display());
        }
        return Ok(());
    }
    files::write(to, &bytes)
}
