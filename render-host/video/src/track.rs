//! A track is what a container says of its one video, and a sample is one coded picture in it.

use crate::{obu::Av1Configuration, rate::FrameRate};

/// `ITU-T H.273` numbers of BT.709: the same for primaries, transfer and matrix.
pub const BT709: u8 = 1;

/// One video.
#[derive(Clone, Debug)]
pub struct Track {
    /// Width and height, both even.
    pub size: (u16, u16),
    pub rate: FrameRate,
    /// Expected number of pictures: it sizes the space that is reserved before them for the sample table.
    pub pictures: usize,
    pub configuration: Av1Configuration,
}

/// One coded picture. They come in the order in which they are shown.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    pub bytes: Vec<u8>,
    /// Whether it needs none before it.
    pub key: bool,
}
