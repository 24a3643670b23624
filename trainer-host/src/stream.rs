//! An encoded scene: the manifest, the packets, and what a host needs to take them apart again.

mod map;
mod player;

pub use dgs_player::Damage;
pub use map::{Mark, PacketMap};
pub use player::Player;

use std::ops::Deref;

use codec_core::{error, wire::manifest};
use dgs_player::sealed;

use crate::encode::{Ledger, Part, Quality, Reached, Searched};

/// A stream, and how it was made.
#[derive(Clone, Debug)]
pub struct Stream {
    bytes: dgs_player::Stream,
    order: Vec<Vec<u32>>,
    ledger: Ledger,
}

impl Deref for Stream {
    type Target = dgs_player::Stream;

    fn deref(&self) -> &dgs_player::Stream {
        &self.bytes
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
        let bytes = dgs_player::Stream::seal(raw, packets)?;
        let message_len = bytes.message().len();
        ledger.manifest = message_len as f64;
        ledger.manifest_parts = manifest_parts(bytes.manifest()?.raw(), sections, message_len)?;
        Ok(Self { bytes, order, ledger })
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

    /// Where every byte went. A stream read from a file knows sizes only.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Per epoch, the source index of each decoded Gaussian; empty for a stream read from a file.
    pub fn order(&self) -> &[Vec<u32>] {
        &self.order
    }

    /// Reads a `.dgs` file and keeps what is readable.
    ///
    /// # Errors
    /// As [`dgs_player::Stream::from_bytes`].
    pub fn from_bytes(file: &[u8]) -> error::Result<(Self, Damage)> {
        let (bytes, damage) = dgs_player::Stream::from_bytes(file)?;
        let manifest = bytes.manifest()?;
        let ledger = Ledger {
            gaussians: manifest.epochs().map(|e| u64::from(e.gaussians)).sum(),
            frames: u64::from(manifest.head().frames),
            payload: bytes.packets().iter().map(Vec::len).sum::<usize>() as f64,
            manifest: bytes.message().len() as f64,
            packets: bytes.packets().iter().filter(|p| !p.is_empty()).count() as u64,
            ..Ledger::default()
        };
        Ok((Self { bytes, order: Vec::new(), ledger }, damage))
    }
}

/// Name and first byte of a section of a manifest body.
pub(crate) type Section = (&'static str, usize);

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
