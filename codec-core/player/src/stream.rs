//! Holds a stream as bytes: its manifest message and its packets, as a `.dgs` file has them.

use codec_core::{
    Caps, Error, Result,
    internals::{
        ids::PacketId,
        pack::packed_bound,
        receiver::Requirements,
        wire::{
            checked::Checked,
            file::{self, Record},
            manifest::{self, Manifest, ManifestHead},
        },
    },
};
use codec_simd::crc32;

use crate::index::IndexCheck;

/// A manifest and its packets: bytes, and nothing about how they were made.
///
/// ```
/// # let file = include_bytes!("../../tests/conformance/one.dgs");
/// let (stream, damage) = dgs_player::Stream::from_bytes(file)?;
/// assert!(damage.is_none());
/// assert_eq!(stream.to_bytes()?, file);
/// # Ok::<(), codec_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stream {
    message: Vec<u8>,
    raw: Vec<u8>,
    packets: Vec<Vec<u8>>,
}

/// What a `.dgs` file had that could not be used, and what it lacks.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Byte ranges that are no packet: offset, length.
    pub ranges: Vec<(usize, usize)>,
    /// Packets that the manifest expects, the file does not hold and repair does not give back.
    pub missing_packets: usize,
    /// Packets whose id another packet before them has; they are passed over.
    pub duplicates: usize,
    /// Why the index cannot be used, if it cannot: it is missing, damaged, or says other places than those
    /// where packets and index lie.
    pub index: Option<Error>,
    /// Whether the file ends before its index.
    pub truncated: bool,
}

impl Damage {
    /// Whether all bytes of the file could be used. Packets that it does not hold are no damage (SPEC.md,
    /// section 12): somebody may have left them out; [`Damage::missing_packets`] counts them.
    pub fn is_none(&self) -> bool {
        *self == Self { missing_packets: self.missing_packets, ..Self::default() }
    }
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut parts = Vec::new();
        if let Some((at, len)) = self.ranges.first() {
            let total: usize = self.ranges.iter().map(|range| range.1).sum();
            parts.push(format!(
                "{} damaged byte ranges ({total} bytes in all, the first at byte {at}, {len} bytes)",
                self.ranges.len()
            ));
        }
        if self.truncated {
            parts.push("the file is cut off".into());
        }
        if let Some(error) = self.index.filter(|_| !self.truncated) {
            parts.push(format!("the index is unusable ({error})"));
        }
        if self.missing_packets > 0 {
            parts.push(format!("{} packets are missing", self.missing_packets));
        }
        if self.duplicates > 0 {
            parts.push(format!("{} packets repeat the id of another", self.duplicates));
        }
        f.write_str(&parts.join("; "))
    }
}

impl Stream {
    /// Seals `raw`, an unpacked manifest body, and joins it with its packets, in order of their ids.
    ///
    /// # Errors
    /// A body that is no manifest, or one that cannot be sealed.
    pub fn new(raw: Vec<u8>, packets: Vec<Vec<u8>>) -> Result<Self> {
        Manifest::parse(&raw)?;
        Ok(Self { message: sealed(&raw)?, raw, packets })
    }

    /// The DGSM message.
    pub fn message(&self) -> &[u8] {
        &self.message
    }

    /// The packets, by id; one that is missing is empty.
    pub fn packets(&self) -> &[Vec<u8>] {
        &self.packets
    }

    /// Takes in a packet that is in order by itself; whether it is of this stream and the first of its id.
    pub fn insert(&mut self, packet: &Checked<'_>) -> bool {
        match self.packets.get_mut(packet.id().index()) {
            Some(slot) if slot.is_empty() => {
                *slot = packet.bytes().to_vec();
                true
            }
            Some(_) | None => false,
        }
    }

    /// Forgets a packet, as if it had never come.
    pub fn remove(&mut self, packet: PacketId) {
        if let Some(slot) = self.packets.get_mut(packet.index()) {
            *slot = Vec::new();
        }
    }

    /// The same stream with the packets that `stays` says, by id; the others are missing.
    #[must_use]
    pub fn with_packets(&self, stays: impl Fn(usize) -> bool) -> Self {
        let packet = |(id, packet): (usize, &Vec<u8>)| if stays(id) { packet.clone() } else { Vec::new() };
        let packets = self.packets.iter().enumerate().map(packet).collect();
        Self { message: self.message.clone(), raw: self.raw.clone(), packets }
    }

    /// Bytes of the message and all packets.
    pub fn wire_bytes(&self) -> usize {
        self.message.len() + self.packets.iter().map(Vec::len).sum::<usize>()
    }

    /// The manifest.
    ///
    /// # Errors
    /// None in practice: the body was checked when the stream was made.
    pub fn manifest(&self) -> Result<Manifest<'_>> {
        Manifest::parse(&self.raw)
    }

    /// The bytes of a `.dgs` file.
    ///
    /// # Errors
    /// A packet of impossible length.
    pub fn to_bytes(&self) -> Result<Vec<u8>> {
        self.file(self.packets.iter())
    }

    /// The bytes of a `.dgs` file whose packets lie in the order `ids`: what comes first is there first when
    /// the file is fetched. Packets that are not named follow in the order of their ids.
    ///
    /// ```
    /// # let file = include_bytes!("../../tests/conformance/still.dgs");
    /// # use codec_core::PacketId;
    /// let (stream, _) = dgs_player::Stream::from_bytes(file)?;
    /// let last = PacketId::new(stream.packets().len() as u32 - 1).unwrap_or_default();
    /// let other = stream.to_bytes_in_order([last])?;
    /// assert!(other != file && other.len() == file.len());
    /// assert_eq!(dgs_player::Stream::from_bytes(&other)?.0, stream);
    /// # Ok::<(), codec_core::Error>(())
    /// ```
    ///
    /// # Errors
    /// A packet of impossible length.
    pub fn to_bytes_in_order(&self, ids: impl IntoIterator<Item = PacketId>) -> Result<Vec<u8>> {
        let mut follows = vec![true; self.packets.len()];
        let mut order = Vec::with_capacity(self.packets.len());
        for at in ids.into_iter().map(PacketId::index) {
            if follows.get(at).is_some_and(|&not_yet| not_yet) {
                follows[at] = false;
                order.push(at);
            }
        }
        order.extend((0..self.packets.len()).filter(|&at| follows[at]));
        self.file(order.into_iter().map(|at| &self.packets[at]))
    }

    fn file<'a>(&'a self, packets: impl Iterator<Item = &'a Vec<u8>>) -> Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut index = file::Index::begin(&self.message, |b| out.extend_from_slice(b));
        let mut entries = Vec::with_capacity(self.packets.len());
        for packet in packets.filter(|packet| !packet.is_empty()) {
            entries.push(index.packet(packet, |b| out.extend_from_slice(b))?);
        }
        index.end(&entries, |b| out.extend_from_slice(b));
        Ok(out)
    }

    /// Reads a `.dgs` file and keeps what is readable.
    ///
    /// # Errors
    /// If the manifest itself is unreadable, without which nothing else means anything, or exceeds
    /// [`Caps::HOST`].
    pub fn from_bytes(bytes: &[u8]) -> Result<(Self, Damage)> {
        Self::from_bytes_within(bytes, &Caps::HOST)
    }

    /// As [`Stream::from_bytes`], of streams within `caps`.
    ///
    /// # Errors
    /// If the manifest itself is unreadable or exceeds `caps`.
    pub fn from_bytes_within(bytes: &[u8], caps: &Caps) -> Result<(Self, Damage)> {
        let (message, start) = file::manifest(bytes)?;
        let sealed = ManifestHead::parse(message)?.within(caps)?;
        let mut raw = vec![0u8; sealed.raw_len];
        sealed.open(message, crc32, &mut raw)?;
        let parsed = Manifest::parse(&raw)?;
        // What no player here takes on is refused before memory is set aside for it.
        Requirements::of(&parsed, caps)?;
        let mut packets = vec![Vec::new(); parsed.head().packets as usize];
        let mut damage = Damage { truncated: true, ..Damage::default() };
        let mut index = IndexCheck::of(bytes, start);
        for record in file::packets(bytes, start, crc32) {
            index.take(&record);
            match record {
                Record::Packet(at, packet) => match packets.get_mut(packet.id().index()) {
                    Some(slot) if slot.is_empty() => *slot = packet.bytes().to_vec(),
                    // The first counts, as for a receiver.
                    Some(_) => damage.duplicates += 1,
                    None => damage.ranges.push((at, packet.bytes().len())),
                },
                Record::Illegal(at, len, _) | Record::Damaged(at, len) => damage.ranges.push((at, len)),
                Record::End => damage.truncated = false,
            }
        }
        let missing = file::missing(&parsed, |id| packets.get(id as usize).is_some_and(|p| !p.is_empty()));
        damage.missing_packets = missing.lost as usize;
        damage.index = index.wrong();
        Ok((Self { message: message.to_vec(), raw, packets }, damage))
    }
}

/// The DGSM message of the unpacked manifest body `raw`.
///
/// # Errors
/// An empty or oversized body.
pub fn sealed(raw: &[u8]) -> Result<Vec<u8>> {
    let mut message = vec![0u8; packed_bound(raw.len()).min(raw.len() * 2 + 4096)];
    let len = manifest::seal(raw, &mut message)?;
    message.truncate(len);
    Ok(message)
}

#[cfg(test)]
mod tests {
    use codec_core::ErrorKind;

    use super::*;

    const FILE: &[u8] = include_bytes!("../../tests/conformance/one.dgs");
    /// Where the lengths of its packets, its end mark and its index lie.
    const PACKETS: [u32; 4] = [276, 300, 322, 344];
    const END: usize = 366;
    const INDEX: usize = END + 2;

    /// `front`, then an index of `entries`.
    fn indexed(front: &[u8], entries: &[u32]) -> Vec<u8> {
        let mut index = [*b"DGSX", (entries.len() as u32).to_le_bytes()].concat();
        entries.iter().for_each(|entry| index.extend(entry.to_le_bytes()));
        let crc = crc32(&index).to_le_bytes();
        let len = (index.len() as u32 + 8).to_le_bytes();
        [front, &index, &crc, &len].concat()
    }

    fn damage(file: &[u8]) -> Damage {
        Stream::from_bytes(file).unwrap().1
    }

    fn error(field: &'static str, at: usize, found: u64, allowed: (u64, u64)) -> Option<Error> {
        Some(Error::illegal(field, at, found, allowed).kind(ErrorKind::Contradiction))
    }

    #[test]
    fn an_index_that_fits_its_crc_and_no_packet_is_reported() {
        let with = |entries: &[u32]| damage(&indexed(&FILE[..INDEX], entries));
        assert_eq!(indexed(&FILE[..INDEX], &PACKETS), FILE);
        assert!(with(&PACKETS).is_none());
        assert_eq!(with(&[276, 300, 323, 344]).index, error("file.index", INDEX + 16, 323, (322, 322)));
        assert_eq!(with(&[300, 276, 322, 344]).index, error("file.index", INDEX + 8, 300, (276, 276)));
        let count = |found, allowed| error("file.index_packets", INDEX + 4, found, allowed);
        assert_eq!(with(&PACKETS[..3]).index, count(3, (4, u32::MAX.into())));
        assert_eq!(with(&[276, 300, 322, 344, 344]).index, count(5, (0, 4)));
        assert_eq!(with(&[]).index, count(0, (1, u32::MAX.into())));
        // The packets are there all the same.
        assert_eq!((with(&[]).missing_packets, with(&[]).ranges.len()), (0, 0));
    }

    #[test]
    fn an_index_elsewhere_is_reported() {
        let first = indexed(&FILE[..INDEX], &PACKETS);
        let two = indexed(&first, &PACKETS);
        let place = first.len() as u64;
        assert_eq!(damage(&two).index, error("file.index", first.len(), place, (INDEX as u64, INDEX as u64)));
    }

    #[test]
    fn what_the_index_says_of_damaged_packets_is_believed() {
        for at in [PACKETS[1], PACKETS[1] + 9, PACKETS[3] + 5] {
            let mut file = FILE.to_vec();
            file[at as usize] ^= 1;
            let found = damage(&file);
            assert_eq!((found.ranges.len(), found.missing_packets, found.index), (1, 1, None), "{at}");
        }
        let end = [&FILE[..END], &[1], &FILE[END + 1..]].concat();
        assert_eq!((damage(&end).truncated, damage(&end).index), (true, None));
    }
}
