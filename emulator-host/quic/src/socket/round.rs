//! Sends one round of playout to one viewer: the sender of `emulator-host` over what is known of the path.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use emulator_host::{
    Bytes as Volume, Nanos, PacketGraph, PacketIndex, PolicyKind, Rate, Scheduler, SessionConfig,
    congestion::{DeliveryRate, DeliverySample},
    graph::GraphError,
    policy::PacketStatus,
    report::SenderCounts,
    session::{MediaSender, Outstanding, PathFacts},
};

use super::{carrier::SessionTransport, served_stream::Content};

/// Shortest time over which arrivals are counted for the estimate of the path.
const SAMPLE: Nanos = Nanos::from_ms(50);
/// Samples of the path older than this, and than ten round trips, are forgotten.
const MEMORY: Nanos = Nanos::from_s(2);

/// Receipts come at least so often while media arrives, twice over.
const RECEIPTS: Nanos = Nanos::from_ms(100);
/// A transport that repeats what is lost may take so long for it.
const REPEATED: Nanos = Nanos::from_s(1);

type Sender = MediaSender<Arc<PacketGraph>, Box<dyn Scheduler + Send>>;

/// One round: a graph, and what of it was sent and has arrived.
pub(super) struct Round {
    /// Number by which the client calls it.
    pub(super) number: u32,
    began: Instant,
    /// First frame, counted over the clip.
    first: u32,
    content: Arc<Content>,
    graph: Arc<PacketGraph>,
    sender: Sender,
    outstanding: Outstanding,
    arrivals: Arrivals,
    /// The last receipt that said when playout began.
    playout: Vec<u8>,
    /// When the client was heard last.
    heard_at: Nanos,
}

/// How fast what was sent arrives, for transports that do not tell.
#[derive(Debug, Default)]
struct Arrivals {
    rate: DeliveryRate,
    since: Nanos,
    bytes: u64,
    /// Whether the scheduler had nothing to send at some time of this sample.
    idle: bool,
    busy_before: bool,
}

impl Arrivals {
    /// Enters `bytes` that are known to have arrived.
    fn enter(&mut self, bytes: u64, path: &PathFacts, now: Nanos) {
        self.bytes += bytes;
        let span = now - self.since;
        if span < SAMPLE.max(path.smoothed_rtt) {
            return;
        }
        let rate = Rate::over(Volume(self.bytes), span);
        let sample = DeliverySample { rate, app_limited: self.idle };
        self.rate.take(sample, MEMORY.max(path.smoothed_rtt.times(10)), now);
        self.busy_before |= !self.idle;
        (self.since, self.bytes, self.idle) = (now, 0, false);
    }

    /// The rate of the path, once some sample was limited by it and not by the sender.
    fn estimate(&self) -> Option<Rate> {
        self.rate.estimate().filter(|_| self.busy_before)
    }
}

/// What is known of the path, with `media` bytes out and `arrived` known to have arrived.
fn facts(carrier: &SessionTransport, arrived: u64, media: u64, estimate: Option<Rate>) -> PathFacts {
    let path = carrier.path(arrived);
    let nanos = |span: Duration| Nanos(u64::try_from(span.as_nanos()).unwrap_or(u64::MAX));
    let (smoothed_rtt, minimum_rtt) = (nanos(path.rtt), nanos(path.least_rtt));
    let newest = path.newest_rtt.map_or(Nanos::ZERO, nanos);
    let smoothed_rtt = PathFacts::expected_round_trip(smoothed_rtt, newest);
    let window = Rate::over(Volume(path.window_bytes), smoothed_rtt.max(Nanos::from_us(100)));
    PathFacts {
        rate: path.rate.or(estimate).map_or(window, |estimate| estimate.min(window)),
        smoothed_rtt,
        // Where the transport does not tell, the part of the round trip above the least it can be varies.
        rtt_variation: path.rtt_variation.map_or_else(
            || Nanos((smoothed_rtt - minimum_rtt).0 / 2).max(Nanos::from_ms(1)),
            |variation| nanos(variation).min(smoothed_rtt),
        ),
        minimum_rtt,
        minimum_rtt_age: nanos(path.least_rtt_age),
        // The manifest, too, waits in the queue that media are not to lengthen.
        in_flight: path.in_flight.map_or(media, |all| all.max(media)),
        datagram_bytes: path.datagram_bytes,
    }
}

/// A sender of `graph` to a client that has `delivered` already.
fn sender(
    graph: &Arc<PacketGraph>,
    policy: PolicyKind,
    path: PathFacts,
    now: Nanos,
    delivered: &[bool],
) -> Sender {
    let rules = SessionConfig::default().sending();
    let mut sender = Sender::new(graph.clone(), policy.build(graph), rules, path, now);
    for at in 0..graph.packets().len() {
        let packet = PacketIndex(at as u32);
        if delivered.get(graph.wire_id(packet).index()).is_some_and(|delivered| *delivered) {
            sender.on_acked(packet);
        }
    }
    sender
}

impl Round {
    /// Round `number` of `content` from frame `first` on, to a client that has `delivered` already. The
    /// client began it half a round trip ago.
    pub(super) fn new(
        number: u32,
        carrier: &SessionTransport,
        (content, first): (Arc<Content>, u32),
        policy: PolicyKind,
        delivered: &[bool],
    ) -> Result<Self, GraphError> {
        let began = Instant::now();
        let began = began.checked_sub(carrier.rtt() / 2).unwrap_or(began);
        let graph = content.graph_from(first)?;
        let path = facts(carrier, 0, 0, None);
        let sender = sender(&graph, policy, path, Nanos::ZERO, delivered);
        let (outstanding, arrivals, playout) = (Outstanding::new(), Arrivals::default(), Vec::new());
        let heard_at = Nanos::ZERO;
        Ok(Self { number, began, first, content, graph, sender, outstanding, arrivals, playout, heard_at })
    }

    /// More of a stream that grows is there; what is on its way stays so.
    pub(super) fn renew(
        &mut self,
        carrier: &SessionTransport,
        content: Arc<Content>,
        policy: PolicyKind,
        delivered: &[bool],
    ) -> Result<(), GraphError> {
        let before = std::mem::replace(&mut self.graph, content.graph_from(self.first)?);
        self.content = content;
        let arrived = self.outstanding.arrived_bytes();
        let path = facts(carrier, arrived, self.outstanding.bytes(), self.arrivals.estimate());
        let fresh = sender(&self.graph, policy, path, self.now(), delivered);
        let earlier = std::mem::replace(&mut self.sender, fresh);
        let graph = self.graph.clone();
        let index = |packet| {
            let id = before.wire_id(packet);
            graph.packets_in(id, id).next()
        };
        self.outstanding.carry_over(&mut self.sender, index);
        self.sender.go_on_from(earlier, index);
        self.sender.on_receipt(&self.playout);
        let path = facts(carrier, arrived, self.outstanding.bytes(), self.arrivals.estimate());
        self.sender.look(path, self.now());
        Ok(())
    }

    /// Time since the client began the round.
    pub(super) fn now(&self) -> Nanos {
        Nanos(u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    /// The moment of a time of this round.
    pub(super) fn instant(&self, at: Nanos) -> Option<Instant> {
        self.began.checked_add(Duration::from_nanos(at.0))
    }

    /// Marks what has arrived, by packet id.
    pub(super) fn note_delivered(&self, delivered: &mut [bool]) {
        for at in 0..self.graph.packets().len() {
            let packet = PacketIndex(at as u32);
            if let Some(place) = delivered.get_mut(self.graph.wire_id(packet).index()) {
                *place |= self.sender.status(packet) == PacketStatus::Delivered;
            }
        }
    }

    /// The client's receipt.
    pub(super) fn on_receipt(&mut self, receipt: &[u8], carrier: &SessionTransport) {
        self.heard_at = self.now();
        self.sender.on_receipt(receipt);
        if self.sender.playout_start().is_some() {
            self.playout.clear();
            self.playout.extend_from_slice(receipt);
        }
        self.settle(carrier);
    }

    /// Settles what news or time has shown, and renews what the scheduler sees.
    pub(super) fn settle(&mut self, carrier: &SessionTransport) {
        let now = self.now();
        let before = self.outstanding.arrived_bytes();
        if carrier.repeats_what_is_lost() {
            self.outstanding.set_repeated();
        }
        self.outstanding.settle(&mut self.sender, now);
        let silence = self.silence();
        self.outstanding.expire(&mut self.sender, silence, self.heard_at, now);
        let arrived = self.outstanding.arrived_bytes();
        let path = facts(carrier, arrived, self.outstanding.bytes(), self.arrivals.estimate());
        self.arrivals.enter(arrived - before, &path, now);
        self.sender.look(path, now);
    }

    /// The transport has learnt something of the path: before a client has the manifest, and says so, nothing
    /// else tells how much the path carries.
    pub(super) fn hear(&mut self, carrier: &SessionTransport) {
        let arrived = self.outstanding.arrived_bytes();
        let path = facts(carrier, arrived, self.outstanding.bytes(), self.arrivals.estimate());
        self.sender.look(path, self.now());
    }

    /// Whether time alone has shown something to be lost.
    pub(super) fn is_due(&self) -> bool {
        self.loss_time() <= self.now()
    }

    /// When time alone shows something to be lost.
    pub(super) fn loss_time(&self) -> Nanos {
        self.outstanding.next_time()
    }

    /// The next packet to send, if one is worth sending and the path is not full.
    pub(super) fn next(&mut self, carrier: &SessionTransport) -> Option<(PacketIndex, Bytes)> {
        let now = self.now();
        self.sender.advance(now);
        if self.sender.full_until(now).is_some() {
            return None;
        }
        let packet = self.sender.next(now);
        self.arrivals.idle |= packet.is_none();
        if let Some(watch) = carrier.watch() {
            watch.set_source_limited(packet.is_none());
        }
        let packet = packet?;
        Some((packet, self.content.packet(&self.graph, packet)))
    }

    /// A packet has left.
    pub(super) fn on_sent(&mut self, packet: PacketIndex, carrier: &SessionTransport) {
        let now = self.now();
        self.outstanding.on_sent(&mut self.sender, packet, now);
        let media = self.outstanding.bytes();
        let all = carrier.path(0).in_flight.map_or(media, |all| all.max(media));
        self.sender.on_datagram_sent(all, now);
    }

    /// What the scheduler sees of the path.
    pub(super) fn path(&self) -> &PathFacts {
        self.sender.path()
    }

    /// When there may be something to send, or something is lost, without news.
    pub(super) fn next_time(&self) -> Nanos {
        let full = self.sender.full_until(self.now()).unwrap_or(Nanos::MAX);
        self.loss_time().min(full).min(self.sender.next_horizon_at())
    }

    /// A packet is lost that no receipt names which came so long after it had left.
    fn silence(&self) -> Nanos {
        let silence = self.path().smoothed_rtt.times(3) + RECEIPTS;
        if self.outstanding.is_repeated() { silence.max(REPEATED) } else { silence }
    }

    /// Whether the viewer has said where it is.
    pub(super) fn is_located(&self) -> bool {
        self.sender.reported_pose().viewpoint().is_some()
    }

    /// What the sender has counted.
    pub(super) fn counts(&self) -> SenderCounts {
        self.sender.counts()
    }

    /// Packets that never arrived, as far as is known, since this was called before.
    pub(super) fn take_lost(&mut self) -> u64 {
        self.outstanding.take_lost()
    }
}
