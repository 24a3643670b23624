//! Parses what `dgs cut` takes.

use std::path::PathBuf;

use clap::Args;

use super::{FrameRange, number::whole};

/// `dgs cut`.
#[derive(Debug, Args)]
pub struct Cut {
    /// A .dgs file; - is standard input.
    pub input: PathBuf,
    /// The .dgs file to write; - is standard output.
    pub out: PathBuf,
    /// Keep levels up to this, 0 to 3; a packet that brings a lower one too stays.
    #[arg(long, visible_alias = "level", value_name = "LEVEL", value_parser = whole::<u8>(0..=3, "levels"))]
    pub levels: Option<u8>,
    /// Keep these frames as a shorter clip that begins at 0: FIRST..LAST with LAST included, FIRST.., or one.
    /// Windows of motion stay whole, so that the clip begins with the one that FIRST is in and ends with that
    /// of LAST, as ffmpeg -c copy begins at the key frame before; parity is computed again.
    #[arg(long, value_name = "FIRST..LAST")]
    pub frames: Option<FrameRange>,
    /// Keep at most this many bytes of file: what adds most to the picture per byte, by the utilities beside
    /// INPUT (`dgs encode --utility` writes them); lower levels first where there are none. What fits no
    /// more is passed over for what does, and parity comes last.
    #[arg(long, value_name = "BYTES", value_parser = whole::<u64>(1..=u64::MAX, "bytes"))]
    pub bytes: Option<u64>,
    /// Write packets window after window, as an encoder does that follows a recording; else they lie by
    /// level, or by what they add to the picture where utilities are beside INPUT.
    #[arg(long)]
    pub by_window: bool,
    /// The same to standard output, each window when its first frame is due: what `dgs serve -` reads
    /// (`dgs cut clip.dgs - --live | dgs serve -`).
    #[arg(long)]
    pub live: bool,
}
