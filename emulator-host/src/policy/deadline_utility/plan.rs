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
    in_flight::{arrives_in_time, survival},
};
use crate::{
    clock::Nanos,
    graph::{PacketGraph, PacketIndex, pieces::Division},
    policy::{PacketStatus, SenderView},
};

/// What is left of one piece.
#[derive(Clone, Copy, Debug, Default)]
struct Rest {
    waiting: u32,
    waiting_bytes: u32,
    in_flight: u32,
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

/// Parity that saves less than this share of what a loss of its members costs is never sent.
const MIN_SAVED: f64 = 0.1;

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
    /// Longest queue that media cause ([`DeadlineUtilityConfig::max_queue_delay`]); zero if nothing bounds
    /// it.
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
            let waiting_bytes = pieces.wire_bytes(piece) + waiting * OVERHEAD_BYTES;
            Rest { waiting, waiting_bytes, in_flight: 0 }
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
            PacketStatus::InFlight => rest.in_flight -= 1,
            PacketStatus::Delivered | PacketStatus::Abandoned => {}
        }
        match after {
            PacketStatus::Waiting => {
                rest.waiting += 1;
                rest.waiting_bytes += bytes;
                self.done = 0;
            }
            PacketStatus::InFlight => rest.in_flight += 1,
            PacketStatus::Delivered | PacketStatus::Abandoned => {}
        }
    }

    /// Ranks what may be sent at `now`.
    pub(super) fn renew(&mut self, view: &SenderView<'_>, config: &DeadlineUtilityConfig, now: Nanos) {
        self.max_queue_delay = config.max_queue_delay.unwrap_or(Nanos::ZERO);
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
            let rest = self.rest[piece];
            let parts = self.division.pieces.parts(piece);
            let value = forecast.value(parts, &self.division.sums, rest.waiting_bytes)
                * config.viewport_weight(view, parts);
            let mut block = Block { value: value * self.chance[piece], bytes: f64::from(rest.waiting_bytes) };
            if config.credit {
                self.add_dependents(piece, &mut block);
            }
            self.blocks[piece] = block;
            if self.missing[piece] == 0 {
                self.push(place);
            }
        }
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
        saved *= repaired_share(view, set);
        // Repetition is cheaper: it costs bytes only where something was lost.
        if saved < MIN_SAVED * value {
            return 0.0;
        }
        // Sent later, parity saves nothing any more: a delay costs all of it.
        forecast.urgent(saved) / f64::from(u32::from(facts.wire_bytes) + OVERHEAD_BYTES)
    }
}

#[cfg(test)]
mod tests {
    use codec_core::internals::ids::{ClusterId, Group as GroupId, Level, PacketId, Span, WindowId};

    use super::*;
    use crate::{
        clock::Rate,
        graph::{ClosureRule, GraphParts, Group, GroupIndex, Packet},
        startup::StartupRule,
    };

    /// Groups of one packet each: (level, bytes, utility, needs).
    fn graph(groups: &[(u8, u16, f64, &[u32])]) -> PacketGraph {
        let packet = |at: usize, bytes| Packet {
            id: PacketId::new(at as u32).unwrap(),
            wire_bytes: bytes,
            groups: vec![GroupIndex(at as u32)],
            needs_packets: Vec::new(),
            parity_of: None,
        };
        let group = |at: usize, level, utility, needs: &[u32]| Group {
            id: GroupId {
                span: Span::Motion(WindowId(0)),
                cluster: ClusterId(at as u16),
                level: Level::new(level).unwrap(),
            },
            first_frame: 0,
            last_frame: 99,
            needs: needs.iter().map(|need| GroupIndex(*need)).collect(),
            packets: vec![PacketIndex(at as u32)],
            utility,
            risk_adjusted: utility,
            place: None,
        };
        let rows = || groups.iter().enumerate();
        PacketGraph::new(GraphParts {
            packets: rows().map(|(at, row)| packet(at, row.1)).collect(),
            groups: rows().map(|(at, row)| group(at, row.0, row.2, row.3)).collect(),
            repair_sets: Vec::new(),
            frames: 100,
            frame_interval: Nanos::from_ms(33),
            manifest_bytes: 0,
            profile: ClosureRule::AllOrNothing,
        })
        .unwrap()
    }

    fn view<'a>(graph: &'a PacketGraph, status: &'a [PacketStatus], sent_at: &'a [Nanos]) -> SenderView<'a> {
        SenderView {
            graph,
            status,
            sent_at,
            playout_start: Nanos::from_s(1),
            playing: false,
            horizon_frame: 100,
            rate: Rate::from_mbps(1),
            smoothed_rtt: Nanos::from_ms(50),
            rtt_variation: Nanos::from_ms(5),
            minimum_rtt: Nanos::from_ms(40),
            in_flight: 0,
            loss: 0.01,
            loss_after_loss: 0.01,
            sent_number: &[],
            startup: StartupRule::AfterWait,
            retransmissions: 2,
            viewpoint: None,
        }
    }

    fn first(graph: &PacketGraph, config: &DeadlineUtilityConfig) -> PacketIndex {
        let count = graph.packets().len();
        let (status, sent_at) = (vec![PacketStatus::Waiting; count], vec![Nanos::ZERO; count]);
        let view = view(graph, &status, &sent_at);
        let mut plan = Plan::new(graph);
        plan.renew(&view, config, Nanos::ZERO);
        plan.next(&view, Nanos::ZERO).unwrap()
    }

    /// A large ancestor that adds little by itself stands under three that add much: together they add more
    /// per byte than the rival.
    #[test]
    fn an_ancestor_is_credited_with_what_stands_on_it() {
        let graph = graph(&[
            (1, 900, 0.01, &[]),
            (1, 100, 1.0, &[0]),
            (1, 100, 1.0, &[0]),
            (1, 100, 1.0, &[0]),
            (1, 700, 1.0, &[]),
        ]);
        let config = DeadlineUtilityConfig::default();
        assert_eq!(first(&graph, &config), PacketIndex(0));
        assert_eq!(first(&graph, &DeadlineUtilityConfig { credit: false, ..config }), PacketIndex(4));
    }

    #[test]
    fn what_adds_nothing_is_never_sent() {
        let graph = graph(&[(1, 100, -1.0, &[]), (1, 1000, 1e-6, &[])]);
        assert_eq!(first(&graph, &DeadlineUtilityConfig::default()), PacketIndex(1));
    }

    #[test]
    fn what_is_in_flight_counts_less_the_longer_no_receipt_tells_of_it() {
        let graph = graph(&[(0, 100, 1.0, &[])]);
        let (status, sent_at) = (vec![PacketStatus::InFlight], vec![Nanos::ZERO]);
        let view = view(&graph, &status, &sent_at);
        let chance = |ms| survival(&view, PacketIndex(0), 0.05, Nanos::from_ms(ms));
        let falling: Vec<f64> = (0..40).map(|step| chance(10 * step)).collect();
        assert!(falling.windows(2).all(|pair| pair[0] >= pair[1]), "{falling:?}");
        assert!(falling[0] > 0.94 && falling[39] < 0.2, "{falling:?}");
    }
}
