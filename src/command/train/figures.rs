//! Measures what a receiver of the whole stream shows, and says how well views agree.

use anyhow::Result;
use codec_core::internals::ids::Level;
use trainer_host::{
    Instant,
    encode::Encoded,
    train::{Dataset, Evaluation},
};

use crate::pipeline::Frames;

/// The frames that a receiver of the whole stream shows.
pub(super) fn decoded(encoded: &Encoded, dataset: &Dataset) -> Result<Vec<Instant>> {
    let mut frames = Frames::of_stream(encoded.stream.receive()?, Level::from_bits(3), dataset.up);
    (0..frames.count()).map(|frame| frames.instant(frame)).collect()
}

/// A line about how well some views agree.
pub(super) fn figure(what: &str, found: &Evaluation) -> String {
    format!(
        "  {what:<48} {:.2} dB (worst view {:.2}, foreground {:.2}), SSIM {:.4}, {} x {}, background {:?}\n",
        found.psnr_db,
        found.worst_psnr_db,
        found.foreground_psnr_db,
        found.ssim,
        found.size.0,
        found.size.1,
        found.background
    )
}
