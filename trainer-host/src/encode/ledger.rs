//! Where every byte went: the paper's accounting table, for any stream.

use super::Reached;

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
    /// Estimated payload by stream: name, level, bits.
    pub shares: Vec<Share>,
    /// How the target was met, if there was one.
    pub reached: Option<Reached>,
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

impl Ledger {
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
