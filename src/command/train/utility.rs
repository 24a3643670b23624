//! Measures what each group of packets adds to a picture, against the photographs of a training.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;
use trainer_host::{
    Stream,
    train::{Dataset, Views},
    utility::{LevelAudit, References, Table, UtilityError, UtilityOptions},
};

use super::trained::Trained;
use crate::{
    figures::audit_lines,
    pipeline::{self, Quiet},
};

/// Groups per level whose utility, measured against some photographs, is negative.
#[derive(Debug, Serialize)]
pub(super) struct Audit {
    /// Which photographs.
    against: String,
    protocol: String,
    levels: Vec<LevelAudit>,
    /// Why nothing was measured, where nothing was.
    missing: Option<String>,
}

impl Audit {
    fn of(against: &str, table: &Table) -> Self {
        let (protocol, levels) = (table.protocol.clone(), table.audit());
        Self { against: against.to_owned(), protocol, levels, missing: None }
    }

    /// The audit for people.
    pub(super) fn text(&self) -> String {
        match &self.missing {
            Some(why) => format!("utilities, {}: not measured: {why}\n", self.against),
            None => format!("utilities, {}\n{}", self.against, audit_lines(&self.levels)),
        }
    }
}

/// Measures utilities of `stream` against the training photographs of `dataset` into the file `path`, and, as
/// a check that no sender uses, against the test photographs. Gives the table of the first, too; none where
/// some window is in no photograph. Where cameras have exposures, training photographs are taken as cameras
/// without them would have; those of test cameras are not known, which is said.
///
/// # Errors
/// Photographs that cannot be compared, or a file that cannot be written.
pub(super) fn audits(
    stream: &Stream,
    dataset: &Dataset,
    trained: &Trained,
    path: &Path,
    quiet: Quiet,
) -> Result<(Vec<Audit>, Option<Table>)> {
    let background = trained.options.background;
    let [neutral, alike] = match trained.exposures.is_empty() {
        true => [""; 2],
        false => [", exposures taken off", ", cameras taken as alike"],
    };
    let photographs = trained.neutral_views(&dataset.train)?;
    let training = measured(stream, &photographs, background, Some(path), quiet);
    let (of_training, table) =
        audited(&format!("training photographs{neutral}"), training).context("--utility")?;
    let test = measured(stream, &dataset.test, background, None, quiet);
    let (of_test, _) = audited(&format!("test photographs{alike}"), test)?;
    Ok((vec![of_training, of_test], table))
}

/// The audit of what was measured, and its table. Photographs need not show every window, or be there at all.
fn audited(against: &str, measured: Result<Table>) -> Result<(Audit, Option<Table>)> {
    let error = match measured {
        Ok(table) => return Ok((Audit::of(against, &table), Some(table))),
        Err(error) => error,
    };
    let missing = match error.downcast_ref::<UtilityError>() {
        Some(why @ (UtilityError::NoCamera | UtilityError::NoPhotograph { .. })) => Some(why.to_string()),
        _ => return Err(error),
    };
    let (against, protocol, levels) = (against.to_owned(), String::new(), Vec::new());
    Ok((Audit { against, protocol, levels, missing }, None))
}

fn measured<S: Sync>(
    stream: &Stream,
    views: &Views<S>,
    background: [f32; 3],
    cache: Option<&Path>,
    quiet: Quiet,
) -> Result<Table> {
    let photographs = pipeline::reference_photographs(views, background)?;
    let mut options = UtilityOptions::paper();
    options.settings.background = background;
    let references = References::Photographs(&photographs);
    // A table of an earlier training is replaced without a word: the folder is this one's.
    pipeline::utilities(&references, stream, &options, cache, quiet, &mut |_| ())
}
