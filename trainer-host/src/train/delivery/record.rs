//! Records what was fixed before training, and what came of it.

use std::{fs::File, io::Write as _, path::Path};

use super::{
    config::{DeliveryOptions, Weights},
    error::DeliveryError,
    masks::Masks,
    objective::Terms,
    select::{Candidate, RULE},
};

/// What is fixed before the first update, so that nothing is chosen by its result.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Preregistration {
    /// All options.
    pub options: DeliveryOptions,
    /// Hash of the options, how the scene is encoded included; 16 hexadecimal digits of FNV-1a.
    pub config_hash: String,
    /// Weights that count in the variant.
    pub weights: Weights,
    /// Hash of the validation states.
    pub validation_masks: String,
    /// Hash of all worlds of all updates, in order; empty in files that do not say.
    #[serde(default)]
    pub worlds: String,
    /// How a candidate is chosen.
    pub selection_rule: String,
}

impl Preregistration {
    /// That of `options`, with the states of validation and the hash of those of all updates.
    pub(super) fn of(options: &DeliveryOptions, validation: &Masks, worlds: u64) -> Self {
        Self {
            options: options.clone(),
            config_hash: hex(options.hash()),
            weights: options.variant.weights(&options.weights),
            validation_masks: hex(validation.hash()),
            worlds: hex(worlds),
            selection_rule: RULE.to_owned(),
        }
    }

    /// Writes it to `path` as JSON, whole or not at all.
    ///
    /// # Errors
    /// What the system says about the path.
    pub(super) fn write(&self, path: &Path) -> Result<(), DeliveryError> {
        let file = |error| DeliveryError::File { path: path.to_owned(), error };
        let text = serde_json::to_string_pretty(self).map_err(|error| file(error.into()))?;
        let mut beside = path.as_os_str().to_owned();
        beside.push(".part");
        let written = File::create(&beside)
            .and_then(|mut part| part.write_all(text.as_bytes()).and_then(|()| part.sync_all()))
            .and_then(|()| std::fs::rename(&beside, path));
        if written.is_err() {
            // Nothing half-written stays; why it failed is what matters.
            let _ = std::fs::remove_file(&beside);
        }
        written.map_err(file)
    }
}

/// A hash as 16 hexadecimal digits.
pub(super) fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

/// What was fixed, what every update measured, and what was chosen.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Record {
    /// What was fixed before.
    pub registration: Preregistration,
    /// Bytes on the wire that a candidate may take, where a size was asked for.
    #[serde(default)]
    pub allowed_bytes: Option<u64>,
    /// Why the fine-tuning ended before its last update, where it could not go on.
    #[serde(default)]
    pub stopped: Option<String>,
    /// The device that drew and differentiated states in the run that ended the fine-tuning, as
    /// [`render_host::Backend::name`] says it; empty in files that do not say.
    #[serde(default)]
    pub device: String,
    /// Objective of each update.
    pub objective: Vec<f64>,
    /// Its terms, update by update.
    pub terms: Vec<Terms>,
    /// What validation saw; empty without.
    pub candidates: Vec<Candidate>,
    /// Which of the candidates was taken.
    pub taken: Option<usize>,
}

impl Record {
    /// The scene as it was given, and the candidate that was taken; `None` without validation.
    pub fn before_and_taken(&self) -> Option<(&Candidate, &Candidate)> {
        Some((self.candidates.first()?, self.candidates.get(self.taken?)?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_that_names_no_device_is_read() {
        let masks = Masks { states: Vec::new() };
        let record = Record {
            registration: Preregistration::of(&DeliveryOptions::default(), &masks, 7),
            allowed_bytes: Some(900),
            stopped: None,
            device: "cpu".to_owned(),
            objective: vec![0.5],
            terms: vec![Terms::default()],
            candidates: Vec::new(),
            taken: None,
        };
        let mut json = serde_json::to_value(&record).unwrap();
        assert_eq!(serde_json::from_value::<Record>(json.clone()).unwrap(), record);
        assert_eq!(json.as_object_mut().unwrap().remove("device"), Some("cpu".into()));
        let read: Record = serde_json::from_value(json).unwrap();
        assert_eq!(read, Record { device: String::new(), ..record });
    }
}
