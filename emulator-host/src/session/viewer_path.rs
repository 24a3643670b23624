//! Says where a modelled viewer is at each frame.

use std::sync::Arc;

use codec_core::internals::wire::receipt::ViewerPose;

/// The poses of a viewer along a clip. Cheap to clone.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewerPath(Arc<[ViewerPose]>);

impl ViewerPath {
    /// A viewer who sees frame 0 from the first of `poses`, the next frame from the next, and goes on from
    /// the first after the last; who has one stays there. `None` without any.
    pub fn new(poses: &[ViewerPose]) -> Option<Self> {
        (!poses.is_empty()).then(|| Self(poses.into()))
    }

    /// Where the viewer is at `frame`.
    pub fn pose(&self, frame: u32) -> ViewerPose {
        self.0[frame as usize % self.0.len()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_go_round() {
        let pose = |x| ViewerPose { position: [x, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] };
        let path = ViewerPath::new(&[pose(0.0), pose(1.0), pose(2.0)]).unwrap();
        assert_eq!([0, 2, 3, 7].map(|frame| path.pose(frame).position[0]), [0.0, 2.0, 0.0, 1.0]);
        assert_eq!(ViewerPath::new(&[]), None);
    }
}
