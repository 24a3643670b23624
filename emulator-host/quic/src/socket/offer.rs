//! Holds a stream that a server offers: its bytes, its graph, and the part of the graph from each window on.

use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, PoisonError},
};

use bytes::Bytes;
use codec_core::{file, internals::wire::manifest::Manifest};
use dgs_player::Stream;
use emulator_host::{
    GroupIndex, PacketGraph, PacketIndex,
    graph::{GraphError, GraphParts, Group, Packet, RepairSet},
};

use super::message::{MAX_MANIFEST_BYTES, is_name};

/// Longest packet that surely fits one QUIC datagram before more of the path is known, bytes.
pub const MAX_MEDIA_BYTES: usize = 1150;

/// A stream under its name.
#[derive(Debug)]
pub struct Offer {
    name: String,
    message: Vec<u8>,
    /// The stream as a `.dgs` file.
    file: Bytes,
    /// By packet id: parts of the file.
    packets: Vec<Bytes>,
    /// First frames of windows, ascending, 0 among them.
    starts: Vec<u32>,
    whole: Arc<PacketGraph>,
    /// The graph from a start on, once somebody has begun there.
    tails: Mutex<BTreeMap<u32, Arc<PacketGraph>>>,
}

/// Why a stream cannot be offered.
#[derive(Debug, thiserror::Error)]
pub enum OfferError {
    /// The name is no name of a stream.
    #[error("{name:?} cannot name a stream: 1 to 64 letters, digits, '.', '_', '-' are allowed")]
    Name {
        /// The name.
        name: String,
    },
    /// Two streams share a name.
    #[error("two streams are called {name}")]
    Twice {
        /// The name.
        name: String,
    },
    /// A packet does not fit a datagram of every path.
    #[error("{name}: packet {id} has {found} bytes, allowed 1 to {MAX_MEDIA_BYTES} (encode --packet-bytes)")]
    Packet {
        /// The stream.
        name: String,
        /// Which packet.
        id: usize,
        /// Its length.
        found: usize,
    },
    /// The bytes of a packet are none of a packet.
    #[error("{name}: packet {id} is no DGSP packet")]
    Illegal {
        /// The stream.
        name: String,
        /// Which packet.
        id: usize,
    },
    /// The manifest is too long for a session.
    #[error("{name}: the manifest has {found} bytes, allowed 1 to {MAX_MANIFEST_BYTES}")]
    Manifest {
        /// The stream.
        name: String,
        /// Its length.
        found: usize,
    },
    /// The manifest cannot be read.
    #[error("{name}: {error}")]
    Format {
        /// The stream.
        name: String,
        /// Why.
        error: codec_core::Error,
    },
}

impl Offer {
    /// Offers `stream` as `name`; `graph` is its graph, packet by packet.
    ///
    /// # Errors
    /// [`OfferError`]; a stream that lacks packets cannot be offered.
    pub fn new(name: &str, stream: &Stream, graph: PacketGraph) -> Result<Self, OfferError> {
        let named = || name.to_owned();
        if !is_name(name) {
            return Err(OfferError::Name { name: named() });
        }
        if stream.message().len() > MAX_MANIFEST_BYTES {
            return Err(OfferError::Manifest { name: named(), found: stream.message().len() });
        }
        for (id, packet) in stream.packets().iter().enumerate() {
            if !(1..=MAX_MEDIA_BYTES).contains(&packet.len()) {
                return Err(OfferError::Packet { name: named(), id, found: packet.len() });
            }
        }
        let format = |error| OfferError::Format { name: named(), error };
        let manifest = stream.manifest().map_err(format)?;
        let file = Bytes::from(stream.to_bytes().map_err(format)?);
        let (_, packets) = file::parts(&file).map_err(format)?;
        let packets: Vec<Bytes> = packets.map(|packet| file.slice_ref(packet)).collect();
        // What is no packet is not found in the file.
        let differs = |id: &usize| packets.get(*id).is_none_or(|found| found != &stream.packets()[*id]);
        if let Some(id) = (0..stream.packets().len()).find(differs) {
            return Err(OfferError::Illegal { name: named(), id });
        }
        Ok(Self {
            name: named(),
            message: stream.message().to_vec(),
            packets,
            file: file.clone(),
            starts: starts(&manifest),
            whole: Arc::new(graph),
            tails: Mutex::default(),
        })
    }

    /// What it is called.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The stream as a `.dgs` file.
    pub fn file(&self) -> &Bytes {
        &self.file
    }

    /// The DGSM message.
    pub(super) fn message(&self) -> &[u8] {
        &self.message
    }

    /// The bytes of a packet of any of its graphs.
    pub(super) fn packet(&self, graph: &PacketGraph, packet: PacketIndex) -> Bytes {
        self.packets.get(graph.wire_id(packet).index()).cloned().unwrap_or_default()
    }

    /// The packets there are.
    pub(super) fn count(&self) -> usize {
        self.packets.len()
    }

    /// The graph from the window on that contains the time `start_us`. Frame 0 of it is the first frame of
    /// that window.
    ///
    /// # Errors
    /// None in practice: part of a consistent graph is consistent.
    pub(super) fn graph_from(&self, start_us: u64) -> Result<Arc<PacketGraph>, GraphError> {
        let interval_us = (self.whole.frame_interval().0 / 1000).max(1);
        let first = start_before(&self.starts, start_us / interval_us);
        if first == 0 {
            return Ok(self.whole.clone());
        }
        let mut tails = self.tails.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(tail) = tails.get(&first) {
            return Ok(tail.clone());
        }
        let tail = Arc::new(tail(&self.whole, first)?);
        tails.insert(first, tail.clone());
        Ok(tail)
    }
}

/// First frames of all windows, ascending; always with 0.
pub(super) fn starts(manifest: &Manifest<'_>) -> Vec<u32> {
    let frames = manifest.head().frames;
    let windows = manifest.windows().map(|window| window.first_frame);
    let epochs = manifest.epochs().map(|epoch| epoch.first_frame);
    let mut starts: Vec<u32> =
        [0].into_iter().chain(windows).chain(epochs).filter(|first| *first < frames).collect();
    starts.sort_unstable();
    starts.dedup();
    starts
}

/// The last of `starts` that is not after `frame`; a frame past the end lies in the last window.
pub(super) fn start_before(starts: &[u32], frame: u64) -> u32 {
    let after = starts.partition_point(|start| u64::from(*start) <= frame);
    starts.get(after.saturating_sub(1)).copied().unwrap_or(0)
}

/// The part of `graph` that frames from `first` on need, with `first` as frame 0. Parity of a set of which
/// some members are left out could repair nothing and is left out too.
fn tail(graph: &PacketGraph, first: u32) -> Result<PacketGraph, GraphError> {
    let stays: Vec<bool> = graph.groups().iter().map(|group| group.last_frame >= first).collect();
    let mut needed = stays.clone();
    for (at, _) in stays.iter().enumerate().filter(|(_, stays)| **stays) {
        for group in graph.closure(GroupIndex(at as u32)) {
            needed[group.at()] = true;
        }
    }
    let media = |packet: &Packet| packet.groups.iter().any(|group| needed[group.at()]);
    let mut sent: Vec<bool> = graph.packets().iter().map(media).collect();
    // What a packet of the tail needs to mean something is sent with it.
    let mut open: Vec<usize> = (0..sent.len()).filter(|at| sent[*at]).collect();
    while let Some(at) = open.pop() {
        for need in &graph.packets()[at].needs_packets {
            if !std::mem::replace(&mut sent[need.at()], true) {
                open.push(need.at());
            }
        }
    }
    // A packet that only others need brings its groups along.
    for (packet, _) in graph.packets().iter().zip(&sent).filter(|(_, sent)| **sent) {
        if !packet.groups.iter().any(|group| needed[group.at()]) {
            packet.groups.iter().for_each(|group| needed[group.at()] = true);
        }
    }
    // A group stays with those of its packets that are sent.
    let whole = |set: &RepairSet| set.members.iter().all(|member| sent[member.at()]);
    let sets: Vec<bool> = graph.repair_sets().iter().map(whole).collect();
    for (at, packet) in graph.packets().iter().enumerate() {
        sent[at] |= packet.parity_of.is_some_and(|set| sets[set as usize]);
    }
    let (packets, groups, repairs) = (places(&sent), places(&needed), places(&sets));
    let moved = |list: &[PacketIndex]| -> Vec<PacketIndex> {
        list.iter().filter(|p| sent[p.at()]).map(|p| PacketIndex(packets[p.at()])).collect()
    };
    let moved_groups = |list: &[GroupIndex]| -> Vec<GroupIndex> {
        list.iter().filter(|g| needed[g.at()]).map(|g| GroupIndex(groups[g.at()])).collect()
    };
    let last = graph.frames() - 1;
    PacketGraph::new(GraphParts {
        packets: chosen(graph.packets(), &sent, |packet| Packet {
            groups: moved_groups(&packet.groups),
            needs_packets: moved(&packet.needs_packets),
            parity_of: packet.parity_of.map(|set| repairs[set as usize]),
            ..packet.clone()
        }),
        groups: chosen(graph.groups(), &needed, |group| Group {
            first_frame: group.first_frame.clamp(first, last) - first,
            last_frame: group.last_frame.clamp(first, last) - first,
            needs: moved_groups(&group.needs),
            packets: moved(&group.packets),
            ..group.clone()
        }),
        repair_sets: chosen(graph.repair_sets(), &sets, |set| RepairSet { members: moved(&set.members) }),
        frames: graph.frames() - first,
        frame_interval: graph.frame_interval(),
        manifest_bytes: graph.manifest_bytes(),
        profile: graph.profile(),
    })
}

/// Where each of those that stay comes to lie.
fn places(stays: &[bool]) -> Vec<u32> {
    let place = |next: &mut u32, stays: &bool| {
        let place = *next;
        *next += u32::from(*stays);
        Some(place)
    };
    stays.iter().scan(0, place).collect()
}

/// Those of `all` that stay, changed.
fn chosen<T>(all: &[T], stays: &[bool], change: impl Fn(&T) -> T) -> Vec<T> {
    all.iter().zip(stays).filter(|(_, stays)| **stays).map(|(one, _)| change(one)).collect()
}

#[cfg(test)]
mod tests {
    use emulator_host::graph::Synthetic;

    use super::*;

    #[test]
    fn a_tail_has_what_its_frames_need_and_nothing_that_is_over() {
        let graph = Synthetic { frames: 90, ..Synthetic::default() }.build(1).unwrap();
        let tail = tail(&graph, 30).unwrap();
        assert_eq!(tail.frames(), 60);
        assert!(tail.packets().len() < graph.packets().len());
        let of = |id| graph.group_of(id).map(|at| &graph.groups()[at.at()]).unwrap();
        for group in tail.groups() {
            let before = of(group.id);
            assert!(before.last_frame >= 30);
            assert_eq!(group.last_frame, before.last_frame - 30);
            assert_eq!(group.first_frame, before.first_frame.saturating_sub(30));
            assert_eq!((group.needs.len(), group.packets.len()), (before.needs.len(), before.packets.len()));
        }
        let active = graph.groups().iter().filter(|group| group.last_frame >= 30).count();
        assert_eq!(tail.groups().len(), active);
        // From the start on it is the whole.
        let whole = super::tail(&graph, 0).unwrap();
        assert_eq!((whole.groups(), whole.packets()), (graph.groups(), graph.packets()));
    }

    #[test]
    fn a_time_begins_at_its_window() {
        let starts = [0, 30, 60];
        for (frame, start) in [(0, 0), (29, 0), (30, 30), (59, 30), (60, 60), (u64::MAX, 60)] {
            assert_eq!(start_before(&starts, frame), start);
        }
    }
}
