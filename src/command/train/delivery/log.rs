//! Keeps the log of a fine-tuning: its updates as CSV and as a line for the progress bar.

use std::{fmt::Write as _, path::Path};

use trainer_host::train::delivery::{Candidate, Terms, Update};

const HEADER: &str = "update,seconds,objective,expected,tail,rate,temporal,monotone,complete,p10_db,clean_db,\
                      wire_bytes";

/// When updates were made. All else that the log says is in the checkpoint.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct DeliveryLog {
    /// Seconds of work until each update was made, from the first one on; `None` where nothing says.
    seconds: Vec<Option<f64>>,
}

impl DeliveryLog {
    /// That of the file at `path` of a fine-tuning that goes on after `updates` updates. Times that it does
    /// not hold are left out.
    pub(super) fn resumed(path: &Path, updates: usize) -> Self {
        let text = std::fs::read(path).unwrap_or_default();
        let text = String::from_utf8_lossy(&text);
        let mut seconds = vec![None; updates];
        for line in text.lines().skip(1) {
            let mut fields = line.split(',');
            let update = fields.next().and_then(|field| field.parse::<usize>().ok());
            let time = fields.next().and_then(|field| field.parse::<f64>().ok()).filter(|s| s.is_finite());
            if let Some(place) = update.and_then(|update| seconds.get_mut(update.checked_sub(1)?)) {
                *place = time;
            }
        }
        Self { seconds }
    }

    /// Seconds of work so far, as far as is known.
    pub(super) fn seconds(&self) -> f64 {
        self.seconds.iter().rev().find_map(|seconds| *seconds).unwrap_or(0.0)
    }

    /// Adds that the next update was made after so many seconds of work.
    pub(super) fn add(&mut self, seconds: f64) {
        self.seconds.push(Some(seconds));
    }

    /// The file: a line per update, of its objective, its terms, and what validation saw after it. Update 0
    /// is the scene as it was given.
    pub(super) fn csv(&self, objective: &[f64], terms: &[Terms], candidates: &[Candidate]) -> String {
        let mut out = format!("{HEADER}\n");
        let seen = |update: usize| {
            let found = candidates.iter().find(|candidate| candidate.updates == update);
            found.map_or_else(
                || ",,".to_owned(),
                |c| format!("{:.4},{:.4},{}", c.p10_db, c.clean_db, c.wire_bytes),
            )
        };
        let _ = writeln!(out, "0,0.00,,,,,,,,{}", seen(0));
        for (index, (objective, terms)) in objective.iter().zip(terms).enumerate() {
            let Terms { expected, tail, rate, temporal, monotone, prefixes } = terms;
            let seconds = self.seconds.get(index).copied().flatten();
            let seconds = seconds.map_or_else(String::new, |seconds| format!("{seconds:.2}"));
            let complete = prefixes.last().copied().unwrap_or(0.0);
            let update = index + 1;
            let _ = writeln!(
                out,
                "{update},{seconds},{objective:.8},{expected:.8},{tail:.8},{rate:.8},{temporal:.8},\
                 {monotone:.8},{complete:.8},{}",
                seen(update)
            );
        }
        out
    }
}

/// For the progress bar: `update`, the last that validation saw, and how long it takes yet, seconds.
pub(super) fn line(update: &Update, candidates: &[Candidate], left: f64) -> String {
    let seen =
        candidates.last().map_or_else(String::new, |last| format!("0.10 quantile {:.2} dB, ", last.p10_db));
    let (minutes, seconds) = (left as u64 / 60, left as u64 % 60);
    let Update { updates, of, objective, .. } = update;
    format!("update {updates} of {of}, objective {objective:.5}, {seen}{minutes}:{seconds:02} left")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(updates: usize) -> Candidate {
        Candidate { updates, violations: 0, p10_db: 25.5, clean_db: 31.25, wire_bytes: 900 }
    }

    #[test]
    fn a_log_goes_on_with_the_times_that_it_holds() {
        let terms = Terms { expected: 0.25, prefixes: [0.4, 0.3, 0.2, 0.125], ..Terms::default() };
        let mut log = DeliveryLog::default();
        log.add(1.5);
        log.add(3.0);
        let csv = |log: &DeliveryLog| log.csv(&[0.5, 0.25], &[terms; 2], &[candidate(0), candidate(2)]);
        let text = csv(&log);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0].split(',').count(), 12);
        assert!(lines.iter().all(|line| line.split(',').count() == 12), "{text}");
        assert_eq!(lines[1], "0,0.00,,,,,,,,25.5000,31.2500,900");
        assert!(lines[2].starts_with("1,1.50,0.50000000,0.25000000,") && lines[2].ends_with("0.12500000,,,"));
        assert!(lines[3].ends_with("25.5000,31.2500,900"), "{text}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("delivery.csv");
        std::fs::write(&path, &text).unwrap();
        assert_eq!(DeliveryLog::resumed(&path, 2), log);
        assert_eq!(csv(&DeliveryLog::resumed(&path, 2)), text);
        let first = DeliveryLog::resumed(&path, 1);
        assert_eq!((first.seconds.len(), first.seconds()), (1, 1.5), "later updates come again");
        // What is no such file costs the times alone.
        std::fs::write(&path, [0xff, b'\n', b'1', b',', b'x', b'\n', 7]).unwrap();
        for path in [path, folder.path().join("nowhere.csv")] {
            let damaged = DeliveryLog::resumed(&path, 2);
            assert_eq!(damaged.seconds, [None, None]);
            assert!(csv(&damaged).contains("\n2,,0.25000000,"), "{}", csv(&damaged));
        }
    }

    #[test]
    fn the_line_says_how_far_it_is_and_how_long_it_takes() {
        let update = Update { updates: 12, of: 240, objective: 0.012_36, expected: 0.01, arrived: 0.5 };
        let text = line(&update, &[candidate(0)], 200.9);
        assert_eq!(text, "update 12 of 240, objective 0.01236, 0.10 quantile 25.50 dB, 3:20 left");
        assert!(!line(&update, &[], 0.0).contains("quantile"));
    }
}
