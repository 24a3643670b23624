//! Accounts for every byte: the paper's accounting table, for any stream.

use codec_core::internals::{error, wire::manifest};
use dgs_player::sealed;

/// The byte cost of each part of a stream. All in bytes unless named otherwise.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct Ledger {
    /// Gaussians over all epochs.
    pub gaussians: u64,
    /// Those of them that are not sent because they are never drawn.
    pub invisible: u64,
    /// Frames.
    pub frames: u64,
    /// Symbols coded.
    pub symbols: u64,
    /// Symbols at two bytes each.
    pub raw_symbols: f64,
    /// Order-0 entropy of the symbols under the model's contexts, tables free.
    pub empirical_entropy: f64,
    /// The same symbols as one entropy-coded stream per context set, without packets.
    pub monolithic: f64,
    /// Entropy-coded bodies as packetised.
    pub payload: f64,
    /// Packet and slice headers.
    pub headers: f64,
    /// Explicit dependency words.
    pub dependencies: f64,
    /// CRCs of media packets.
    pub crc: f64,
    /// Parity packets, whole.
    pub parity: f64,
    /// The DGSM message.
    pub manifest: f64,
    /// Media packets.
    pub packets: u64,
    /// Parity packets.
    pub parity_packets: u64,
    /// Values that did not fit their symbol and were clamped.
    pub saturated: u64,
    /// Of the payload, code words that select tables.
    pub table_indices: f64,
    /// Of the payload, what stands in front of the coder's lanes: how many values the states keep and
    /// how long the states are.
    pub lane_heads: f64,
    /// The manifest section by section.
    pub manifest_parts: Vec<LedgerPart>,
    /// Payload by attribute and level as its tables price it: raw bits and escapes included, code
    /// words not.
    pub shares: Vec<Share>,
}

/// Payload that one attribute takes at one level.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Share {
    /// Attribute, for example `position` or `track`.
    pub attribute: &'static str,
    /// Level.
    pub level: u8,
    /// Bits.
    pub bits: f64,
}

/// A part of what is on the wire.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LedgerPart {
    /// What it is.
    pub name: String,
    /// Bits.
    pub bits: f64,
}

impl Ledger {
    /// Bits by which the payload exceeds what its own tables price it at, code words and lane heads
    /// apart: rounding to bytes, probabilities as the coder rounds them, less what the final states
    /// hold. 0 where shares are not known.
    pub fn coder_gap(&self) -> f64 {
        if self.shares.is_empty() {
            return 0.0;
        }
        let priced: f64 = self.shares.iter().map(|s| s.bits).sum();
        8.0 * (self.payload - self.table_indices - self.lane_heads) - priced
    }

    /// All parts, which together are [`Ledger::wire`], with nothing twice.
    pub fn parts(&self) -> Vec<LedgerPart> {
        let part = |name: &str, bytes: f64| LedgerPart { name: name.into(), bits: 8.0 * bytes };
        let mut parts = Vec::new();
        if self.shares.is_empty() {
            parts.push(part("payload", self.payload));
        } else {
            let name = |s: &Share| format!("{} level {}", s.attribute, s.level);
            parts.extend(self.shares.iter().map(|s| LedgerPart { name: name(s), bits: s.bits }));
            parts.push(part("table indices", self.table_indices));
            parts.push(part("lane heads", self.lane_heads));
            parts.push(LedgerPart { name: "coder gap".into(), bits: self.coder_gap() });
        }
        parts.push(part("headers", self.headers));
        parts.push(part("dependencies", self.dependencies));
        parts.push(part("CRC", self.crc));
        parts.push(part("repair", self.parity));
        match &self.manifest_parts[..] {
            [] => parts.push(part("manifest", self.manifest)),
            sections => parts.extend_from_slice(sections),
        }
        parts.retain(|p| p.bits != 0.0);
        parts
    }

    /// Bytes of all packets and the manifest.
    pub fn wire(&self) -> f64 {
        self.payload + self.headers + self.dependencies + self.crc + self.parity + self.manifest
    }

    /// Headers, dependencies and CRCs as a share of the media packets (paper table 3, last rows).
    pub fn packetisation_overhead(&self) -> f64 {
        let overhead = self.headers + self.dependencies + self.crc;
        overhead / (self.payload + overhead).max(1.0)
    }

    /// Wire plus manifest over the monolithic stream, less one.
    pub fn robustness_premium(&self) -> f64 {
        self.wire() / self.monolithic.max(1.0) - 1.0
    }

    /// Bits on the wire per Gaussian of the scene, manifest included.
    pub fn bits_per_gaussian(&self) -> f64 {
        8.0 * self.wire() / (self.gaussians.max(1)) as f64
    }

    /// Bytes on the wire per frame.
    pub fn bytes_per_frame(&self) -> f64 {
        self.wire() / (self.frames.max(1)) as f64
    }
}

/// Name and first byte of a section of a manifest body.
pub(super) type Section = (&'static str, usize);

/// What each section takes of a manifest of `len` bytes: header and CRC apart, the packed body is
/// shared out in proportion to what the message shrinks by when it is packed without the section.
pub(super) fn manifest_parts(raw: &[u8], sections: &[Section], len: usize) -> error::Result<Vec<LedgerPart>> {
    let mut shrinks = Vec::new();
    for (i, &(name, start)) in sections.iter().enumerate() {
        let end = sections.get(i + 1).map_or(raw.len(), |next| next.1);
        let without = [&raw[..start], &raw[end..]].concat();
        let shrinks_by = if start == end { 0 } else { len.saturating_sub(sealed(&without)?.len()) };
        shrinks.push((name, shrinks_by));
    }
    let total: usize = shrinks.iter().map(|s| s.1).sum();
    let frame = (manifest::HEADER_BYTES + 4) as f64;
    let mut parts = vec![LedgerPart { name: "manifest header and CRC".into(), bits: 8.0 * frame }];
    parts.extend(shrinks.into_iter().filter(|s| s.1 > 0).map(|(name, by)| {
        let share = by as f64 / total as f64;
        LedgerPart { name: format!("manifest {name}"), bits: 8.0 * share * (len as f64 - frame) }
    }));
    let named: f64 = parts.iter().map(|p| p.bits).sum();
    if total == 0 {
        parts.push(LedgerPart { name: "manifest body".into(), bits: 8.0 * len as f64 - named });
    }
    Ok(parts)
}

#[cfg(test)]
mod tests {
    use crate::{
        encode::{EncodeOptions, Protection, encode},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    #[test]
    fn the_parts_are_the_whole() {
        for kind in [SynthKind::Figure, SynthKind::Balls] {
            let options = synth::SynthOptions { gaussians: 1500, frames: 40, kind, ..Default::default() };
            let scene = synth::make(&options, &Limits::default()).unwrap();
            let repaired = EncodeOptions { repair: Protection::xor(4), ..EncodeOptions::default() };
            for options in [repaired, EncodeOptions::default(), EncodeOptions::paper()] {
                let encoded = encode(&scene, &options, &crate::encode::no_progress).unwrap();
                let (sent, ledger) = (encoded.stream.wire_bytes(), &encoded.report.ledger);
                assert_eq!(ledger.wire(), sent as f64);
                let parts = ledger.parts();
                let sum: f64 = parts.iter().map(|p| p.bits).sum();
                assert!((sum - 8.0 * sent as f64).abs() < 1e-6, "{sum} of {}", 8 * sent);
                let manifest: f64 =
                    parts.iter().filter(|p| p.name.starts_with("manifest")).map(|p| p.bits).sum();
                assert!((manifest - 8.0 * ledger.manifest).abs() < 1e-6);
                // What is left over after pricing is small: the prices are the coder's.
                let gap = ledger.coder_gap();
                assert!(gap > -128.0 * ledger.packets as f64, "{gap}");
                assert!(gap < 0.01 * 8.0 * ledger.payload + 16.0 * ledger.packets as f64, "{gap}");
                let mut names: Vec<&str> = parts.iter().map(|p| p.name.as_str()).collect();
                names.sort_unstable();
                names.dedup();
                assert_eq!(names.len(), parts.len());
            }
        }
    }
}
