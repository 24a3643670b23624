//! Codes a scene while its parameters and steps change, within its packets and the size that was asked for.

use super::{
    coded::Coded, config::DeliveryOptions, error::DeliveryError, parameters::Parameters, steps::Steps,
};
use crate::{
    encode::{Decisions, EncodeError, Encoded, Target},
    scene::Scene,
};

/// Encodings in which a stream that is too large is made smaller, at most.
const ATTEMPTS: usize = 4;
/// What is saved at least where a stream is too large, of the size that was asked for: less than this is soon
/// too much again.
const LEAST_SAVED: f64 = 0.002;

/// How a scene is coded while its parameters and steps change.
pub(super) struct Coding<'a> {
    scene: &'a Scene,
    /// What the encoder chose.
    pub(super) decisions: Decisions,
    table_choices: usize,
    /// Values beyond the range of their symbols that the encoder's own steps leave.
    saturated: u64,
    /// Bytes on the wire, at most, where a size was asked for.
    pub(super) allowed: Option<u64>,
}

impl<'a> Coding<'a> {
    /// As in `coded`, the encoding of `scene` under `options`.
    pub(super) fn new(scene: &'a Scene, coded: &Coded, options: &DeliveryOptions) -> Self {
        let (encoded, table_choices) = (&coded.encoded, options.encode.table_choices);
        let saturated = encoded.report.ledger.saturated;
        let allowed = allowed_bytes(encoded, options.encode.target);
        Self { scene, decisions: encoded.decisions.clone(), table_choices, saturated, allowed }
    }

    /// The steps that a fine-tuning of `scene`, whose first encoding is `coded`, begins with.
    ///
    /// # Errors
    /// What the encoder refuses of other steps.
    pub(super) fn steps(
        scene: &Scene,
        coded: &Coded,
        options: &DeliveryOptions,
    ) -> Result<Steps, DeliveryError> {
        let encoded = &coded.encoded;
        let gaussians = encoded.order.iter().map(Vec::len).sum::<usize>().max(1);
        // R is in kilobits per Gaussian.
        let price = 8.0 * options.variant.weights(&options.weights).rate / (1000.0 * gaussians as f64);
        match options.learn_steps {
            true => Steps::learned(scene, encoded, options.encode.table_choices, price),
            false => Ok(Steps::fixed(&encoded.decisions)),
        }
    }

    /// The scene with `parameters`, coded with `steps`.
    ///
    /// # Errors
    /// As [`Coded::rewrite`].
    pub(super) fn with_steps(&self, steps: &Steps, parameters: &Parameters) -> Result<Coded, DeliveryError> {
        Coded::with_tables(self.scene, parameters, &steps.of(&self.decisions), self.table_choices)
    }

    /// The same; with the steps before their last change where these do not fit packets or symbols, and with
    /// longer ones where the stream is larger than allowed and steps are learned.
    ///
    /// # Errors
    /// As [`Coded::rewrite`].
    pub(super) fn coded(&self, steps: &mut Steps, parameters: &Parameters) -> Result<Coded, DeliveryError> {
        let first = self.with_steps(steps, parameters);
        let fits = match &first {
            Ok(coded) => coded.encoded.report.ledger.saturated <= self.saturated,
            Err(DeliveryError::Encode(EncodeError::BlockTooLarge { .. })) => false,
            Err(_) => true,
        };
        let mut coded = if fits || !steps.step_back() { first? } else { self.with_steps(steps, parameters)? };
        let Some(allowed) = self.allowed.map(|bytes| bytes as f64) else { return Ok(coded) };
        for _ in 0..ATTEMPTS {
            let excess = coded.encoded.report.ledger.wire() - allowed;
            if excess <= 0.0 || !steps.save(excess.max(LEAST_SAVED * allowed)) {
                break;
            }
            coded = self.with_steps(steps, parameters)?;
        }
        Ok(coded)
    }
}

/// Bytes on the wire that `target` allows of the scene whose encoding is `encoded`; none where it is no size.
fn allowed_bytes(encoded: &Encoded, target: Option<Target>) -> Option<u64> {
    let ledger = &encoded.report.ledger;
    match target? {
        Target::Bytes(bytes) => Some(bytes),
        Target::BitsPerGaussian(bits) => Some((bits * ledger.wire() / ledger.bits_per_gaussian()) as u64),
        Target::PsnrDb(_) => None,
    }
}
