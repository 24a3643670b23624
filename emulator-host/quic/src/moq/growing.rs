//! Publishes a stream that grows: each window once, as soon as it is whole.

use std::sync::Arc;

use bytes::Bytes;
use moq_net::origin;
use tokio::sync::watch;

use super::{
    broadcast::{Broadcast, BroadcastReport, ChannelError, TrackKind},
    track::LEVELS,
    units::{Levels, Units},
};
use crate::socket::{Content, ServedStream};

/// A stream that grows, on its way to the relay.
pub(super) struct GrowingChannel {
    broadcast: Broadcast,
    content: watch::Receiver<Arc<Content>>,
    /// By packet id: what was published.
    published: Vec<bool>,
    /// Number of the window to be published next, and of the epoch published last.
    next: u64,
    epoch: Option<u64>,
}

impl GrowingChannel {
    /// Announces `offer` as `name`, with nothing but its manifest yet.
    pub(super) fn new(
        name: &str,
        offer: &ServedStream,
        origin: &origin::Producer,
    ) -> Result<Self, ChannelError> {
        let broadcast = Broadcast::announce(name, offer, origin)?;
        let mut content = offer.content();
        // What is there by now is as new as what comes.
        content.mark_changed();
        Ok(Self { broadcast, content, published: Vec::new(), next: 0, epoch: None })
    }

    /// Publishes what comes, for ever.
    pub(super) async fn follow(&mut self) -> Result<(), ChannelError> {
        while self.content.changed().await.is_ok() {
            self.publish_whole()?;
        }
        // What has come stays there for who comes later.
        std::future::pending().await
    }

    /// Publishes the windows that have become whole. Nothing is of a window that was skipped.
    fn publish_whole(&mut self) -> Result<(), ChannelError> {
        let content = self.content.borrow_and_update().clone();
        let graph = content.graph();
        let Some(newest) = content.newest().filter(|_| !graph.packets().is_empty()) else { return Ok(()) };
        let units = Units::of(graph, self.broadcast.windows.firsts());
        // In round 0: those of a clip that repeats are counted since 1970.
        let newest = self.broadcast.windows.of_frame(newest);
        while self.next <= newest {
            let epoch = self.broadcast.epochs.of_frame(self.broadcast.windows.first(self.next));
            if self.epoch != Some(epoch) {
                let levels = self.take(&content, units.canonical.get(epoch as usize));
                self.broadcast.publish(TrackKind::Canonical, epoch, &levels)?;
                self.epoch = Some(epoch);
            }
            let mut levels = self.take(&content, units.motion.get(self.next as usize));
            // Attributes may come at any time in their epoch; its groups are closed.
            let late = self.take(&content, units.canonical.get(epoch as usize));
            levels.iter_mut().zip(late).for_each(|(packets, late)| packets.extend(late));
            self.broadcast.publish(TrackKind::Motion, self.next, &levels)?;
            self.next += 1;
        }
        Ok(())
    }

    /// The bytes of what of `levels` was not published, which it is from here on.
    fn take(&mut self, content: &Content, levels: Option<&Levels>) -> [Vec<Bytes>; LEVELS] {
        let mut taken = <[Vec<Bytes>; LEVELS]>::default();
        for (taken, packets) in taken.iter_mut().zip(levels.into_iter().flatten()) {
            for packet in packets {
                let id = content.graph().wire_id(*packet).index();
                if self.published.len() <= id {
                    self.published.resize(id + 1, false);
                }
                if !std::mem::replace(&mut self.published[id], true) {
                    taken.push(content.packet(content.graph(), *packet));
                }
            }
        }
        taken
    }

    /// What was published.
    pub(super) fn report(&self) -> BroadcastReport {
        self.broadcast.report()
    }
}
