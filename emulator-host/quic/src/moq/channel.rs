//! Holds one stream as a broadcast, and publishes its windows one after the other.

use std::time::Duration;

use bytes::Bytes;
use dgs_player::{Caps, Waiting};
use emulator_host::{Nanos, PacketIndex};
use moq_net::{Timestamp, broadcast, group, origin, track};
use serde::Serialize;

use super::{
    numbering::{LEAD, Spans},
    track::{LEVELS, Track},
    units::{Levels, Units},
};
use crate::socket::ServedStream;

/// What was published under one name.
#[derive(Clone, Debug, Default, Serialize)]
pub struct BroadcastReport {
    /// The name.
    pub name: String,
    /// Windows published, repeats included.
    pub windows: u64,
    /// Groups: a track's part of an epoch or window.
    pub groups: u64,
    /// Packets in them.
    pub packets: u64,
    /// Their bytes. They leave only where somebody subscribes.
    pub media_bytes: u64,
}

/// Why a stream is not published.
#[derive(Debug, thiserror::Error)]
#[error("{name}: {what}")]
pub struct ChannelError {
    name: String,
    what: String,
}

/// A stream on its way to the relay.
pub(super) struct Channel {
    windows: Spans,
    epochs: Spans,
    units: Units,
    /// By packet index.
    packets: Vec<Bytes>,
    /// Number of the window to be published next, and of the epoch published last.
    next: u64,
    epoch: Option<u64>,
    /// By level.
    canonical: Vec<track::Producer>,
    motion: Vec<track::Producer>,
    /// What is dropped ends for subscribers too.
    _alive: (track::Producer, broadcast::Producer),
    report: BroadcastReport,
}

impl Channel {
    /// Announces `offer` as `name`, with nothing but its manifest yet.
    pub(super) fn new(
        name: &str,
        offer: &ServedStream,
        origin: &origin::Producer,
    ) -> Result<Self, ChannelError> {
        let refused = |what: String| ChannelError { name: name.to_owned(), what };
        let message = offer.message();
        let waiting = Waiting::new(Caps::HOST).map_err(|error| refused(error.to_string()))?;
        let player = waiting.manifest(message).map_err(|(_, error)| refused(error.to_string()))?;
        let (windows, epochs) = Spans::of(player.manifest())
            .ok_or_else(|| refused("a clip without time cannot be repeated".to_owned()))?;
        let content = offer.content().borrow().clone();
        let graph = content.graph();
        let units = Units::of(graph, windows.firsts());
        let indices = (0..graph.packets().len() as u32).map(PacketIndex);
        let packets = indices.map(|packet| content.packet(graph, packet)).collect();
        // A window is of use until it has been shown, which is the lead after the newest came.
        let max_age = Duration::from_nanos((LEAD + windows.longest()).0);
        let library = |error: moq_net::Error| refused(error.to_string());
        let broadcast = origin.create_broadcast(name).map_err(library)?;
        let create = |of: Track| {
            let info = track::Info::default().with_priority(of.priority()).with_max_age(max_age);
            broadcast.create_track(of.name(), info).map_err(library)
        };
        let manifest = create(Track::Manifest)?;
        let canonical = (0..LEVELS).map(|level| create(Track::Canonical(level))).collect::<Result<_, _>>()?;
        let motion = (0..LEVELS).map(|level| create(Track::Motion(level))).collect::<Result<_, _>>()?;
        let message = [Bytes::copy_from_slice(message)];
        write(&manifest, 0, Timestamp::ZERO, &message).map_err(library)?;
        broadcast.announce(origin::Route::default()).map_err(library)?;
        Ok(Self {
            windows,
            epochs,
            units,
            packets,
            next: 0,
            epoch: None,
            canonical,
            motion,
            _alive: (manifest, broadcast),
            report: BroadcastReport { name: name.to_owned(), ..BroadcastReport::default() },
        })
    }

    /// The window that is shown at `now` is the first.
    pub(super) fn begin(&mut self, now: Nanos) {
        self.next = self.windows.at(now);
    }

    /// When the window that is to be published next is shown, since 1970.
    pub(super) fn next_begins(&self) -> Nanos {
        self.windows.begins(self.next)
    }

    /// Publishes the next window, after the epoch that it needs.
    pub(super) fn advance(&mut self) -> Result<(), ChannelError> {
        let (number, at) = (self.next, self.next_begins());
        let epoch = self.epochs.at(at);
        // Attributes of a clip of one epoch stay what they are for ever.
        if self.epoch.is_none_or(|last| last != epoch && !self.epochs.is_one()) {
            let levels = self.units.canonical.get(self.epochs.place(epoch));
            let levels = levels.cloned().unwrap_or_default();
            self.publish(false, epoch, self.epochs.begins(epoch), &levels)?;
            self.epoch = Some(epoch);
        }
        let levels = self.units.motion.get(self.windows.place(number));
        let levels = levels.cloned().unwrap_or_default();
        self.publish(true, number, at, &levels)?;
        self.report.windows += 1;
        self.next += 1;
        Ok(())
    }

    /// Publishes one span as a group on each track.
    fn publish(&mut self, moves: bool, number: u64, at: Nanos, levels: &Levels) -> Result<(), ChannelError> {
        let refused = |what: String| ChannelError { name: self.report.name.clone(), what };
        let stamp = Timestamp::from_millis(at.0 / 1_000_000).map_err(|error| refused(error.to_string()))?;
        let tracks = if moves { &self.motion } else { &self.canonical };
        for (track, packets) in tracks.iter().zip(levels) {
            let frames: Vec<Bytes> =
                packets.iter().filter_map(|packet| self.packets.get(packet.at())).cloned().collect();
            write(track, number, stamp, &frames).map_err(|error| refused(error.to_string()))?;
            self.report.groups += 1;
            self.report.packets += frames.len() as u64;
            self.report.media_bytes += frames.iter().map(|frame| frame.len() as u64).sum::<u64>();
        }
        Ok(())
    }

    /// What was published.
    pub(super) fn into_report(self) -> BroadcastReport {
        self.report
    }
}

/// Publishes a whole group.
fn write(
    track: &track::Producer,
    sequence: u64,
    stamp: Timestamp,
    frames: &[Bytes],
) -> Result<(), moq_net::Error> {
    let mut group = track.create_group(group::Info { sequence })?;
    for frame in frames {
        group.write_frame(stamp, frame)?;
    }
    group.finish()
}
