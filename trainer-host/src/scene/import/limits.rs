//! Bounds what a reader accepts of a file that it does not trust.

use super::error::{ErrorKind, Format, ImportError};

/// What errors call the number of Gaussians that a file says it has.
pub(super) const GAUSSIAN_COUNT: &str = "Gaussian count";

/// What a reader accepts of a file it does not trust.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Most Gaussians (or points, or mesh vertices) in one file.
    pub max_gaussians: usize,
    /// Most bytes in one file, one decompressed stream, or one sequence.
    pub max_bytes: u64,
    /// Give the readable part of a file that ends early or holds values that are not numbers, with a
    /// note, instead of an error.
    pub keep_readable: bool,
}

impl Default for Limits {
    fn default() -> Self {
        Self { max_gaussians: 20_000_000, max_bytes: 2 << 30, keep_readable: false }
    }
}

impl Limits {
    /// `count` as a `usize` if this many Gaussians are accepted.
    pub(super) fn gaussians(&self, format: Format, count: u64) -> Result<usize, ImportError> {
        match usize::try_from(count) {
            Ok(0) => Err(format.empty(GAUSSIAN_COUNT)),
            Ok(n) if n <= self.max_gaussians => Ok(n),
            _ => Err(format.error(
                ErrorKind::TooLarge,
                GAUSSIAN_COUNT,
                count,
                format_args!("up to {}", self.max_gaussians),
            )),
        }
    }

    /// `bytes` as a `usize` if a file or stream of this length is accepted.
    pub(super) fn bytes(&self, format: Format, field: &str, bytes: u64) -> Result<usize, ImportError> {
        match usize::try_from(bytes) {
            Ok(n) if bytes <= self.max_bytes => Ok(n),
            _ => Err(format.error(
                ErrorKind::TooLarge,
                field,
                format_args!("{bytes} bytes"),
                format_args!("up to {} bytes", self.max_bytes),
            )),
        }
    }
}
