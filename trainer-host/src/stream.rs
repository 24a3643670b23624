//! An encoded scene: the manifest, the packets, and what a host needs to take them apart again.

mod map;
mod player;

pub use map::{Mark, PacketMap};
pub use player::{HostMemory, Player, Shown};

use codec_core::{
    error,
    receiver::{Content, Counters},
    wire::{
        crc::checked,
        file,
        manifest::{self, Manifest},
        packet::Packet,
    },
};
use codec_simd::{Intake, crc32};

use crate::encode::{Ledger, Part, Quality, Reached, Searched};

/// A manifest and its packets.
#[derive(Clone, Debug)]
pub struct Stream {
    message: Vec<u8>,
    raw: Vec<u8>,
    packets: Vec<Vec<u8>>,
    order: Vec<Vec<u32>>,
    ledger: Ledger,
}

/// What a damaged `.dgs` file had that could not be used.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Runs of bytes that are no packet: offset, length.
    pub runs: Vec<(usize, usize)>,
    /// Packets that the manifest expects and the file does not hold.
    pub missing_packets: usize,
    /// Why the index could not be used, if it could not.
    pub index: Option<error::Error>,
    /// Whether the packets end where the index begins.
    pub truncated: bool,
}

impl Damage {
    /// True when the file was whole.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut parts = Vec::new();
        if let Some((at, len)) = self.runs.first() {
            let total: usize = self.runs.iter().map(|r| r.1).sum();
            parts.push(format!(
                "{} damaged stretches ({total} bytes in all, the first at byte {at}, {len} bytes)",
                self.runs.len()
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
        f.write_str(&parts.join("; "))
    }
}

impl Stream {
    /// Seals `raw` (an unpacked manifest body of `sections`) and joins it with its packets. `order`
    /// gives, per epoch, the source index of each decoded Gaussian.
    ///
    /// # Errors
    /// If the manifest cannot be sealed.
    pub(crate) fn seal(
        raw: Vec<u8>,
        sections: &[Section],
        packets: Vec<Vec<u8>>,
        order: Vec<Vec<u32>>,
        mut ledger: Ledger,
    ) -> error::Result<Self> {
        let message = sealed(&raw)?;
        ledger.manifest = message.len() as f64;
        ledger.manifest_parts = manifest_parts(&raw, sections, message.len())?;
        Ok(Self { message, raw, packets, order, ledger })
    }

    /// The same with what its ledger says of the target.
    pub(crate) fn with_reached(mut self, reached: Option<Reached>) -> Self {
        self.ledger.reached = reached;
        self
    }

    /// The same with what its ledger says of the search of its steps.
    pub(crate) fn with_searched(mut self, searched: Searched) -> Self {
        self.ledger.searched = Some(searched);
        self
    }

    /// The same with the steps it was encoded at.
    pub(crate) fn with_quality(mut self, quality: Quality) -> Self {
        self.ledger.quality = quality;
        self
    }

    /// The DGSM message.
    pub fn message(&self) -> &[u8] {
        &self.message
    }

    /// The packets, by id.
    pub fn packets(&self) -> &[Vec<u8>] {
        &self.packets
    }

    /// Where every byte went. A stream read from a file knows sizes only.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Per epoch, the source index of each decoded Gaussian; empty for a stream read from a file.
    pub fn order(&self) -> &[Vec<u32>] {
        &self.order
    }

    /// The manifest.
    ///
    /// # Errors
    /// None in practice: the body was checked when the stream was made.
    pub fn manifest(&self) -> error::Result<Manifest<'_>> {
        Manifest::parse(&self.raw)
    }

    /// The bytes of a `.dgs` file.
    ///
    /// # Errors
    /// A packet of impossible length; not for streams of this crate's making.
    pub fn to_bytes(&self) -> error::Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut index = file::Index::begin(&self.message, |b| out.extend_from_slice(b));
        let mut entries = Vec::with_capacity(self.packets.len());
        for packet in self.packets.iter().filter(|p| !p.is_empty()) {
            entries.push(index.packet(packet, |b| out.extend_from_slice(b))?);
        }
        index.end(&entries, |b| out.extend_from_slice(b));
        Ok(out)
    }

    /// Reads a `.dgs` file and keeps what is readable. A packet that is not there is empty in
    /// [`Stream::packets`].
    ///
    /// # Errors
    /// If the manifest itself is unreadable: without it nothing else means anything.
    pub fn from_bytes(bytes: &[u8]) -> error::Result<(Self, Damage)> {
        let (message, start) = file::manifest(bytes)?;
        let sealed = manifest::Sealed::parse(message)?;
        let mut raw = vec![0u8; sealed.raw_len.min(codec_core::limits::MAX_MANIFEST_BYTES)];
        manifest::open(message, crc32, &mut raw)?;
        let parsed = Manifest::parse(&raw)?;
        let count = parsed.head().packets as usize;
        let mut packets = vec![Vec::new(); count];
        let mut damage = Damage { truncated: true, ..Damage::default() };
        for record in file::packets(bytes, start, crc32) {
            match record {
                file::Record::Packet(at, packet) => {
                    let parsed = checked("packet.crc", packet, crc32).and_then(Packet::parse);
                    match parsed.ok().and_then(|p| packets.get_mut(p.id().index())) {
                        Some(slot) => *slot = packet.to_vec(),
                        None => damage.runs.push((at, packet.len())),
                    }
                }
                file::Record::Damaged(at, len) => damage.runs.push((at, len)),
                file::Record::End => damage.truncated = false,
            }
        }
        damage.missing_packets = packets.iter().filter(|p| p.is_empty()).count();
        damage.index = file::index(bytes, crc32).err();
        let media: usize = packets.iter().map(Vec::len).sum();
        let ledger = Ledger {
            gaussians: parsed.epochs().map(|e| u64::from(e.gaussians)).sum(),
            frames: u64::from(parsed.head().frames),
            payload: media as f64,
            manifest: message.len() as f64,
            packets: packets.iter().filter(|p| !p.is_empty()).count() as u64,
            ..Ledger::default()
        };
        Ok((Self { message: message.to_vec(), raw, packets, order: Vec::new(), ledger }, damage))
    }

    /// Feeds the manifest and every packet to a receiver, many packets at a time.
    ///
    /// # Errors
    /// If the manifest is refused; refused packets are counted, not errors.
    pub fn receive(&self) -> error::Result<Received<'_>> {
        let manifest = self.manifest()?;
        let mut memory = HostMemory::new(&manifest, 0)?;
        let counters = {
            let mut receiver = codec_simd::receiver(memory.memory());
            receiver.control(&self.message)?;
            let packets = self.packets.iter().filter(|p| !p.is_empty()).map(Vec::as_slice);
            // Refusals are counted by kind in the receiver's counters.
            Intake::default().media(&mut receiver, packets, |_| ());
            *receiver.counters()
        };
        Ok(Received { manifest, memory, counters })
    }
}

/// Name and first byte of a section of a manifest body.
pub(crate) type Section = (&'static str, usize);

fn sealed(raw: &[u8]) -> error::Result<Vec<u8>> {
    let mut message = vec![0u8; codec_core::pack::packed_bound(raw.len()).min(raw.len() * 2 + 4096)];
    let len = manifest::seal(raw, &mut message)?;
    message.truncate(len);
    Ok(message)
}

/// What each section takes of a manifest of `len` bytes: header and CRC apart, the packed body is
/// shared out in proportion to what the message shrinks by when it is packed without the section.
fn manifest_parts(raw: &[u8], sections: &[Section], len: usize) -> error::Result<Vec<Part>> {
    let mut shrinks = Vec::new();
    for (i, &(name, start)) in sections.iter().enumerate() {
        let end = sections.get(i + 1).map_or(raw.len(), |next| next.1);
        let without = [&raw[..start], &raw[end..]].concat();
        let shrinks_by = if start == end { 0 } else { len.saturating_sub(sealed(&without)?.len()) };
        shrinks.push((name, shrinks_by));
    }
    let total: usize = shrinks.iter().map(|s| s.1).sum();
    let frame = (manifest::HEADER_BYTES + 4) as f64;
    let mut parts = vec![Part { name: "manifest header and CRC".into(), bits: 8.0 * frame }];
    parts.extend(shrinks.into_iter().filter(|s| s.1 > 0).map(|(name, by)| {
        let share = by as f64 / total as f64;
        Part { name: format!("manifest {name}"), bits: 8.0 * share * (len as f64 - frame) }
    }));
    let named: f64 = parts.iter().map(|p| p.bits).sum();
    if total == 0 {
        parts.push(Part { name: "manifest body".into(), bits: 8.0 * len as f64 - named });
    }
    Ok(parts)
}

/// Everything a receiver decoded, on the host's heap.
#[derive(Clone, Debug)]
pub struct Received<'s> {
    manifest: Manifest<'s>,
    memory: HostMemory,
    counters: Counters,
}

impl Received<'_> {
    /// What was decoded, in the state that arrived.
    pub fn content(&self) -> Content<'_> {
        self.memory.content(&self.manifest)
    }

    /// What happened to the packets.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }
}
