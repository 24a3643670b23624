//! Holds what a scheduler may know of path and playout.

use crate::{
    clock::{Nanos, Rate},
    graph::PacketGraph,
    policy::{PacketStatus, SenderView},
    startup::StartupRule,
    viewpoint::Viewpoint,
};

/// What a transport knows of its path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PathFacts {
    /// What the sender can count on, bits/s of UDP payload: min(cwnd/srtt, estimated rate of the path).
    pub rate: Rate,
    /// Smoothed round trip; RFC 9002 assumes 333 ms before the first sample.
    pub smoothed_rtt: Nanos,
    /// Its mean deviation.
    pub rtt_variation: Nanos,
    /// Smallest round trip of late ([`crate::congestion::RecentMinimum`]); zero before the first sample.
    pub minimum_rtt: Nanos,
    /// How long ago it was measured; zero where the transport knows it for certain.
    pub minimum_rtt_age: Nanos,
    /// UDP payload bytes in flight.
    pub in_flight: u64,
    /// UDP payload of the largest datagram.
    pub datagram_bytes: u64,
}

/// Longest round trip of an empty path: satellites in high orbits take 0.6 s. What measured longer waited
/// somewhere, such as on a link that carried nothing when the session began.
const LONGEST_EMPTY_ROUND_TRIP: Nanos = Nanos::from_s(1);

impl PathFacts {
    /// The round trip to count on: the smoothed one, unless the newest sample (zero before the first) took
    /// less than half as long. The mean that has seen a link stand still says seconds for many samples after
    /// it carries again; a path that is no faster than before shows at once that it is not.
    pub fn expected_round_trip(smoothed: Nanos, newest: Nanos) -> Nanos {
        if newest > Nanos::ZERO && newest.times(2) < smoothed { newest } else { smoothed }
    }

    /// The same with a smallest round trip that an empty path may have: otherwise everything would count as
    /// too late to be sent that is shown within half of what the first datagrams had to wait.
    pub(super) fn plausible(self) -> Self {
        Self { minimum_rtt: self.minimum_rtt.min(LONGEST_EMPTY_ROUND_TRIP), ..self }
    }

    /// What is known of a path before anything was sent: the assumptions of RFC 9002, and a rate of its
    /// initial window per round trip.
    pub fn unknown(datagram_bytes: u64) -> Self {
        let smoothed_rtt = Nanos::from_ms(333);
        let window = crate::congestion::initial_window(datagram_bytes);
        Self {
            rate: Rate::over(crate::clock::Bytes(window), smoothed_rtt),
            smoothed_rtt,
            rtt_variation: Nanos(smoothed_rtt.0 / 2),
            minimum_rtt: Nanos::ZERO,
            minimum_rtt_age: Nanos::ZERO,
            in_flight: 0,
            datagram_bytes,
        }
    }
}

/// Path and playout part of [`SenderView`], renewed when feedback comes.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewState {
    pub(super) path: PathFacts,
    pub(super) playout_start: Nanos,
    pub(super) playing: bool,
    pub(super) horizon_frame: u32,
    pub(super) loss: f64,
    pub(super) loss_after_loss: f64,
    pub(super) retransmissions: u32,
    pub(super) startup: StartupRule,
    pub(super) viewpoint: Option<Viewpoint>,
}

impl ViewState {
    pub(super) fn new(path: PathFacts, retransmissions: u32, startup: StartupRule) -> Self {
        Self {
            path,
            playout_start: Nanos::ZERO,
            playing: false,
            horizon_frame: 0,
            loss: 0.0,
            loss_after_loss: 0.0,
            retransmissions,
            startup,
            viewpoint: None,
        }
    }

    pub(super) fn view<'a>(
        &self,
        graph: &'a PacketGraph,
        status: &'a [PacketStatus],
        sent_at: &'a [Nanos],
        sent_number: &'a [u64],
    ) -> SenderView<'a> {
        SenderView {
            graph,
            status,
            sent_at,
            sent_number,
            in_flight: self.path.in_flight,
            startup: self.startup,
            playout_start: self.playout_start,
            playing: self.playing,
            horizon_frame: self.horizon_frame,
            rate: self.path.rate,
            smoothed_rtt: self.path.smoothed_rtt,
            rtt_variation: self.path.rtt_variation,
            minimum_rtt: self.path.minimum_rtt,
            loss: self.loss,
            loss_after_loss: self.loss_after_loss,
            retransmissions: self.retransmissions,
            viewpoint: self.viewpoint,
        }
    }
}
