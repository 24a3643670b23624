//! Decides which media leaves next, and learns from what becomes of it, over any transport.
//!
//! The transport says when a datagram may leave, what it knows of the path ([`PathFacts`]), and what became
//! of each datagram. This core knows time and packets: statuses, losses that compete again, parity, the
//! horizon, when playout is expected, and the queue that it causes itself. It never asks a clock and moves no
//! bytes.

mod succession;

use std::{collections::VecDeque, fmt, ops::Deref};

use codec_core::internals::wire::receipt::ViewerPose;

use super::{
    feedback::{self, Feedback},
    forecast::Forecasts,
    loss_bursts::LossBursts,
    loss_share::LossShare,
    parity_queue::ParityQueue,
    reported_pose::ReportedPose,
    round_trip_probe::RoundTripProbe,
    view_state::{PathFacts, ViewState},
};
use crate::{
    clock::{Bytes, Nanos},
    graph::{GroupIndex, PacketGraph, PacketIndex},
    policy::{PacketStatus, Scheduler, SenderRequirements},
    report::SenderCounts,
    startup::{Startup, StartupRule},
};

/// Below this share of lost datagrams the window is as large as the path and its queue, and a shorter queue
/// costs nothing. Where losses keep the window small, it grows only while it is filled.
const FEW_LOSSES: f64 = 0.005;

/// Longest time without a datagram while something is worth sending. A rate that was measured while the link
/// stood still would ask for longer; a link for which this is too often carries less than 10 kbit/s.
const LONGEST_SILENCE: Nanos = Nanos::from_s(1);

/// What a sender of media may do, whatever the transport.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SendingRules {
    /// How far ahead of playout media may be sent.
    pub lookahead: Nanos,
    /// When playout starts.
    pub startup: Startup,
    /// Times that one lost packet of the base may be sent again, where the scheduler does not decide on lost
    /// packets.
    pub retransmissions: u32,
}

/// The sender of one clip to one receiver. `G` is a [`PacketGraph`] borrowed or shared (`&PacketGraph`,
/// `Arc<PacketGraph>`), `S` a scheduler owned or borrowed.
///
/// # Examples
/// ```
/// use emulator_host::{
///     Nanos, PacketIndex, PolicyKind, Rate, SessionConfig,
///     graph::Synthetic,
///     session::{MediaSender, PathFacts},
/// };
/// use std::sync::Arc;
///
/// let graph = Arc::new(Synthetic { frames: 30, ..Synthetic::default() }.build(1)?);
/// let path = PathFacts { rate: Rate::from_mbps(5), ..PathFacts::unknown(1200) };
/// let scheduler = PolicyKind::Layered.build(&graph);
/// let rules = SessionConfig::default().sending();
/// let mut sender = MediaSender::new(graph, scheduler, rules, path, Nanos::ZERO);
/// // Whenever the transport has room for a datagram:
/// let now = Nanos::from_ms(1);
/// sender.advance(now);
/// if sender.full_until(now).is_none()
///     && let Some(packet) = sender.next(now)
/// {
///     sender.on_sent(packet, 0, now);
///     sender.on_datagram_sent(1180, now);
///     // And when the transport hears of it, or a receipt says so:
///     sender.on_acked(packet);
/// }
/// # Ok::<(), emulator_host::graph::GraphError>(())
/// ```
pub struct MediaSender<G, S> {
    graph: G,
    scheduler: S,
    rules: SendingRules,
    service: SenderRequirements,
    status: Vec<PacketStatus>,
    sent_times: Vec<u8>,
    sent_at: Vec<Nanos>,
    last_number: Vec<u64>,
    again: VecDeque<PacketIndex>,
    parity: ParityQueue,
    /// Level-0 bytes of frame 0 that were never sent and are not known to be there, at the start those of a
    /// packet once for each of its groups. So playout is expected late rather than early: losses and the
    /// link's own queue also delay it, and a sender that expects it too early gives up what would be in time.
    first_base_bytes: u64,
    view_state: ViewState,
    known_start: Option<Nanos>,
    /// Before this time the horizon stands.
    horizon_moves_at: Nanos,
    reported_pose: ReportedPose,
    last_sent_at: Nanos,
    starved: bool,
    counts: SenderCounts,
    loss: LossShare,
    bursts: LossBursts,
    probe: RoundTripProbe,
    forecasts: Forecasts,
    /// What the last receipt said; kept, so that reading one costs no allocation.
    feedback: Feedback,
}

impl<G, S> fmt::Debug for MediaSender<G, S> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MediaSender").field("counts", &self.counts).finish_non_exhaustive()
    }
}

impl<G: Deref<Target = PacketGraph>, S: Scheduler> MediaSender<G, S> {
    /// Nothing sent; `path` is what the transport knows at `now`.
    pub fn new(graph: G, scheduler: S, rules: SendingRules, path: PathFacts, now: Nanos) -> Self {
        let first = graph.groups().iter().filter(|group| group.level() == 0 && group.first_frame == 0);
        let first_base = first.flat_map(|group| &group.packets);
        let first_base_bytes =
            first_base.map(|packet| u64::from(graph.packets()[packet.at()].wire_bytes)).sum();
        let packets = graph.packets().len();
        let mut sender = Self {
            service: scheduler.service(),
            scheduler,
            rules,
            status: vec![PacketStatus::Waiting; packets],
            sent_times: vec![0; packets],
            sent_at: vec![Nanos::ZERO; packets],
            last_number: vec![u64::MAX; packets],
            again: VecDeque::new(),
            parity: ParityQueue::new(&graph),
            first_base_bytes,
            view_state: ViewState::new(path, rules.retransmissions, rules.startup.rule),
            known_start: None,
            horizon_moves_at: Nanos::ZERO,
            reported_pose: ReportedPose::default(),
            last_sent_at: Nanos::ZERO,
            starved: false,
            counts: SenderCounts::default(),
            loss: LossShare::new(),
            bursts: LossBursts::new(),
            probe: RoundTripProbe::default(),
            forecasts: Forecasts::default(),
            feedback: Feedback::default(),
            graph,
        };
        sender.look(path, now);
        sender
    }

    /// What is sent.
    pub fn graph(&self) -> &PacketGraph {
        &self.graph
    }

    /// Name of the scheduler.
    pub fn policy(&self) -> &'static str {
        self.scheduler.name()
    }

    /// What is known of `packet`.
    pub fn status(&self, packet: PacketIndex) -> PacketStatus {
        self.status[packet.at()]
    }

    /// What the transport said of the path when it was last heard.
    pub fn path(&self) -> &PathFacts {
        &self.view_state.path
    }

    /// What this core counts: media, parity, repeats, refusals. Counts of datagrams are the transport's.
    pub fn counts(&self) -> SenderCounts {
        self.counts
    }

    pub(super) fn forecasts(&self) -> &Forecasts {
        &self.forecasts
    }

    /// When playout started, once a receipt has said so.
    pub fn playout_start(&self) -> Option<Nanos> {
        self.known_start
    }

    /// Where the viewer is, by the newest receipt that says so.
    pub fn reported_pose(&self) -> ReportedPose {
        self.reported_pose
    }

    /// When more of the clip comes within the horizon, so that [`Self::next`] may have something again.
    pub fn next_horizon_at(&self) -> Nanos {
        let Some(start) = self.known_start else { return Nanos::MAX };
        let reach = start + self.graph.frame_interval().times(u64::from(self.view_state.horizon_frame));
        if self.view_state.horizon_frame >= self.graph.frames() {
            Nanos::MAX
        } else {
            reach - self.rules.lookahead
        }
    }

    /// When [`Self::advance`] next moves the horizon; never before playout.
    pub(super) fn horizon_moves_at(&self) -> Nanos {
        self.horizon_moves_at
    }

    /// Renews what the scheduler sees of path and playout; to be called after news of the path. Before
    /// playout has started, the sender expects it to start when the rest of the first base could be there.
    pub fn look(&mut self, path: PathFacts, now: Nanos) {
        self.view_state.path = path.plausible();
        self.probe.look(&self.view_state.path, now);
        self.view_state.loss = self.loss.share(now);
        self.view_state.loss_after_loss = self.bursts.share_after_loss(self.view_state.loss, now);
        self.view_state.playing = self.known_start.is_some();
        self.view_state.playout_start = self.known_start.unwrap_or_else(|| {
            let latest = self.rules.startup.max_wait.max(now);
            let base = path.rate.time_for(Bytes(self.first_base_bytes));
            match self.rules.startup.rule {
                StartupRule::AfterWait => latest,
                _ => (now + path.smoothed_rtt + base).min(latest),
            }
        });
        self.widen(now);
    }

    /// Time has come to `now`: more of the clip may be within the horizon.
    pub fn advance(&mut self, now: Nanos) {
        self.expect_start_after(now);
        if now >= self.horizon_moves_at {
            self.widen(now);
        }
    }

    /// Playout that no receipt has reported is still to begin, whatever was expected when the receiver was
    /// last heard: otherwise what is shown first would count as too late while a link stands still.
    fn expect_start_after(&mut self, now: Nanos) {
        if self.known_start.is_none() {
            self.view_state.playout_start = self.view_state.playout_start.max(now);
        }
    }

    /// Moves the horizon; with more of the clip within it there may be something to send again.
    fn widen(&mut self, now: Nanos) {
        let before = self.view_state.horizon_frame;
        self.move_horizon(now);
        self.starved &= self.view_state.horizon_frame == before;
    }

    /// Until when another datagram would only lengthen the sender's own queue on the path; `None` if it would
    /// not. Two may always be out, and one more leaves after every silence of twice the queue, or of what the
    /// path needs for two datagrams, so that a full path drains nevertheless: what is in flight may be lost,
    /// and without an acknowledgement of something later nothing but the probe timeout would tell. Control is
    /// not subject to this. Where the scheduler requires it, a path that was never empty for ten seconds is
    /// emptied for about a round trip, to measure how long it is by itself.
    pub fn full_until(&self, now: Nanos) -> Option<Nanos> {
        let path = &self.view_state.path;
        let max_queue_delay = self.service.max_queue_delay.filter(|_| path.minimum_rtt > Nanos::ZERO)?;
        let emptied_until = self.probe.holds_until(path, now).filter(|_| self.service.empty_path);
        if emptied_until.is_some() || path.in_flight < 2 * path.datagram_bytes {
            return emptied_until;
        }
        // A path of many milliseconds needs as many more to be probed for its rate.
        let widest = max_queue_delay.max(path.minimum_rtt);
        let is_short = self.service.short_queue && self.view_state.loss < FEW_LOSSES;
        let queue = if is_short { Nanos(widest.0 / 20 * 9) } else { widest };
        let longest = path.minimum_rtt + queue;
        if path.rate.moves_within(Bytes(path.in_flight), longest) {
            return None;
        }
        let silence = path.rate.time_for(Bytes(2 * path.datagram_bytes)).min(LONGEST_SILENCE);
        let silence = silence.max(max_queue_delay.times(2));
        let silence_ends = self.last_sent_at + silence;
        (now < silence_ends).then_some(silence_ends)
    }

    /// The packet to send now, which counts as in flight from here on: first what was lost, then parity, then
    /// what the scheduler says. `None`: nothing is worth sending until something is learnt, or time brings
    /// more of the clip near.
    #[inline]
    pub fn next(&mut self, now: Nanos) -> Option<PacketIndex> {
        if self.starved && self.again.is_empty() && self.parity.is_empty() {
            return None;
        }
        self.next_of_any(now)
    }

    fn next_of_any(&mut self, now: Nanos) -> Option<PacketIndex> {
        let packet = self.next_lost(now).or_else(|| self.next_parity(now));
        let packet = if packet.is_none() && !self.starved { self.next_choice(now) } else { packet }?;
        let is_parity = self.is_parity(packet);
        self.counts.parity += u64::from(is_parity);
        let first = self.sent_times[packet.at()] == 0;
        self.sent_times[packet.at()] = self.sent_times[packet.at()].saturating_add(1);
        self.set_status(packet, PacketStatus::InFlight);
        if first {
            self.count_off(packet);
        }
        Some(packet)
    }

    /// A packet from [`Self::next`] has left. `number` ascends from one sending to the next; the transport
    /// names it again in [`Self::on_lost`].
    pub fn on_sent(&mut self, packet: PacketIndex, number: u64, now: Nanos) {
        self.last_number[packet.at()] = number;
        self.sent_at[packet.at()] = now;
    }

    /// A datagram of any kind has left; `in_flight` bytes of UDP payload are out now.
    pub fn on_datagram_sent(&mut self, in_flight: u64, now: Nanos) {
        self.last_sent_at = now;
        self.view_state.path.in_flight = in_flight;
    }

    /// `acked` datagrams of any kind were acknowledged, and `lost` were found lost.
    pub fn on_acks_and_losses(&mut self, acked: usize, lost: usize, now: Nanos) {
        self.loss.settle(acked, lost, now);
    }

    /// The datagram `number`, counted in the order of sending, was found to be `lost` or to have arrived: how
    /// losses cluster follows from it.
    pub fn on_fate(&mut self, number: u64, lost: bool, now: Nanos) {
        self.bursts.settle(number, lost, now);
    }

    /// Another sender to the same receiver sent `packet` at the time `at` as its sending `number`, and what
    /// became of it is not known.
    pub fn on_sent_before(&mut self, packet: PacketIndex, number: u64, at: Nanos) {
        if self.status[packet.at()] == PacketStatus::Waiting {
            self.set_status(packet, PacketStatus::InFlight);
            self.count_off(packet);
        }
        self.sent_times[packet.at()] = self.sent_times[packet.at()].saturating_add(1);
        self.on_sent(packet, number, at);
    }

    /// The receiver has `packet`.
    pub fn on_acked(&mut self, packet: PacketIndex) {
        if self.sent_times[packet.at()] == 0 && self.status[packet.at()] == PacketStatus::Waiting {
            self.count_off(packet);
        }
        self.set_status(packet, PacketStatus::Delivered);
    }

    /// The sending `number` of `packet` was lost.
    pub fn on_lost(&mut self, packet: PacketIndex, number: u64, now: Nanos) {
        if self.status[packet.at()] != PacketStatus::InFlight || self.last_number[packet.at()] != number {
            return;
        }
        self.expect_start_after(now);
        let view = self.view_state.view(&self.graph, &self.status, &self.sent_at, &self.last_number);
        let expired = view.is_expired(packet, now);
        if self.service.lost_compete && !self.is_parity(packet) {
            self.set_status(packet, if expired { PacketStatus::Abandoned } else { PacketStatus::Waiting });
            self.starved = false;
            return;
        }
        let budget = u32::from(self.sent_times[packet.at()]) <= self.rules.retransmissions;
        let is_base = !self.is_parity(packet) && self.graph.level(packet) == 0;
        if budget && is_base && !expired {
            self.again.push_back(packet);
        } else {
            self.set_status(packet, PacketStatus::Abandoned);
        }
    }

    /// The bytes of a receipt have come; [`Self::look`] is to be called after it. A receipt that cannot be
    /// read is counted and ignored.
    pub fn on_receipt(&mut self, bytes: &[u8]) {
        let mut feedback = std::mem::take(&mut self.feedback);
        match feedback::read(bytes, &self.graph, &mut feedback) {
            Ok(()) => {
                feedback.received.iter().for_each(|packet| self.on_acked(*packet));
                self.on_playout(feedback.playout_start);
                feedback.pose.into_iter().for_each(|said| self.on_pose(said));
            }
            Err(_) => self.counts.refused_receipts += 1,
        }
        self.feedback = feedback;
    }

    /// A receipt has said when frame 0 was shown, or that it was not.
    pub(super) fn on_playout(&mut self, start: Option<Nanos>) {
        // Until playout starts, what is worth sending follows from what is known to be there.
        self.starved &= self.known_start.is_some();
        self.known_start = self.known_start.or(start);
    }

    /// A receipt has said where the viewer was: its number, and the pose.
    pub(super) fn on_pose(&mut self, (sequence, pose): (u32, ViewerPose)) {
        self.reported_pose.take(sequence, &pose);
        self.view_state.viewpoint = self.reported_pose.viewpoint();
    }

    fn is_parity(&self, packet: PacketIndex) -> bool {
        self.graph.is_parity(packet)
    }

    /// What was lost and is to be sent again before all else.
    fn next_lost(&mut self, now: Nanos) -> Option<PacketIndex> {
        while let Some(lost) = self.again.pop_front() {
            if self.status[lost.at()] != PacketStatus::InFlight {
                continue;
            }
            let view = self.view_state.view(&self.graph, &self.status, &self.sent_at, &self.last_number);
            if !view.is_expired(lost, now) {
                self.counts.retransmitted += 1;
                return Some(lost);
            }
            self.set_status(lost, PacketStatus::Abandoned);
        }
        None
    }

    /// Parity whose set has been sent, if the scheduler wants it.
    fn next_parity(&mut self, now: Nanos) -> Option<PacketIndex> {
        if self.parity.is_empty() {
            return None;
        }
        let view = self.view_state.view(&self.graph, &self.status, &self.sent_at, &self.last_number);
        self.parity.next(&mut self.scheduler, &view, now)
    }

    /// What the scheduler says; with nothing else to send, parity that was not worth its bytes before may be,
    /// while what it protects is on its way.
    fn next_choice(&mut self, now: Nanos) -> Option<PacketIndex> {
        let view = self.view_state.view(&self.graph, &self.status, &self.sent_at, &self.last_number);
        let mut packet = self.scheduler.next(&view, now);
        if packet.is_some_and(|packet| !view.is_sendable(packet, now) || view.graph.is_parity(packet)) {
            self.counts.refused_choices += 1;
            packet = None;
        }
        if packet.is_none() {
            packet = self.parity.next_of_refused(&mut self.scheduler, &view, now);
        }
        self.starved = packet.is_none();
        let packet = packet?;
        if self.sent_times[packet.at()] > 0 {
            self.counts.retransmitted += 1;
        } else if !view.graph.is_parity(packet) {
            self.counts.media += 1;
            if let Some((chance, frame)) = self.scheduler.forecast(&view, packet, now) {
                self.forecasts.note(packet, chance, frame);
            }
        }
        Some(packet)
    }

    /// `packet` no longer waits for its first sending.
    fn count_off(&mut self, packet: PacketIndex) {
        // Few packets can be of the first base, and only for them is it worth to look at their groups.
        let may_be_first_base = self.graph.level(packet) == 0 && self.graph.needed_from(packet) == 0;
        let is_first_base = |group: GroupIndex| {
            let group = &self.graph.groups()[group.at()];
            group.level() == 0 && group.first_frame == 0
        };
        if may_be_first_base && self.graph.groups_of(packet).any(is_first_base) {
            let bytes = u64::from(self.graph.wire_bytes(packet));
            self.first_base_bytes = self.first_base_bytes.saturating_sub(bytes);
        }
        self.parity.count_off(&self.graph, packet);
    }

    fn set_status(&mut self, packet: PacketIndex, after: PacketStatus) {
        let before = std::mem::replace(&mut self.status[packet.at()], after);
        if before != after {
            self.scheduler.on_status(&self.graph, packet, [before, after]);
        }
    }

    /// Sets the horizon as it is at `now`, and when it moves next; before playout it stands.
    fn move_horizon(&mut self, now: Nanos) {
        let interval = self.graph.frame_interval();
        let played = self.known_start.map_or(Nanos::ZERO, |start| now - start);
        let frames = (played + self.rules.lookahead).0 / interval.0 + 1;
        self.view_state.horizon_frame = u32::try_from(frames).unwrap_or(u32::MAX);
        let reach = interval.times(frames) - self.rules.lookahead;
        self.horizon_moves_at = self.known_start.map_or(Nanos::MAX, |start| start + reach);
    }
}

#[cfg(test)]
mod tests;
