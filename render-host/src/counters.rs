//! Counters say what a render did, what it left out and why.
//!
//! Invariant: every Gaussian is counted once, so `gaussians` is the sum of `drawn` and all reasons
//! ([`Counters::skipped`]); a field that says "of" one is a part of it. Counts do not depend on the number of
//! threads.

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
    /// Of `outside`: found by the cheap bound, so that the shape was never computed.
    pub culled: u64,
    /// Skipped: falls between pixel centres.
    pub sub_pixel: u64,
    /// Tiles in the image, of the settings' side.
    pub tiles: u64,
    /// Tiles with at least one splat.
    pub tiles_touched: u64,
    /// Entries in all tile lists.
    pub intersections: u64,
    /// Entries there would be if every splat that lists were made of were in those of all tiles of its box.
    /// Where so many splats lie one behind the other that lists end early, those behind are left out.
    pub boxed: u64,
    /// Entries that came after all pixels of their tile were finished: never read.
    pub entries_unread: u64,
    /// Entries read that reached no row of their tile.
    pub entries_idle: u64,
    /// Rows of tiles that lie in the box of a splat whose entry was read.
    pub rows: u64,
    /// Of these, rows that the splat does not reach: skipped.
    pub rows_unreached: u64,
    /// Of these, rows reached whose pixels are all finished: skipped.
    pub rows_finished: u64,
    /// Pixels in the image.
    pub pixels: u64,
    /// Pixels finished early, below `transmittance_stop`.
    pub pixels_stopped: u64,
    /// Harmonic coefficients above band 0 of all Gaussians drawn, up to the degree asked for; one counts
    /// for three channels.
    pub sh_coefficients: u64,
    /// Of these, coefficients in bands that the Gaussian does not hold: not weighed.
    pub sh_skipped: u64,
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
        self.culled += other.culled;
        self.sub_pixel += other.sub_pixel;
        self.tiles += other.tiles;
        self.tiles_touched += other.tiles_touched;
        self.intersections += other.intersections;
        self.boxed += other.boxed;
        self.entries_unread += other.entries_unread;
        self.entries_idle += other.entries_idle;
        self.rows += other.rows;
        self.rows_unreached += other.rows_unreached;
        self.rows_finished += other.rows_finished;
        self.pixels += other.pixels;
        self.pixels_stopped += other.pixels_stopped;
        self.sh_coefficients += other.sh_coefficients;
        self.sh_skipped += other.sh_skipped;
    }
}
