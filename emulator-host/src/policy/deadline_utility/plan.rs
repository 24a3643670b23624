//! Ranks the pieces that may be sent now by what each byte of them adds, with all that stands on them.
//!
//! The rank of a piece is the largest Σ value ÷ Σ bytes over the sets that begin with it and hold only what
//! stands on it: the piece, and of what needs it first that of the highest rank, for as long as that raises
//! the ratio. On trees this is Horn's rule, whose order is the best one; where something needs several pieces
//! that are not sent yet, each of them is credited with an equal share of its value and of its bytes.

use std::{cmp::Ordering, collections::BinaryHeap, sync::Arc};

use super::{
    bursts::repaired_share,
    config::DeadlineUtilityConfig,
    forecast::{Forecast, OVERHEAD_BYTES},
    in_flight::{arrives_at_all, arrives_in_time, survival},
};
use crate::{
    clock::Nanos,
    graph::{
        PacketGraph, PacketIndex,
        pieces::{Division, Pieces},
    },
    policy::{PacketStatus, SenderView},
};

/// What is left of one piece.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    waiting: u32,
    waiting_bytes: u32,
    in_flight: u32,
    in_flight_bytes: u32,
}

/// A piece, with what of the pieces that stand on it raises its rank.
#[derive(Clone, Copy, Debug, Default)]
struct Block {
    value: f64,
    bytes: f64,
}

impl Block {
    fn rank(self) -> f64 {
        if self.bytes > 0.0 { self.value / self.bytes } else { f64::INFINITY }
    }
}

/// A piece that may be sent.
#[derive(Clone, Copy, Debug)]
struct Ready {
    rank: f64,
    /// Of equals, the piece that is needed earlier, then the one that stands lower.
    needed_from: u32,
    place: u32,
}

impl Ord for Ready {
    fn cmp(&self, other: &Self) -> Ordering {
        let earlier = (other.needed_from, other.place).cmp(&(self.needed_from, self.place));
        self.rank.total_cmp(&other.rank).then(earlier)
    }
}

impl PartialOrd for Ready {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Ready {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Ready {}

/// Bytes of the packets that `piece` alone has, headers included.
fn own_bytes(pieces: &Pieces, piece: usize) -> u32 {
    pieces.wire_bytes(piece) + pieces.packets(piece).len() as u32 * OVERHEAD_BYTES
}

/// Bytes of headers of so many packets that do not count ([`DeadlineUtilityConfig::headers`]).
fn uncounted_bytes(packets: u32, config: &DeadlineUtilityConfig) -> u32 {
    if config.headers { 0 } else { packets * OVERHEAD_BYTES }
}

/// The ranking, and what it is made from.
#[derive(Debug)]
pub(super) struct Plan {
    division: Arc<Division>,
    rest: Vec<Rest>,
    /// How many of [`Division::by_time`] have come near.
    entered: usize,
    /// Places of the pieces that are near and not done, ascending: needed pieces first.
    open: Vec<u32>,
    /// Whether a piece and all that it needs is on its way or there. Pieces that are not open count as that.
    sent: Vec<bool>,
    /// Probability that what of a piece and of its needs is in flight arrives.
    chance: Vec<f64>,
    /// Needs of a piece that are not sent.
    missing: Vec<u32>,
    blocks: Vec<Block>,
    ready: BinaryHeap<Ready>,
    /// Kept, so that plans cost no allocation.
    children: Vec<(f64, Block)>,
    finished: Vec<usize>,
    /// Longest queue that media cause and that may make a packet too late ([`arrives_in_time`]); zero if
    /// nothing bounds it, or what is late is sent too.
    max_queue_delay: Nanos,
    target: Option<u32>,
    /// Packets at the front of the target of which none waits.
    done: usize,
}

impl Plan {
    pub(super) fn new(graph: &PacketGraph) -> Self {
        let division = graph.division();
        let pieces = &division.pieces;
        let count = pieces.len();
        let rest = |piece| {
            let waiting = pieces.packets(piece).len() as u32;
            Rest { waiting, waiting_bytes: own_bytes(pieces, piece), in_flight: 0, in_flight_bytes: 0 }
        };
        Self {
            rest: (0..count).map(rest).collect(),
            entered: 0,
            open: Vec::new(),
            sent: vec![true; count],
            chance: vec![1.0; count],
            missing: vec![0; count],
            blocks: vec![Block::default(); count],
            ready: BinaryHeap::new(),
            children: Vec::new(),
            finished: Vec::new(),
            max_queue_delay: Nanos::ZERO,
            target: None,
            done: 0,
            division,
        }
    }

    /// The status of a packet has changed from the first of `change` to the second.
    pub(super) fn on_status(&mut self, packet: PacketIndex, bytes: u16, change: [PacketStatus; 2]) {
        let [before, after] = change;
        let Some(piece) = self.division.pieces.of_packet(packet) else { return };
        let rest = &mut self.rest[piece];
        let bytes = u32::from(bytes) + OVERHEAD_BYTES;
        match before {
            PacketStatus::Waiting => {
                rest.waiting -= 1;
                rest.waiting_bytes -= bytes;
            }
            PacketStatus::InFlight => {
                rest.in_flight -= 1;
                rest.in_flight_bytes -= bytes;
            }
            PacketStatus::Delivered | PacketStatus::Abandoned => {}
        }
        match after {
            PacketStatus::Waiting => {
                rest.waiting += 1;
                rest.waiting_bytes += bytes;
                self.done = 0;
            }
            PacketStatus::InFlight => {
                rest.in_flight += 1;
                rest.in_flight_bytes += bytes;
            }
            PacketStatus::Delivered | PacketStatus::Abandoned => {}
        }
    }

    /// Ranks what may be sent at `now`.
    pub(super) fn renew(&mut self, view: &SenderView<'_>, config: &DeadlineUtilityConfig, now: Nanos) {
        self.max_queue_delay = config.max_queue_delay.filter(|_| config.skip_late).unwrap_or(Nanos::ZERO);
        self.target = None;
        self.ready.clear();
        self.enter(view);
        let forecast = Forecast::new(view, config, now);
        self.look_down(view, &forecast, now);
        self.look_up(view, &forecast, config);
    }

    /// Takes in the pieces that have come near.
    fn enter(&mut self, view: &SenderView<'_>) {
        let before = self.entered;
        while let Some(place) = self.division.by_time.get(self.entered).copied() {
            if self.division.pieces.needed_from(self.piece_at(place)) >= view.horizon_frame {
                break;
            }
            self.open.push(place);
            self.entered += 1;
        }
        if self.entered > before {
            self.open.sort_unstable();
        }
    }

    fn piece_at(&self, place: u32) -> usize {
        self.division.pieces.order()[place as usize] as usize
    }

    /// From what is needed to what needs it: what is sent, what is missing, what may be lost. Drops what is
    /// done or past.
    fn look_down(&mut self, view: &SenderView<'_>, forecast: &Forecast, now: Nanos) {
        let mut open = std::mem::take(&mut self.open);
        open.retain(|place| {
            let piece = self.piece_at(*place);
            let rest = self.rest[piece];
            let (mut missing, mut chance) = (0, 1.0);
            for need in self.division.pieces.needs(piece) {
                missing += u32::from(!self.sent[*need as usize]);
                chance *= self.chance[*need as usize];
            }
            let past = self.division.pieces.useful_until(piece) < forecast.next_frame();
            let done = rest.waiting == 0 && rest.in_flight == 0 && missing == 0;
            // Needs in flight keep a piece open: they may be lost.
            if past || (done && chance >= 1.0) {
                self.sent[piece] = true;
                self.chance[piece] = 1.0;
                return false;
            }
            if rest.in_flight > 0 {
                for packet in self.division.pieces.packets(piece) {
                    if view.status[packet.at()] == PacketStatus::InFlight {
                        chance *= survival(view, packet, forecast.loss, now);
                    }
                }
            }
            self.missing[piece] = missing;
            self.chance[piece] = chance;
            self.sent[piece] = rest.waiting == 0 && missing == 0;
            true
        });
        self.open = open;
    }

    /// From what needs to what is needed: ranks.
    fn look_up(&mut self, view: &SenderView<'_>, forecast: &Forecast, config: &DeadlineUtilityConfig) {
        for at in (0..self.open.len()).rev() {
            let place = self.open[at];
            let piece = self.piece_at(place);
            if self.sent[piece] {
                continue;
            }
            let mut block = self.own_block(piece, view, forecast, config);
            if config.credit {
                self.add_dependents(piece, &mut block);
            }
            self.blocks[piece] = block;
            if self.missing[piece] == 0 {
                self.push(place);
            }
        }
    }

    /// `piece` by itself: what it is expected to add, and the bytes that count for it.
    fn own_block(
        &self,
        piece: usize,
        view: &SenderView<'_>,
        forecast: &Forecast,
        config: &DeadlineUtilityConfig,
    ) -> Block {
        let rest = self.rest[piece];
        let pieces = &self.division.pieces;
        let parts = pieces.parts(piece);
        let value = forecast.value(parts, &self.division.sums, rest.waiting_bytes)
            * config.viewport_weight(view, parts);
        let chance = if config.survival { self.chance[piece] } else { 1.0 };
        let bytes = rest.waiting_bytes - uncounted_bytes(rest.waiting, config);
        let mut block = Block { value: value * chance, bytes: f64::from(bytes) };
        if !config.rest_only {
            let own = own_bytes(pieces, piece);
            let begun = if own > 0 { 1.0 - f64::from(rest.waiting_bytes) / f64::from(own) } else { 0.0 };
            // U_g = ½ (1 + the share that is under way or there), but for the ½, which all have.
            block.value *= 1.0 + begun;
            block.bytes += f64::from(rest.in_flight_bytes - uncounted_bytes(rest.in_flight, config));
        }
        if !config.loss_repaired {
            let waiting =
                pieces.packets(piece).filter(|packet| view.status[packet.at()] == PacketStatus::Waiting);
            block.value *= waiting.map(|packet| arrives_at_all(view, packet, forecast.loss)).product::<f64>();
        }
        block
    }

    fn add_dependents(&mut self, piece: usize, block: &mut Block) {
        self.children.clear();
        for dependent in self.division.pieces.dependents(piece) {
            let dependent = *dependent as usize;
            if !self.sent[dependent] {
                let whole = self.blocks[dependent];
                let share = 1.0 / f64::from(self.missing[dependent].max(1));
                let child = Block { value: whole.value * share, bytes: whole.bytes * share };
                self.children.push((child.rank(), child));
            }
        }
        if self.children.len() > 1 {
            self.children.sort_by(|one, other| other.0.total_cmp(&one.0));
        }
        for (rank, child) in &self.children {
            if *rank <= block.rank() {
                break;
            }
            block.value += child.value;
            block.bytes += child.bytes;
        }
    }

    fn push(&mut self, place: u32) {
        let piece = self.piece_at(place);
        let rank = self.blocks[piece].rank();
        if self.rest[piece].waiting > 0 && rank > 0.0 {
            self.ready.push(Ready { rank, needed_from: self.division.pieces.needed_from(piece), place });
        }
    }

    /// The next packet by rank; `None` if the plan is done.
    pub(super) fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        loop {
            if let Some(place) = self.target {
                let piece = self.piece_at(place);
                let found = self.next_of(piece, view, now);
                if found.is_some() {
                    return found;
                }
                self.target = None;
                if self.rest[piece].waiting == 0 {
                    self.finish(piece);
                }
            }
            self.target = Some(self.ready.pop()?.place);
            self.done = 0;
        }
    }

    /// The next packet of the target, `piece`.
    fn next_of(&mut self, piece: usize, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        let packets = self.division.pieces.packets(piece);
        let mut waiting = packets
            .enumerate()
            .skip(self.done)
            .skip_while(|(_, packet)| view.status[packet.at()] != PacketStatus::Waiting);
        let (at, first) = waiting.next()?;
        self.done = at;
        let mut candidates = std::iter::once(first).chain(waiting.map(|(_, packet)| packet));
        let in_time = |packet: &PacketIndex| {
            view.is_sendable(*packet, now) && arrives_in_time(view, *packet, self.max_queue_delay, now)
        };
        let found = candidates.find(in_time);
        debug_assert_eq!(
            found,
            self.division.pieces.packets(piece).find(in_time),
            "a packet at the front of the target waits"
        );
        found
    }

    /// All of `piece` is on its way: what needs it may be sent.
    fn finish(&mut self, piece: usize) {
        self.finished.push(piece);
        while let Some(piece) = self.finished.pop() {
            self.sent[piece] = true;
            for at in 0..self.division.pieces.dependents(piece).len() {
                let dependent = self.division.pieces.dependents(piece)[at] as usize;
                if self.sent[dependent] {
                    continue;
                }
                self.missing[dependent] -= 1;
                if self.missing[dependent] > 0 {
                    continue;
                }
                if self.rest[dependent].waiting == 0 {
                    self.finished.push(dependent);
                } else {
                    let rank = self.blocks[dependent].rank();
                    let place = self.place_of(dependent);
                    if rank > 0.0 {
                        let needed_from = self.division.pieces.needed_from(dependent);
                        self.ready.push(Ready { rank, needed_from, place });
                    }
                }
            }
        }
    }

    fn place_of(&self, piece: usize) -> u32 {
        self.division.pieces.place(piece)
    }

    /// The highest rank that waits; 0 if nothing does.
    pub(super) fn best_rank(&self) -> f64 {
        self.ready.peek().map_or(0.0, |ready| ready.rank)
    }

    /// What is lost, per byte of `parity`, if one of the members of its set is lost that parity would repair,
    /// and comes only after a repetition.
    pub(super) fn parity_rank(
        &self,
        view: &SenderView<'_>,
        config: &DeadlineUtilityConfig,
        forecast: &Forecast,
        parity: PacketIndex,
    ) -> f64 {
        let facts = &view.graph.packets()[parity.at()];
        let Some(set) = facts.parity_of else { return 0.0 };
        let members = &view.graph.repair_sets()[set as usize].members;
        // A loss is known after a round trip and an eighth, and what is sent then takes another half.
        let repetition = 1.125 * view.smoothed_rtt.as_s() + view.minimum_rtt.as_s() / 2.0;
        let (mut saved, mut value) = (0.0, 0.0);
        for member in members.iter().filter(|member| view.status[member.at()] == PacketStatus::InFlight) {
            let Some(piece) = self.division.pieces.of_packet(*member) else { continue };
            let (parts, bytes) =
                (self.division.pieces.parts(piece), u32::from(view.graph.wire_bytes(*member)));
            let (soon, late) = forecast.soon_and_late(parts, &self.division.sums, bytes, repetition);
            let weight = config.viewport_weight(view, parts);
            saved += forecast.loss * (soon - late) * weight;
            value += forecast.loss * soon * weight;
        }
        if config.parity_bursts {
            saved *= repaired_share(view, set);
        }
        // Repetition is cheaper: it costs bytes only where something was lost.
        if saved < config.least_saved * value {
            return 0.0;
        }
        // Sent later, parity saves nothing any more: a delay costs all of it.
        let bytes = u32::from(facts.wire_bytes) + OVERHEAD_BYTES - uncounted_bytes(1, config);
        forecast.urgent(saved) / f64::from(bytes)
    }
}

#[cfg(test)]
mod tests;
