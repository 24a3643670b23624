//! Holds the quantiser classes of one epoch: its clusters, which class each is in, and the steps of the
//! classes.

use crate::encode::QuantiserSteps;

/// The classes of one epoch.
#[derive(Clone, Debug)]
pub(in crate::encode) struct EpochClasses<'s> {
    /// Clusters, each of one class.
    pub sets: &'s [Vec<u32>],
    /// Class of each Gaussian of the epoch.
    pub of: &'s [u8],
    /// Steps of each class.
    pub qualities: Vec<QuantiserSteps>,
}

impl EpochClasses<'_> {
    /// The class of `set`, whose Gaussians all are of the same.
    pub fn of(&self, set: &[u32]) -> usize {
        set.first().and_then(|&i| self.of.get(i as usize)).map_or(0, |&s| s.into())
    }
}
