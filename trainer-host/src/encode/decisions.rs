//! Decisions hold everything the encoder chose for one stream, as plain data.
//!
//! [`decide`](super::decide) makes them and [`write`](super::write) follows them: writing has no choice
//! of its own, so the same scene and the same decisions give the same bytes. As JSON they can be read,
//! changed and replayed.

mod check;

pub(super) use check::misfit;

use codec_core::internals::{
    quant::{Class, Quantiser},
    rans::table::Table,
    wire::manifest::Quant,
};
use serde::{Deserialize, Serialize};

use super::{EncodeError, Protection, QuantiserSteps, cluster};

/// Everything that was chosen for one stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "profile", rename_all = "snake_case")]
pub enum Decisions {
    /// For profile `dgs1`.
    Dgs1(Dgs1Decisions),
    /// For profile `paper`.
    Paper(PaperDecisions),
}

impl Decisions {
    /// What the choices were made from.
    pub const fn made_from(&self) -> &DecisionInputs {
        match self {
            Self::Dgs1(decisions) => &decisions.made_from,
            Self::Paper(decisions) => &decisions.made_from,
        }
    }

    /// These epochs and then those of `next`, for [`reencode`](super::reencode) on a scene of both: it
    /// decides tables anew, and what both share is as here. Nothing for profile `paper` or for two profiles.
    #[must_use]
    pub fn followed_by(self, next: Self) -> Option<Self> {
        let (Self::Dgs1(mut decisions), Self::Dgs1(next)) = (self, next) else { return None };
        decisions.made_from.quantiser_classes.extend(next.made_from.quantiser_classes);
        decisions.made_from.epoch_gaussians.extend(next.made_from.epoch_gaussians);
        decisions.epochs.extend(next.epochs);
        Some(Self::Dgs1(decisions))
    }

    /// Gaussians of each cluster, epoch after epoch.
    pub fn cluster_sizes(&self) -> Vec<usize> {
        match self {
            Self::Dgs1(d) => d.epochs.iter().flat_map(|e| &e.clusters).map(|c| c.gaussians.len()).collect(),
            Self::Paper(d) => d.epochs.iter().flat_map(|e| &e.clusters).map(Vec::len).collect(),
        }
    }
}

/// What choices were made from. A record: writing does not read it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionInputs {
    /// Steps before quantiser classes scale them.
    pub quality: QuantiserSteps,
    /// Gaussians that share steps, the most sensitive first (`dgs1`; empty in `paper`).
    pub quantiser_classes: Vec<QuantiserClass>,
    /// How Gaussians were clustered.
    pub clustering: cluster::ClusterOptions,
    /// Gaussians of each epoch of the scene, those that are never drawn included; empty where nobody says.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub epoch_gaussians: Vec<usize>,
}

/// Gaussians that share steps.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct QuantiserClass {
    /// How many of the scene's, over all epochs.
    pub gaussians: u64,
    /// Their steps.
    pub quality: QuantiserSteps,
}

/// What was chosen for a stream of profile `dgs1`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dgs1Decisions {
    /// What the choices were made from.
    pub made_from: DecisionInputs,
    /// Gaussians per block, 1..=256.
    pub block_len: usize,
    /// Where packets are cut: the most bytes of one, header and CRC included, 200..=1226.
    pub packet_bytes: usize,
    /// Whether every block has a proxy in the manifest.
    pub proxies: bool,
    /// Parity per kind of packets.
    pub repair: Protection,
    /// Per epoch of the scene.
    pub epochs: Vec<EpochDecisions>,
    /// The entropy tables that table sets name.
    pub tables: Vec<TableForm>,
    /// Per stream of symbols, the tables that its symbol runs choose from.
    pub table_sets: Vec<Vec<TableSetEntry>>,
}

/// What was chosen for one epoch.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpochDecisions {
    /// What positions are counted from, scene units.
    pub origin: [f32; 3],
    /// In which of its equivalent forms each rotation is sent.
    pub canonical_rotation: CanonicalRotation,
    /// Quantisers that clusters refer to.
    pub quantisers: Vec<Quantisers>,
    /// Clusters in the order of their ids.
    pub clusters: Vec<ClusterDecisions>,
    /// Motion windows in order; none if nothing moves.
    pub windows: Vec<WindowDecisions>,
    /// What is added to each block's proxy, clusters in order; none, or one per block.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub proxy_changes: Vec<ProxyChange>,
}

/// What is added to the proxy of one block before it is quantised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProxyChange {
    /// To the centre, scene units.
    pub offset: [f32; 3],
    /// To the natural log of all three scales.
    pub log_scale: f32,
    /// To the linear opacity.
    pub opacity: f32,
    /// To band 0 of colour.
    pub sh0: [f32; 3],
}

/// How rotations and scales are sent; every form describes the same covariances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum CanonicalRotation {
    /// As the scene has them.
    AsGiven,
    /// Axes permuted and flipped so that the turn is the least.
    LeastTurn,
    /// As [`CanonicalRotation::LeastTurn`], and turns that do not show follow the cluster's.
    FollowingCluster,
}

/// Quantisers of all attributes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Quantisers {
    /// Of canonical values, by [`Class`].
    pub canonical: [QuantiserDecision; Class::COUNT],
    /// Of motion coefficients, by moving class.
    pub motion: [QuantiserDecision; Class::MOVING],
}

/// One quantiser.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuantiserDecision {
    /// Step at level 3, in the attribute's unit, 1e-9..=1e9.
    pub step: f32,
    /// Step of levels 0, 1, 2 over that of the level above it, each at least 1.
    pub ratios: [u8; 3],
    /// Whether first-level symbols are differences to the Gaussian before.
    pub predicted: bool,
    /// Whether triples of components are coded as their mean and differences.
    pub decorrelated: bool,
}

/// What was chosen for one cluster's canonical values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClusterDecisions {
    /// Which of [`EpochDecisions::quantisers`].
    pub quantisers: usize,
    /// Highest degree of spherical harmonics sent, 0..=3.
    pub harmonic_degree: u8,
    /// Highest level sent, 0..=3.
    pub highest_level: u8,
    /// Its members, as indices into the epoch, in the order in which they are sent.
    pub gaussians: Vec<u32>,
    /// Per level, the table of each symbol run: a digit that indexes the table set of its stream.
    pub table_indices: [String; 4],
}

/// What was chosen for one motion window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct WindowDecisions {
    /// Frames it covers, 1..=64.
    pub frames: usize,
    /// Shared temporal basis of position residuals: vectors over the frames, in 1/16384.
    pub basis: Vec<Vec<i16>>,
    /// Per cluster of the epoch.
    pub motions: Vec<MotionDecisions>,
}

/// What was chosen for one cluster in one window.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotionDecisions {
    /// How the cluster moves as a whole.
    pub track: TrackForm,
    /// Fineness of the track: each unit doubles its step.
    pub track_shift: u8,
    /// Coefficients per Gaussian and component: position, scale, rotation, opacity, band 0.
    pub ranks: [u8; Class::MOVING],
    /// Highest level sent, 0..=3.
    pub highest_level: u8,
    /// As [`ClusterDecisions::table_indices`].
    pub table_indices: [String; 4],
}

impl MotionDecisions {
    /// Whether nothing of the cluster moves in the window.
    pub fn is_still(&self) -> bool {
        self.track == TrackForm::Static && self.ranks == [0; Class::MOVING]
    }
}

/// How a cluster moves as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrackForm {
    /// Not at all.
    Static,
    /// It turns and glides.
    Rigid,
    /// It also scales and shears.
    Affine,
}

/// One entropy table.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TableForm {
    /// A table of the built-in family, by its index.
    Family(u8),
    /// A table of its own.
    Frequencies {
        /// Raw low bits per value, 0..=8.
        raw_bits: u8,
        /// Token and frequency, frequencies of 2048 in all; token 0 is the escape.
        frequencies: Vec<(u8, u16)>,
    },
}

/// One table of a table set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TableSetEntry {
    /// Which of [`Dgs1Decisions::tables`].
    pub table: u8,
    /// Bits of the code word that selects it.
    pub code_bits: u8,
}

/// What was chosen for a stream of profile `paper`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperDecisions {
    /// What the choices were made from.
    pub made_from: DecisionInputs,
    /// Parity per kind of packets.
    pub repair: Protection,
    /// Whether probabilities follow the symbols of a chunk, in place of tables in the manifest.
    #[serde(default)]
    pub context_coder: bool,
    /// Per epoch of the scene.
    pub epochs: Vec<PaperEpochDecisions>,
}

/// What was chosen for one epoch in profile `paper`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PaperEpochDecisions {
    /// What positions are counted from, scene units.
    pub origin: [f32; 3],
    /// Quantisers of all clusters.
    pub quantisers: Quantisers,
    /// Most vectors of the shared temporal basis.
    pub rank: usize,
    /// Members of each cluster, in the order in which they are sent.
    pub clusters: Vec<Vec<u32>>,
}

impl Quantisers {
    /// `quant` as plain data.
    pub(super) fn of(quant: &Quant) -> Self {
        let plain = |q: &Quantiser| QuantiserDecision {
            step: q.step(codec_core::internals::ids::Level::ALL[3]),
            ratios: [1, 2, 3].map(|level| q.ratio(codec_core::internals::ids::Level::ALL[level])),
            predicted: q.predicted(),
            decorrelated: q.decorrelated(),
        };
        Self { canonical: quant.canonical.each_ref().map(plain), motion: quant.motion.each_ref().map(plain) }
    }

    /// As the manifest has them.
    ///
    /// # Errors
    /// A step or ratio out of range.
    pub(super) fn quant(&self) -> Result<Quant, EncodeError> {
        let quantiser = |d: &QuantiserDecision| -> Result<Quantiser, EncodeError> {
            Ok(Quantiser::new(d.step, d.ratios, d.predicted)?.with_decorrelated(d.decorrelated))
        };
        let first = quantiser(&self.canonical[0])?;
        let mut quant = Quant { canonical: [first; Class::COUNT], motion: [first; Class::MOVING] };
        for (target, decision) in quant.canonical.iter_mut().zip(&self.canonical) {
            *target = quantiser(decision)?;
        }
        for (target, decision) in quant.motion.iter_mut().zip(&self.motion) {
            *target = quantiser(decision)?;
        }
        Ok(quant)
    }
}

impl TableForm {
    /// `table` as plain data.
    pub(super) fn of(table: &Table) -> Self {
        let mut wire = Vec::new();
        table.write(|bytes| wire.extend_from_slice(bytes));
        match wire[..] {
            [codec_core::internals::rans::table::NAMED, index] => Self::Family(index),
            _ => Self::Frequencies {
                raw_bits: table.raw_bits(),
                frequencies: (0..=u8::MAX)
                    .map(|token| (token, table.frequency(token) as u16))
                    .filter(|(_, frequency)| *frequency > 0)
                    .collect(),
            },
        }
    }

    /// The table.
    ///
    /// # Errors
    /// An index that names none, raw bits out of range, frequencies that do not sum to 2048.
    pub(super) fn table(&self) -> Result<Table, EncodeError> {
        match self {
            Self::Family(index) => Ok(Table::named(*index)?),
            Self::Frequencies { raw_bits, frequencies } => {
                let mut all = [0u16; 256];
                frequencies.iter().for_each(|&(token, frequency)| all[usize::from(token)] = frequency);
                Ok(Table::new(all, *raw_bits)?)
            }
        }
    }
}

/// Table indices, each below 8, as a string of digits.
pub(super) fn digits(indices: &[u8]) -> String {
    indices.iter().map(|&index| char::from(b'0' + index)).collect()
}
