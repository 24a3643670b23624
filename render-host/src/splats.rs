//! The view of Gaussians that a renderer takes.

use codec_core::{Gaussian, gaussian::ShDegree};

/// Gaussians of one instant and their higher harmonic bands, borrowed.
///
/// Values are not checked: a NaN or a zero quaternion is skipped and counted while rendering, because a
/// state decoded from what happened to arrive must always give a picture.
#[derive(Clone, Copy, Debug)]
pub struct Splats<'a> {
    gaussians: &'a [Gaussian],
    /// Exactly `sh_degree.rest_len()` values per Gaussian.
    sh_rest: &'a [f32],
    sh_degree: ShDegree,
}

/// Slices that do not describe the same Gaussians.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SplatsError {
    /// `sh_rest` has the wrong length.
    #[error(
        "sh_rest: found {found} values, need {needed} ({gaussians} Gaussians of degree {degree}, {each} each)"
    )]
    RestLength {
        /// Values found.
        found: usize,
        /// Values needed.
        needed: usize,
        /// Number of Gaussians.
        gaussians: usize,
        /// Harmonic degree.
        degree: u8,
        /// Values per Gaussian of that degree.
        each: usize,
    },
    /// More Gaussians than an index holds.
    #[error("found {found} Gaussians; up to 4294967294 are allowed")]
    TooMany {
        /// Gaussians found.
        found: usize,
    },
}

impl<'a> Splats<'a> {
    /// N Gaussians with `sh_degree.rest_len()` values each in `sh_rest` (Gaussian-major, then
    /// coefficient, then channel).
    ///
    /// # Errors
    /// `sh_rest` has another length, or N is above `u32::MAX - 1`.
    pub fn new(
        gaussians: &'a [Gaussian],
        sh_rest: &'a [f32],
        sh_degree: ShDegree,
    ) -> Result<Self, SplatsError> {
        let (n, each, found) = (gaussians.len(), sh_degree.rest_len(), sh_rest.len());
        if n >= u32::MAX as usize {
            return Err(SplatsError::TooMany { found: n });
        }
        let needed = n.saturating_mul(each);
        if found != needed {
            let degree = sh_degree.get();
            return Err(SplatsError::RestLength { found, needed, gaussians: n, degree, each });
        }
        Ok(Self { gaussians, sh_rest, sh_degree })
    }

    /// N Gaussians whose colour does not depend on the view. Beyond `u32::MAX - 1` the rest is left out.
    pub fn plain(gaussians: &'a [Gaussian]) -> Self {
        let n = gaussians.len().min(u32::MAX as usize - 1);
        Self { gaussians: &gaussians[..n], sh_rest: &[], sh_degree: ShDegree::ZERO }
    }

    /// The Gaussians.
    pub fn gaussians(&self) -> &'a [Gaussian] {
        self.gaussians
    }

    /// Degree of the harmonics.
    pub fn sh_degree(&self) -> ShDegree {
        self.sh_degree
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.gaussians.len()
    }

    /// True when there is nothing to draw.
    pub fn is_empty(&self) -> bool {
        self.gaussians.is_empty()
    }

    /// Harmonic coefficients above band 0 of Gaussian `index`; empty past the end and at degree 0.
    pub fn rest(&self, index: usize) -> &'a [f32] {
        let each = self.sh_degree.rest_len();
        self.sh_rest.get(index * each..(index + 1) * each).unwrap_or(&[])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_length_is_named_with_both_numbers() {
        let gaussians = [Gaussian::ABSENT; 2];
        let degree = ShDegree::new(1).unwrap();
        let error = Splats::new(&gaussians, &[0.0; 17], degree).unwrap_err().to_string();
        assert!(error.contains("found 17") && error.contains("need 18"), "{error}");
        let rest: Vec<f32> = (0..18).map(|i| i as f32).collect();
        let splats = Splats::new(&gaussians, &rest, degree).unwrap();
        assert_eq!(splats.rest(1)[0], 9.0);
        assert!(splats.rest(2).is_empty() && Splats::plain(&gaussians).rest(1).is_empty());
    }
}
