//! Says why utilities cannot be measured.

use codec_core::internals::ids::Span;

/// Why utilities cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum UtilityError {
    /// Nothing to look with.
    #[error("no camera or photograph was given; at least one is needed")]
    NoCamera,
    /// A span that the manifest does not hold.
    #[error("the manifest holds no {span:?}; the stream's lattice does not hold together")]
    NoSpan {
        /// The epoch or window.
        span: Span,
    },
    /// A span that no photograph shows.
    #[error("no photograph shows frames {first}..{end}; each window needs at least one")]
    NoPhotograph {
        /// First frame of the span.
        first: u32,
        /// One past its last frame.
        end: u32,
    },
    /// A photograph that cannot be compared with.
    #[error("{name}: {why}")]
    Photograph {
        /// Name of the image.
        name: String,
        /// What is wrong with it.
        why: String,
    },
    /// A stream that has more frames than its source.
    #[error("the stream shows frame {frame}; the source has frames 0..{frames}")]
    Frame {
        /// The frame that a span holds.
        frame: u32,
        /// Frames of the source.
        frames: usize,
    },
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
