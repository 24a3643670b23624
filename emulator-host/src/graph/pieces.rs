//! Pieces that each add to the picture at once, and what they add, to which frames. `division` makes them.
//!
//! - [`super::ClosureRule::Sliced`]: a packet is a piece. It adds to every group that it carries the share of
//!   its bytes.
//! - [`super::ClosureRule::AllOrNothing`]: a group is a piece, with the packets that it alone has. A packet
//!   that several groups share is a piece of its own that adds nothing by itself and that each of them needs.
//!
//! A piece counts once everything that it needs counts. What a schedule adds is then the sum over its pieces,
//! exactly as [`crate::report::FrameRow::utility`] has it: per frame, over the positive utility of the groups
//! that show. What groups of negative utility take from a picture is kept apart: no piece is sent for it, but
//! a packet may carry some of them beside others.

use super::{
    csr::Csr,
    index::{GroupIndex, PacketIndex},
};

/// What a piece adds to each of some frames.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Contribution {
    /// The group that it is part of.
    pub group: GroupIndex,
    /// First frame.
    pub first: u32,
    /// Last frame, inclusive.
    pub last: u32,
    /// Utility per frame, before division by that of all groups that show.
    pub utility: f64,
    /// Share of a level-0 group that it brings.
    pub base: f64,
}

pub(super) const NO_PIECE: u32 = u32::MAX;

/// The pieces of a graph, and what a ranking of them by time and utility begins with. It follows from the
/// graph alone, and every run of it uses the same.
#[derive(Debug)]
pub(crate) struct Division {
    pub pieces: Pieces,
    pub sums: FrameSums,
    /// Places in [`Pieces::order`] by the frame from which they are needed; those of no use are left out.
    pub by_time: Vec<u32>,
    /// First frames of groups, each once, ascending.
    pub starts: Vec<u32>,
}

/// The pieces of a graph.
#[derive(Clone, Debug)]
pub(crate) struct Pieces {
    pub(super) packets: Csr,
    /// The piece of each packet; [`NO_PIECE`] for parity.
    pub(super) of_packet: Vec<u32>,
    pub(super) wire_bytes: Vec<u32>,
    pub(super) needs: Csr,
    pub(super) dependents: Csr,
    pub(super) parts: Vec<Vec<Contribution>>,
    pub(super) negative_contributions: Vec<Vec<Contribution>>,
    pub(super) order: Vec<u32>,
    pub(super) place: Vec<u32>,
    pub(super) needed_from: Vec<u32>,
    pub(super) useful_until: Vec<u32>,
}

/// Running sums over frames, so that the gain of a span of frames is one subtraction.
#[derive(Clone, Debug)]
pub(crate) struct FrameSums {
    /// Σ over the frames before f of 1 ÷ positive utility showing.
    pub(super) utility: Vec<f64>,
    /// Σ over the frames before f of 1 ÷ level-0 groups showing.
    pub(super) base: Vec<f64>,
}

impl FrameSums {
    /// Frames in which no group of positive utility shows.
    pub(crate) fn frames_without_utility(&self) -> usize {
        self.utility.windows(2).filter(|pair| pair[0] == pair[1]).count()
    }

    /// What `part` adds to its frames from `from` on: utility, and share of the level-0 groups.
    pub(crate) fn gain(&self, part: &Contribution, from: u32) -> (f64, f64) {
        let (first, after) = (part.first.max(from) as usize, part.last as usize + 1);
        if first >= after {
            return (0.0, 0.0);
        }
        let span = |sums: &[f64]| sums[after] - sums[first];
        (part.utility * span(&self.utility), part.base * span(&self.base))
    }

    /// As [`FrameSums::gain`], but a unit of utility counts the same in every frame: the mean over all frames
    /// of what it counts in each.
    pub(crate) fn even_gain(&self, part: &Contribution, from: u32) -> (f64, f64) {
        let (_, base) = self.gain(part, from);
        let frames = (part.last + 1).saturating_sub(part.first.max(from));
        let unit = self.utility.last().map_or(0.0, |sum| sum / (self.utility.len() - 1).max(1) as f64);
        (part.utility * unit * f64::from(frames), base)
    }
}

impl Pieces {
    pub(crate) fn len(&self) -> usize {
        self.parts.len()
    }

    /// Packets that a piece consists of.
    pub(crate) fn packets(&self, piece: usize) -> impl ExactSizeIterator<Item = PacketIndex> + '_ {
        self.packets.row(piece).iter().map(|packet| PacketIndex(*packet))
    }

    /// Bytes of the packets of `piece`.
    pub(crate) fn wire_bytes(&self, piece: usize) -> u32 {
        self.wire_bytes[piece]
    }

    /// The piece that `packet` belongs to; none for parity.
    pub(crate) fn of_packet(&self, packet: PacketIndex) -> Option<usize> {
        let piece = self.of_packet[packet.at()];
        (piece != NO_PIECE).then_some(piece as usize)
    }

    /// Pieces that `piece` needs directly.
    pub(crate) fn needs(&self, piece: usize) -> &[u32] {
        self.needs.row(piece)
    }

    /// Pieces that need `piece` directly.
    pub(crate) fn dependents(&self, piece: usize) -> &[u32] {
        self.dependents.row(piece)
    }

    /// What a piece adds.
    pub(crate) fn parts(&self, piece: usize) -> &[Contribution] {
        &self.parts[piece]
    }

    /// What a piece takes from some frames: additions of negative utility.
    pub(crate) fn negative_contributions(&self, piece: usize) -> &[Contribution] {
        &self.negative_contributions[piece]
    }

    /// All pieces, needed ones first.
    pub(crate) fn order(&self) -> &[u32] {
        &self.order
    }

    /// Where `piece` stands in [`Self::order`].
    pub(crate) fn place(&self, piece: usize) -> u32 {
        self.place[piece]
    }

    /// First frame to which the piece or what needs it adds anything; `u32::MAX` if none.
    pub(crate) fn needed_from(&self, piece: usize) -> u32 {
        self.needed_from[piece]
    }

    /// Last frame to which the piece or what needs it adds anything.
    pub(crate) fn useful_until(&self, piece: usize) -> u32 {
        self.useful_until[piece]
    }
}
