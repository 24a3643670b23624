//! A checkpoint is a training at rest: it goes on from there bit for bit.
//!
//! Layout, little-endian: `DGSTRAIN`, u16 version, u32 CRC-32 of what follows, then the numbers in the
//! postcard format. Also a scene: `dgs encode` and `dgs render` read it at any number of frames.

use std::borrow::Cow;

use codec_core::{Up, internals::digest::Digest};
use rayon::prelude::*;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    error::TrainError,
    model::Model,
    options::TrainOptions,
    state::State,
    trainer::Trainer,
    views::{Dataset, PosedPhotograph},
};

const MAGIC: &str = "DGSTRAIN";
const VERSION: u16 = 14;
const HEADER: usize = 14;
/// A training between two steps, with what it was trained on and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Checkpoint {
    /// Name of the dataset.
    pub dataset: String,
    /// Frames of the clip.
    pub frames: usize,
    /// Frames per second that the scene is encoded at.
    pub frames_per_second: f64,
    /// Steps that the whole training is to take, where steps end it.
    length: Option<u32>,
    /// Number of the axis that points up.
    up: u8,
    options: TrainOptions,
    /// FNV-1a over names, times, cameras and pixels of the training views.
    views: u64,
    state: State,
    /// What to fall back to, where that is another state.
    fallback: Option<State>,
}

/// A file that is not a checkpoint, or a damaged one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CheckpointError {
    /// Not a checkpoint at all.
    #[error("not a checkpoint: it does not begin with {needed}")]
    Magic {
        /// What it is to begin with.
        needed: &'static str,
    },
    /// Written by another version.
    #[error("version is {found}; {allowed} is allowed")]
    Version {
        /// The version found.
        found: u16,
        /// The version that is read.
        allowed: u16,
    },
    /// Bytes changed or missing.
    #[error("damaged: {0}")]
    Damaged(&'static str),
}

impl Checkpoint {
    /// Most Gaussians times frames of the scene in a checkpoint: about 3 GB.
    pub const MAX_POSED: usize = 50_000_000;

    /// The state of `trainer`, whose next step is at `progress`, 0 to 1; 1: it is complete.
    pub fn of(trainer: &Trainer, dataset: &Dataset, progress: f64) -> Self {
        let [state, fallback] = trainer.states();
        Self {
            dataset: dataset.name.clone(),
            frames: dataset.frames,
            frames_per_second: trainer.frames_per_second(),
            length: None,
            up: dataset.up as u8,
            options: trainer.options().clone(),
            views: fingerprint(dataset),
            state: State { progress, ..state.clone() },
            fallback: Some(fallback).filter(|fallback| *fallback != state).cloned(),
        }
    }

    /// The same of a training that is to take so many steps in all; `None`: something else ends it.
    #[must_use]
    pub fn of_length(self, length: Option<u32>) -> Self {
        Self { length, ..self }
    }

    /// Steps that the whole training is to take, where steps end it.
    pub fn length(&self) -> Option<u32> {
        self.length
    }

    /// How the scene is trained.
    pub fn options(&self) -> &TrainOptions {
        &self.options
    }

    /// The scene; of a training near its end, the moving average of its parameters.
    pub fn model(&self) -> Cow<'_, Model> {
        self.state.scene()
    }

    /// Which way is up.
    pub fn up(&self) -> Up {
        Up::numbered(self.up).unwrap_or_default()
    }

    /// Steps taken.
    pub fn steps(&self) -> u32 {
        self.state.step
    }

    /// How far the training had come, 0 to 1.
    pub fn progress(&self) -> f64 {
        self.state.progress
    }

    /// Whether values are rounded by choices of the encoder that the training has made its own.
    pub fn has_rounded(&self) -> bool {
        self.state.finishing.has_rounded()
    }

    /// A trainer that goes on from here.
    ///
    /// # Errors
    /// Another dataset than the one the checkpoint was made on, or numbers that do not fit together.
    pub fn resume(self, dataset: &Dataset) -> Result<Trainer<'_>, TrainError> {
        if self.views != fingerprint(dataset) {
            return Err(TrainError::Checkpoint(format!(
                "made from {:?}, whose training images have other names, times, sizes, cameras or pixels \
                 than those of {:?}; of a scene, --cameras and --side must be the same",
                self.dataset, dataset.name
            )));
        }
        let fallback = self.fallback.unwrap_or_else(|| self.state.clone());
        Trainer::new(dataset, &self.options)?.with_state(self.state, fallback)
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// Never for a checkpoint made by [`Checkpoint::of`].
    pub fn to_bytes(&self) -> Result<Vec<u8>, CheckpointError> {
        framed(MAGIC, VERSION, self)
    }

    /// Reads the bytes of a file. Memory is bounded by their number.
    ///
    /// # Errors
    /// Other bytes than [`Checkpoint::to_bytes`] gives.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        let read: Self = unframed(MAGIC, VERSION, bytes)?;
        let posed = read.frames.saturating_mul(read.state.model.gaussians());
        let sound = read.state.is_sound()
            && read.fallback.as_ref().is_none_or(State::is_sound)
            && read.options.validate().is_ok()
            && read.frames_per_second.is_finite()
            && read.frames_per_second > 0.0
            && Up::numbered(read.up).is_some()
            && (1..=Self::MAX_POSED).contains(&posed);
        if sound { Ok(read) } else { Err(CheckpointError::Damaged("its numbers do not fit together")) }
    }
}

/// `value` as the bytes of a file: `magic`, eight bytes, version and checksum before it.
pub(super) fn framed(
    magic: &'static str,
    version: u16,
    value: &impl Serialize,
) -> Result<Vec<u8>, CheckpointError> {
    let body = postcard::to_stdvec(value).map_err(|_| CheckpointError::Damaged("cannot be written"))?;
    let mut out = Vec::with_capacity(HEADER + body.len());
    out.extend_from_slice(magic.as_bytes());
    out.extend_from_slice(&version.to_le_bytes());
    out.extend_from_slice(&crc32fast::hash(&body).to_le_bytes());
    out.extend_from_slice(&body);
    Ok(out)
}

/// What [`framed`] wrote. Memory is bounded by the number of bytes.
pub(super) fn unframed<T: DeserializeOwned>(
    magic: &'static str,
    version: u16,
    bytes: &[u8],
) -> Result<T, CheckpointError> {
    let header = bytes.split_at_checked(HEADER).filter(|(header, _)| header.starts_with(magic.as_bytes()));
    let Some((header, body)) = header else { return Err(CheckpointError::Magic { needed: magic }) };
    let found = u16::from_le_bytes([header[8], header[9]]);
    if found != version {
        return Err(CheckpointError::Version { found, allowed: version });
    }
    if crc32fast::hash(body).to_le_bytes() != header[10..14] {
        return Err(CheckpointError::Damaged("its checksum does not match its bytes"));
    }
    postcard::from_bytes(body)
        .map_err(|_| CheckpointError::Damaged("its numbers end early or have no meaning"))
}

/// FNV-1a, 64 bits, over what tells the training views of one dataset from those of another.
fn fingerprint(dataset: &Dataset) -> u64 {
    let mut digest = Digest::new();
    let photographs = dataset.train.photographs();
    // The checksum of a processor's instruction, since there may be a gigabyte.
    let sum = |view: &PosedPhotograph| crc32fast::hash(view.photograph.rgba());
    let sums: Vec<u32> = photographs.par_iter().map(sum).collect();
    for (view, sum) in photographs.iter().zip(sums) {
        let PosedPhotograph { name, camera, time, .. } = view;
        digest = [&view.foreground, &view.counted]
            .into_iter()
            .flatten()
            .fold(digest, |digest, mask| digest.bytes(&crc32fast::hash(mask.values()).to_le_bytes()));
        digest = digest.bytes(name.as_bytes()).bytes(&time.to_le_bytes()).bytes(&sum.to_le_bytes());
        let lens = camera.intrinsics();
        for value in [lens.fx, lens.fy, lens.cx, lens.cy] {
            digest = digest.bytes(&value.to_le_bytes());
        }
        digest = digest.bytes(&camera.width().to_le_bytes()).bytes(&camera.height().to_le_bytes());
        for value in camera.rotation().iter().flatten().chain(&camera.translation()) {
            digest = digest.bytes(&value.to_le_bytes());
        }
    }
    digest.get()
}
