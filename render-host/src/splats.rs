//! Splats are the borrowed Gaussians that a renderer takes.

use codec_core::{Gaussian, ShDegree};

/// Gaussians of one instant and their higher harmonic bands, borrowed.
///
/// Values are not checked: a NaN or a zero quaternion is skipped and counted while rendering, because a
/// state decoded from what happened to arrive must always give a picture.
///
/// ```
/// use render_host::{Gaussian, ShDegree, Splats};
///
/// let gaussians = [Gaussian { scale: [0.1; 3], opacity: 0.9, ..Gaussian::ABSENT }];
/// assert_eq!(Splats::plain(&gaussians).len(), 1);
/// // With harmonics of degree 1: nine numbers per Gaussian.
/// let degree = ShDegree::new(1).ok_or("degrees are 0 to 3")?;
/// assert!(Splats::new(&gaussians, &[0.0; 9], degree).is_ok());
/// assert!(Splats::new(&gaussians, &[], degree).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Splats<'a> {
    gaussians: &'a [Gaussian],
    /// Exactly `sh_degree.rest_len()` values per Gaussian.
    sh_rest: &'a [f32],
    sh_degree: ShDegree,
    /// Per Gaussian a degree above which all its coefficients are zero; empty where nobody looked.
    bands: &'a [u8],
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
    /// `bands` has the wrong length.
    #[error("bands: found {found} degrees, need {needed}, one per Gaussian")]
    BandsLength {
        /// Degrees found.
        found: usize,
        /// Degrees needed.
        needed: usize,
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
        Ok(Self { gaussians, sh_rest, sh_degree, bands: &[] })
    }

    /// N Gaussians whose colour does not depend on the view. Beyond `u32::MAX - 1` the rest is left out.
    pub fn plain(gaussians: &'a [Gaussian]) -> Self {
        let n = gaussians.len().min(u32::MAX as usize - 1);
        Self { gaussians: &gaussians[..n], sh_rest: &[], sh_degree: ShDegree::ZERO, bands: &[] }
    }

    /// The same Gaussians, with the degree that each one holds, as [`Splats::used_bands`] finds it: bands
    /// above it are not weighed (`Settings::sh_by_need`). A degree below what a Gaussian holds changes its
    /// colour; one above costs time and nothing else.
    ///
    /// # Errors
    /// Not one degree per Gaussian.
    pub fn with_bands(self, bands: &'a [u8]) -> Result<Self, SplatsError> {
        let (found, needed) = (bands.len(), self.gaussians.len());
        if found != needed {
            return Err(SplatsError::BandsLength { found, needed });
        }
        Ok(Self { bands, ..self })
    }

    /// Per Gaussian the highest degree (0..=3) in which a coefficient is not zero; a NaN is not zero.
    /// Higher bands do not move with frames, so once per scene is enough.
    pub fn used_bands(&self) -> Vec<u8> {
        (0..self.len()).map(|index| highest_degree(self.rest(index))).collect()
    }

    /// The degree of Gaussian `index` as far as it is known, 0..=3.
    pub(crate) fn band(&self, index: usize) -> u8 {
        self.bands.get(index).copied().unwrap_or(u8::MAX).min(self.sh_degree.get())
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
        let start = index.saturating_mul(each);
        self.sh_rest.get(start..start.saturating_add(each)).unwrap_or(&[])
    }
}

/// The highest degree in which one of the coefficients `rest` of a Gaussian is not zero.
pub(crate) fn highest_degree(rest: &[f32]) -> u8 {
    let used = rest.iter().rposition(|&v| v != 0.0).map_or(0, |last| last + 1);
    match used {
        0 => 0,
        1..=9 => 1,
        10..=24 => 2,
        _ => 3,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_band_is_used_by_its_last_coefficient() {
        let mut rest = [0.0f32; 45];
        for (at, degree) in [(0, 1), (8, 1), (9, 2), (23, 2), (24, 3), (44, 3)] {
            rest.fill(0.0);
            assert_eq!(highest_degree(&rest), 0);
            rest[at] = f32::NAN;
            assert_eq!(highest_degree(&rest), degree);
        }
        assert_eq!(highest_degree(&[]), 0);
        let gaussians = [Gaussian::ABSENT; 2];
        let error = Splats::plain(&gaussians).with_bands(&[0]).unwrap_err().to_string();
        assert!(error.contains("found 1") && error.contains("need 2"), "{error}");
    }

    #[test]
    fn a_wrong_length_is_named_with_both_numbers() {
        let gaussians = [Gaussian::ABSENT; 2];
        let degree = ShDegree::new(1).unwrap();
        let error = Splats::new(&gaussians, &[0.0; 17], degree).unwrap_err().to_string();
        assert!(error.contains("found 17") && error.contains("need 18"), "{error}");
        let rest: Vec<f32> = (0..18).map(|i| i as f32).collect();
        let splats = Splats::new(&gaussians, &rest, degree).unwrap();
        assert_eq!(splats.rest(1)[0], 9.0);
        assert!(splats.rest(usize::MAX).is_empty());
        assert!(splats.rest(2).is_empty() && Splats::plain(&gaussians).rest(1).is_empty());
    }
}
