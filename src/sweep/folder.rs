//! Keeps the results of a sweep in a folder: batches that are there whole or not at all, and what follows.

use std::{
    fs,
    io::{Read as _, Seek as _, SeekFrom, Write as _},
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail, ensure};
use emulator_host::{
    report::FrameRow,
    sweep::{Outcomes, Summary, Trial},
};

use super::{Digests, Outline, trajectory};
use crate::files::{self, PendingFile};

/// Blocks of one batch: few, so that little is lost with a killed process and shards are of equal size.
const BLOCKS: u64 = 4;
const CONFIG: &str = "sweep.toml";
const RUNS: &str = "runs.jsonl";
const SUMMARY: &str = "summary.json";
/// Last bytes of a Parquet file.
const PARQUET: [u8; 4] = *b"PAR1";

/// What results were made of.
#[derive(Clone, Debug)]
pub(crate) struct Origin {
    /// Text of the configuration.
    pub(crate) text: String,
    /// Size of the design.
    pub(crate) outline: Outline,
    /// Digests of the trace files that it names.
    pub(crate) digests: Digests,
}

impl Origin {
    /// What the results in `folder` were made of.
    ///
    /// # Errors
    /// A folder without results, or without digests of the traces that its configuration names.
    pub(crate) fn of(folder: &Path) -> Result<Self> {
        let config = folder.join(CONFIG);
        let text = fs::read_to_string(&config)
            .with_context(|| format!("{}: no results of a sweep here", config.display()))?;
        let outline = Outline::parse(&text).with_context(|| config.display().to_string())?;
        let digests = match Digests::read(folder)? {
            Some(digests) => digests,
            None if outline.has_files => bail!(undigested(folder)),
            None => Digests::default(),
        };
        Ok(Self { text, outline, digests })
    }

    /// Refuses the results in `folder` if they were made of something else than those in `first`.
    ///
    /// # Errors
    /// What differs: the configuration, or a trace by name.
    pub(crate) fn check(&self, first: &Path, folder: &Path) -> Result<()> {
        let other = Self::of(folder)?;
        let [first, folder] = [first, folder].map(Path::display);
        ensure!(self.text == other.text, "{folder}: results of another configuration than {first}");
        match self.digests.difference(&other.digests) {
            Some(name) => bail!("{folder}: results over another {name} than {first}"),
            None => Ok(()),
        }
    }
}

/// Why results without digests are refused.
fn undigested(folder: &Path) -> String {
    format!(
        "{}: is not there, so nothing says which traces these results are of; another folder is needed",
        Digests::path(folder).display()
    )
}

/// What follows from the batches of a folder.
#[derive(Clone, Debug)]
pub(crate) enum Finished {
    /// All are there, and this is their summary.
    Whole(Summary),
    /// So many are missing or were cut, and why the first of them counts as such.
    Lacks {
        /// How many.
        batches: usize,
        /// The file, and what is wrong with it.
        reason: String,
    },
}

impl Finished {
    /// The summary, if there is one.
    pub(crate) fn summary(&self) -> Option<&Summary> {
        match self {
            Self::Whole(summary) => Some(summary),
            Self::Lacks { .. } => None,
        }
    }

    /// Batches that are missing or were cut.
    pub(crate) fn missing(&self) -> usize {
        match self {
            Self::Whole(_) => 0,
            Self::Lacks { batches, .. } => *batches,
        }
    }
}

/// A folder of results of one configuration.
#[derive(Clone, Debug)]
pub(crate) struct Folder {
    path: PathBuf,
    outline: Outline,
    trajectories: bool,
}

impl Folder {
    /// Opens or makes `path` for results of `origin`.
    ///
    /// # Errors
    /// A folder of another configuration or of other traces, one with files of other programs in the places
    /// of what follows from batches, or one that cannot be made.
    pub(crate) fn open(path: &Path, origin: &Origin, trajectories: bool) -> Result<Self> {
        // Processes that share the folder write the configuration first: it is looked for last.
        if let Some(file) = [RUNS, SUMMARY].map(|name| path.join(name)).iter().find(|file| file.exists()) {
            ensure!(
                path.join(CONFIG).exists(),
                "{}: is there already, and no {CONFIG} beside it that makes it of a sweep; another folder is \
                 needed",
                file.display()
            );
        }
        for folder in [path.to_owned(), path.join("runs"), path.join("trajectories")] {
            let failed = || format!("{}: cannot make this folder", folder.display());
            fs::create_dir_all(&folder).with_context(failed)?;
        }
        let config = path.join(CONFIG);
        match fs::read_to_string(&config) {
            Ok(found) if found == origin.text => {}
            Ok(_) => {
                bail!("{}: results of another configuration; another folder is needed", config.display())
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                files::write(&config, origin.text.as_bytes())?;
            }
            Err(error) => return Err(error).with_context(|| config.display().to_string()),
        }
        let folder = Self { path: path.to_owned(), outline: origin.outline, trajectories };
        folder.check_digests(&origin.digests)?;
        Ok(folder)
    }

    /// Refuses results of other traces than those of `digests`; writes the digests if there are no results.
    fn check_digests(&self, digests: &Digests) -> Result<()> {
        // Processes that share the folder write digests before batches: batches are counted first.
        let has_batches = (0..self.batches()).any(|batch| self.runs(batch).exists());
        match Digests::read(&self.path)? {
            Some(found) => match digests.difference(&found) {
                Some(name) => bail!(
                    "{}: results over another {name}, which has changed; another folder is needed",
                    Digests::path(&self.path).display()
                ),
                None => Ok(()),
            },
            None if digests.is_empty() => Ok(()),
            None if has_batches => bail!(undigested(&self.path)),
            None => digests.write(&self.path),
        }
    }

    /// Batches of the whole design.
    pub(crate) fn batches(&self) -> u64 {
        self.outline.blocks.div_ceil(BLOCKS)
    }

    /// Blocks of `batch`.
    pub(super) fn blocks_of(&self, batch: u64) -> Range<u64> {
        batch * BLOCKS..((batch + 1) * BLOCKS).min(self.outline.blocks)
    }

    fn runs(&self, batch: u64) -> PathBuf {
        self.path.join(format!("runs/{batch:05}.jsonl"))
    }

    fn trajectories(&self, batch: u64) -> PathBuf {
        self.path.join(format!("trajectories/{batch:05}.parquet"))
    }

    /// Whether `batch` is there. Its runs are written last, so they say that all of it is.
    fn has(&self, batch: u64) -> bool {
        self.runs(batch).is_file() && (!self.trajectories || self.trajectories(batch).is_file())
    }

    /// Whether `batch` is there and no file of it was cut since: otherwise the sweep makes it again.
    pub(super) fn has_whole(&self, batch: u64) -> bool {
        self.read_whole(batch).is_ok()
    }

    /// As [`Self::read`], where all files of `batch` are there and none was cut since.
    ///
    /// # Errors
    /// The file that is not there or not whole.
    fn read_whole(&self, batch: u64) -> Result<(String, Vec<Trial>)> {
        let trajectories = self.trajectories(batch);
        ensure!(!self.trajectories || trajectories.is_file(), "{}: is not there", trajectories.display());
        let read = self.read(batch)?;
        check_parquet(&trajectories)?;
        Ok(read)
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
    /// A batch that is in both and differs or is cut short, or a file that cannot be copied.
    pub(crate) fn take(&self, other: &Path) -> Result<u64> {
        let other = Self { path: other.to_owned(), trajectories: false, ..self.clone() };
        let mut taken = 0;
        for batch in (0..self.batches()).filter(|batch| other.has(*batch)) {
            let fresh = !self.runs(batch).is_file();
            other.read(batch)?;
            check_parquet(&other.trajectories(batch))?;
            copy(&other.trajectories(batch), &self.trajectories(batch))?;
            copy(&other.runs(batch), &self.runs(batch))?;
            taken += u64::from(fresh);
        }
        Ok(taken)
    }

    /// Batches that are there without trajectories, and all that are there.
    pub(crate) fn without_trajectories(&self) -> (usize, usize) {
        let there: Vec<u64> = (0..self.batches()).filter(|batch| self.runs(*batch).is_file()).collect();
        let without = there.iter().filter(|batch| !self.trajectories(**batch).is_file()).count();
        (without, there.len())
    }

    /// The lines of `batch` and its simulations, all of them in order.
    ///
    /// # Errors
    /// The file, and the line that is no simulation or not the one that belongs there.
    fn read(&self, batch: u64) -> Result<(String, Vec<Trial>)> {
        let path = self.runs(batch);
        let named = || path.display();
        let text = fs::read_to_string(&path).with_context(|| named().to_string())?;
        let (blocks, each) = (self.blocks_of(batch), self.outline.simulations_per_block);
        let (first, count) = (blocks.start * each, (blocks.end - blocks.start) * each);
        let mut trials = Vec::new();
        for (line, allowed) in text.lines().zip(first..) {
            let number = trials.len() + 1;
            let trial: Trial = serde_json::from_str(line)
                .with_context(|| format!("{}: line {number}: not a simulation", named()))?;
            let found = trial.simulation;
            ensure!(found == allowed, "{}: line {number}: simulation is {found}, allowed {allowed}", named());
            trials.push(trial);
        }
        let found = trials.len();
        ensure!(
            found as u64 == count,
            "{}: {found} simulations, allowed are {count}; without this file the sweep makes it again",
            named()
        );
        Ok((text, trials))
    }

    /// Writes what follows from all batches: every simulation in order, and the summary against `baseline`.
    /// Where a batch is missing or was cut, nothing is written.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub(crate) fn finish(&self, baseline: &str) -> Result<Finished> {
        let target = self.path.join(RUNS);
        let failed = || format!("{}: cannot write", target.display());
        let are_there = (0..self.batches()).all(|batch| self.has(batch));
        let mut runs = are_there.then(|| PendingFile::begin(&target)).transpose()?;
        let mut outcomes = Outcomes::default();
        let (mut batches, mut first) = (0, None);
        for batch in 0..self.batches() {
            match (self.read_whole(batch), &mut runs) {
                (Ok((text, trials)), Some(runs)) => {
                    runs.file().write_all(text.as_bytes()).with_context(failed)?;
                    trials.iter().for_each(|trial| outcomes.push(trial));
                }
                (Ok(_), None) => {}
                (Err(reason), _) => {
                    batches += 1;
                    first.get_or_insert(reason);
                    runs = None;
                }
            }
        }
        if let Some(reason) = first {
            return Ok(Finished::Lacks { batches, reason: format!("{reason:#}") });
        }
        runs.map_or(Ok(()), PendingFile::finish)?;
        let summary = outcomes.summary(baseline);
        let mut json = serde_json::to_vec_pretty(&summary)?;
        json.push(b'\n');
        files::write(&self.path.join(SUMMARY), &json)?;
        Ok(Finished::Whole(summary))
    }
}

/// Refuses a Parquet file, if it is there, that does not end as one.
fn check_parquet(path: &Path) -> Result<()> {
    if path.is_file() {
        let failed = || path.display().to_string();
        let mut file = fs::File::open(path).with_context(failed)?;
        let bytes = file.metadata().with_context(failed)?.len();
        let mut last = [0; PARQUET.len()];
        let is_read = file
            .seek(SeekFrom::End(-(PARQUET.len() as i64)))
            .and_then(|_| file.read_exact(&mut last))
            .is_ok();
        let is_whole = is_read && last == PARQUET && bytes > 2 * PARQUET.len() as u64;
        ensure!(is_whole, "{}: {bytes} bytes, which end inside a table", path.display());
    }
    Ok(())
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
