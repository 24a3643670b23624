//! Fills segment budgets in the manner of DASH: for each second of content, choose what fits the estimated
//! rate, then send it.
//!
//! A segment is [`Dash::SEGMENT_FRAMES_S`] of frames. When its turn comes, levels are added from the base up,
//! and within a level cluster by cluster (a cluster is a tile), while the bytes fit 90 % of what the path is
//! expected to move in a segment's time; the base is always taken. The choice is then sent in order, whatever
//! happens meanwhile. One segment is prefetched: a segment's turn comes when the playout of the segment
//! before it starts. Long-lived groups that did not fit are offered again to later segments.

use super::{PacketStatus, Scheduler, SenderView};
use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketGraph, PacketIndex},
};

/// The policy's state.
#[derive(Clone, Debug)]
pub struct Dash {
    segment_frames: u32,
    /// Groups of each segment by (level, cluster, index).
    segments: Vec<Vec<GroupIndex>>,
    /// The next segment to choose for.
    turn: usize,
    chosen: Vec<PacketIndex>,
    cursor: usize,
    leftovers: Vec<GroupIndex>,
}

impl Dash {
    /// Length of a segment in seconds.
    pub const SEGMENT_FRAMES_S: u64 = 1;

    /// For `graph`.
    pub fn new(graph: &PacketGraph) -> Self {
        let interval = graph.frame_interval().0.max(1);
        let frames = (Nanos::from_s(Self::SEGMENT_FRAMES_S).0 + interval / 2) / interval;
        let segment_frames = u32::try_from(frames).unwrap_or(u32::MAX).max(1);
        let count = graph.frames().div_ceil(segment_frames) as usize;
        let mut segments = vec![Vec::new(); count];
        for (at, group) in graph.groups().iter().enumerate() {
            segments[(group.first_frame / segment_frames) as usize].push(GroupIndex(at as u32));
        }
        for segment in &mut segments {
            segment.sort_by_key(|index| {
                let group = &graph.groups()[index.at()];
                (group.level(), group.id.cluster, *index)
            });
        }
        Self { segment_frames, segments, turn: 0, chosen: Vec::new(), cursor: 0, leftovers: Vec::new() }
    }

    /// Whether the next segment's turn has come: at most one segment ahead of the one that plays.
    fn is_due(&self, view: &SenderView<'_>, now: Nanos) -> bool {
        let before = self.turn.saturating_sub(1) as u32 * self.segment_frames;
        self.turn < 2 || (view.playing && now >= view.playout_at(before))
    }

    fn choose(&mut self, view: &SenderView<'_>, now: Nanos) {
        let span = view.graph.frame_interval().times(u64::from(self.segment_frames));
        let budget = view.rate.scaled(9, 10).bytes_in(span).0;
        let mut spent = 0;
        let mut candidates = std::mem::take(&mut self.segments[self.turn]);
        candidates.append(&mut self.leftovers);
        let next_start = (self.turn as u32 + 1) * self.segment_frames;
        self.chosen.clear();
        self.cursor = 0;
        let mut skipped_level = u8::MAX;
        for index in candidates {
            let group = &view.graph.groups()[index.at()];
            let waiting = view
                .graph
                .packets_of(index)
                .filter(|packet| view.status[packet.at()] == PacketStatus::Waiting);
            let bytes: u64 = waiting.clone().map(|packet| u64::from(view.graph.wire_bytes(packet))).sum();
            // A tile that does not fit does not stop its neighbours of the same level, only all levels above.
            let fits = group.level() == 0 || (group.level() <= skipped_level && spent + bytes <= budget);
            if fits && !view.is_past(group.last_frame, now) {
                spent += bytes;
                self.chosen.extend(waiting);
            } else {
                skipped_level = skipped_level.min(group.level());
                if group.last_frame >= next_start {
                    self.leftovers.push(index);
                }
            }
        }
        self.turn += 1;
    }
}

impl Scheduler for Dash {
    fn name(&self) -> &'static str {
        "dash"
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        loop {
            while let Some(packet) = self.chosen.get(self.cursor).copied() {
                if view.is_sendable(packet, now) {
                    return Some(packet);
                }
                let too_early = view.graph.needed_from(packet) >= view.horizon_frame;
                if too_early && view.status[packet.at()] == PacketStatus::Waiting {
                    return None;
                }
                self.cursor += 1;
            }
            if self.turn >= self.segments.len() || !self.is_due(view, now) {
                return None;
            }
            self.choose(view, now);
        }
    }
}
