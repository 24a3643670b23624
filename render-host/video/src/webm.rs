//! Writes AV1 as WebM: clusters that begin with a key picture, and where each of them is.
//!
//! RFC 8794 (EBML), RFC 9559 (Matroska) and "AV1 in Matroska and WebM". What stands before the clusters is
//! written twice, with the same length: first without what is known only at the end.

use std::io::{Seek, SeekFrom, Write};

use crate::{
    error::VideoError,
    rate::FrameRate,
    track::{BT709, Sample, Track},
};

/// Identifiers of elements, with the marker of their own length, as the documents list them.
mod id {
    pub const EBML: u32 = 0x1A45_DFA3;
    pub const EBML_VERSION: u32 = 0x4286;
    pub const EBML_READ_VERSION: u32 = 0x42F7;
    pub const EBML_MAX_ID_LENGTH: u32 = 0x42F2;
    pub const EBML_MAX_SIZE_LENGTH: u32 = 0x42F3;
    pub const DOC_TYPE: u32 = 0x4282;
    pub const DOC_TYPE_VERSION: u32 = 0x4287;
    pub const DOC_TYPE_READ_VERSION: u32 = 0x4285;
    pub const SEGMENT: u32 = 0x1853_8067;
    pub const SEEK_HEAD: u32 = 0x114D_9B74;
    pub const SEEK: u32 = 0x4DBB;
    pub const SEEK_ID: u32 = 0x53AB;
    pub const SEEK_POSITION: u32 = 0x53AC;
    pub const INFO: u32 = 0x1549_A966;
    pub const TIMESTAMP_SCALE: u32 = 0x2A_D7B1;
    pub const DURATION: u32 = 0x4489;
    pub const MUXING_APP: u32 = 0x4D80;
    pub const WRITING_APP: u32 = 0x5741;
    pub const TRACKS: u32 = 0x1654_AE6B;
    pub const TRACK_ENTRY: u32 = 0xAE;
    pub const TRACK_NUMBER: u32 = 0xD7;
    pub const TRACK_UID: u32 = 0x73C5;
    pub const TRACK_TYPE: u32 = 0x83;
    pub const FLAG_LACING: u32 = 0x9C;
    pub const DEFAULT_DURATION: u32 = 0x23_E383;
    pub const CODEC_ID: u32 = 0x86;
    pub const CODEC_PRIVATE: u32 = 0x63A2;
    pub const VIDEO: u32 = 0xE0;
    pub const PIXEL_WIDTH: u32 = 0xB0;
    pub const PIXEL_HEIGHT: u32 = 0xBA;
    pub const COLOUR: u32 = 0x55B0;
    pub const MATRIX_COEFFICIENTS: u32 = 0x55B1;
    pub const BITS_PER_CHANNEL: u32 = 0x55B2;
    pub const CHROMA_SUBSAMPLING_HORIZONTAL: u32 = 0x55B3;
    pub const CHROMA_SUBSAMPLING_VERTICAL: u32 = 0x55B4;
    pub const CHROMA_SITING_HORIZONTAL: u32 = 0x55B7;
    pub const CHROMA_SITING_VERTICAL: u32 = 0x55B8;
    pub const RANGE: u32 = 0x55B9;
    pub const TRANSFER_CHARACTERISTICS: u32 = 0x55BA;
    pub const PRIMARIES: u32 = 0x55BB;
    pub const CLUSTER: u32 = 0x1F43_B675;
    pub const TIMESTAMP: u32 = 0xE7;
    pub const SIMPLE_BLOCK: u32 = 0xA3;
    pub const CUES: u32 = 0x1C53_BB6B;
    pub const CUE_POINT: u32 = 0xBB;
    pub const CUE_TIME: u32 = 0xB3;
    pub const CUE_TRACK_POSITIONS: u32 = 0xB7;
    pub const CUE_TRACK: u32 = 0xF7;
    pub const CUE_CLUSTER_POSITION: u32 = 0xF1;
}

const NANOSECONDS_PER_SECOND: u64 = 1_000_000_000;
/// The longest cluster, in ticks: a block counts from its cluster in 16 bits with a sign.
const MAX_CLUSTER_TICKS: u64 = 30_000;
/// The only track.
const TRACK: u8 = 1;
/// Bytes of the identifier and size of a segment.
const SEGMENT_HEAD: u64 = 12;

/// A file on its way.
pub struct WebM<W> {
    file: W,
    track: Track,
    /// Nanoseconds per tick.
    tick: u64,
    /// Pictures so far.
    pictures: u64,
    /// The cluster that is being filled.
    cluster: Option<Cluster>,
    cues: Vec<Cue>,
    /// Where the next cluster begins, counted from the first byte inside the segment.
    position: u64,
}

struct Cluster {
    start: u64,
    begins_with_key: bool,
    /// Its elements.
    body: Vec<u8>,
}

/// Where a key picture is.
struct Cue {
    time: u64,
    position: u64,
}

/// What is known at the end; all zero before.
#[derive(Clone, Copy, Default)]
struct Totals {
    segment_bytes: u64,
    cues_position: u64,
    /// In ticks.
    duration: f64,
}

impl<W: Write + Seek> WebM<W> {
    pub fn begin(mut file: W, track: &Track) -> Result<Self, VideoError> {
        let tick = nanoseconds_per_tick(track.rate);
        let head = head(track, tick, Totals::default());
        file.write_all(&[ebml_header(), head.clone()].concat())?;
        let position = head.len() as u64 - SEGMENT_HEAD;
        Ok(Self { file, track: track.clone(), tick, pictures: 0, cluster: None, cues: Vec::new(), position })
    }

    pub fn add(&mut self, sample: &Sample) -> Result<(), VideoError> {
        let time = self.time(self.pictures);
        self.pictures += 1;
        let is_full = |cluster: &Cluster| sample.key || time - cluster.start > MAX_CLUSTER_TICKS;
        if self.cluster.as_ref().is_none_or(is_full) {
            self.end_cluster()?;
            let body = unsigned(id::TIMESTAMP, time);
            self.cluster = Some(Cluster { start: time, begins_with_key: sample.key, body });
        }
        let Some(cluster) = &mut self.cluster else { return Ok(()) };
        // Ticks fit: a cluster ends before they do not.
        let since = (time - cluster.start) as u16;
        let head = [0x80 | TRACK, since.to_be_bytes()[0], since.to_be_bytes()[1], u8::from(sample.key) << 7];
        cluster.body.extend(element(id::SIMPLE_BLOCK, &[&head, sample.bytes.as_slice()].concat()));
        Ok(())
    }

    pub fn finish(mut self) -> Result<W, VideoError> {
        self.end_cluster()?;
        let cues_position = self.position;
        let cues: Vec<u8> = self.cues.iter().flat_map(Cue::element).collect();
        let cues = element(id::CUES, &cues);
        self.file.write_all(&cues)?;
        let rate = self.track.rate;
        let seconds = self.pictures as f64 * f64::from(rate.denominator) / f64::from(rate.numerator);
        let totals = Totals {
            segment_bytes: cues_position + cues.len() as u64,
            cues_position,
            duration: seconds * NANOSECONDS_PER_SECOND as f64 / self.tick as f64,
        };
        self.file.seek(SeekFrom::Start(ebml_header().len() as u64))?;
        self.file.write_all(&head(&self.track, self.tick, totals))?;
        Ok(self.file)
    }

    /// When picture `index` is shown, in ticks.
    fn time(&self, index: u64) -> u64 {
        self.track.rate.ticks(index, NANOSECONDS_PER_SECOND / self.tick)
    }

    fn end_cluster(&mut self) -> Result<(), VideoError> {
        let Some(cluster) = self.cluster.take() else { return Ok(()) };
        if cluster.begins_with_key {
            self.cues.push(Cue { time: cluster.start, position: self.position });
        }
        let bytes = element(id::CLUSTER, &cluster.body);
        self.file.write_all(&bytes)?;
        self.position += bytes.len() as u64;
        Ok(())
    }
}

impl Cue {
    fn element(&self) -> Vec<u8> {
        let place =
            [unsigned(id::CUE_TRACK, u64::from(TRACK)), unsigned(id::CUE_CLUSTER_POSITION, self.position)];
        let place = element(id::CUE_TRACK_POSITIONS, &place.concat());
        element(id::CUE_POINT, &[unsigned(id::CUE_TIME, self.time), place].concat())
    }
}

/// A millisecond, as players of WebM expect; less where pictures come faster than those tell apart.
fn nanoseconds_per_tick(rate: FrameRate) -> u64 {
    let frames_per_second = f64::from(rate.numerator) / f64::from(rate.denominator);
    if frames_per_second <= 500.0 { 1_000_000 } else { 10_000 }
}

fn ebml_header() -> Vec<u8> {
    let fields = [
        unsigned(id::EBML_VERSION, 1),
        unsigned(id::EBML_READ_VERSION, 1),
        unsigned(id::EBML_MAX_ID_LENGTH, 4),
        unsigned(id::EBML_MAX_SIZE_LENGTH, 8),
        element(id::DOC_TYPE, b"webm"),
        unsigned(id::DOC_TYPE_VERSION, 4),
        unsigned(id::DOC_TYPE_READ_VERSION, 2),
    ];
    element(id::EBML, &fields.concat())
}

/// The head of the segment and what stands in it before the clusters: as long whatever `totals` are.
fn head(track: &Track, tick: u64, totals: Totals) -> Vec<u8> {
    let (info, tracks) = (information(tick, totals.duration), tracks(track));
    let seek = |id: u32, position: u64| {
        let fields = [element(id::SEEK_ID, &id.to_be_bytes()), fixed(id::SEEK_POSITION, position)];
        element(id::SEEK, &fields.concat())
    };
    let places = |info: u64, tracks: u64| {
        let seeks = [seek(id::INFO, info), seek(id::TRACKS, tracks), seek(id::CUES, totals.cues_position)];
        element(id::SEEK_HEAD, &seeks.concat())
    };
    let info_position = places(0, 0).len() as u64;
    let places = places(info_position, info_position + info.len() as u64);
    let mut head = id::SEGMENT.to_be_bytes().to_vec();
    // Eight bytes of size, whatever it is.
    head.extend((totals.segment_bytes | 1 << 56).to_be_bytes());
    [head, places, info, tracks].concat()
}

fn information(tick: u64, duration: f64) -> Vec<u8> {
    let fields = [
        unsigned(id::TIMESTAMP_SCALE, tick),
        element(id::DURATION, &duration.to_be_bytes()),
        element(id::MUXING_APP, b"dgs"),
        element(id::WRITING_APP, b"dgs"),
    ];
    element(id::INFO, &fields.concat())
}

fn tracks(track: &Track) -> Vec<u8> {
    let colour = [
        unsigned(id::MATRIX_COEFFICIENTS, u64::from(BT709)),
        unsigned(id::BITS_PER_CHANNEL, 8),
        unsigned(id::CHROMA_SUBSAMPLING_HORIZONTAL, 1),
        unsigned(id::CHROMA_SUBSAMPLING_VERTICAL, 1),
        // On the left, between two rows.
        unsigned(id::CHROMA_SITING_HORIZONTAL, 1),
        unsigned(id::CHROMA_SITING_VERTICAL, 2),
        // Limited.
        unsigned(id::RANGE, 1),
        unsigned(id::TRANSFER_CHARACTERISTICS, u64::from(BT709)),
        unsigned(id::PRIMARIES, u64::from(BT709)),
    ];
    let video = [
        unsigned(id::PIXEL_WIDTH, u64::from(track.size.0)),
        unsigned(id::PIXEL_HEIGHT, u64::from(track.size.1)),
        element(id::COLOUR, &colour.concat()),
    ];
    let entry = [
        unsigned(id::TRACK_NUMBER, u64::from(TRACK)),
        unsigned(id::TRACK_UID, 1),
        // Video.
        unsigned(id::TRACK_TYPE, 1),
        unsigned(id::FLAG_LACING, 0),
        unsigned(id::DEFAULT_DURATION, track.rate.ticks(1, NANOSECONDS_PER_SECOND)),
        element(id::CODEC_ID, b"V_AV1"),
        element(id::CODEC_PRIVATE, &track.configuration.record()),
        element(id::VIDEO, &video.concat()),
    ];
    element(id::TRACKS, &element(id::TRACK_ENTRY, &entry.concat()))
}

/// An element: its identifier, the bytes of its body, the body.
fn element(id: u32, body: &[u8]) -> Vec<u8> {
    let id = id.to_be_bytes();
    let id = &id[id.iter().take_while(|byte| **byte == 0).count()..];
    [id, &size(body.len() as u64), body].concat()
}

/// A size in as many bytes as it needs: each has seven bits, and all ones is no size.
fn size(bytes: u64) -> Vec<u8> {
    let width = (1..8).find(|width| bytes < (1 << (7 * width)) - 1).unwrap_or(8);
    (bytes | 1 << (7 * width)).to_be_bytes()[8 - width..].to_vec()
}

/// An unsigned number in as many bytes as it needs, at least one.
fn unsigned(id: u32, value: u64) -> Vec<u8> {
    let bytes = value.to_be_bytes();
    element(id, &bytes[bytes.iter().take(7).take_while(|byte| **byte == 0).count()..])
}

/// An unsigned number in eight bytes.
fn fixed(id: u32, value: u64) -> Vec<u8> {
    element(id, &value.to_be_bytes())
}
