//! Reads `codec-core/budget.toml`, the most that each figure may be. `[target]` headings, then
//! `key = number`; comments. No more of TOML than that is understood.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Context, Result, bail};

/// Upper bounds by `target.key`.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Budget(BTreeMap<String, f64>);

impl Budget {
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| format!("{}", path.display()))?;
        Self::parse(&text).with_context(|| format!("{}", path.display()))
    }

    fn parse(text: &str) -> Result<Self> {
        let mut bounds = BTreeMap::new();
        let mut target = String::new();
        for (i, line) in text.lines().enumerate() {
            let line = line.split('#').next().unwrap_or("").trim();
            if line.is_empty() {
                continue;
            }
            if let Some(name) = line.strip_prefix('[').and_then(|l| l.strip_suffix(']')) {
                target = format!("{name}.");
                continue;
            }
            let parsed = line.split_once('=').and_then(|(key, value)| {
                let value: f64 = value.trim().replace('_', "").parse().ok()?;
                Some((format!("{target}{}", key.trim().trim_matches('"')), value)).filter(|_| value > 0.0)
            });
            let Some((key, value)) = parsed else {
                bail!("line {}: found {line:?}; `key = number` or `[target]` is allowed", i + 1);
            };
            if bounds.insert(key, value).is_some() {
                bail!("line {}: {line:?} is there twice", i + 1);
            }
        }
        Ok(Self(bounds))
    }

    /// The most that `key` may be, if it is bounded.
    pub(super) fn of(&self, key: &str) -> Option<f64> {
        self.0.get(key).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{experiment::embedded::Report, figures::Bench, fixture::Fixture};

    #[test]
    fn bounds_are_read_and_nonsense_is_refused_by_line() {
        let budget =
            Budget::parse("# sizes\n[thumb]\nflash_bytes = 90_000 # B\n\"stack.x\" = 1.5\n").unwrap();
        assert_eq!((budget.of("thumb.flash_bytes"), budget.of("thumb.stack.x")), (Some(90e3), Some(1.5)));
        assert_eq!(budget.of("flash_bytes"), None);
        for (text, line) in [("a = b", 1), ("[t]\na", 2), ("a = 1\na = 2", 2), ("a = -1", 1), ("\n= = 3", 2)]
        {
            let error = Budget::parse(text).unwrap_err().to_string();
            assert!(error.contains(&format!("line {line}")), "{text:?}: {error}");
        }
    }

    #[test]
    fn a_figure_above_its_bound_is_wrong_and_one_at_it_is_not() {
        let budget = Budget::parse("[t]\na = 10\n").unwrap();
        let fixture = Fixture::make().unwrap();
        let mut report = Report { bench: Bench::new("t", ""), fixture: &fixture, budget, wrong: Vec::new() };
        report.figure("t.a".into(), 10.0, "B");
        report.figure("t.b".into(), 1e9, "B");
        assert!(report.wrong.is_empty());
        report.figure("t.a".into(), 10.5, "B");
        assert_eq!(report.wrong, ["t.a is 10.5; the budget is 10"]);
    }

    #[test]
    fn the_committed_budget_is_read() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../codec-core/budget.toml");
        assert!(Budget::read(&path).unwrap().of("thumbv7em.flash_bytes").is_some());
    }
}
