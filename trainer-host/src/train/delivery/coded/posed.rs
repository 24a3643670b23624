//! Finds what the look of a block depends on, and which window's track poses its cluster.
//!
//! A cluster whose track has not arrived keeps the last pose of the latest earlier window of the epoch whose
//! track has, and its canonical pose without any (SPEC.md 9.4).

use codec_core::internals::{
    closure::Arrived,
    ids::{ClusterId, Level, Span, WindowId},
    wire::manifest::Track,
};

use super::{Block, Moving};

/// States with equal versions of a block show it alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::train::delivery) struct BlockVersion {
    /// What has arrived of it.
    canonical: u8,
    /// And of its motion in the window of the frame.
    motion: u8,
    /// Which window's track poses its cluster.
    posed_by: Option<WindowId>,
}

impl Moving<'_> {
    /// The version of `block` that `state` shows at `frame`.
    pub(in crate::train::delivery) fn version(
        &self,
        block: &Block,
        frame: u32,
        state: &[u8],
    ) -> BlockVersion {
        let arrived = |mask: usize| state.get(mask).copied().unwrap_or(0);
        BlockVersion {
            canonical: arrived(block.canonical),
            motion: self.motion_mask(block, frame).map_or(0, arrived),
            posed_by: self.posed_by(block.cluster, frame, state),
        }
    }

    /// Place in a state of the mask of the motion of `block` in the window of `frame`, if it has one.
    pub(super) fn motion_mask(&self, block: &Block, frame: u32) -> Option<usize> {
        let window = self.content.manifest.window_at(frame).map(Span::Motion)?;
        let cell = self.content.cell(window, block.cluster)?;
        Some(cell.blocks as usize + block.index)
    }

    /// The window whose track poses `cluster` at `frame` in `state`: that of the frame, or the latest before
    /// it in the epoch whose track has arrived or which needs none.
    fn posed_by(&self, cluster: ClusterId, frame: u32, state: &[u8]) -> Option<WindowId> {
        let manifest = self.content.manifest;
        let own = manifest.window_at(frame)?;
        let epoch = manifest.window(own)?.epoch;
        let is_of_epoch = |&id: &WindowId| manifest.window(id).is_some_and(|window| window.epoch == epoch);
        let has_track = |&id: &WindowId| {
            let is_static = manifest.motion(id, cluster).is_some_and(|m| m.class() == Track::Static);
            let mask = self.content.cell(Span::Motion(id), cluster).map(|cell| cell.blocks as usize);
            let arrived = mask.and_then(|mask| state.get(mask)).copied().unwrap_or(0);
            is_static || Arrived(arrived).has(Level::BASE)
        };
        (0..=own.0).rev().map(WindowId).take_while(is_of_epoch).find(has_track)
    }

    /// The frame of its epoch in whose pose `state` shows `cluster` at `frame`, frame `t` of the epoch.
    pub(super) fn pose_frame(&self, cluster: ClusterId, (frame, t): (u32, usize), state: &[u8]) -> usize {
        let manifest = self.content.manifest;
        let Some(own) = manifest.window_at(frame) else { return t };
        match self.posed_by(cluster, frame, state) {
            Some(by) if by == own => t,
            Some(by) => {
                let first = frame as usize - t;
                let window = manifest.window(by);
                let end =
                    window.map_or(first, |window| window.first_frame as usize + usize::from(window.frames));
                end.saturating_sub(first + 1)
            }
            None => 0,
        }
    }
}
