//! Holds what a scheduler may know of path and playout.

use crate::{
    clock::{Nanos, Rate},
    graph::PacketGraph,
    policy::{PacketStatus, SenderView},
    startup::StartupRule,
};

/// What the view holds besides the graph and the status table; renewed when feedback comes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outlook {
    pub(super) playout_start: Nanos,
    pub(super) playing: bool,
    pub(super) horizon_frame: u32,
    pub(super) rate: Rate,
    pub(super) smoothed_rtt: Nanos,
    pub(super) rtt_variation: Nanos,
    pub(super) minimum_rtt: Nanos,
    pub(super) loss: f64,
    pub(super) in_flight: u64,
    pub(super) retransmissions: u32,
    pub(super) startup: StartupRule,
}

impl Outlook {
    pub(super) fn view<'a>(
        &self,
        graph: &'a PacketGraph,
        status: &'a [PacketStatus],
        sent_at: &'a [Nanos],
    ) -> SenderView<'a> {
        SenderView {
            graph,
            status,
            sent_at,
            in_flight: self.in_flight,
            startup: self.startup,
            playout_start: self.playout_start,
            playing: self.playing,
            horizon_frame: self.horizon_frame,
            rate: self.rate,
            smoothed_rtt: self.smoothed_rtt,
            rtt_variation: self.rtt_variation,
            minimum_rtt: self.minimum_rtt,
            loss: self.loss,
            retransmissions: self.retransmissions,
        }
    }
}
