//! The report of an encoding: what was chosen, what it came to, and where every byte went.

use super::{Ledger, Quality, Reached, Searched};
use crate::stream::Stream;

/// An encoded scene.
#[derive(Clone, Debug)]
pub struct Encoded {
    /// The manifest and the packets.
    pub stream: Stream,
    /// What was chosen and what it came to.
    pub report: Report,
    /// Per epoch, the source index of each decoded Gaussian.
    pub order: Vec<Vec<u32>>,
}

/// What an encoding came to.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// Where every byte went.
    pub ledger: Ledger,
    /// Steps before quantiser classes scale them.
    pub quality: Quality,
    /// Gaussians that share steps, the most sensitive first (`dgs1`; empty in `paper`).
    pub quantiser_classes: Vec<QuantiserClass>,
    /// How the target was met, if there was one.
    pub reached: Option<Reached>,
    /// What the search of the steps came to, if there was one.
    pub searched: Option<Searched>,
}

/// Gaussians that share steps.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct QuantiserClass {
    /// How many of the scene's, over all epochs.
    pub gaussians: u64,
    /// Their steps.
    pub quality: Quality,
}
