//! A network emulates what lies between a session's packets and its player: which of them are through.

use std::collections::BTreeSet;

use codec_core::internals::{ids::PacketId, wire::packet::Head};

use crate::channel::{Channel, Conditions};

/// A channel, and how far the packets of a session are through it.
#[derive(Debug)]
pub(super) struct Network {
    channel: Channel,
    /// Packets that are through, arrived or lost; the first ones of all that came.
    through: usize,
    /// When it began, seconds.
    since_s: Option<f64>,
    /// Of what a server sends, the packets that are not through.
    on_way: BTreeSet<PacketId>,
}

impl Network {
    /// One that has been given nothing.
    pub(super) fn new(conditions: Conditions) -> Self {
        let channel = Channel::new(conditions);
        Self { channel, through: 0, since_s: None, on_way: BTreeSet::new() }
    }

    pub(super) fn conditions(&self) -> Conditions {
        self.channel.conditions()
    }

    /// Packets that are through.
    pub(super) fn through(&self) -> usize {
        self.through
    }

    /// Notes that packet `id` of a server is on its way; false where it was already.
    pub(super) fn note(&mut self, id: PacketId) -> bool {
        self.on_way.insert(id)
    }

    /// Lets all of `packets` through.
    pub(super) fn skip(&mut self, packets: &[Vec<u8>]) {
        self.through = packets.len();
        self.on_way.clear();
    }

    /// Those of `packets`, which are all that came, that arrive until `now_s`, seconds. What a server sends
    /// `live` is handed over as it comes; a file is when the network begins, all of it.
    pub(super) fn deliver<'p>(&mut self, packets: &'p [Vec<u8>], live: bool, now_s: f64) -> Vec<&'p [u8]> {
        let since_s = *self.since_s.get_or_insert(now_s);
        let handed_s = if live { now_s } else { since_s };
        for packet in &packets[self.through + self.channel.on_way()..] {
            self.channel.send(packet.len(), handed_s);
        }
        let mut arrived = Vec::new();
        while let Some(arrives) = self.channel.next_through(now_s) {
            let packet = packets[self.through].as_slice();
            self.through += 1;
            if let Some(id) = id_of(packet) {
                self.on_way.remove(&id);
            }
            if arrives {
                arrived.push(packet);
            }
        }
        arrived
    }
}

/// The id of `packet`, if it has one.
pub(super) fn id_of(packet: &[u8]) -> Option<PacketId> {
    Head::parse(packet).ok().map(|head| head.id)
}
