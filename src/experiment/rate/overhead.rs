//! What a real `dgs1` stream spends on anything but its symbols: the coder's gap to the entropy of its own
//! models, lane states, headers, CRC, manifest, proxy, each as a share of the wire.

use anyhow::Result;
use codec_core::rans::lanes::STATES_BYTES;
use trainer_host::{Scene, encode::Ledger};

use super::dgs;
use crate::{
    args::ProfileName,
    figures::{Bench, Figure},
};

/// Bytes of one stream by purpose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overhead {
    /// All bytes.
    pub wire: f64,
    /// What the symbols take by the models used: −log2 of each one's probability, escapes and raw bits.
    pub models: f64,
    /// Payload above that: flushed states, words' granularity.
    pub gap: f64,
    /// Lane states as stored; they hold symbols too, and what they do not hold is in `gap`.
    pub states: f64,
    /// Packet and slice headers.
    pub headers: f64,
    /// CRCs.
    pub crc: f64,
    /// Manifest, without the proxy.
    pub manifest: f64,
    /// Proxy.
    pub proxy: f64,
}

impl Overhead {
    /// Of a stream with this ledger.
    pub fn of(ledger: &Ledger) -> Self {
        let models = ledger.shares.iter().map(|s| s.bits).sum::<f64>() / 8.0;
        // A ledger without proxies has no such field.
        let field = serde_json::to_value(ledger).ok().and_then(|v| v.get("proxy").and_then(|p| p.as_f64()));
        Self {
            wire: ledger.wire() - ledger.parity,
            models,
            gap: ledger.payload - models,
            states: (STATES_BYTES as u64 * ledger.packets) as f64,
            headers: ledger.headers + ledger.dependencies,
            crc: ledger.crc,
            manifest: ledger.manifest,
            proxy: field.unwrap_or(0.0),
        }
    }

    /// Gap, headers, CRC, manifest and proxy as a share of the wire.
    pub fn share(&self) -> f64 {
        (self.gap + self.headers + self.crc + self.manifest + self.proxy) / self.wire.max(1.0)
    }
}

/// Measures `scene` at the default quality.
///
/// # Errors
/// If it cannot be encoded.
pub fn measure(bench: &mut Bench, key: &str, scene: &Scene) -> Result<Overhead> {
    let stream = dgs::stream(scene, ProfileName::Dgs1, 1.0)?;
    let ledger = stream.ledger();
    let o = Overhead::of(ledger);
    let mut push = |what: &str, bytes: f64| {
        let percent = 100.0 * bytes / o.wire.max(1.0);
        bench.push(Figure::new(format!("{key}.overhead.{what}"), percent, "% of the wire"));
    };
    push("coder_gap", o.gap);
    push("lane_states_gross", o.states);
    push("headers", o.headers);
    push("crc", o.crc);
    push("manifest", o.manifest);
    push("proxy", o.proxy);
    push("sum", o.share() * o.wire);
    let gap = 100.0 * o.gap / o.models.max(1.0);
    bench.push(Figure::new(format!("{key}.coder_gap_over_models"), gap, "%"));
    let tables = 100.0 * (o.models / ledger.empirical_entropy.max(1.0) - 1.0);
    bench.push(Figure::new(format!("{key}.models_over_empirical_entropy"), tables, "%"));
    bench.push(Figure::new(format!("{key}.manifest_bytes"), o.manifest, "byte"));
    Ok(o)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_to_the_wire() {
        let scene = crate::experiment::synth("figure", 1000, 6).unwrap();
        let stream = dgs::stream(&scene, ProfileName::Dgs1, 1.0).unwrap();
        let o = Overhead::of(stream.ledger());
        let sum = o.models + o.gap + o.headers + o.crc + o.manifest;
        assert!((sum - o.wire).abs() < 1.0, "{sum} of {}", o.wire);
        let stored: usize = stream.packets().iter().map(Vec::len).sum::<usize>();
        assert!((stored as f64 + o.manifest - o.wire).abs() < 1.0);
        assert!(o.gap > 0.0 && o.share() > 0.0 && o.share() < 1.0);
    }
}
