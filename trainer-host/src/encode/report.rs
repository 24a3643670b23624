//! Reports an encoding: what was chosen, what it came to, and where every byte went.

use super::{
    Decisions, Ledger, QuantiserSteps, Target, cluster, decisions::QuantiserClass, evaluator::MeasuredViews,
};
use crate::stream::Stream;

/// An encoded scene.
///
/// # Examples
/// ```
/// use trainer_host::{
///     encode::{EncodeOptions, encode},
///     import::{Limits, synth},
/// };
///
/// let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..Default::default() };
/// let scene = synth::make(&options, &Limits::default())?;
/// let options = EncodeOptions { pictures: 0, ..Default::default() };
/// let encoded = encode(&scene, &options, &trainer_host::encode::no_progress)?;
/// let file = encoded.stream.to_bytes()?;
/// println!("{} bytes, {:.0} bits per Gaussian", file.len(), encoded.report.ledger.bits_per_gaussian());
/// // Which of the scene's Gaussians the first decoded one is.
/// assert!((encoded.order[0][0] as usize) < scene.max_count());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Encoded {
    /// The manifest and the packets.
    pub stream: Stream,
    /// What was chosen and what it came to.
    pub report: Report,
    /// Per epoch, the source index of each decoded Gaussian.
    pub order: Vec<Vec<u32>>,
    /// Everything that was chosen: [`write`](super::write) makes the same stream of them.
    pub decisions: Decisions,
}

/// What an encoding came to.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// Where every byte went.
    pub ledger: Ledger,
    /// Steps before quantiser classes scale them.
    pub quality: QuantiserSteps,
    /// Gaussians that share steps, the most sensitive first (`dgs1`; empty in `paper`).
    pub quantiser_classes: Vec<QuantiserClass>,
    /// How Gaussians were clustered, and what that gave.
    pub clustering: ClusteringReport,
    /// How the target was met, if there was one.
    pub reached: Option<TargetReport>,
    /// What the search of the steps came to, if there was one.
    pub searched: Option<SearchReport>,
}

impl Report {
    /// The report of a stream with this ledger that was written by `decisions`.
    pub(super) fn of(ledger: Ledger, decisions: &Decisions) -> Self {
        let made_from = decisions.made_from();
        Self {
            ledger,
            quality: made_from.quality,
            quantiser_classes: made_from.quantiser_classes.clone(),
            clustering: ClusteringReport::of(decisions),
            reached: None,
            searched: None,
        }
    }
}

/// How Gaussians were clustered (paper section 3), and the clusters that are sent.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ClusteringReport {
    /// Bounds and feature weights.
    pub options: cluster::ClusterOptions,
    /// Clusters over all epochs.
    pub clusters: usize,
    /// Gaussians in the smallest; 0 if there are none.
    pub smallest: usize,
    /// Mean number of Gaussians.
    pub mean: f64,
    /// Gaussians in the median cluster, the upper one of two.
    pub median: usize,
    /// Gaussians in the largest.
    pub largest: usize,
}

impl ClusteringReport {
    fn of(decisions: &Decisions) -> Self {
        let mut sizes = decisions.cluster_sizes();
        sizes.sort_unstable();
        Self {
            options: decisions.made_from().clustering,
            clusters: sizes.len(),
            smallest: sizes.first().copied().unwrap_or(0),
            mean: sizes.iter().sum::<usize>() as f64 / sizes.len().max(1) as f64,
            median: sizes.get(sizes.len() / 2).copied().unwrap_or(0),
            largest: sizes.last().copied().unwrap_or(0),
        }
    }
}

/// How a target was met.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct TargetReport {
    /// What was asked for.
    pub target: Target,
    /// Factor on the steps of [`EncodeOptions::quality`](super::EncodeOptions::quality).
    pub coarseness: f32,
    /// Encodings it took.
    pub encodes: usize,
    /// Of the stream, in the target's unit: bits per Gaussian, bytes or dB.
    pub value: f64,
    /// What a PSNR is a mean over.
    pub views: Option<MeasuredViews>,
}

/// What a search found.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SearchReport {
    /// Encodings it took, those at the end included.
    pub encodes: usize,
    /// Whether its steps are better than those it began with; if not, the stream has those.
    #[serde(rename = "kept")]
    pub is_better: bool,
    /// Bits on the wire over those without the search: at the same PSNR, or at the same size if
    /// that was asked for.
    pub bits: f64,
    /// PSNR from validation cameras above that without the search, dB.
    pub psnr_db: f64,
}
