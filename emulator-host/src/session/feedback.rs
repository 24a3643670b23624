//! Writes receipts at the receiver and reads them at the sender: real DGSF bytes (SPEC.md, receipts).
//!
//! A transport acknowledges datagrams; a receipt says what the application knows beyond that: which packets
//! have arrived by id, which were recovered by repair, which groups are complete, when playout began, and
//! where the viewer is.
//! Each piece of news is repeated in a few receipts, so that losing one does no harm, and lists are cut so
//! that a receipt always fits one datagram.

use std::{collections::VecDeque, ops::Range};

use codec_core::internals::{
    ids::{Group as GroupId, PacketId},
    limits::MAX_RECEIPT_BYTES,
    wire::{
        crc::crc32,
        receipt::{IdRange, Receipt, Value, ViewerPose},
    },
};

use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketGraph, PacketIndex},
};

/// Receipts in which one piece of news is repeated.
const REPEATS: u8 = 4;
/// Most id ranges, recovered ids and completed groups of one receipt. At 8, 4 and 7 bytes each they fit
/// together.
const MAX_RANGES: usize = 64;
const MAX_RECOVERED: usize = 64;
const MAX_COMPLETED: usize = 48;

/// Some news of one kind: those from the `from`-th until before the `to`-th of the session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct NewsRange {
    pub(super) from: u32,
    pub(super) to: u32,
}

impl NewsRange {
    /// As places in the list of all news of the kind.
    pub(super) fn places(self) -> Range<usize> {
        self.from as usize..self.to as usize
    }
}

/// Which news a receipt reports.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reported {
    pub(super) arrived: NewsRange,
    pub(super) recovered: NewsRange,
    pub(super) completed: NewsRange,
    /// When frame 0 was shown, as the receipt has it: whole microseconds, zero for not yet.
    pub(super) playout_us: u64,
    /// Where the viewer was, and the number of the receipt that says so.
    pub(super) pose: Option<(u32, ViewerPose)>,
}

impl Reported {
    /// When frame 0 was shown.
    pub(super) fn playout_start(&self) -> Option<Nanos> {
        playout_start(self.playout_us)
    }
}

/// News that waits to be reported, oldest first, each with the receipts it is still to appear in.
#[derive(Debug)]
struct News<T> {
    waiting: VecDeque<(T, u8)>,
    forgotten: u32,
}

impl<T: Copy> News<T> {
    const fn new() -> Self {
        Self { waiting: VecDeque::new(), forgotten: 0 }
    }

    fn push(&mut self, item: T) {
        self.waiting.push_back((item, REPEATS));
    }

    /// Puts up to `most` of the oldest into `taken`, which is emptied first, and says which they are; those
    /// that have been repeated enough are forgotten. They stand at the front: what is older has never been
    /// repeated less.
    fn take(&mut self, most: usize, taken: &mut Vec<T>) -> NewsRange {
        taken.clear();
        for (item, left) in self.waiting.iter_mut().take(most) {
            taken.push(*item);
            *left -= 1;
        }
        let range = NewsRange { from: self.forgotten, to: self.forgotten + taken.len() as u32 };
        while self.waiting.front().is_some_and(|(_, left)| *left == 0) {
            self.waiting.pop_front();
            self.forgotten += 1;
        }
        range
    }
}

/// Writes receipts at the receiver.
#[derive(Debug)]
pub(super) struct ReceiptWriter {
    sequence: u32,
    arrived: News<PacketId>,
    recovered: News<PacketId>,
    completed: News<GroupId>,
    pose: Option<ViewerPose>,
    /// Receipts that are still to say the pose.
    pose_left: u8,
    content: Content,
    bytes: Box<[u8; MAX_RECEIPT_BYTES]>,
}

/// What the receipt composed last says; kept, so that a receipt costs no allocation.
#[derive(Debug, Default)]
struct Content {
    sequence: u32,
    playout_us: u64,
    pose: Option<ViewerPose>,
    ids: Vec<PacketId>,
    acknowledged: Vec<IdRange>,
    recovered: Vec<PacketId>,
    completed: Vec<GroupId>,
}

impl ReceiptWriter {
    pub(super) fn new() -> Self {
        Self {
            sequence: 0,
            arrived: News::new(),
            recovered: News::new(),
            completed: News::new(),
            pose: None,
            pose_left: 0,
            content: Content::default(),
            bytes: Box::new([0; MAX_RECEIPT_BYTES]),
        }
    }

    /// A packet arrived by itself.
    pub(super) fn on_arrived(&mut self, packet: PacketId) {
        self.arrived.push(packet);
    }

    /// A packet was recovered from parity.
    pub(super) fn on_recovered(&mut self, packet: PacketId) {
        self.recovered.push(packet);
    }

    /// A group is complete.
    pub(super) fn on_complete(&mut self, group: GroupId) {
        self.completed.push(group);
    }

    /// The viewer looks from `pose`; it is news if it has moved.
    pub(super) fn on_pose(&mut self, pose: ViewerPose) {
        if self.pose != Some(pose) {
            (self.pose, self.pose_left) = (Some(pose), REPEATS);
        }
    }

    /// Where the viewer is, if it has been said.
    pub(super) fn pose(&self) -> Option<ViewerPose> {
        self.pose
    }

    /// Number of a receipt that somebody else writes.
    pub(super) fn next_sequence(&mut self) -> u32 {
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        sequence
    }

    /// Composes the next receipt; what it reports. `playout_start`: when frame 0 was shown.
    pub(super) fn compose(&mut self, playout_start: Option<Nanos>) -> Reported {
        let sequence = self.next_sequence();
        let pose = self.pose.filter(|_| self.pose_left > 0);
        self.pose_left = self.pose_left.saturating_sub(1);
        let content = &mut self.content;
        (content.sequence, content.pose) = (sequence, pose);
        content.playout_us = playout_start.map_or(0, |start| start.0.div_ceil(1000).max(1));
        let arrived = self.arrived.take(MAX_RANGES, &mut content.ids);
        join(&mut content.ids, &mut content.acknowledged);
        let recovered = self.recovered.take(MAX_RECOVERED, &mut content.recovered);
        let completed = self.completed.take(MAX_COMPLETED, &mut content.completed);
        let pose = pose.map(|pose| (sequence, pose));
        Reported { arrived, recovered, completed, playout_us: content.playout_us, pose }
    }

    /// Length of the receipt composed last.
    pub(super) fn wire_len(&self) -> usize {
        self.content.value().wire_len()
    }

    /// Bytes of the receipt composed last.
    pub(super) fn bytes(&mut self) -> &[u8] {
        // Ranges ascend and the space is the largest receipt's, so writing cannot fail; an empty one would be
        // ignored.
        let len = self.content.value().write(&mut self.bytes[..]).unwrap_or(0);
        &self.bytes[..len]
    }
}

impl Content {
    fn value(&self) -> Value<'_> {
        Value {
            sequence: self.sequence,
            playout_us: self.playout_us,
            pose: self.pose,
            acknowledged: &self.acknowledged,
            recovered: &self.recovered,
            completed: &self.completed,
        }
    }
}

/// When frame 0 was shown, as a receipt has it: whole microseconds, zero for not yet.
fn playout_start(playout_us: u64) -> Option<Nanos> {
    (playout_us > 0).then(|| Nanos::from_us(playout_us))
}

/// Writes `ids` to `ranges` as ascending ranges that do not touch.
fn join(ids: &mut Vec<PacketId>, ranges: &mut Vec<IdRange>) {
    ids.sort_unstable();
    ids.dedup();
    ranges.clear();
    for id in ids {
        match ranges.last_mut() {
            Some((_, last)) if last.get() + 1 == id.get() => *last = *id,
            _ => ranges.push((*id, *id)),
        }
    }
}

/// What a sender learns from one receipt.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Feedback {
    /// Packets that the receiver has, by arrival, repair, or as part of a complete group.
    pub(super) received: Vec<PacketIndex>,
    /// When frame 0 was shown.
    pub(super) playout_start: Option<Nanos>,
    /// Where the viewer was, and the number of the receipt that says so.
    pub(super) pose: Option<(u32, ViewerPose)>,
}

/// Reads a receipt into `feedback`, which is emptied first; ids that the graph does not have are ignored.
///
/// # Errors
/// Bytes that are no receipt.
pub(super) fn read(bytes: &[u8], graph: &PacketGraph, feedback: &mut Feedback) -> codec_core::Result<()> {
    let Feedback { received, playout_start, pose } = feedback;
    received.clear();
    let receipt = Receipt::parse(bytes, crc32)?;
    for range in receipt.acknowledged() {
        let (first, last) = range?;
        graph.packets_in(first, last).for_each(|packet| received.push(packet));
    }
    for id in receipt.recovered() {
        let id = id?;
        received.extend(graph.packets_in(id, id));
    }
    for id in receipt.completed() {
        let group: Option<GroupIndex> = graph.group_of(id?);
        received.extend(group.into_iter().flat_map(|group| &graph.groups()[group.at()].packets));
    }
    *playout_start = self::playout_start(receipt.playout_us);
    *pose = receipt.pose.map(|pose| (receipt.sequence, pose));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Synthetic;

    fn read(bytes: &[u8], graph: &PacketGraph) -> codec_core::Result<Feedback> {
        // What an earlier receipt has left behind does not show.
        let mut feedback =
            Feedback { received: vec![PacketIndex(1)], playout_start: Some(Nanos(7)), pose: None };
        super::read(bytes, graph, &mut feedback).map(|()| feedback)
    }

    fn written(writer: &mut ReceiptWriter, playout_start: Option<Nanos>) -> &[u8] {
        writer.compose(playout_start);
        let len = writer.wire_len();
        let bytes = writer.bytes();
        assert_eq!(bytes.len(), len);
        bytes
    }

    fn graph() -> PacketGraph {
        Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap()
    }

    #[test]
    fn news_comes_back_as_it_was_and_is_repeated_and_then_forgotten() {
        let graph = graph();
        let mut writer = ReceiptWriter::new();
        let packets = [3, 4, 5, 9].map(PacketIndex);
        packets[..3].iter().for_each(|packet| writer.on_arrived(graph.wire_id(*packet)));
        writer.on_recovered(graph.wire_id(packets[3]));
        for repeat in 0..=REPEATS {
            let feedback = read(written(&mut writer, Some(Nanos(1))), &graph).unwrap();
            let expected = if repeat < REPEATS { packets.to_vec() } else { Vec::new() };
            assert_eq!(
                feedback,
                Feedback { received: expected, playout_start: Some(Nanos::from_us(1)), pose: None }
            );
        }
    }

    #[test]
    fn a_complete_group_stands_for_its_packets() {
        let graph = graph();
        let mut writer = ReceiptWriter::new();
        writer.on_complete(graph.groups()[5].id);
        let feedback = read(written(&mut writer, None), &graph).unwrap();
        assert_eq!(
            feedback,
            Feedback { received: graph.groups()[5].packets.clone(), playout_start: None, pose: None }
        );
    }

    #[test]
    fn a_flood_of_news_is_spread_over_receipts_that_each_fit_a_datagram() {
        let graph = graph();
        let mut writer = ReceiptWriter::new();
        let count = graph.packets().len().min(400) as u32;
        // Every second packet: as many ranges as ids.
        let packets: Vec<PacketIndex> = (0..count).step_by(2).map(PacketIndex).collect();
        packets.iter().for_each(|packet| writer.on_arrived(graph.wire_id(*packet)));
        packets.iter().for_each(|packet| writer.on_recovered(graph.wire_id(*packet)));
        graph.groups().iter().take(63).for_each(|group| writer.on_complete(group.id));
        let mut known = std::collections::BTreeSet::new();
        for _ in 0..40 {
            let bytes = written(&mut writer, None);
            assert!((1..=MAX_RECEIPT_BYTES).contains(&bytes.len()), "{}", bytes.len());
            known.extend(read(bytes, &graph).unwrap().received);
        }
        assert!(packets.iter().all(|packet| known.contains(packet)));
    }

    #[test]
    fn a_pose_is_said_in_a_few_receipts_and_again_when_the_viewer_moves() {
        let graph = graph();
        let mut writer = ReceiptWriter::new();
        let pose = |x| ViewerPose { position: [x, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] };
        let said = |writer: &mut ReceiptWriter, x| {
            writer.on_pose(pose(x));
            read(written(writer, None), &graph).unwrap().pose
        };
        for sequence in 0..u32::from(REPEATS) {
            assert_eq!(said(&mut writer, 1.0), Some((sequence, pose(1.0))));
        }
        assert_eq!(said(&mut writer, 1.0), None);
        assert_eq!(writer.next_sequence(), u32::from(REPEATS) + 1);
        assert_eq!(said(&mut writer, 2.0), Some((u32::from(REPEATS) + 2, pose(2.0))));
        assert_eq!(writer.pose(), Some(pose(2.0)));
    }

    #[test]
    fn damaged_bytes_are_refused() {
        let graph = graph();
        let mut bytes = written(&mut ReceiptWriter::new(), None).to_vec();
        bytes[1] ^= 1;
        assert!(read(&bytes, &graph).is_err());
    }
}
