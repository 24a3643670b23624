//! What a render did, and what it left out and why.
//!
//! Invariant: every Gaussian is counted once, so `gaussians` is the sum of `drawn` and all reasons
//! ([`Counters::skipped`]). Counts do not depend on the number of threads.

use serde::{Deserialize, Serialize};

/// Counts of one render. The reasons are tried in the order of the fields.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Counters {
    /// Gaussians given.
    pub gaussians: u64,
    /// Gaussians that reached at least one pixel's list.
    pub drawn: u64,
    /// Skipped: absent (opacity 0 or less).
    pub absent: u64,
    /// Skipped: a NaN or infinity in any used field, or a colour that overflows.
    pub non_finite: u64,
    /// Skipped: opacity below the alpha cut-off.
    pub transparent: u64,
    /// Skipped: zero quaternion, negative scale, or an ellipse without area.
    pub degenerate: u64,
    /// Skipped: nearer than the near plane, or behind the camera.
    pub behind_near: u64,
    /// Skipped: wholly outside the image.
    pub outside: u64,
    /// Skipped: falls between pixel centres.
    pub sub_pixel: u64,
    /// Tiles of 16 × 16 pixels in the image.
    pub tiles: u64,
    /// Tiles with at least one splat.
    pub tiles_touched: u64,
    /// Entries in all tile lists.
    pub intersections: u64,
    /// Pixels in the image.
    pub pixels: u64,
    /// Pixels finished early, below `transmittance_stop`.
    pub pixels_stopped: u64,
}

impl Counters {
    /// Gaussians left out, for whatever reason.
    pub fn skipped(&self) -> u64 {
        self.absent
            + self.non_finite
            + self.transparent
            + self.degenerate
            + self.behind_near
            + self.outside
            + self.sub_pixel
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.gaussians += other.gaussians;
        self.drawn += other.drawn;
        self.absent += other.absent;
        self.non_finite += other.non_finite;
        self.transparent += other.transparent;
        self.degenerate += other.degenerate;
        self.behind_near += other.behind_near;
        self.outside += other.outside;
        self.sub_pixel += other.sub_pixel;
        self.tiles += other.tiles;
        self.tiles_touched += other.tiles_touched;
        self.intersections += other.intersections;
        self.pixels += other.pixels;
        self.pixels_stopped += other.pixels_stopped;
    }
}
