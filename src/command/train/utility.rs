//! Measures what each group of packets adds to a picture, against the photographs of a training.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;
use trainer_host::{
    Stream,
    stream::PacketMap,
    train::{Dataset, Views},
    utility::{LevelAudit, References, Table, UtilityError, UtilityOptions},
};

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
/// a check that no sender uses, against the test photographs. Gives the table of the first, too.
///
/// # Errors
/// A window that no training photograph shows, or a file that cannot be written.
pub(super) fn audits(
    stream: &Stream,
    dataset: &Dataset,
    background: [f32; 3],
    path: &Path,
    quiet: Quiet,
) -> Result<(Vec<Audit>, Table)> {
    let training = measured(stream, &dataset.train, background, Some(path), quiet).context("--utility")?;
    let mut audits = vec![Audit::of("training photographs", &training)];
    let against = "test photographs";
    match measured(stream, &dataset.test, background, None, quiet) {
        Ok(table) => audits.push(Audit::of(against, &table)),
        Err(error) => {
            // Test photographs need not show every window, or be there at all.
            let missing = match error.downcast_ref::<UtilityError>() {
                Some(why @ (UtilityError::NoCamera | UtilityError::NoPhotograph { .. })) => why.to_string(),
                _ => return Err(error),
            };
            let (against, missing) = (against.to_owned(), Some(missing));
            audits.push(Audit { against, protocol: String::new(), levels: Vec::new(), missing });
        }
    }
    Ok((audits, training))
}

fn measured<S: Sync>(
    stream: &Stream,
    views: &Views<S>,
    background: [f32; 3],
    cache: Option<&Path>,
    quiet: Quiet,
) -> Result<Table> {
    let photographs = pipeline::reference_photographs(views, background)?;
    let (map, received) = (PacketMap::of(stream)?, stream.receive()?);
    let mut options = UtilityOptions::paper();
    options.settings.background = background;
    let references = References::Photographs(&photographs);
    // A table of an earlier training is replaced without a word: the folder is this one's.
    pipeline::utilities(&references, &received.content(), &map, &options, cache, quiet, &mut |_| ())
}
