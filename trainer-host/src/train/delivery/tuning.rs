//! A fine-tuning between two updates: on the same device it goes on from there bit for bit.
//!
//! The bytes of a file are little-endian: `DGSTUNED`, u16 version, u32 CRC-32 of what follows, then the
//! numbers in the postcard format.

use codec_core::internals::digest::Digest;
use serde::{Deserialize, Serialize};

use super::{
    adam::Adam,
    coded::Coded,
    error::DeliveryError,
    objective::Terms,
    parameters::Parameters,
    record::{Preregistration, hex},
    select::{Candidate, select},
    steps::Steps,
    view::Reference,
};
use crate::{
    encode::Decisions,
    stream::Stream,
    train::checkpoint::{CheckpointError, framed, unframed},
};

const MAGIC: &str = "DGSTUNED";
const VERSION: u16 = 3;

/// A fine-tuning between two updates.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Tuning {
    made_from: Origin,
    /// Updates made.
    pub(super) updates: usize,
    pub(super) parameters: Parameters,
    /// The parameters that were encoded last; none before the second encoding.
    pub(super) encoded: Option<Parameters>,
    pub(super) adam: Adam,
    pub(super) steps: Steps,
    pub(super) candidates: Vec<Candidate>,
    /// Of the candidate that the rule would take now: its parameters, and its decisions as JSON, since their
    /// form names itself.
    best: Option<(Parameters, String)>,
    pub(super) objective: Vec<f64>,
    pub(super) terms: Vec<Terms>,
}

/// What a fine-tuning depends on, as hashes.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Origin {
    config: String,
    scene: String,
    references: String,
    worlds: String,
}

impl Origin {
    /// Of what was registered, the first encoding, and references for training and for validation.
    pub(super) fn of(registration: &Preregistration, stream: &Stream, references: [&[Reference]; 2]) -> Self {
        let scene = stream
            .packets()
            .iter()
            .fold(Digest::new().bytes(stream.message()), |digest, packet| digest.bytes(packet));
        Self {
            config: registration.config_hash.clone(),
            scene: hex(scene.get()),
            references: references.map(references_hash).join(" "),
            worlds: registration.worlds.clone(),
        }
    }

    /// # Errors
    /// The first thing that differs.
    fn check(&self, now: &Self) -> Result<(), DeliveryError> {
        let parts = [
            (&self.config, &now.config, "the configuration, the seed or options of the encoder are"),
            (&self.scene, &now.scene, "the scene is"),
            (&self.references, &now.references, "the pictures that it is compared with are"),
            (&self.worlds, &now.worlds, "the recorded states are"),
        ];
        match parts.into_iter().find(|(then, now, _)| then != now) {
            Some((.., what)) => Err(DeliveryError::Resumed { what }),
            None => Ok(()),
        }
    }
}

/// Hash of pictures, their cameras and frames.
pub(super) fn references_hash(references: &[Reference]) -> String {
    hex(references.iter().fold(Digest::new(), with_reference).get())
}

fn with_reference(digest: Digest, reference: &Reference) -> Digest {
    let Reference { frame, camera, background, picture } = reference;
    let lens = camera.intrinsics();
    let mut digest = digest.bytes(&frame.to_le_bytes()).values(background).values(picture.rgb());
    let pose = camera.rotation().into_iter().flatten().chain(camera.translation());
    for value in [lens.fx, lens.fy, lens.cx, lens.cy].into_iter().chain(pose) {
        digest = digest.bytes(&value.to_le_bytes());
    }
    digest
}

impl Tuning {
    /// Before the first update.
    pub(super) fn begun(made_from: Origin, parameters: Parameters, steps: Steps) -> Self {
        Self {
            made_from,
            updates: 0,
            adam: Adam::new(parameters.count()),
            parameters,
            encoded: None,
            steps,
            candidates: Vec::new(),
            best: None,
            objective: Vec::new(),
            terms: Vec::new(),
        }
    }

    /// The same, if it is a fine-tuning of at most `updates` updates `made_from` the same, whose first
    /// encoding is `coded` with `parameters`.
    ///
    /// # Errors
    /// What differs.
    pub(super) fn checked(
        self,
        made_from: &Origin,
        coded: &Coded,
        parameters: &Parameters,
        updates: usize,
    ) -> Result<Self, DeliveryError> {
        self.made_from.check(made_from)?;
        let lists = [Some(&self.parameters), self.encoded.as_ref(), self.best.as_ref().map(|best| &best.0)];
        let sound = lists.into_iter().flatten().all(|list| list.is_like(parameters))
            && self.adam.is_sound(parameters.count())
            && self.steps.is_sound(&coded.encoded.decisions)
            && self.updates <= updates
            && self.objective.len() == self.updates
            && self.terms.len() == self.updates
            && self.best.is_some() != self.candidates.is_empty();
        if sound {
            Ok(self)
        } else {
            Err(DeliveryError::Resumed { what: "numbers of Gaussians, steps or updates are" })
        }
    }

    /// Updates made.
    pub fn updates(&self) -> usize {
        self.updates
    }

    /// The objective of each update.
    pub fn objective(&self) -> &[f64] {
        &self.objective
    }

    /// Terms of the objective, update by update.
    pub fn terms(&self) -> &[Terms] {
        &self.terms
    }

    /// What validation has seen.
    pub fn candidates(&self) -> &[Candidate] {
        &self.candidates
    }

    /// Adds a candidate, the scene of now by `decisions`; at most so many bytes on the wire are allowed, if
    /// any number is.
    ///
    /// # Errors
    /// [`DeliveryError::Resumed`] for decisions that JSON cannot hold.
    pub(super) fn add(
        &mut self,
        candidate: Candidate,
        decisions: &Decisions,
        allowed: Option<u64>,
    ) -> Result<(), DeliveryError> {
        self.candidates.push(candidate);
        if select(&self.candidates, allowed) == Some(self.candidates.len() - 1) {
            let text = serde_json::to_string(decisions).map_err(|_| DECISIONS)?;
            self.best = Some((self.parameters.clone(), text));
        }
        Ok(())
    }

    /// Whether there is a candidate.
    pub(super) fn has_best(&self) -> bool {
        self.best.is_some()
    }

    /// Parameters and decisions of the candidate that the rule takes; none without candidates.
    ///
    /// # Errors
    /// Decisions in the checkpoint that are none.
    pub(super) fn best(&self) -> Result<Option<(Parameters, Decisions)>, DeliveryError> {
        let Some((parameters, text)) = &self.best else { return Ok(None) };
        let decisions = serde_json::from_str(text).map_err(|_| DECISIONS)?;
        Ok(Some((parameters.clone(), decisions)))
    }

    /// The bytes of a file.
    ///
    /// # Errors
    /// Never for one that [`resume`](super::resume) made.
    pub fn to_bytes(&self) -> Result<Vec<u8>, CheckpointError> {
        framed(MAGIC, VERSION, self)
    }

    /// Reads the bytes of a file. Memory is bounded by their number.
    ///
    /// # Errors
    /// Other bytes than [`Tuning::to_bytes`] gives.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, CheckpointError> {
        unframed(MAGIC, VERSION, bytes)
    }
}

/// Decisions that cannot be written or read.
const DECISIONS: DeliveryError = DeliveryError::Resumed { what: "the decisions of the encoder are" };
