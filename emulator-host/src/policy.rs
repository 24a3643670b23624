//! Chooses what to send next. A scheduler is called at the moment a datagram may leave, never earlier, so
//! nothing stale is queued.
//!
//! Every policy sees the same [`SenderView`] and is served by the same sender: control bytes go first, parity
//! follows the last member of its set, and what can no longer be shown is never sent. Who decides on lost
//! packets, and how long a queue the sender may cause, is the policy's to say ([`SenderRequirements`]).

mod dash;
mod deadline_utility;
mod deadline_utility_paper;
mod dependency;
mod kind;
mod layered;
mod probability;
mod service;

use crate::{
    clock::{Bytes, Nanos, Rate},
    graph::{GroupIndex, PacketGraph, PacketIndex},
    startup::StartupRule,
    viewpoint::Viewpoint,
};

pub use dash::Dash;
pub use deadline_utility::{
    DeadlineUtility, DeadlineUtilityConfig, ViewportConfig, file_order, order_by_utility,
};
pub use dependency::Dependency;
pub use kind::PolicyKind;
pub use layered::Layered;
pub use service::SenderRequirements;

/// What the sender knows of a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PacketStatus {
    /// Never sent; or lost, where the scheduler decides on lost packets.
    Waiting,
    /// Sent, or lost and queued to be sent again.
    InFlight,
    /// Acknowledged by the receiver, or recovered there from parity.
    Delivered,
    /// Lost, and not to be sent again.
    Abandoned,
}

/// What a scheduler may look at.
#[derive(Clone, Copy, Debug)]
pub struct SenderView<'a> {
    /// What is to be delivered.
    pub graph: &'a PacketGraph,
    /// One status per packet.
    pub status: &'a [PacketStatus],
    /// When frame 0 is shown: known from feedback, or the sender's estimate before playout has started.
    pub playout_start: Nanos,
    /// Whether playout has started, as far as the sender knows.
    pub playing: bool,
    /// First frame that is too far ahead to send for.
    pub horizon_frame: u32,
    /// min(cwnd/srtt, r̂_path) in bits/s of UDP payload.
    pub rate: Rate,
    /// Smoothed round trip.
    pub smoothed_rtt: Nanos,
    /// Its mean deviation.
    pub rtt_variation: Nanos,
    /// Smallest round trip of late; zero before the first sample.
    pub minimum_rtt: Nanos,
    /// UDP payload bytes in flight.
    pub in_flight: u64,
    /// When each packet was last sent; zero if never.
    pub sent_at: &'a [Nanos],
    /// Number of the latest sending of each packet, ascending in the order of sending; [`u64::MAX`] if never.
    pub sent_number: &'a [u64],
    /// Share of datagrams that the path loses of late, 0..=1.
    pub loss: f64,
    /// The same share among those whose predecessor was lost: [`Self::loss`] where losses are independent,
    /// 1 − 1/n where they come in bursts of mean length n.
    pub loss_after_loss: f64,
    /// What playout waits for.
    pub startup: StartupRule,
    /// Times that a lost base packet may be sent again.
    pub retransmissions: u32,
    /// Where the viewer is, if it says so.
    pub viewpoint: Option<Viewpoint>,
}

impl SenderView<'_> {
    /// When `frame` is shown.
    pub fn playout_at(&self, frame: u32) -> Nanos {
        self.playout_start + self.graph.frame_interval().times(u64::from(frame))
    }

    /// How long what is in flight still takes to arrive beyond the smallest round trip: the queue on the
    /// path, as far as the sender can know it. A round trip once measured says nothing of it.
    pub fn queueing(&self) -> Nanos {
        self.rate.time_for(Bytes(self.in_flight)) - self.minimum_rtt
    }

    /// Whether a datagram sent at `now` cannot arrive before `frame` is shown, even on an empty path.
    pub fn is_past(&self, frame: u32, now: Nanos) -> bool {
        now + Nanos(self.minimum_rtt.0 / 2) >= self.playout_at(frame)
    }

    /// Whether `packet` can no longer contribute to any frame.
    pub fn is_expired(&self, packet: PacketIndex, now: Nanos) -> bool {
        self.is_past(self.graph.useful_until(packet), now)
    }

    /// Whether `packet` may be sent for the first time: of this graph, never sent, near enough, not expired.
    pub fn is_sendable(&self, packet: PacketIndex, now: Nanos) -> bool {
        self.status.get(packet.at()) == Some(&PacketStatus::Waiting)
            && self.graph.needed_from(packet) < self.horizon_frame
            && !self.is_expired(packet, now)
    }
}

/// Chooses packets.
pub trait Scheduler {
    /// Name in reports.
    fn name(&self) -> &'static str;

    /// The packet to send at `now`, or `None` if nothing is worth sending until the view changes. It must be
    /// [`SenderView::is_sendable`] and no parity packet. The sender sends what is returned; another choice is
    /// counted as refused.
    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex>;

    /// How the sender is to serve this scheduler.
    fn service(&self) -> SenderRequirements {
        SenderRequirements::CONVENTIONAL
    }

    /// Whether `parity`, whose set has just been sent, is worth its bytes at `now`.
    fn wants_parity(&mut self, _view: &SenderView<'_>, _parity: PacketIndex, _now: Nanos) -> bool {
        true
    }

    /// The chance that `packet`, sent at `now`, arrives before a frame is shown, and that frame; `None` if
    /// this scheduler forecasts nothing.
    fn forecast(&self, _view: &SenderView<'_>, _packet: PacketIndex, _now: Nanos) -> Option<(f64, u32)> {
        None
    }

    /// The status of `packet` has just changed from the first of `change` to the second.
    fn on_status(&mut self, _graph: &PacketGraph, _packet: PacketIndex, _change: [PacketStatus; 2]) {}
}

impl<S: Scheduler + ?Sized> Scheduler for &mut S {
    fn name(&self) -> &'static str {
        (**self).name()
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        (**self).next(view, now)
    }

    fn service(&self) -> SenderRequirements {
        (**self).service()
    }

    fn wants_parity(&mut self, view: &SenderView<'_>, parity: PacketIndex, now: Nanos) -> bool {
        (**self).wants_parity(view, parity, now)
    }

    fn forecast(&self, view: &SenderView<'_>, packet: PacketIndex, now: Nanos) -> Option<(f64, u32)> {
        (**self).forecast(view, packet, now)
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        (**self).on_status(graph, packet, change);
    }
}

impl<S: Scheduler + ?Sized> Scheduler for Box<S> {
    fn name(&self) -> &'static str {
        (**self).name()
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        (**self).next(view, now)
    }

    fn service(&self) -> SenderRequirements {
        (**self).service()
    }

    fn wants_parity(&mut self, view: &SenderView<'_>, parity: PacketIndex, now: Nanos) -> bool {
        (**self).wants_parity(view, parity, now)
    }

    fn forecast(&self, view: &SenderView<'_>, packet: PacketIndex, now: Nanos) -> Option<(f64, u32)> {
        (**self).forecast(view, packet, now)
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        (**self).on_status(graph, packet, change);
    }
}

/// The first sendable packet of `group`'s closure, needed groups first.
fn first_of_closure(view: &SenderView<'_>, group: GroupIndex, now: Nanos) -> Option<PacketIndex> {
    let mut packets = view.graph.closure(group).flat_map(|member| view.graph.packets_of(member));
    packets.find(|packet| view.is_sendable(*packet, now))
}
