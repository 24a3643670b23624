//! Adds up what a viewer has seen.

use emulator_host::{Nanos, session::Freezes};

use crate::socket::screen::{FrameShown, PlayReport};

/// Frames remembered one by one.
const MAX_SHOWN: usize = 1 << 16;

/// Sums over the frames that were shown.
pub(super) struct Seen {
    base_miss: f64,
    levels: f64,
    freezes: Freezes,
}

impl Seen {
    /// Nothing yet, of a clip whose frames are shown for `interval` each.
    pub(super) fn new(interval: Nanos) -> Self {
        Self { base_miss: 0.0, levels: 0.0, freezes: Freezes::new(interval) }
    }

    /// A frame is shown; `report` lists it.
    pub(super) fn show(&mut self, shown: FrameShown, report: &mut PlayReport) {
        self.base_miss += shown.base_miss;
        self.levels += shown.levels;
        self.freezes.show(1.0 - shown.base_miss);
        report.shown_count += 1;
        if report.shown.len() >= MAX_SHOWN {
            report.shown.drain(..MAX_SHOWN / 2);
        }
        report.shown.push(shown);
    }

    /// Enters means and freezes.
    pub(super) fn end(&self, report: &mut PlayReport) {
        let count = (report.shown_count as f64).max(1.0);
        (report.base_miss_rate, report.mean_levels) = (self.base_miss / count, self.levels / count);
        (report.freezes, report.frozen_frames) = (self.freezes.count(), self.freezes.frames());
    }
}
