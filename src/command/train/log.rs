//! Keeps the log of a training: samples over its steps, as CSV and as a line for the progress bar.

use std::{fmt::Write as _, path::Path};

use anyhow::{Context, Result};
use trainer_host::train::StepReport;

/// Rounding and pruning at the end cost less than this, dB.
const CLEAR_FALL_DB: f64 = 1.0;
const HEADER: &str = "step,seconds,loss,gaussians,nodes,width,height,psnr_db";

/// What training looked like at one step.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Sample {
    pub(super) step: u32,
    pub(super) seconds: f64,
    /// Running mean.
    pub(super) loss: f64,
    gaussians: usize,
    nodes: usize,
    size: (u32, u32),
    /// Where it was measured.
    pub(super) psnr_db: Option<f64>,
}

impl Sample {
    pub(super) fn of(report: &StepReport, seconds: f64, psnr_db: Option<f64>) -> Self {
        Self {
            step: report.step,
            seconds,
            loss: report.mean_loss,
            gaussians: report.gaussians,
            nodes: report.nodes,
            size: report.size,
            psnr_db,
        }
    }

    fn csv(&self) -> String {
        let Self { step, seconds, loss, gaussians, nodes, size: (width, height), psnr_db } = self;
        let psnr = psnr_db.map_or_else(String::new, |v| format!("{v:.3}"));
        format!("{step},{seconds:.2},{loss:.6},{gaussians},{nodes},{width},{height},{psnr}")
    }

    fn parse(line: &str) -> Option<Self> {
        let mut fields = line.split(',');
        let mut next = || fields.next();
        Some(Self {
            step: next()?.parse().ok()?,
            seconds: next()?.parse().ok()?,
            loss: next()?.parse().ok()?,
            gaussians: next()?.parse().ok()?,
            nodes: next()?.parse().ok()?,
            size: (next()?.parse().ok()?, next()?.parse().ok()?),
            psnr_db: match next()? {
                "" => None,
                text => Some(text.parse().ok()?),
            },
        })
    }
}

/// Samples in order of step, and what a person should know.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Log {
    pub(super) samples: Vec<Sample>,
    pub(super) notes: Vec<String>,
    /// Where the samples of each further epoch begin.
    epochs: Vec<usize>,
}

impl Log {
    /// The log at `path` of a training that goes on after `steps` steps. What is not such a log does not keep
    /// it from going on: the log ends before it, says so, and the file stays under another name.
    ///
    /// # Errors
    /// A file that can neither be read nor renamed.
    pub(super) fn resumed(path: &Path, steps: u32) -> Result<Self> {
        if !path.exists() {
            return Ok(Self::default());
        }
        let failed = || path.display().to_string();
        let bytes = std::fs::read(path).with_context(failed)?;
        let (mut log, damage) = Self::parse(&String::from_utf8_lossy(&bytes));
        if let Some(damage) = damage {
            let aside = path.with_extension("csv.damaged");
            std::fs::rename(path, &aside).with_context(failed)?;
            log.notes.push(format!(
                "{}: {damage}; the log goes on without it, and the file is {} now",
                path.display(),
                aside.display()
            ));
        }
        // Steps after the checkpoint are taken again.
        log.samples.retain(|sample| sample.step <= steps);
        Ok(log)
    }

    /// The samples of what [`Log::csv`] wrote, up to the first line that is none; and what is wrong there.
    fn parse(text: &str) -> (Self, Option<String>) {
        let mut log = Self::default();
        let mut lines = text.lines();
        if lines.next() != Some(HEADER) {
            return (log, Some(format!("line 1 is not {HEADER:?}")));
        }
        for (index, line) in lines.enumerate() {
            let Some(sample) = Sample::parse(line) else {
                return (log, Some(format!("line {} is not a sample of a log", index + 2)));
            };
            log.samples.push(sample);
        }
        (log, None)
    }

    pub(super) fn csv(&self) -> String {
        let mut out = format!("{HEADER}\n");
        for sample in &self.samples {
            let _ = writeln!(out, "{}", sample.csv());
        }
        out
    }

    /// The same, with `next` after it.
    pub(super) fn followed_by(mut self, next: Self) -> Self {
        let (steps, seconds) = self.samples.last().map_or((0, 0.0), |last| (last.step, last.seconds));
        let later = |sample: Sample| Sample {
            step: sample.step + steps,
            seconds: sample.seconds + seconds,
            ..sample
        };
        self.epochs.push(self.samples.len());
        self.samples.extend(next.samples.into_iter().map(later));
        self.notes.extend(next.notes);
        self
    }

    /// Ends with `last`, unless a sample of that step is there.
    pub(super) fn end(&mut self, last: Option<Sample>) {
        let has = |step: u32| self.samples.last().is_some_and(|sample| sample.step >= step);
        self.samples.extend(last.filter(|last| !has(last.step)));
    }

    /// Seconds of training so far.
    pub(super) fn seconds(&self) -> f64 {
        self.samples.last().map_or(0.0, |sample| sample.seconds)
    }

    /// The highest PSNR and the last one, dB, where the training, or that of an epoch, has clearly lost what
    /// it had.
    pub(super) fn fall(&self) -> Option<(f64, f64)> {
        let ends = self.epochs.iter().copied().chain([self.samples.len()]);
        let mut start = 0;
        ends.filter_map(|end| {
            let samples = self.samples.get(start..end).unwrap_or_default();
            start = end;
            let psnr = || samples.iter().filter_map(|sample| sample.psnr_db);
            let (best, last) = (psnr().fold(f64::MIN, f64::max), psnr().next_back()?);
            (last < best - CLEAR_FALL_DB).then_some((best, last))
        })
        .next()
    }

    /// For the progress bar; `left` is an estimate, seconds.
    pub(super) fn line(&self, left: f64) -> String {
        let Some(last) = self.samples.last() else { return "train".to_owned() };
        let psnr = self.samples.iter().rev().find_map(|sample| sample.psnr_db);
        let psnr = psnr.map_or_else(String::new, |v| format!("{v:.1} dB, "));
        let (minutes, seconds) = (left as u64 / 60, left as u64 % 60);
        format!("{psnr}{} Gaussians, {} px, {minutes}:{seconds:02} left", last.gaussians, last.size.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_reads_back_what_it_wrote() {
        let sample = |step: u32, psnr_db| Sample {
            step,
            seconds: 1.5,
            loss: 0.25,
            gaussians: 10,
            nodes: 2,
            size: (40, 30),
            psnr_db,
        };
        let samples = vec![sample(100, None), sample(200, Some(31.5))];
        let log = Log { samples, ..Log::default() };
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        std::fs::write(&path, log.csv()).unwrap();
        assert_eq!(Log::resumed(&path, 200).unwrap(), log);
        assert_eq!(Log::resumed(&path, 150).unwrap().samples, log.samples[..1], "later steps come again");
        std::fs::write(&path, log.csv() + "x\n").unwrap();
        let found = Log::resumed(&path, 200).unwrap();
        assert_eq!(found.samples, log.samples);
        assert!(found.notes[0].contains("log.csv: line 4 is not a sample"), "{:?}", found.notes);
        assert!(!path.exists() && folder.path().join("log.csv.damaged").exists());
        std::fs::write(&path, [0xff, b'\n', 7]).unwrap();
        let foreign = Log::resumed(&path, 200).unwrap();
        assert!(foreign.samples.is_empty() && foreign.notes[0].contains("line 1 is not"), "{foreign:?}");
    }

    #[test]
    fn epochs_follow_each_other_and_are_judged_one_by_one() {
        let log = |samples: &[(u32, Option<f64>)]| {
            let of = |&(step, psnr_db): &(u32, Option<f64>)| Sample {
                step,
                seconds: f64::from(step),
                loss: 0.25,
                gaussians: 10,
                nodes: 2,
                size: (40, 30),
                psnr_db,
            };
            Log { samples: samples.iter().map(of).collect(), ..Log::default() }
        };
        let mut first = log(&[(100, Some(36.0))]);
        first.end(log(&[(150, None)]).samples.pop());
        first.end(log(&[(150, Some(9.0))]).samples.pop());
        let both = first.clone().followed_by(log(&[(90, Some(27.0))]));
        assert_eq!(both.samples.iter().map(|sample| sample.step).collect::<Vec<_>>(), [100, 150, 240]);
        assert!(both.seconds() == 240.0 && both.fall().is_none(), "an epoch is no fall from that before");
        let fallen = first.followed_by(log(&[(80, Some(27.0)), (90, Some(20.0))]));
        assert_eq!(fallen.fall(), Some((27.0, 20.0)));
    }
}
