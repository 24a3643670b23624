//! Measures what a receiver of the whole stream shows, and says how well views agree.

use std::path::Path;

use anyhow::{Context, Result};
use codec_core::internals::ids::Level;
use render_host::metric::Lpips;
use serde::Serialize;
use trainer_host::{
    encode::Encoded,
    train::{Clip, Evaluation, Perceptual},
};

use crate::pipeline::Frames;

/// The frames that a receiver of the whole stream shows.
pub(super) fn decoded(encoded: &Encoded) -> Result<Clip> {
    let mut frames = Frames::of_stream(encoded.stream.receive()?, Level::HIGHEST, None);
    let instants: Result<_> = (0..frames.count()).map(|frame| frames.instant(frame)).collect();
    Ok(Clip { instants: instants?, footprint: frames.footprint() })
}

/// How well a scene agrees with some views.
#[derive(Debug, Serialize)]
pub(super) struct Figure {
    pub(super) what: String,
    pub(super) found: Evaluation,
    /// How different it looks, where that was measured.
    pub(super) seen: Option<Perceptual>,
}

impl Figure {
    /// The figure for people.
    pub(super) fn line(&self) -> String {
        let mut text = figure(&self.what, &self.found);
        if let Some(Perceptual { flip, lpips }) = self.seen {
            let lpips = lpips.map_or(String::new(), |lpips| format!(", LPIPS {}", share(lpips)));
            text.insert_str(text.trim_end().len(), &format!(", FLIP {}{lpips}", share(flip)));
        }
        text
    }
}

/// The network whose weights are in a file.
///
/// # Errors
/// A file that cannot be read, or holds something else.
pub(super) fn lpips(path: &Path) -> Result<Lpips> {
    let failed = || format!("--lpips: {}", path.display());
    let bytes = std::fs::read(path).with_context(failed)?;
    Lpips::from_safetensors(&bytes).with_context(failed)
}

/// A PSNR for people; a dash where masks leave nothing to compare.
pub(super) fn decibels(psnr_db: f64) -> String {
    if psnr_db.is_finite() { format!("{psnr_db:.2}") } else { "–".to_owned() }
}

/// SSIM, FLIP or LPIPS for people; a dash where masks leave nothing to compare.
pub(super) fn share(value: f64) -> String {
    if value.is_finite() { format!("{value:.4}") } else { "–".to_owned() }
}

/// A line about how well some views agree.
pub(super) fn figure(what: &str, found: &Evaluation) -> String {
    format!(
        "  {what:<48} {} dB (worst view {}, foreground {}), SSIM {}, {} x {}, background {:?}\n",
        decibels(found.psnr_db),
        decibels(found.worst_psnr_db),
        decibels(found.foreground_psnr_db),
        share(found.ssim),
        found.size.0,
        found.size.1,
        found.background
    )
}
