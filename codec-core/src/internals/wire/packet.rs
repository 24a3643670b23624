//! DGSP, the packets, in three kinds told apart by the top three bits of the first byte.
//!
//! - `0b100`, **chunk** (`paper`): 22-byte header, dependency words, payload ≤ 1200 bytes, CRC.
//! - `0b101`, **slices** (`dgs1`): packet id, one or more extents of blocks, one entropy-coded body,
//!   CRC. What a slice needs is implied by the lattice and costs no bytes.
//! - `0b110`, **parity**: packet id, one coded sum of the packets of a repair set, CRC.
//!
//! Every packet ends with the CRC-32 of all bytes before it. `parse` functions take the bytes
//! without that CRC (see [`super::crc::checked`]). `SPEC.md` gives every byte.

use heapless::Vec;

use super::crc::crc32;
use crate::{
    cursor::{Reader, Writer, in_range},
    error::{Error, ErrorKind, Result},
    ids::{EpochId, Level, PacketId, Span, WindowId},
    limits,
};

/// Kind of a packet that carries a `paper` chunk.
pub const KIND_CHUNK: u8 = 0b100;
/// Kind of a packet that carries `dgs1` slices.
pub const KIND_SLICES: u8 = 0b101;
/// Kind of a parity packet.
pub const KIND_PARITY: u8 = 0b110;
/// Kind of a receipt (DGSF).
pub const KIND_RECEIPT: u8 = 0b111;
/// Bytes of a chunk's fixed header.
pub const CHUNK_HEADER_BYTES: usize = 22;
/// Bytes of a parity packet before the coded length and content.
pub const PARITY_HEADER_BYTES: usize = 4;
/// Bytes by which parity exceeds the longest packet it covers: header, length, CRC.
pub const PARITY_OVERHEAD_BYTES: usize = PARITY_HEADER_BYTES + 2 + 4;

/// What every packet begins with.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Kind: [`KIND_CHUNK`], [`KIND_SLICES`] or [`KIND_PARITY`].
    pub kind: u8,
    /// The lower five bits of the first byte, which each kind reads its own way.
    pub flags: u8,
    /// The packet.
    pub id: PacketId,
    /// Bytes up to and including the id.
    pub len: usize,
}

impl Head {
    /// The head of `content`; what follows it is not looked at.
    ///
    /// # Errors
    /// Short bytes, an unknown kind, an id that is no varint in shortest form or too large.
    #[inline]
    pub fn parse(content: &[u8]) -> Result<Self> {
        // One check of length; the varints of ids below 2^14, which most packets have.
        let Some(&[first, a, b, c]) = content.first_chunk() else { return Self::parse_slowly(content) };
        let (id, len) = match first >> 5 {
            KIND_SLICES if a < 0x80 => ([a, 0, 0], 2),
            KIND_SLICES if (1..0x80).contains(&b) => ([a & 0x7f | b << 7, b >> 1, 0], 3),
            KIND_CHUNK | KIND_PARITY => ([a, b, c], 4),
            _ => return Self::parse_slowly(content),
        };
        let id = PacketId::from_bytes(id);
        Ok(Self { kind: first >> 5, flags: first & 0x1f, id, len })
    }

    /// Field by field.
    #[cold]
    fn parse_slowly(content: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(content);
        let first = reader.u8("packet.kind")?;
        let id = match first >> 5 {
            KIND_SLICES => PacketId::read(&mut reader)?,
            KIND_CHUNK => PacketId::from_bytes(reader.array("chunk.id")?),
            KIND_PARITY => PacketId::from_bytes(reader.array("parity.id")?),
            kind => return Err(unknown(kind)),
        };
        Ok(Self { kind: first >> 5, flags: first & 0x1f, id, len: reader.offset() })
    }
}

fn unknown(kind: u8) -> Error {
    let allowed = (KIND_CHUNK.into(), KIND_PARITY.into());
    Error::illegal("packet.kind", 0, kind.into(), allowed).kind(ErrorKind::Unknown)
}

/// A packet's content, CRC already checked and removed.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no heap to put the large one on")]
pub enum Packet<'a> {
    /// `paper`.
    Chunk(Chunk<'a>),
    /// `dgs1`.
    Slices(Slices<'a>),
    /// Repair.
    Parity(Parity<'a>),
}

impl<'a> Packet<'a> {
    /// Parses `content`.
    ///
    /// # Errors
    /// An unknown kind, or what the kind's `parse` refuses.
    pub fn parse(content: &'a [u8]) -> Result<Self> {
        let Some(&first) = content.first() else {
            return Err(Error::short("packet.kind", 0, 0, 1));
        };
        match first >> 5 {
            KIND_CHUNK => Chunk::parse(content).map(Self::Chunk),
            KIND_SLICES => Slices::parse(content).map(Self::Slices),
            KIND_PARITY => Parity::parse(content).map(Self::Parity),
            kind => Err(unknown(kind)),
        }
    }

    /// The packet's id.
    pub const fn id(&self) -> PacketId {
        match self {
            Self::Chunk(chunk) => chunk.id,
            Self::Slices(slices) => slices.id,
            Self::Parity(parity) => parity.id,
        }
    }
}

/// A `paper` packet: a run of symbols of one group, entropy-coded on its own.
#[derive(Clone, Debug, PartialEq)]
pub struct Chunk<'a> {
    /// Level of the group.
    pub level: Level,
    /// The packet.
    pub id: PacketId,
    /// Cluster, counted over all epochs.
    pub cluster: u16,
    /// First frame of the group's temporal coverage.
    pub first_frame: u16,
    /// Frames of the group's temporal coverage.
    pub frames: u16,
    /// Quantisation profile.
    pub quant: u8,
    /// First symbol of the group in this chunk.
    pub first_symbol: u32,
    /// Symbols in this chunk.
    pub symbols: u16,
    /// Groups this one needs, as `4 · cluster + level`.
    pub dependencies: Vec<u32, { limits::MAX_DEPENDENCIES }>,
    /// Entropy-coded symbols.
    pub payload: &'a [u8],
}

impl<'a> Chunk<'a> {
    /// Parses `content`.
    ///
    /// # Errors
    /// Short bytes, illegal fields, leftovers.
    pub fn parse(content: &'a [u8]) -> Result<Self> {
        let mut reader = Reader::new(content);
        let first = reader.u8("chunk.kind")?;
        in_range("chunk.kind", 0, first, KIND_CHUNK << 5, KIND_CHUNK << 5 | 3)?;
        let level = Level::from_bits(first);
        let id = PacketId::from_bytes(reader.array("chunk.id")?);
        let cluster = reader.u16("chunk.cluster")?;
        let first_frame = reader.u16("chunk.first_frame")?;
        let frames = in_range("chunk.frames", 8, reader.u16("chunk.frames")?, 1, u16::MAX)?;
        let quant = reader.u8("chunk.quant")?;
        let most_words = limits::MAX_DEPENDENCIES as u8;
        let count = in_range("chunk.dependencies", 11, reader.u8("chunk.dependencies")?, 0, most_words)?;
        let most = limits::MAX_PAYLOAD_BYTES as u16;
        let payload_len = in_range("chunk.payload_len", 12, reader.u16("chunk.payload_len")?, 1, most)?;
        let first_symbol = reader.u32("chunk.first_symbol")?;
        let symbols = in_range("chunk.symbols", 18, reader.u16("chunk.symbols")?, 1, u16::MAX)?;
        let reserved = reader.offset();
        in_range("chunk.reserved", reserved, reader.u16("chunk.reserved")?, 0, 0)?;
        let mut dependencies = Vec::new();
        let full = Error::illegal("chunk.dependencies", 11, count.into(), (0, most_words.into()));
        for _ in 0..count {
            dependencies.push(reader.u32("chunk.dependency")?).map_err(|_| full)?;
        }
        let payload = reader.bytes("chunk.payload", usize::from(payload_len))?;
        reader.finish("chunk.leftover")?;
        Ok(Self {
            level,
            id,
            cluster,
            first_frame,
            frames,
            quant,
            first_symbol,
            symbols,
            dependencies,
            payload,
        })
    }

    /// Bytes of the whole packet.
    pub fn wire_len(&self) -> usize {
        CHUNK_HEADER_BYTES + 4 * self.dependencies.len() + self.payload.len() + 4
    }

    /// Writes the whole packet, CRC included, to the front of `out`; returns its length.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if `out` is too small, [`ErrorKind::Illegal`] for a payload over
    /// 1200 bytes.
    pub fn write(&self, out: &mut [u8]) -> Result<usize> {
        let most = limits::MAX_PAYLOAD_BYTES;
        in_range("chunk.payload_len", 12, self.payload.len() as u64, 1, most as u64)?;
        let mut writer = Writer::new(out);
        writer.bytes(&[KIND_CHUNK << 5 | self.level.get()])?;
        writer.bytes(&self.id.to_bytes())?;
        writer.bytes(&self.cluster.to_le_bytes())?;
        writer.bytes(&self.first_frame.to_le_bytes())?;
        writer.bytes(&self.frames.to_le_bytes())?;
        writer.bytes(&[self.quant, self.dependencies.len() as u8])?;
        writer.bytes(&(self.payload.len() as u16).to_le_bytes())?;
        writer.bytes(&self.first_symbol.to_le_bytes())?;
        writer.bytes(&self.symbols.to_le_bytes())?;
        writer.bytes(&[0, 0])?;
        for word in &self.dependencies {
            writer.bytes(&word.to_le_bytes())?;
        }
        writer.bytes(self.payload)?;
        seal(writer)
    }
}

/// Consecutive blocks of one level in one span: a slice of every group they belong to.
///
/// Blocks are numbered over all clusters of the span's epoch, in order, so that an extent takes a
/// few bytes however many clusters it crosses. Clusters without symbols at the level are counted
/// and bring nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Extent {
    /// Epoch or window.
    pub span: Span,
    /// Level.
    pub level: Level,
    /// First block, counted over the span.
    pub first: u32,
    /// Number of blocks, ≥ 1.
    pub blocks: u32,
}

const FLAG_MOTION: u8 = 1 << 2;
const FLAG_MORE: u8 = 1 << 3;
/// Bits of an extent's flag byte that may be set; the kind above them is the first extent's.
const FLAGS: u8 = 0xf;

impl Extent {
    /// Bytes of this extent's header, its flag byte included.
    #[inline(never)]
    pub fn header_len(&self) -> usize {
        use crate::cursor::varint_len;
        let (Span::Canonical(EpochId(span)) | Span::Motion(WindowId(span))) = self.span;
        1 + varint_len(span.into()) + varint_len(self.first) + varint_len(self.blocks)
    }

    fn flags(&self, more: bool) -> u8 {
        let motion = if matches!(self.span, Span::Motion(_)) { FLAG_MOTION } else { 0 };
        self.level.get() | motion | if more { FLAG_MORE } else { 0 }
    }

    fn read(reader: &mut Reader<'_>, flags: u8) -> Result<Self> {
        let motion = flags & FLAG_MOTION != 0;
        let most = if motion { limits::MAX_WINDOWS } else { limits::MAX_EPOCHS } as u32 - 1;
        let span = reader.varint("extent.span", most)? as u16;
        let span = if motion { Span::Motion(WindowId(span)) } else { Span::Canonical(EpochId(span)) };
        let first = reader.varint("extent.first", limits::MAX_EPOCH_GAUSSIANS - 1)?;
        let blocks = reader.varint_in("extent.blocks", 1, limits::MAX_EPOCH_GAUSSIANS)?;
        Ok(Self { span, level: Level::from_bits(flags), first, blocks })
    }
}

/// A `dgs1` packet: extents of blocks that share one entropy-coded body.
#[derive(Clone, Debug, PartialEq)]
pub struct Slices<'a> {
    /// The packet.
    pub id: PacketId,
    /// What the body holds, in order.
    pub extents: Vec<Extent, { limits::MAX_EXTENTS }>,
    /// Table indices, then the four-lane rANS body.
    pub body: &'a [u8],
}

impl<'a> Slices<'a> {
    /// Parses `content`.
    ///
    /// # Errors
    /// Short bytes, illegal fields, too many extents.
    pub fn parse(content: &'a [u8]) -> Result<Self> {
        let mut reader = Reader::new(content);
        let first = reader.u8("extent.flags")?;
        in_range("packet.kind", 0, first >> 5, KIND_SLICES, KIND_SLICES)?;
        let mut flags = in_range("extent.flags", 0, first & 0x1f, 0, FLAGS)?;
        let id = PacketId::read(&mut reader)?;
        let mut extents = Vec::new();
        loop {
            let place = reader.offset();
            let extent = Extent::read(&mut reader, flags)?;
            let most = limits::MAX_EXTENTS as u64;
            let full = Error::illegal("packet.extents", place, most + 1, (1, most));
            extents.push(extent).map_err(|_| full)?;
            if flags & FLAG_MORE == 0 {
                break;
            }
            let place = reader.offset();
            flags = in_range("extent.flags", place, reader.u8("extent.flags")?, 0, FLAGS)?;
        }
        let left = reader.left();
        let body = reader.bytes("packet.body", left)?;
        Ok(Self { id, extents, body })
    }

    /// Bytes before the body.
    pub fn header_len(&self) -> usize {
        let headers: usize = self.extents.iter().map(Extent::header_len).sum();
        crate::cursor::varint_len(self.id.get()) + headers
    }

    /// Bytes of the whole packet.
    pub fn wire_len(&self) -> usize {
        self.header_len() + self.body.len() + super::crc::CRC_BYTES
    }

    /// Writes the whole packet, CRC included, to the front of `out`; returns its length.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if `out` is too small, [`ErrorKind::Illegal`] without an extent.
    pub fn write(&self, out: &mut [u8]) -> Result<usize> {
        in_range("packet.extents", 0, self.extents.len() as u64, 1, limits::MAX_EXTENTS as u64)?;
        let mut writer = Writer::new(out);
        for (i, extent) in self.extents.iter().enumerate() {
            let flags = extent.flags(i + 1 < self.extents.len());
            if i == 0 {
                writer.bytes(&[KIND_SLICES << 5 | flags])?;
                writer.varint(self.id.get())?;
            } else {
                writer.bytes(&[flags])?;
            }
            let (Span::Canonical(EpochId(span)) | Span::Motion(WindowId(span))) = extent.span;
            writer.varint(span.into())?;
            writer.varint(extent.first)?;
            writer.varint(extent.blocks)?;
        }
        writer.bytes(self.body)?;
        seal(writer)
    }
}

/// A parity packet: one row of the code over the packets of one repair set.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Parity<'a> {
    /// The packet; its id says which row of which set it is.
    pub id: PacketId,
    /// Sum of the covered packets' lengths, byte by byte, each times its coefficient.
    pub length: u16,
    /// Sum of the covered packets' bytes (CRCs included, padded with zeros), each times its
    /// coefficient.
    pub content: &'a [u8],
}

impl<'a> Parity<'a> {
    /// Parses `content`.
    ///
    /// # Errors
    /// Short bytes, illegal fields.
    pub fn parse(content: &'a [u8]) -> Result<Self> {
        let mut reader = Reader::new(content);
        let first = reader.u8("parity.kind")?;
        in_range("parity.kind", 0, first, KIND_PARITY << 5, KIND_PARITY << 5)?;
        let id = PacketId::from_bytes(reader.array("parity.id")?);
        let length = reader.u16("parity.length")?;
        let place = reader.offset();
        let left = reader.left();
        in_range("parity.content", place, left as u64, 1, limits::MAX_PACKET_BYTES as u64)?;
        let content = reader.bytes("parity.content", left)?;
        Ok(Self { id, length, content })
    }

    /// Writes the whole packet, CRC included, to the front of `out`; returns its length.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if `out` is too small.
    pub fn write(&self, out: &mut [u8]) -> Result<usize> {
        let mut writer = Writer::new(out);
        writer.bytes(&[KIND_PARITY << 5])?;
        writer.bytes(&self.id.to_bytes())?;
        writer.bytes(&self.length.to_le_bytes())?;
        writer.bytes(self.content)?;
        seal(writer)
    }
}

fn seal(mut writer: Writer<'_>) -> Result<usize> {
    let crc = crc32(writer.written());
    writer.bytes(&crc.to_le_bytes())?;
    Ok(writer.len())
}

#[cfg(test)]
mod tests {
    use super::{super::crc::checked, *};
    use proptest::prelude::*;
    extern crate std;
    use std::vec;

    fn extent() -> impl Strategy<Value = Extent> {
        (any::<bool>(), 0u16..4000, 0u32..1_000_000, 0u8..4, 1u32..3000).prop_map(
            |(m, s, first, l, blocks)| Extent {
                span: if m { Span::Motion(WindowId(s)) } else { Span::Canonical(EpochId(s)) },
                level: Level::from_bits(l),
                first,
                blocks,
            },
        )
    }

    proptest! {
        #[test]
        fn heads_are_read_alike(
            bytes in proptest::collection::vec(prop_oneof![any::<u8>(), Just(0xa0), Just(0x80)], 0..8),
        ) {
            prop_assert_eq!(Head::parse(&bytes), Head::parse_slowly(&bytes));
        }

        #[test]
        fn slices_round_trip_at_their_stated_length(
            list in proptest::collection::vec(extent(), 1..9), id in 0u32..1 << 24,
            body in proptest::collection::vec(any::<u8>(), 0..900),
        ) {
            let packet = Slices {
                id: PacketId::new(id).unwrap(), extents: list.into_iter().collect(), body: &body,
            };
            let mut out = vec![0u8; 1280];
            let len = packet.write(&mut out).unwrap();
            prop_assert_eq!(len, packet.wire_len());
            let content = checked("packet.crc", &out[..len], crc32).unwrap();
            prop_assert_eq!(Packet::parse(content).unwrap(), Packet::Slices(packet));
        }

        #[test]
        fn chunks_round_trip_at_their_stated_length(
            level in 0u8..4, id in 0u32..1 << 24, cluster: u16, symbols in 1u16..3000,
            words in proptest::collection::vec(any::<u32>(), 0..=8),
            payload in proptest::collection::vec(any::<u8>(), 1..=1200),
        ) {
            let packet = Chunk {
                level: Level::from_bits(level), id: PacketId::new(id).unwrap(), cluster, first_frame: 3,
                frames: 24, quant: 1, first_symbol: 77, symbols,
                dependencies: words.into_iter().collect(), payload: &payload,
            };
            let mut out = vec![0u8; 1280];
            let len = packet.write(&mut out).unwrap();
            prop_assert_eq!(len, packet.wire_len());
            prop_assert_eq!(len - payload.len() - 4 * packet.dependencies.len(), CHUNK_HEADER_BYTES + 4);
            let content = checked("packet.crc", &out[..len], crc32).unwrap();
            prop_assert_eq!(Packet::parse(content).unwrap(), Packet::Chunk(packet));
        }

        #[test]
        fn any_bytes_parse_or_are_refused_and_what_parses_writes_back(
            kind in 4u8..8, bytes in proptest::collection::vec(any::<u8>(), 0..200),
        ) {
            let mut bytes = bytes;
            if let Some(first) = bytes.first_mut() { *first = *first & 0x1f | kind << 5; }
            if let Ok(packet) = Packet::parse(&bytes) {
                let mut out = vec![0u8; 1300];
                let len = match &packet {
                    Packet::Chunk(p) => p.write(&mut out),
                    Packet::Slices(p) => p.write(&mut out),
                    Packet::Parity(p) => p.write(&mut out),
                }.unwrap();
                prop_assert_eq!(&out[..len - 4], &bytes[..]);
            }
        }
    }

    #[test]
    fn literal_bytes_of_a_slices_packet() {
        let extent =
            Extent { span: Span::Canonical(EpochId(0)), level: Level::from_bits(2), first: 300, blocks: 4 };
        let packet = Slices {
            id: PacketId::new(0x01_02_03).unwrap(),
            extents: [extent].into_iter().collect(),
            body: &[0xaa, 0xbb],
        };
        let mut out = [0u8; 32];
        let len = packet.write(&mut out).unwrap();
        assert_eq!(out[..len - 4], [0b1010_0010, 0x83, 0x84, 0x04, 0, 0xac, 2, 4, 0xaa, 0xbb]);
    }
}
