//! Holds a stream that a server offers: its bytes, its graph, and the part of the graph from each window on.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, PoisonError},
};

use bytes::Bytes;
use codec_core::{
    file,
    internals::wire::{
        manifest::{Manifest, Profile},
        packet::Head,
    },
};
use dgs_player::Stream;
use emulator_host::{
    GroupIndex, Nanos, PacketGraph, PacketIndex,
    graph::{GraphError, GraphParts, Packet, RepairSet, Selection},
    policy,
};
use tokio::sync::watch;

use super::message::{MAX_MANIFEST_BYTES, is_name};

/// Longest packet that surely fits one QUIC datagram before more of the path is known, bytes.
pub const MAX_MEDIA_BYTES: usize = 1150;

/// A stream under its name.
#[derive(Debug)]
pub struct ServedStream {
    name: String,
    message: Vec<u8>,
    /// The stream as a `.dgs` file, if it has an end.
    file: Option<Bytes>,
    /// First frames of windows, ascending, 0 among them.
    starts: Vec<u32>,
    content: watch::Receiver<Arc<Content>>,
}

/// What there is of a stream.
#[derive(Debug)]
pub(crate) struct Content {
    /// By packet id; parts of the file, if there is one. One that is not there is empty.
    packets: Vec<Bytes>,
    whole: Arc<PacketGraph>,
    /// First frame of the newest window that is there, of a stream that grows.
    newest: Option<u32>,
    /// Graphs from starts on where somebody has begun of late, the newest last.
    tails: Mutex<VecDeque<(u32, Arc<PacketGraph>)>>,
}

/// Graphs that are kept for the next viewer who begins there. Each is as large as the rest of the clip.
const MAX_TAILS: usize = 8;

/// Where what comes of a stream that grows is entered.
#[derive(Debug)]
pub struct LiveFeed {
    name: String,
    content: watch::Sender<Arc<Content>>,
}

impl LiveFeed {
    /// Offers what there is by now: the packets of `stream`, of which those in `graph` are sent; viewers who
    /// come begin at the window of frame `newest`.
    ///
    /// # Errors
    /// A packet that is too long.
    pub fn renew(&self, stream: &Stream, graph: PacketGraph, newest: u32) -> Result<(), ServedStreamError> {
        let content = Content::growing(&self.name, stream, graph, newest)?;
        self.content.send_replace(Arc::new(content));
        Ok(())
    }
}

impl Content {
    fn new(packets: Vec<Bytes>, graph: PacketGraph, newest: Option<u32>) -> Self {
        Self { packets, whole: Arc::new(graph), newest, tails: Mutex::default() }
    }

    fn growing(
        name: &str,
        stream: &Stream,
        graph: PacketGraph,
        newest: u32,
    ) -> Result<Self, ServedStreamError> {
        let long = |(_, packet): &(usize, &Vec<u8>)| packet.len() > MAX_MEDIA_BYTES;
        if let Some((id, packet)) = stream.packets().iter().enumerate().find(long) {
            let (name, found, remedy) = (name.to_owned(), packet.len(), remedy(stream));
            return Err(ServedStreamError::Packet { name, id, found, remedy });
        }
        let packets = stream.packets().iter().map(|packet| Bytes::copy_from_slice(packet)).collect();
        Ok(Self::new(packets, graph, Some(newest)))
    }

    /// The bytes of a packet of any of its graphs.
    pub(crate) fn packet(&self, graph: &PacketGraph, packet: PacketIndex) -> Bytes {
        self.packets.get(graph.wire_id(packet).index()).cloned().unwrap_or_default()
    }

    /// First frame of the newest window of a stream that grows.
    #[cfg(feature = "moq")]
    pub(crate) fn newest(&self) -> Option<u32> {
        self.newest
    }

    /// The graph of all that there is.
    pub(crate) fn graph(&self) -> &PacketGraph {
        &self.whole
    }

    /// The packets there can be, present or not.
    pub(super) fn count(&self) -> usize {
        self.packets.len()
    }

    /// The graph from frame `first` on, as frame 0.
    ///
    /// # Errors
    /// None in practice: part of a consistent graph is consistent.
    pub(super) fn graph_from(&self, first: u32) -> Result<Arc<PacketGraph>, GraphError> {
        if first == 0 {
            return Ok(self.whole.clone());
        }
        let lock = || self.tails.lock().unwrap_or_else(PoisonError::into_inner);
        let known = lock().iter().find(|(start, _)| *start == first).map(|(_, tail)| tail.clone());
        if let Some(tail) = known {
            return Ok(tail);
        }
        // Not while others wait for theirs.
        let tail = Arc::new(tail(&self.whole, first)?);
        let mut tails = lock();
        if tails.len() == MAX_TAILS {
            tails.pop_front();
        }
        tails.push_back((first, tail.clone()));
        Ok(tail)
    }
}

/// Why a stream cannot be offered.
#[derive(Debug, thiserror::Error)]
pub enum ServedStreamError {
    /// The name is no name of a stream.
    #[error("{name:?} cannot name a stream: 1 to 64 letters, digits, '.', '_', '-' are allowed")]
    Name {
        /// The name.
        name: String,
    },
    /// Two streams share a name.
    #[error("two streams are called {name}; rename one of the files")]
    Twice {
        /// The name.
        name: String,
    },
    /// A packet does not fit a datagram of every path.
    #[error("{name}: packet {id} has {found} bytes, allowed 1 to {MAX_MEDIA_BYTES} ({remedy})")]
    Packet {
        /// The stream.
        name: String,
        /// Which packet.
        id: usize,
        /// Its length.
        found: usize,
        /// What makes a stream of shorter packets, for people.
        remedy: &'static str,
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

impl ServedStream {
    /// Offers `stream` as `name`; `graph` is of the packets that are there.
    ///
    /// # Errors
    /// [`ServedStreamError`]; a graph with packets that the stream lacks.
    pub fn new(name: &str, stream: &Stream, graph: PacketGraph) -> Result<Self, ServedStreamError> {
        let named = || name.to_owned();
        for (at, _) in graph.packets().iter().enumerate() {
            let id = graph.wire_id(PacketIndex(at as u32)).index();
            let found = stream.packets().get(id).map_or(0, Vec::len);
            if !(1..=MAX_MEDIA_BYTES).contains(&found) {
                let remedy = remedy(stream);
                return Err(ServedStreamError::Packet { name: named(), id, found, remedy });
            }
        }
        let format = |error| ServedStreamError::Format { name: named(), error };
        // Packets that the graph does not have mean nothing: their stream stays as it is numbered.
        let there = stream.packets().iter().filter(|packet| !packet.is_empty()).count();
        let file = if graph.packets().len() == there {
            let order = policy::file_order(&graph).into_iter().map(|packet| graph.wire_id(packet));
            stream.to_bytes_in_order(order)
        } else {
            stream.to_bytes()
        };
        let file = Bytes::from(file.map_err(format)?);
        let (_, found) = file::parts(&file).map_err(format)?;
        let mut packets = vec![Bytes::new(); stream.packets().len()];
        for packet in found {
            let place = Head::parse(packet).ok().and_then(|head| packets.get_mut(head.id.index()));
            if let Some(place) = place {
                *place = file.slice_ref(packet);
            }
        }
        // What is no packet is not found in the file.
        let differs = |id: &usize| packets.get(*id).is_none_or(|found| found != &stream.packets()[*id]);
        if let Some(id) = (0..stream.packets().len()).find(differs) {
            return Err(ServedStreamError::Illegal { name: named(), id });
        }
        let file = Some(file.clone());
        let (_, content) = watch::channel(Arc::new(Content::new(packets, graph, None)));
        Self::with(name, stream, file, content)
    }

    /// Offers a stream that grows: of `stream` its manifest and the packets that are there, as
    /// [`LiveFeed::renew`] takes them. Viewers begin at the newest window.
    ///
    /// # Errors
    /// [`ServedStreamError`].
    pub fn live(
        name: &str,
        stream: &Stream,
        graph: PacketGraph,
        newest: u32,
    ) -> Result<(Self, LiveFeed), ServedStreamError> {
        let content = Content::growing(name, stream, graph, newest)?;
        let (sender, content) = watch::channel(Arc::new(content));
        let offer = Self::with(name, stream, None, content)?;
        Ok((offer, LiveFeed { name: name.to_owned(), content: sender }))
    }

    fn with(
        name: &str,
        stream: &Stream,
        file: Option<Bytes>,
        content: watch::Receiver<Arc<Content>>,
    ) -> Result<Self, ServedStreamError> {
        let named = || name.to_owned();
        if !is_name(name) {
            return Err(ServedStreamError::Name { name: named() });
        }
        let message = stream.message().to_vec();
        if message.len() > MAX_MANIFEST_BYTES {
            return Err(ServedStreamError::Manifest { name: named(), found: message.len() });
        }
        let manifest =
            stream.manifest().map_err(|error| ServedStreamError::Format { name: named(), error })?;
        Ok(Self { name: named(), message, file, starts: starts(&manifest), content })
    }

    /// What it is called.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The stream as a `.dgs` file, if it has an end.
    pub fn file(&self) -> Option<&Bytes> {
        self.file.as_ref()
    }

    /// The DGSM message.
    pub(crate) fn message(&self) -> &[u8] {
        &self.message
    }

    /// Whether more of it comes.
    #[cfg(feature = "moq")]
    pub(crate) fn grows(&self) -> bool {
        self.file.is_none()
    }

    /// What there is, now and later.
    pub(crate) fn content(&self) -> watch::Receiver<Arc<Content>> {
        self.content.clone()
    }

    /// Where a round begins that asks for the time `start_us`: the frame, and whether that is for the server
    /// to say, because the stream grows.
    pub(super) fn start(&self, content: &Content, start_us: u64) -> (u32, bool) {
        match content.newest {
            Some(newest) => (start_before(&self.starts, newest.into()), true),
            None => {
                let frame = frame_at(start_us, content.graph().frame_interval());
                (start_before(&self.starts, frame), false)
            }
        }
    }

    /// The time of the middle of a frame as a client says it, microseconds.
    pub(super) fn middle_us(&self, content: &Content, frame: u32) -> u64 {
        middle_us(frame, content.graph().frame_interval())
    }
}

/// What makes a stream as `stream` of shorter packets: the option is for profile `dgs1` alone.
fn remedy(stream: &Stream) -> &'static str {
    match stream.manifest().map(|manifest| manifest.profile()) {
        Ok(Profile::Paper) => {
            "longer packets of profile paper are not served; dgs encode --profile dgs1 makes shorter ones"
        }
        Ok(Profile::Dgs1) | Err(_) => "dgs encode --packet-bytes makes shorter ones",
    }
}

/// When `frame` begins, in whole microseconds: at most one before it does.
pub(super) fn time_us(frame: u32, interval: Nanos) -> u64 {
    let nanos = u128::from(frame) * u128::from(interval.0);
    u64::try_from(nanos / 1000).unwrap_or(u64::MAX)
}

/// The time of the middle of `frame`, in whole microseconds.
pub(crate) fn middle_us(frame: u32, interval: Nanos) -> u64 {
    time_us(frame, interval).saturating_add(interval.0 / 2000)
}

/// The frame that shows at a time in whole microseconds, which may be that of [`time_us`].
pub(super) fn frame_at(time_us: u64, interval: Nanos) -> u64 {
    let nanos = u128::from(time_us) * 1000 + 999;
    u64::try_from(nanos / u128::from(interval.0.max(1))).unwrap_or(u64::MAX)
}

/// First frames of all windows, ascending; always with 0.
pub(crate) fn starts(manifest: &Manifest<'_>) -> Vec<u32> {
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
    let mut groups = stays.clone();
    for (at, _) in stays.iter().enumerate().filter(|(_, stays)| **stays) {
        for group in graph.closure(GroupIndex(at as u32)) {
            groups[group.at()] = true;
        }
    }
    let media = |packet: &Packet| packet.groups.iter().any(|group| groups[group.at()]);
    let mut packets: Vec<bool> = graph.packets().iter().map(media).collect();
    // What a packet of the tail needs to mean something is sent with it.
    let mut open: Vec<usize> = (0..packets.len()).filter(|at| packets[*at]).collect();
    while let Some(at) = open.pop() {
        for need in &graph.packets()[at].needs_packets {
            if !std::mem::replace(&mut packets[need.at()], true) {
                open.push(need.at());
            }
        }
    }
    // A packet that only others need brings its groups along.
    for (packet, _) in graph.packets().iter().zip(&packets).filter(|(_, sent)| **sent) {
        if !packet.groups.iter().any(|group| groups[group.at()]) {
            packet.groups.iter().for_each(|group| groups[group.at()] = true);
        }
    }
    // A group stays with those of its packets that are sent.
    let whole = |set: &RepairSet| set.members.iter().all(|member| packets[member.at()]);
    let repair_sets: Vec<bool> = graph.repair_sets().iter().map(whole).collect();
    for (at, packet) in graph.packets().iter().enumerate() {
        packets[at] |= packet.parity_of.is_some_and(|set| repair_sets[set as usize]);
    }
    let mut parts = Selection { packets, groups, repair_sets }.of(graph.parts());
    let last = graph.frames() - 1;
    for group in &mut parts.groups {
        group.first_frame = group.first_frame.clamp(first, last) - first;
        group.last_frame = group.last_frame.clamp(first, last) - first;
    }
    PacketGraph::new(GraphParts { frames: graph.frames() - first, ..parts })
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
    fn a_remedy_is_one_that_the_profile_of_the_stream_has() {
        let file = |bytes: &[u8]| Stream::from_bytes(bytes).unwrap().0;
        let paper = file(include_bytes!("../../../../codec-core/tests/conformance/paper.dgs"));
        let graph = Synthetic { frames: 90, ..Synthetic::default() }.build(1).unwrap();
        let error = ServedStream::live("paper", &paper, graph, 0).unwrap_err().to_string();
        assert!(error.contains("has 1230 bytes, allowed 1 to 1150"), "{error}");
        assert!(error.contains("--profile dgs1") && !error.contains("--packet-bytes"), "{error}");
        let dgs1 = file(include_bytes!("../../../../codec-core/tests/conformance/one.dgs"));
        assert!(remedy(&dgs1).contains("--packet-bytes"));
    }

    /// Sixty frames a second are no whole number of microseconds.
    #[test]
    fn a_frame_is_found_at_its_own_time_hours_into_a_clip() {
        for interval in [16_666_667, 33_333_333, 40_000_000].map(Nanos) {
            for frame in [0, 1, 3, 59, 1800, 108_000, 216_000] {
                assert_eq!(frame_at(time_us(frame, interval), interval), u64::from(frame));
                assert_eq!(frame_at(time_us(frame, interval) + 16_000, interval), u64::from(frame));
            }
        }
        assert_eq!(frame_at(1_800_000_000, Nanos(16_666_667)), 107_999, "of 108,000 longer by 36 us");
        assert!(frame_at(u64::MAX, Nanos(1)) == u64::MAX && time_us(u32::MAX, Nanos(u64::MAX)) == u64::MAX);
    }

    #[test]
    fn a_time_begins_at_its_window() {
        let starts = [0, 30, 60];
        for (frame, start) in [(0, 0), (29, 0), (30, 30), (59, 30), (60, 60), (u64::MAX, 60)] {
            assert_eq!(start_before(&starts, frame), start);
        }
    }
}
