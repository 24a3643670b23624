//! Says why pictures become no video.

use std::io;

/// Pictures that become no video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// A side that is too short or too long.
    #[error("AV1: found {width} × {height} pixels; sides of {least} to {most} are allowed")]
    Size {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// The shortest side.
        least: u32,
        /// The longest.
        most: u32,
    },
    /// A rate that is out of range, or no number.
    #[error("frames per second: found {0}; 0.001 to 10000 are allowed")]
    Rate(f64),
    /// A picture of another size than the first.
    #[error("found {} pixels; {}, as of the first, are allowed", sides(found), sides(first))]
    Mismatch {
        /// Its width and height.
        found: (u32, u32),
        /// Those of the first.
        first: (u32, u32),
    },
    /// The end comes before the first picture.
    #[error("no pictures")]
    Empty,
    /// What the encoder says.
    #[error("AV1: {0}")]
    Encoder(String),
    /// What the writer of MP4 says.
    #[error("MP4: {0}")]
    Mp4(String),
    /// What the file says.
    #[error(transparent)]
    File(#[from] io::Error),
}

/// Width and height for people.
fn sides((width, height): &(u32, u32)) -> String {
    format!("{width} × {height}")
}
