//! One sender follows another to the same receiver, of a stream that has grown.

use std::ops::Deref;

use super::{MediaSender, PacketStatus};
use crate::{
    graph::{PacketGraph, PacketIndex},
    policy::Scheduler,
};

impl<G: Deref<Target = PacketGraph>, S: Scheduler> MediaSender<G, S> {
    /// Goes on from where `before` was: what it has learnt of the path's losses and round trips, how often
    /// each packet was sent, and where the viewer is. `index` says which packet of this graph is one of that
    /// of `before`. Numbers of sendings go on as well; [`Self::look`] is to be called after it.
    pub fn go_on_from(&mut self, before: Self, index: impl Fn(PacketIndex) -> Option<PacketIndex>) {
        for (at, &times) in before.sent_times.iter().enumerate().filter(|(_, times)| **times > 0) {
            let Some(packet) = index(PacketIndex(at as u32)) else { continue };
            if self.sent_times[packet.at()] == 0 && self.status[packet.at()] == PacketStatus::Waiting {
                self.count_off(packet);
            }
            self.sent_times[packet.at()] = self.sent_times[packet.at()].max(times);
        }
        (self.loss, self.bursts, self.probe) = (before.loss, before.bursts, before.probe);
        self.reported_pose = before.reported_pose;
        self.view_state.viewpoint = self.reported_pose.viewpoint();
    }
}
