//! Prepares what the studies of packet-conditioned training share: a scene, finer truth, test states, and
//! figures.

mod photographs;

use std::ops::ControlFlow::Continue;

use anyhow::Result;
use render_host::{Backend, Image, Settings};
use trainer_host::{
    Scene,
    encode::{self, EncodeOptions, Encoded, Protection},
    evaluator,
    train::delivery::{
        ChannelRanges, DeliveryOptions, Evaluation, FineTuned, LossModel, LossUnit, Masks, Reference,
        Validation, Variant, fine_tune,
    },
    viewpoint::{Framing, Ring},
};

pub(super) use self::photographs::trained;
use crate::setup::{Setup, synth};

/// Mean length of a burst of lost packets.
pub(super) const BURST: f64 = 6.0;
/// Seed of the states that are tested on; training never sees it.
const TEST_SEED: u64 = 7001;

/// How large a study is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Size {
    /// Gaussians of the scene that is trained; the truth has three times as many.
    pub gaussians: usize,
    pub frames: usize,
    /// Cameras to train on.
    pub cameras: usize,
    /// Side of all pictures, pixels.
    pub side: u32,
    pub updates: usize,
    pub worlds: usize,
    /// States that are tested per loss.
    pub states: usize,
    pub seeds: u64,
}

impl Size {
    /// The size that `setup` asks for.
    pub(super) fn of(setup: &Setup) -> Self {
        if setup.quick {
            return Self {
                gaussians: 1000,
                frames: 4,
                cameras: 4,
                side: 40,
                updates: 24,
                worlds: 8,
                states: 24,
                seeds: 3,
            };
        }
        Self {
            gaussians: 1000,
            frames: 8,
            cameras: 6,
            side: 64,
            updates: 120,
            worlds: 16,
            states: 128,
            seeds: 3,
        }
    }

    /// As a protocol says it.
    pub(super) fn words(&self) -> String {
        format!(
            "synthetic sheet with four modes, {} Gaussians over {} frames, towards pictures of one with {} \
            (same motion), \
             {} validation cameras at {side}x{side}, tested on 2 held-out cameras and 2 frames, black \
             background, profile dgs1 with packets of 400 bytes and blocks of 16, {} updates of {} worlds",
            self.gaussians,
            self.frames,
            3 * self.gaussians,
            self.cameras,
            self.updates,
            self.worlds,
            side = self.side
        )
    }
}

/// A scene, what it should look like, and its first encoding.
pub(super) struct Study {
    pub scene: Scene,
    pub training: Vec<Reference>,
    pub test: Vec<Reference>,
    /// What follows each test picture: the next frame from its camera, where there is one.
    pub following: Vec<Option<Image>>,
    pub encoded: Encoded,
    /// How the scene is encoded, at first and while it is trained.
    pub coding: EncodeOptions,
    pub size: Size,
}

impl Study {
    /// The study of size `size`.
    ///
    /// # Errors
    /// What the renderer or the encoder refuses.
    pub(super) fn make(size: Size) -> Result<Self> {
        let scene = synth("cloth", size.gaussians, size.frames)?;
        let truth = synth("cloth", 3 * size.gaussians, size.frames)?;
        let framing = Framing::of(&truth);
        let last = size.frames as u32 - 1;
        let pictures = |ring, cameras, frames: &[u32]| -> Result<Vec<Reference>> {
            let mut references = Vec::new();
            for camera in framing.ring(ring, cameras, (size.side, size.side))? {
                let pictures =
                    evaluator::references(&truth, frames, &camera, &Settings::default(), &Backend::Cpu)?;
                let background = Settings::default().background;
                for (&frame, picture) in frames.iter().zip(pictures) {
                    references.push(Reference { frame, camera: camera.clone(), background, picture });
                }
            }
            Ok(references)
        };
        let all: Vec<u32> = (0..=last).collect();
        let training = pictures(Ring::Validation, size.cameras, &all)?;
        let test = pictures(Ring::HeldOut, 2, &[last / 3, last])?;
        let settings = Settings::default();
        let next = |reference: &Reference| -> Result<Option<Image>> {
            let frame = reference.frame + 1;
            if frame > last {
                return Ok(None);
            }
            let mut pictures =
                evaluator::references(&truth, &[frame], &reference.camera, &settings, &Backend::Cpu)?;
            Ok(pictures.pop())
        };
        let following = test.iter().map(next).collect::<Result<_>>()?;
        let coding = coding();
        let encoded = encode::encode(&scene, &coding, &trainer_host::encode::no_progress)?;
        Ok(Self { scene, training, test, following, encoded, coding, size })
    }

    /// The same with parity of `repair`.
    ///
    /// # Errors
    /// What the encoder refuses.
    pub(super) fn protected(self, repair: Protection) -> Result<Self> {
        let coding = EncodeOptions { repair, ..self.coding };
        let encoded = encode::encode(&self.scene, &coding, &trainer_host::encode::no_progress)?;
        Ok(Self { encoded, coding, ..self })
    }

    /// The test states after `loss`, by packets of the first encoding: the same for every checkpoint.
    ///
    /// # Errors
    /// A stream whose manifest does not hold.
    pub(super) fn masks(&self, loss: LossModel) -> Result<Masks> {
        self.masks_by(loss, LossUnit::Packet)
    }

    /// The same by `unit`: packets, or completion groups, of which all is lost at once.
    ///
    /// # Errors
    /// As [`Study::masks`].
    pub(super) fn masks_by(&self, loss: LossModel, unit: LossUnit) -> Result<Masks> {
        Ok(Masks::draw(&self.encoded.stream, loss, unit, self.size.states, TEST_SEED)?)
    }

    /// The test states after links drawn from `ranges`, with their display deadlines.
    ///
    /// # Errors
    /// As [`Study::masks`].
    pub(super) fn link_masks(&self, ranges: &ChannelRanges) -> Result<Masks> {
        let (stream, states) = (&self.encoded.stream, self.size.states);
        Ok(Masks::draw_links(stream, ranges, LossUnit::Packet, states, TEST_SEED)?)
    }

    /// Trains under `options`.
    ///
    /// # Errors
    /// What training refuses.
    pub(super) fn train(&self, options: &DeliveryOptions) -> Result<FineTuned> {
        let (scene, training) = (&self.scene, &self.training);
        Ok(fine_tune(scene, training, options, &Backend::Cpu, &|_| Continue(()))?)
    }

    /// Options of `variant` at this study's size; the last scene is taken.
    pub(super) fn options(&self, variant: Variant) -> DeliveryOptions {
        DeliveryOptions {
            worlds: self.size.worlds,
            updates: self.size.updates,
            validation: Validation { candidates: 0, ..Validation::default() },
            encode: self.coding.clone(),
            ..DeliveryOptions::of(variant)
        }
    }

    /// What the states of `masks` show of a trained scene on the test pictures.
    ///
    /// # Errors
    /// States of another stream.
    pub(super) fn evaluate(&self, tuned: &FineTuned, masks: &Masks) -> Result<Evaluation> {
        Ok(trainer_host::train::delivery::evaluate(&tuned.scene, &tuned.decisions, masks, &self.test)?)
    }

    /// What the states of `masks` show of the scene as it was given.
    ///
    /// # Errors
    /// As [`Study::evaluate`].
    pub(super) fn evaluate_given(&self, masks: &Masks) -> Result<Evaluation> {
        let (scene, decisions) = (&self.scene, &self.encoded.decisions);
        Ok(trainer_host::train::delivery::evaluate(scene, decisions, masks, &self.test)?)
    }
}

/// Small packets and blocks, so that a small scene has many, and one quantiser class.
fn coding() -> EncodeOptions {
    EncodeOptions { packet_bytes: 400, block_len: 16, pictures: 0, ..EncodeOptions::default() }
}

/// Mean and standard deviation (of a sample) of `values`.
pub(super) fn mean_and_deviation(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    (mean, if values.len() < 2 { 0.0 } else { (squares / (n - 1.0)).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviations_are_those_of_a_sample() {
        assert_eq!(mean_and_deviation(&[2.0, 4.0, 6.0]), (4.0, 2.0));
        assert_eq!(mean_and_deviation(&[3.0]), (3.0, 0.0));
    }
}
