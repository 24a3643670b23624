//! Says why utilities cannot be measured.

/// Why utilities cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum UtilityError {
    /// Nothing to look with.
    #[error("no camera was given; at least one is needed")]
    NoCamera,
    /// The stream does not decode.
    #[error(transparent)]
    Decode(#[from] codec_core::Error),
    /// A cluster that a decoded frame does not hold.
    #[error("a state shows no version of a cluster; the stream's lattice does not hold together")]
    NoVersion,
    /// The renderer refused its input.
    #[error("rendering failed: {0}")]
    Render(String),
}
