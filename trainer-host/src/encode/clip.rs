//! Takes a part in time out of a `dgs1` stream without decoding it: a stream of its own, whose frames begin
//! at 0.
//!
//! Windows decode independently, so that what stays is whole windows with the attributes of their epochs.
//! The manifest is written anew, packets get new heads before the same bodies, and parity is added up again.
//! An epoch without windows does not move, and is cut at any frame.

use std::ops::Range;

use codec_core::internals::{
    ids::{ClusterId, EpochId, Group, PacketId, Span, WindowId},
    limits::MAX_PACKET_BYTES,
    wire::{
        checked::Checked,
        manifest::{Epoch, Head, Manifest, Profile, Proxy, Repair, Window, stream as symbol_streams},
        packet::{Extent, Packet, Slices},
    },
};

use super::{EncodeError, Ledger, packetise::packet_id, parity};
use crate::{
    stream::{PacketMap, Stream},
    utility::{GroupUtility, Table},
};

/// Why a stream cannot be cut in time.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ClipError {
    /// Its profile is `paper`.
    #[error("profile paper codes every epoch as a whole; dgs1 is allowed")]
    Paper,
    /// No frame of the stream is wanted for.
    #[error("frames {}..{} hold none of the stream's {of}", .frames.start, .frames.end)]
    Empty {
        /// What is wanted for.
        frames: Range<u32>,
        /// Frames of the stream.
        of: u32,
    },
    /// A packet cannot be divided.
    #[error("packet {packet} codes parts of frames that stay and of frames that go in one body")]
    Shared {
        /// Its id.
        packet: u32,
    },
    /// Parity cannot be added up.
    #[error(transparent)]
    Parity(#[from] EncodeError),
    /// Bytes that are refused.
    #[error(transparent)]
    Format(#[from] codec_core::Error),
}

/// A part in time of a stream.
#[derive(Clone, Debug)]
pub struct Clip {
    /// The part as a stream.
    pub stream: Stream,
    /// The frames of the whole that it shows: those wanted for, and what shares their windows.
    pub frames: Range<u32>,
    part: Part,
}

/// What stays, numbered as in the whole stream.
#[derive(Clone, Debug)]
struct Part {
    epochs: Range<u16>,
    windows: Range<u16>,
    /// Frames of each epoch that stays.
    frames: Vec<Range<u32>>,
}

impl Clip {
    /// The part of `stream` that shows `frames`. Packets that `stream` lacks are not in it.
    ///
    /// ```
    /// # use trainer_host::{encode::{self, clip::Clip}, import::{Limits, synth}};
    /// # let make = synth::SynthOptions { gaussians: 1000, frames: 8, ..synth::SynthOptions::default() };
    /// # let scene = synth::make(&make, &Limits::default())?;
    /// let options = encode::EncodeOptions { window_frames: Some(4), ..encode::EncodeOptions::default() };
    /// let whole = encode::encode(&scene, &options, &encode::no_progress)?.stream;
    /// let clip = Clip::of(&whole, 5..7)?;
    /// assert_eq!(clip.frames, 4..8);
    /// assert_eq!(clip.stream.manifest()?.head().frames, 4);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// A stream of `paper`, frames that it has not, a packet that would have to be divided.
    pub fn of(stream: &Stream, frames: Range<u32>) -> Result<Self, ClipError> {
        let manifest = stream.manifest()?;
        if manifest.profile() != Profile::Dgs1 {
            return Err(ClipError::Paper);
        }
        let of = manifest.head().frames;
        let part = Part::of(&manifest, &frames);
        let shown = part.frames.first().zip(part.frames.last()).map(|(first, last)| first.start..last.end);
        let shown = shown.filter(|_| !frames.is_empty()).ok_or(ClipError::Empty { frames, of })?;
        let mut packets = Vec::new();
        // The new id of each packet that stays.
        let mut ids = vec![None; stream.packets().len()];
        for (id, bytes) in stream.packets().iter().enumerate().filter(|(_, bytes)| !bytes.is_empty()) {
            let checked = Checked::without_crc_check(bytes)?;
            let Packet::Slices(slices) = checked.packet() else { continue };
            if let Some(packet) = part.packet(slices, packet_id(packets.len())?)? {
                ids[id] = Some(packets.len() as u32);
                packets.push(packet);
            }
        }
        let mut repairs: Vec<Repair> =
            manifest.repairs().filter_map(|range| repaired_again(&range, &ids, &packets)).collect();
        parity::append(&mut repairs, &mut packets, &mut Ledger::default())?;
        let raw = part.body(&manifest, &repairs, packets.len())?;
        Ok(Self { stream: Stream::new(raw, packets)?, frames: shown, part })
    }

    /// The utilities of its groups, by `table`, those of `whole`, the stream that it is a part of.
    ///
    /// # Errors
    /// None in practice: both streams were read.
    pub fn utilities(&self, whole: &Stream, table: &Table) -> codec_core::Result<Table> {
        let manifest = self.stream.manifest()?;
        let (of_whole, of_part) = (PacketMap::of(whole)?, PacketMap::of(&self.stream)?);
        let part = of_whole.groups().iter().zip(&table.groups).filter_map(|((group, _), utility)| {
            let span = self.part.renumbered(group.span)?;
            let cell = manifest.cell(span, group.cluster)?;
            Some((Group { span, ..*group }, GroupUtility { cell: cell.index() as u32, ..*utility }))
        });
        let (groups, utilities): (Vec<Group>, Vec<GroupUtility>) = part.unzip();
        debug_assert!(of_part.groups().iter().map(|(group, _)| *group).eq(groups));
        let manifest_crc = codec_simd::crc32(manifest.raw());
        Ok(Table { manifest_crc, groups: utilities, ..table.clone() })
    }
}

/// The range that protects what stays of that which `range` does, before parity is added up.
fn repaired_again(range: &Repair, ids: &[Option<u32>], packets: &[Vec<u8>]) -> Option<Repair> {
    let first = range.first_packet as usize;
    let protected = ids.get(first..first + range.packets as usize)?;
    let part: Vec<u32> = protected.iter().flatten().copied().collect();
    let (&first_packet, &last) = (part.first()?, part.last()?);
    let longest = (first_packet..=last).filter_map(|id| packets.get(id as usize)).map(Vec::len).max()?;
    debug_assert!(longest <= MAX_PACKET_BYTES);
    Some(Repair { first_packet, packets: part.len() as u32, longest: longest as u16, ..*range })
}

impl Part {
    fn of(manifest: &Manifest<'_>, frames: &Range<u32>) -> Self {
        let overlaps = |start: u32, count: u32| start < frames.end && frames.start < start + count;
        let (mut epochs, mut windows): (Vec<u16>, Vec<u16>) = (Vec::new(), Vec::new());
        let mut part = Vec::new();
        for (e, epoch) in (0..).zip(manifest.epochs()).filter(|(_, e)| overlaps(e.first_frame, e.frames)) {
            epochs.push(e);
            if epoch.windows == 0 {
                let end = frames.end.min(epoch.first_frame + epoch.frames);
                part.push(frames.start.max(epoch.first_frame)..end);
                continue;
            }
            let of_epoch = (0..).zip(manifest.windows()).filter(|(_, w)| w.epoch == e);
            let mut shown: Option<Range<u32>> = None;
            for (w, window) in of_epoch.filter(|(_, w)| overlaps(w.first_frame, w.frames.into())) {
                windows.push(w);
                let start = shown.map_or(window.first_frame, |shown| shown.start);
                shown = Some(start..window.first_frame + u32::from(window.frames));
            }
            part.extend(shown);
        }
        let span = |all: &[u16]| all.first().zip(all.last()).map_or(0..0, |(first, last)| *first..last + 1);
        Self { epochs: span(&epochs), windows: span(&windows), frames: part }
    }

    /// What a span of the whole is in the part, if it stays.
    fn renumbered(&self, span: Span) -> Option<Span> {
        let within = |range: &Range<u16>, number: u16| range.contains(&number).then(|| number - range.start);
        match span {
            Span::Canonical(EpochId(epoch)) => {
                within(&self.epochs, epoch).map(|epoch| Span::Canonical(EpochId(epoch)))
            }
            Span::Motion(WindowId(window)) => {
                within(&self.windows, window).map(|window| Span::Motion(WindowId(window)))
            }
        }
    }

    /// The packet of `slices` as number `id` of the part; none if it brings nothing that stays.
    fn packet(&self, slices: &Slices<'_>, id: PacketId) -> Result<Option<Vec<u8>>, ClipError> {
        let part = slices.extents.iter().filter_map(|extent| {
            let span = self.renumbered(extent.span)?;
            Some(Extent { span, ..*extent })
        });
        match part.clone().count() {
            0 => return Ok(None),
            all if all == slices.extents.len() => {}
            _ => return Err(ClipError::Shared { packet: slices.id.get() }),
        }
        let packet = Slices { id, extents: part.collect(), body: slices.body };
        let mut out = vec![0; packet.wire_len()];
        packet.write(&mut out)?;
        Ok(Some(out))
    }

    /// The unpacked manifest of the part.
    fn body(&self, whole: &Manifest<'_>, repairs: &[Repair], packets: usize) -> Result<Vec<u8>, ClipError> {
        let epochs: Vec<Epoch> = self.epochs.clone().filter_map(|e| whole.epoch(EpochId(e))).collect();
        let windows: Vec<Window> = self.windows.clone().filter_map(|w| whole.window(WindowId(w))).collect();
        let mut epoch_records = Vec::new();
        let (mut first_frame, mut first_cluster, mut first_window) = (0, 0, 0);
        for ((number, epoch), frames) in self.epochs.clone().zip(&epochs).zip(&self.frames) {
            let count = windows.iter().filter(|window| window.epoch == number).count() as u32;
            let record = Epoch {
                first_frame,
                frames: frames.end - frames.start,
                first_cluster,
                first_window,
                windows: count,
                ..*epoch
            };
            epoch_records.extend(record.to_bytes());
            first_frame += record.frames;
            first_cluster += record.clusters;
            first_window += count;
        }
        let (mut window_records, mut motions, mut basis) = (Vec::new(), Vec::new(), Vec::new());
        let (mut frame, mut first_cell) = (0, 0);
        for (number, window) in self.windows.clone().zip(&windows) {
            // Epochs without windows between those with them have frames too.
            let epoch = usize::from(window.epoch - self.epochs.start);
            let before: u32 = self.frames[..epoch].iter().map(|frames| frames.end - frames.start).sum();
            frame = before.max(frame);
            let clusters = epochs.get(epoch).map_or(0, |epoch| epoch.clusters);
            let record = Window {
                epoch: epoch as u16,
                first_frame: frame,
                first_cell,
                basis_first: basis.len() as u32 / 2,
                ..*window
            };
            window_records.extend(record.to_bytes());
            frame += u32::from(window.frames);
            first_cell += clusters;
            let of_window = (0..clusters).map(|cluster| ClusterId(cluster as u16));
            let of_window = of_window.filter_map(|cluster| whole.motion(WindowId(number), cluster));
            motions.extend(of_window.flat_map(|motion| motion.to_bytes()));
            let first = window.basis_first as usize;
            let values = first..first + usize::from(window.rank) * usize::from(window.frames);
            // Values are whole multiples of 2^-14: what is scaled up again is exact.
            let unscaled = values.filter_map(|at| whole.basis(at)).map(|value| (value * 16384.0) as i16);
            basis.extend(unscaled.flat_map(i16::to_le_bytes));
        }
        let head = Head {
            frames: first_frame,
            packets: packets as u32,
            epochs: epochs.len() as u16,
            windows: windows.len() as u16,
            clusters: first_cluster,
            repairs: repairs.len() as u16,
            basis_values: basis.len() as u32 / 2,
            transform_values: 0,
            ..*whole.head()
        };
        let mut out = head.to_bytes().to_vec();
        out.extend(epoch_records);
        out.extend(window_records);
        let clusters = self.epochs.clone().zip(&epochs).flat_map(|(number, epoch)| {
            let numbers = (0..epoch.clusters).map(|cluster| ClusterId(cluster as u16));
            numbers.filter_map(move |cluster| whole.cluster(EpochId(number), cluster))
        });
        let clusters: Vec<_> = clusters.collect();
        out.extend(clusters.iter().flat_map(|cluster| cluster.to_bytes()));
        out.extend(motions);
        let quants = (0..=u8::MAX).map_while(|index| whole.quant(index));
        quants.for_each(|quant| quant.write(|bytes| out.extend_from_slice(bytes)));
        let sets = (0..symbol_streams::COUNT).filter_map(|stream| whole.table_set(stream));
        out.extend(sets.flat_map(|set| set.to_bytes()));
        out.extend(repairs.iter().flat_map(Repair::to_bytes));
        out.extend(basis);
        let before = whole.epochs().take(self.epochs.start.into()).zip(0..);
        let blocks_of = |epoch: u16, clusters: u32| -> u32 {
            let numbers = (0..clusters).map(|cluster| ClusterId(cluster as u16));
            let clusters = numbers.filter_map(|cluster| whole.cluster(EpochId(epoch), cluster));
            clusters.map(|cluster| cluster.blocks(whole.block_len())).sum()
        };
        let first: u32 = before.map(|(epoch, number)| blocks_of(number, epoch.clusters)).sum();
        let blocks: u32 = clusters.iter().map(|cluster| cluster.blocks(whole.block_len())).sum();
        let mut proxies: Vec<Proxy> = Vec::new();
        for block in first..first + blocks {
            proxies.extend(whole.proxy(block as usize)?);
        }
        for plane in 0..Proxy::BYTES {
            out.extend(proxies.iter().map(|proxy| proxy.to_bytes()[plane]));
        }
        for table in whole.tables() {
            table?.write(|bytes| out.extend_from_slice(bytes));
        }
        Ok(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::{self, EncodeOptions, Protection},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
    };

    fn encoded(kind: SynthKind, frames: usize) -> Stream {
        let scene = SynthOptions { kind, gaussians: 1000, frames, ..SynthOptions::default() };
        let scene = synth::make(&scene, &Limits::default()).unwrap();
        let options = EncodeOptions {
            window_frames: Some(4),
            pictures: 0,
            repair: Protection::STANDARD,
            ..EncodeOptions::default()
        };
        encode::encode(&scene, &options, &encode::no_progress).unwrap().stream
    }

    /// The bits of each of `frames`.
    fn bits(stream: &Stream, frames: Range<u32>) -> Vec<Vec<u32>> {
        let mut player = stream.receive().unwrap();
        let frame = |number| {
            let shown = player.frame(number).unwrap();
            let values = shown.gaussians.iter().flat_map(|g| {
                g.position.into_iter().chain(g.scale).chain(g.rotation).chain([g.opacity]).chain(g.sh0)
            });
            values.chain(shown.sh_rest.iter().copied()).map(f32::to_bits).collect()
        };
        frames.map(frame).collect()
    }

    #[test]
    fn frames_are_those_of_the_whole_bit_for_bit() {
        for (kind, frames) in [(SynthKind::Cloth, 13), (SynthKind::Births, 12)] {
            let whole = encoded(kind, frames);
            let of = whole.manifest().unwrap().head().frames;
            for wanted in [0..1, 5..7, 3..of, 0..of] {
                let clip = Clip::of(&whole, wanted.clone()).unwrap();
                assert!(clip.frames.start <= wanted.start && clip.frames.end >= wanted.end, "{wanted:?}");
                let manifest = clip.stream.manifest().unwrap();
                assert_eq!(manifest.head().frames, clip.frames.end - clip.frames.start);
                let shown = bits(&clip.stream, 0..manifest.head().frames);
                assert!(shown == bits(&whole, clip.frames.clone()), "{wanted:?}");
                assert!(clip.stream.packets().iter().all(|packet| !packet.is_empty()));
                assert_eq!(Stream::from_bytes(&clip.stream.to_bytes().unwrap()).unwrap().0, clip.stream);
            }
            assert_eq!(Clip::of(&whole, 0..of).unwrap().stream, whole, "all of it is the same stream");
        }
    }

    #[test]
    fn parity_of_a_part_repairs_it() {
        let clip = Clip::of(&encoded(SynthKind::Cloth, 13), 4..12).unwrap().stream;
        let range = clip.manifest().unwrap().repairs().next().unwrap();
        let lossy = clip.with_packets(|id| id != range.first_packet as usize);
        assert!(lossy != clip && bits(&lossy, 0..8) == bits(&clip, 0..8));
    }

    #[test]
    fn what_cannot_be_cut_is_said() {
        let whole = encoded(SynthKind::Cloth, 8);
        let empty = Clip::of(&whole, 8..9).unwrap_err();
        assert_eq!(empty.to_string(), "frames 8..9 hold none of the stream's 8");
        let mut packets = whole.packets().to_vec();
        let checked = Checked::without_crc_check(&packets[0]).unwrap();
        let Packet::Slices(slices) = checked.packet().clone() else { panic!("media comes first") };
        let window = |number| Extent { span: Span::Motion(WindowId(number)), ..slices.extents[0] };
        let both = Slices { extents: [window(0), window(1)].into_iter().collect(), ..slices };
        let mut bytes = vec![0; both.wire_len()];
        both.write(&mut bytes).unwrap();
        packets[0] = bytes;
        let shared = Stream::new(whole.manifest().unwrap().raw().to_vec(), packets).unwrap();
        assert_eq!(Clip::of(&shared, 0..4).unwrap_err(), ClipError::Shared { packet: 0 });
    }
}
