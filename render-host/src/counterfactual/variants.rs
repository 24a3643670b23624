//! Holds the scene of a counterfactual question: Gaussians with the group each belongs to.

use super::CounterfactualError;
use crate::Splats;

/// Gaussians of one instant, each in one of `count` groups, borrowed.
#[derive(Clone, Copy, Debug)]
pub struct Variants<'a> {
    splats: Splats<'a>,
    /// One id below `count` per Gaussian.
    groups: &'a [u32],
    count: usize,
}

impl<'a> Variants<'a> {
    /// Gaussian `i` belongs to group `groups[i]`, below `count`.
    ///
    /// # Errors
    /// Another number of ids than of Gaussians, or an id that is not below `count`.
    pub fn new(splats: Splats<'a>, groups: &'a [u32], count: usize) -> Result<Self, CounterfactualError> {
        let (found, needed) = (groups.len(), splats.len());
        if found != needed {
            return Err(CounterfactualError::Ids { found, needed });
        }
        if let Some(&group) = groups.iter().find(|&&g| g as usize >= count) {
            return Err(CounterfactualError::Group { group, count });
        }
        Ok(Self { splats, groups, count })
    }

    /// The Gaussians.
    pub fn splats(&self) -> Splats<'a> {
        self.splats
    }

    /// Group of each Gaussian.
    pub fn groups(&self) -> &'a [u32] {
        self.groups
    }

    /// Number of groups.
    pub fn count(&self) -> usize {
        self.count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use codec_core::Gaussian;

    #[test]
    fn wrong_ids_are_named() {
        let gaussians = [Gaussian::ABSENT; 3];
        let splats = Splats::plain(&gaussians);
        let error = Variants::new(splats, &[0, 1], 2).unwrap_err().to_string();
        assert!(error.contains("found 2 ids for 3"), "{error}");
        let error = Variants::new(splats, &[0, 1, 2], 2).unwrap_err();
        assert_eq!(error, CounterfactualError::Group { group: 2, count: 2 });
        assert_eq!(Variants::new(splats, &[0, 1, 1], 2).unwrap().count(), 2);
    }
}
