//! Remembers where the viewer was last, by the newest receipt that says so.

use codec_core::internals::wire::receipt::ViewerPose;

use crate::viewpoint::Viewpoint;

/// Where the viewer is, by the newest receipt that says so.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReportedPose {
    newest: Option<u32>,
    viewpoint: Option<Viewpoint>,
}

impl ReportedPose {
    /// Receipt `sequence` says `pose`. Receipts that overtook each other and poses without a direction
    /// change nothing.
    pub(super) fn take(&mut self, sequence: u32, pose: &ViewerPose) {
        // Numbers wrap around: what is less than half of all numbers ahead is newer.
        let is_newer = |newest: u32| (sequence.wrapping_sub(newest) as i32) > 0;
        if self.newest.is_none_or(is_newer)
            && let Some(viewpoint) = Viewpoint::of(pose)
        {
            *self = Self { newest: Some(sequence), viewpoint: Some(viewpoint) };
        }
    }

    /// Where it is.
    pub fn viewpoint(&self) -> Option<Viewpoint> {
        self.viewpoint
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_newest_receipt_counts_in_whatever_order_they_come() {
        let pose = |x| ViewerPose { position: [x, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] };
        let mut reported_pose = ReportedPose::default();
        assert_eq!(reported_pose.viewpoint(), None);
        for (sequence, x, expected) in
            [(u32::MAX - 1, 1.0, 1.0), (1, 2.0, 2.0), (u32::MAX, 3.0, 2.0), (1, 4.0, 2.0), (2, 5.0, 5.0)]
        {
            reported_pose.take(sequence, &pose(x));
            assert_eq!(reported_pose.viewpoint().unwrap().position()[0], expected);
        }
        reported_pose.take(3, &ViewerPose { rotation: [0.0; 4], ..pose(6.0) });
        assert_eq!(reported_pose.viewpoint().unwrap().position()[0], 5.0, "no direction, no view");
    }
}
