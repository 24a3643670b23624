//! Publishes the windows of a clip one after the other, again and again.

use bytes::Bytes;
use emulator_host::{Nanos, PacketIndex};
use moq_net::origin;

use super::{
    broadcast::{Broadcast, BroadcastReport, ChannelError, TrackKind},
    units::{Levels, Units},
};
use crate::socket::ServedStream;

/// A clip on its way to the relay.
pub(super) struct Channel {
    broadcast: Broadcast,
    units: Units,
    /// By packet index.
    packets: Vec<Bytes>,
    /// Number of the window to be published next, and of the epoch published last.
    next: u64,
    epoch: Option<u64>,
}

impl Channel {
    /// Announces `offer` as `name`, with nothing but its manifest yet.
    pub(super) fn new(
        name: &str,
        offer: &ServedStream,
        origin: &origin::Producer,
    ) -> Result<Self, ChannelError> {
        let broadcast = Broadcast::announce(name, offer, origin)?;
        let content = offer.content().borrow().clone();
        let graph = content.graph();
        let units = Units::of(graph, broadcast.windows.firsts());
        let indices = (0..graph.packets().len() as u32).map(PacketIndex);
        let packets = indices.map(|packet| content.packet(graph, packet)).collect();
        Ok(Self { broadcast, units, packets, next: 0, epoch: None })
    }

    /// The window that is shown at `now` is the first.
    pub(super) fn begin(&mut self, now: Nanos) {
        self.next = self.broadcast.windows.at(now);
    }

    /// When the window that is to be published next is shown, since 1970.
    pub(super) fn next_begins(&self) -> Nanos {
        self.broadcast.windows.begins(self.next)
    }

    /// Publishes the next window, after the epoch that it needs.
    pub(super) fn advance(&mut self) -> Result<(), ChannelError> {
        let epochs = &self.broadcast.epochs;
        let epoch = epochs.at(self.next_begins());
        // Attributes of a clip of one epoch stay what they are for ever.
        if self.epoch.is_none_or(|last| last != epoch && !epochs.is_one()) {
            let levels = self.units.canonical.get(epochs.place(epoch));
            let levels = levels.cloned().unwrap_or_default();
            self.publish(TrackKind::Canonical, epoch, &levels)?;
            self.epoch = Some(epoch);
        }
        let levels = self.units.motion.get(self.broadcast.windows.place(self.next));
        let levels = levels.cloned().unwrap_or_default();
        self.publish(TrackKind::Motion, self.next, &levels)?;
        self.next += 1;
        Ok(())
    }

    fn publish(&mut self, kind: TrackKind, number: u64, levels: &Levels) -> Result<(), ChannelError> {
        let bytes = |packet: &PacketIndex| self.packets.get(packet.at()).cloned();
        let levels = levels.each_ref().map(|packets| packets.iter().filter_map(bytes).collect());
        self.broadcast.publish(kind, number, &levels)
    }

    /// What was published.
    pub(super) fn report(&self) -> BroadcastReport {
        self.broadcast.report()
    }
}
