//! Changes say which Gaussians of a frame may differ from those of the frame before.

use std::ops::Range;

/// Which Gaussians may differ from the frame before.
#[derive(Clone, Copy, Debug, Default)]
pub enum Changes<'a> {
    /// Nobody knows: all are compared with those of the frame before.
    #[default]
    Unknown,
    /// Those in these ranges of indices, which may overlap and end past the last one; all others are what
    /// they were in the last call that succeeded. That is the caller's promise: a change outside is not
    /// seen.
    Within(&'a [Range<usize>]),
}
