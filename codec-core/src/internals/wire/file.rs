//! A `.dgs` file: the wire's bytes at rest.
//!
//! ```text
//! "DGS\x01" [manifest length: u32][DGSM]
//! { [packet length: u16][DGSP] }…
//! [0: u16] "DGSX" [packets: u32] { [offset of the length: u32] }… [CRC-32 of the index] [index length: u32]
//! ```
//!
//! The index only speeds things up: it can be rebuilt by walking the packets. A truncated or
//! damaged file gives what it still holds: where a packet or its length is damaged, [`packets`]
//! searches for the next place at which a packet's CRC fits.
//!
//! Of packets with one id the first in the file counts, as it would for a receiver.

use super::{
    checked::Checked,
    crc::{CRC_BYTES, Crc32, RunningCrc, checked, crc32},
    manifest::{Manifest, ManifestHead},
};
use crate::{
    cursor::{Reader, in_range},
    error::{Error, ErrorKind, Result},
    limits::{MAX_MANIFEST_BYTES, MAX_PACKET_BYTES},
};

/// First four bytes of a `.dgs` file.
pub const MAGIC: [u8; 4] = *b"DGS\x01";
/// First four bytes of the index.
pub const INDEX_MAGIC: [u8; 4] = *b"DGSX";
/// Shortest packet there can be: kind, id, one byte, CRC.
const MIN_PACKET_BYTES: usize = 9;

/// The manifest message of `file` and the offset of the first packet.
///
/// # Errors
/// Short bytes or another magic. The manifest itself is checked by whoever opens it.
pub fn manifest(file: &[u8]) -> Result<(&[u8], usize)> {
    let mut reader = Reader::new(file);
    let wanted = u32::from_le_bytes(MAGIC);
    let magic = u32::from_le_bytes(reader.array("file.magic")?);
    in_range("file.magic", 0, magic, wanted, wanted).map_err(|e| e.kind(ErrorKind::Unknown))?;
    let len = reader.u32("file.manifest_len")?;
    in_range("file.manifest_len", 4, len, 1, MAX_MANIFEST_BYTES as u32 + 20)?;
    let message = reader.bytes("file.manifest", len as usize)?;
    let sealed = ManifestHead::parse(message).map_err(|e| Error { offset: e.offset + 8, ..e })?;
    let len = u64::from(len);
    in_range("file.manifest_len", 4, sealed.wire_len as u64, len, len)
        .map_err(|e| e.kind(ErrorKind::Contradiction))?;
    Ok((message, reader.offset()))
}

/// The manifest message of `file` and its packets that are in order by themselves, for a player.
///
/// ```
/// let file = include_bytes!("../../../tests/conformance/one.dgs");
/// let (message, packets) = codec_core::file::parts(file)?;
/// assert!(message.starts_with(b"DGSM"));
/// assert_eq!(packets.count(), 4);
/// # Ok::<(), codec_core::Error>(())
/// ```
///
/// # Errors
/// As [`manifest`].
pub fn parts(file: &[u8]) -> Result<(&[u8], impl Iterator<Item = &[u8]>)> {
    let (message, start) = manifest(file)?;
    let packets = packets(file, start, crc32).filter_map(|record| match record {
        Record::Packet(_, packet) => Some(packet.bytes()),
        Record::Illegal(..) | Record::Damaged(..) | Record::End => None,
    });
    Ok((message, packets))
}

/// One record found in a file.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "there is no heap to put the large one on")]
pub enum Record<'a> {
    /// A packet that is in order by itself, and the offset of its first byte.
    Packet(usize, Checked<'a>),
    /// Bytes whose CRC fits and that are no packet all the same: offset, length and why.
    Illegal(usize, usize, Error),
    /// Bytes that are no packet: offset and length.
    Damaged(usize, usize),
    /// The packets end here as they should.
    End,
}

/// Walks the packets of `file` from `start` (see [`manifest`]).
///
/// Work is bounded: each byte is looked at as a possible start once, and a CRC is computed only
/// where length and kind are plausible.
pub const fn packets(file: &[u8], start: usize, crc: Crc32) -> Packets<'_> {
    Packets { file, at: start, crc, done: false }
}

/// See [`packets`].
#[derive(Debug)]
pub struct Packets<'a> {
    file: &'a [u8],
    at: usize,
    crc: Crc32,
    done: bool,
}

impl<'a> Packets<'a> {
    /// The bytes whose length field is at `at` and whose CRC fits.
    fn packet_at(&self, at: usize) -> Option<&'a [u8]> {
        let (len, rest) = self.file.get(at..)?.split_first_chunk::<2>()?;
        let len = usize::from(u16::from_le_bytes(*len));
        let plausible = (MIN_PACKET_BYTES..=MAX_PACKET_BYTES).contains(&len);
        let packet = rest.get(..len).filter(|p| plausible && (4..=6).contains(&(p[0] >> 5)))?;
        checked("packet.crc", packet, self.crc).is_ok().then_some(packet)
    }

    fn is_end(&self, at: usize) -> bool {
        let found = self.file.get(at..).and_then(|rest| rest.split_first_chunk::<2>());
        found.is_some_and(|(end, rest)| *end == [0, 0] && rest.starts_with(&INDEX_MAGIC))
    }
}

impl<'a> Iterator for Packets<'a> {
    type Item = Record<'a>;

    fn next(&mut self) -> Option<Record<'a>> {
        if self.done {
            return None;
        }
        if self.is_end(self.at) {
            self.done = true;
            return Some(Record::End);
        }
        if let Some(packet) = self.packet_at(self.at) {
            let start = self.at + 2;
            self.at = start + packet.len();
            return Some(match Checked::without_crc_check(packet) {
                Ok(packet) => Record::Packet(start, packet),
                Err(error) => Record::Illegal(start, packet.len(), error),
            });
        }
        let from = self.at;
        if from >= self.file.len() {
            self.done = true;
            return None;
        }
        // The damaged length is not believed, however plausible: the nearest whole packet is next.
        self.at = (from + 1..self.file.len())
            .find(|&at| self.is_end(at) || self.packet_at(at).is_some())
            .unwrap_or(self.file.len());
        Some(Record::Damaged(from, self.at - from))
    }
}

/// Packets of a stream that are not there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Missing {
    /// Packets, parity among them, that repair does not give back.
    pub lost: u32,
    /// Protected packets that repair gives back from the parity that is there.
    pub repairable: u32,
}

/// Which packets of `manifest`'s stream are missing where exactly those for whose ids `has` says so are
/// there.
pub fn missing(manifest: &Manifest<'_>, has: impl Fn(u32) -> bool) -> Missing {
    let mut missing = Missing::default();
    for id in 0..manifest.head().packets {
        missing.lost += u32::from(!has(id));
    }
    for repair in manifest.repairs() {
        for set in 0..repair.sets() {
            let lacks = (0..repair.members(set)).filter(|&at| !has(repair.member(set, at))).count();
            let rows = (0..repair.parity.into()).filter(|&row| has(repair.parity_id(set, row))).count();
            if lacks <= rows {
                missing.repairable += lacks as u32;
            }
        }
    }
    missing.lost -= missing.repairable;
    missing
}

/// Writes a file piece by piece through `emit`, and keeps its index.
#[derive(Debug)]
pub struct Index {
    at: u32,
    packets: u32,
}

impl Index {
    /// Emits the head of a file with the DGSM message `manifest`.
    pub fn begin(manifest: &[u8], mut emit: impl FnMut(&[u8])) -> Self {
        emit(&MAGIC);
        emit(&(manifest.len() as u32).to_le_bytes());
        emit(manifest);
        Self { at: 8 + manifest.len() as u32, packets: 0 }
    }

    /// Emits one packet and returns its index entry.
    ///
    /// # Errors
    /// A packet shorter or longer than there can be; [`ErrorKind::Capacity`] past 4 GiB.
    pub fn packet(&mut self, packet: &[u8], mut emit: impl FnMut(&[u8])) -> Result<u32> {
        let (least, most) = (MIN_PACKET_BYTES as u64, MAX_PACKET_BYTES as u64);
        in_range("file.packet_len", self.at as usize, packet.len() as u64, least, most)?;
        let entry = self.at;
        let next = u64::from(entry) + 2 + packet.len() as u64;
        // Offsets in the index have 32 bits.
        in_range("file.offset", 0, next, 0, u64::from(u32::MAX)).map_err(|e| e.kind(ErrorKind::Capacity))?;
        emit(&(packet.len() as u16).to_le_bytes());
        emit(packet);
        self.at = next as u32;
        self.packets += 1;
        Ok(entry)
    }

    /// Emits the end of the packets and the index of `entries`, one per packet.
    pub fn end(self, entries: &[u32], mut emit: impl FnMut(&[u8])) {
        emit(&[0, 0]);
        let mut crc = RunningCrc::new();
        let mut both = |bytes: &[u8]| {
            crc.update(bytes);
            emit(bytes);
        };
        both(&INDEX_MAGIC);
        both(&self.packets.to_le_bytes());
        entries.iter().for_each(|entry| both(&entry.to_le_bytes()));
        emit(&crc.finish().to_le_bytes());
        emit(&(entries.len() as u32 * 4 + 16).to_le_bytes());
    }
}

/// The index at the end of `file`: an iterator over the offsets of packet lengths.
///
/// # Errors
/// If the file does not end with a whole index; rebuild it with [`packets`].
pub fn index(file: &[u8], crc: Crc32) -> Result<impl ExactSizeIterator<Item = u32> + '_> {
    let short = Error::short("file.index", file.len(), 0, 16);
    let (_, tail) = file.split_last_chunk::<4>().ok_or(short)?;
    let len = u32::from_le_bytes(*tail) as usize;
    let place = file.len().checked_sub(len).ok_or(short)?;
    let content = file.get(place..file.len() - CRC_BYTES).ok_or(short)?;
    let in_file = |e: Error| Error { offset: e.offset.saturating_add(place as u32), ..e };
    let entries = checked("file.index_crc", content, crc).and_then(entries).map_err(in_file)?;
    Ok(entries.chunks_exact(4).map(|e| u32::from_le_bytes([e[0], e[1], e[2], e[3]])))
}

/// The entries of an index whose CRC fits.
fn entries(content: &[u8]) -> Result<&[u8]> {
    let mut reader = Reader::new(content);
    let wanted = u32::from_le_bytes(INDEX_MAGIC);
    let magic = u32::from_le_bytes(reader.array("file.index_magic")?);
    in_range("file.index_magic", 0, magic, wanted, wanted)?;
    let count = reader.u32("file.index_packets")? as usize;
    let entries = reader.bytes("file.index", count.saturating_mul(4))?;
    reader.finish("file.index")?;
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::{super::packet::Parity, *};
    use crate::{ids::PacketId, wire::manifest};
    extern crate std;
    use std::{vec, vec::Vec};

    /// Every place, but where each costs a million times more.
    const STEP: usize = if cfg!(miri) { 997 } else { 1 };

    fn file() -> (Vec<u8>, Vec<Vec<u8>>) {
        let mut message = vec![0u8; 64];
        let len = manifest::seal(&[7], &mut message).unwrap();
        let mut file = Vec::new();
        let mut index = Index::begin(&message[..len], |b| file.extend_from_slice(b));
        let (mut packets, mut entries) = (Vec::new(), Vec::new());
        for i in 0..20u32 {
            let content = vec![i as u8; 10 + 7 * i as usize];
            let mut out = vec![0u8; 300];
            let parity = Parity { id: PacketId::new(i).unwrap(), length: 5, content: &content };
            let len = parity.write(&mut out).unwrap();
            out.truncate(len);
            entries.push(index.packet(&out, |b| file.extend_from_slice(b)).unwrap());
            packets.push(out);
        }
        index.end(&entries, |b| file.extend_from_slice(b));
        (file, packets)
    }

    fn found(bytes: &[u8]) -> Vec<Vec<u8>> {
        let Ok((_, start)) = super::manifest(bytes) else { return Vec::new() };
        packets(bytes, start, crc32)
            .filter_map(|r| match r {
                Record::Packet(_, p) => Some(p.bytes().to_vec()),
                _ => None,
            })
            .collect()
    }

    #[test]
    fn a_whole_file_gives_every_packet_and_its_index() {
        let (file, written) = file();
        assert_eq!(found(&file), written);
        let (_, start) = super::manifest(&file).unwrap();
        assert_eq!(packets(&file, start, crc32).last(), Some(Record::End));
        let entries: Vec<u32> = index(&file, crc32).unwrap().collect();
        let walked: Vec<u32> = packets(&file, start, crc32)
            .filter_map(|r| match r {
                Record::Packet(at, _) => Some(at as u32 - 2),
                _ => None,
            })
            .collect();
        assert_eq!(entries, walked);
    }

    #[test]
    fn every_truncation_keeps_every_whole_packet() {
        let (file, written) = file();
        let (_, start) = super::manifest(&file).unwrap();
        let mut at = start;
        for cut in (start..file.len()).step_by(STEP) {
            while at < cut && written.get(found(&file[..at]).len()).is_some_and(|p| at + 2 + p.len() <= cut) {
                at += 2 + written[found(&file[..at]).len()].len();
            }
            let whole = found(&file[..cut]);
            assert_eq!(whole, written[..whole.len()]);
            assert!(whole.len() >= found(&file[..at]).len());
            assert!(index(&file[..cut], crc32).is_err());
        }
    }

    #[test]
    fn a_flipped_bit_loses_at_most_one_packet() {
        let (file, written) = file();
        let (_, start) = super::manifest(&file).unwrap();
        let end = file.len() - 16 - 4 * written.len() - 2;
        for bit in (start * 8..end * 8).step_by(STEP) {
            let mut damaged = file.clone();
            damaged[bit / 8] ^= 1 << (bit % 8);
            let left = found(&damaged);
            assert!(left.len() + 1 >= written.len(), "bit {bit}: {} of {}", left.len(), written.len());
            assert!(left.iter().all(|p| written.contains(p)));
        }
    }
}
