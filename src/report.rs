//! Reports a demo or a stream to a person: one self-contained HTML page, and the same
//! figures as JSON beside it.
//!
//! This file is the data; `html` lays it out and `plot` draws it. Nothing here measures.

pub mod html;
pub mod plot;

use emulator_host::Report as Delivery;
use render_host::Image;
use serde::Serialize;
use trainer_host::encode::Ledger;

use crate::figures::Machine;

/// Everything on the page.
#[derive(Debug, Serialize)]
pub struct Page {
    /// Heading, for example the scene's name.
    pub title: String,
    /// Where it was measured.
    pub machine: Machine,
    /// How it was measured: (what, value) pairs in reading order (scene, frames, resolution,
    /// background, cameras, trace, seeds …).
    pub protocol: Vec<(String, String)>,
    /// Where the bytes went.
    pub ledger: Ledger,
    /// PSNR of the complete decoded state against the source, per frame, dB.
    pub complete_psnr_db: Vec<f64>,
    /// Link capacity over the run: (seconds, Mbit/s) steps.
    pub capacity_mbps: Vec<(f64, f64)>,
    /// One per scheduler, in the paper's order.
    pub runs: Vec<SchedulerRun>,
    /// Frames shown side by side.
    pub strips: Vec<Strip>,
    /// Things a reader should know (identity not stored, losses, warnings).
    pub notes: Vec<String>,
    /// Whether only a part of the source was read; the notes say which.
    #[serde(skip)]
    pub damaged: bool,
}

/// One scheduler over the link.
#[derive(Debug, Serialize)]
pub struct SchedulerRun {
    /// Name for people, for example `deadline-utility`.
    pub name: String,
    /// Startup, misses, waste, trajectory.
    pub delivery: Delivery,
    /// What kept the run from showing more: link, congestion control or deadline.
    pub limit: String,
    /// Utility that no schedule passes over this link with the same start of playout; `None` if not computed.
    pub utility_bound: Option<f64>,
    /// How often what was shown stood still for want of its base.
    pub freezes: u64,
    /// Frames without motion in all freezes.
    pub frozen_frames: u64,
    /// Image quality of what was shown, per frame.
    pub frames: Vec<Shown>,
    /// Mean PSNR over shown frames, dB; a frame that was never shown counts as the background.
    pub mean_psnr_db: f64,
    /// The mean of the worst tenth of frames, dB.
    pub tail_psnr_db: f64,
    /// D: the mean over the same frames of MSE + 0.20 (1 − SSIM), data range 1. Source: the paper's
    /// distortion.
    #[serde(rename = "d")]
    pub distortion: f64,
    /// Mean SSIM.
    pub mean_ssim: f64,
    /// Temporal flicker against the source's own frame-to-frame changes.
    pub flicker: f64,
}

/// Quality of one shown frame against the source.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Shown {
    /// Playout time since the session began, seconds; `None` if never shown.
    pub time_s: Option<f64>,
    /// Frame.
    pub frame: u32,
    /// PSNR, dB (capped at 99).
    pub psnr_db: f64,
    /// SSIM.
    pub ssim: f64,
}

/// One frame as the source has it and as each scheduler showed it.
#[derive(Debug, Serialize)]
pub struct Strip {
    /// Frame.
    pub frame: u32,
    /// The source, and the complete decoded state.
    pub reference: Picture,
    /// One per run, in the order of [`Page::runs`].
    pub shown: Vec<Picture>,
}

/// An image with its error map.
#[derive(Debug, Serialize)]
pub struct Picture {
    /// Caption.
    pub caption: String,
    /// What was seen.
    #[serde(skip)]
    pub image: Image,
    /// Error against the source; `None` for the source itself.
    #[serde(skip)]
    pub error: Option<Image>,
    /// PSNR against the source, dB.
    pub psnr_db: Option<f64>,
}
