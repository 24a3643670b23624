//! Announces a stream at the relay, and writes spans of it as groups.

use std::time::Duration;

use bytes::Bytes;
use dgs_player::{Caps, Waiting};
use emulator_host::Nanos;
use moq_net::{Timestamp, broadcast, group, origin, track};
use serde::Serialize;

use super::{
    numbering::{LEAD, Spans},
    track::{LEVELS, Track},
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

/// Which kind of tracks a span is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TrackKind {
    Canonical,
    Motion,
}

/// A stream that is announced, with nothing but its manifest yet.
pub(super) struct Broadcast {
    pub(super) windows: Spans,
    pub(super) epochs: Spans,
    /// By level.
    canonical: Vec<track::Producer>,
    motion: Vec<track::Producer>,
    /// What is dropped ends for subscribers too.
    _alive: (track::Producer, broadcast::Producer),
    report: BroadcastReport,
}

impl Broadcast {
    /// Announces `offer` as `name`.
    pub(super) fn announce(
        name: &str,
        offer: &ServedStream,
        origin: &origin::Producer,
    ) -> Result<Self, ChannelError> {
        let refused = |what: String| ChannelError { name: name.to_owned(), what };
        let message = offer.message();
        let waiting = Waiting::new(Caps::HOST).map_err(|error| refused(error.to_string()))?;
        let player = waiting.manifest(message).map_err(|(_, error)| refused(error.to_string()))?;
        let (windows, epochs) = Spans::of(player.manifest())
            .ok_or_else(|| refused("a clip without time has no windows to publish".to_owned()))?;
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
            canonical,
            motion,
            _alive: (manifest, broadcast),
            report: BroadcastReport { name: name.to_owned(), ..BroadcastReport::default() },
        })
    }

    /// Publishes span `number` as a group on each track of `kind`: per level, its packets.
    pub(super) fn publish(
        &mut self,
        kind: TrackKind,
        number: u64,
        levels: &[Vec<Bytes>; LEVELS],
    ) -> Result<(), ChannelError> {
        let refused = |what: String| ChannelError { name: self.report.name.clone(), what };
        let (tracks, at): (_, Nanos) = match kind {
            TrackKind::Canonical => (&self.canonical, self.epochs.begins(number)),
            TrackKind::Motion => (&self.motion, self.windows.begins(number)),
        };
        let stamp = Timestamp::from_millis(at.0 / 1_000_000).map_err(|error| refused(error.to_string()))?;
        for (track, frames) in tracks.iter().zip(levels) {
            write(track, number, stamp, frames).map_err(|error| refused(error.to_string()))?;
            self.report.groups += 1;
            self.report.packets += frames.len() as u64;
            self.report.media_bytes += frames.iter().map(|frame| frame.len() as u64).sum::<u64>();
        }
        self.report.windows += u64::from(kind == TrackKind::Motion);
        Ok(())
    }

    /// What was published.
    pub(super) fn report(&self) -> BroadcastReport {
        self.report.clone()
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
