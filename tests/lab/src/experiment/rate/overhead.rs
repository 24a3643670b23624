//! Measures what a `dgs1` stream spends on anything but its symbols: the coder's gap to the entropy of its
//! own models, lane heads, headers, CRC, manifest, proxies, each as a share of the wire.

use anyhow::Result;
use dgs::args::ProfileName;
use trainer_host::{Scene, encode::Ledger};

use super::dgs1;
use crate::figures::{Bench, Figure};

/// Bytes of one stream by purpose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overhead {
    /// All bytes.
    pub wire: f64,
    /// What the symbols take by the models used: −log2 of each one's probability, escapes, raw bits and
    /// the code words that select tables.
    pub models: f64,
    /// Of these, the code words.
    pub table_indices: f64,
    /// Payload above that: rounding, what the lanes' states do not hold.
    pub gap: f64,
    /// What stands in front of the lanes.
    pub lane_heads: f64,
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
        let priced = ledger.shares.iter().map(|s| s.bits).sum::<f64>() / 8.0;
        let proxies = ledger.manifest_parts.iter().filter(|p| p.name.contains("prox"));
        let proxy = proxies.map(|p| p.bits).sum::<f64>() / 8.0;
        Self {
            wire: ledger.wire() - ledger.parity,
            models: priced + ledger.table_indices,
            table_indices: ledger.table_indices,
            gap: ledger.coder_gap() / 8.0,
            lane_heads: ledger.lane_heads,
            headers: ledger.headers + ledger.dependencies,
            crc: ledger.crc,
            manifest: ledger.manifest - proxy,
            proxy,
        }
    }

    /// Gap, lane heads, headers, CRC, manifest and proxies as a share of the wire.
    pub fn share(&self) -> f64 {
        let parts = [self.gap, self.lane_heads, self.headers, self.crc, self.manifest, self.proxy];
        parts.iter().sum::<f64>() / self.wire.max(1.0)
    }
}

/// Measures `scene` at the default quality.
///
/// # Errors
/// If it cannot be encoded.
pub fn measure(bench: &mut Bench, key: &str, scene: &Scene) -> Result<Overhead> {
    let stream = dgs1::stream(scene, ProfileName::Dgs1, 1.0)?;
    let ledger = &stream.report.ledger;
    let o = Overhead::of(ledger);
    let mut push = |what: &str, bytes: f64| {
        let percent = 100.0 * bytes / o.wire.max(1.0);
        bench.push(Figure::new(format!("{key}.overhead.{what}"), percent, "% of the wire"));
    };
    push("coder_gap", o.gap);
    push("lane_heads", o.lane_heads);
    push("selectors", o.table_indices);
    push("headers", o.headers);
    push("crc", o.crc);
    push("manifest", o.manifest);
    push("proxy", o.proxy);
    push("sum", o.share() * o.wire);
    let gap = 100.0 * (o.gap + o.lane_heads) / o.models.max(1.0);
    bench.push(Figure::new(format!("{key}.coder_gap_over_models"), gap, "%"));
    let tables = 100.0 * (o.models / ledger.empirical_entropy.max(1.0) - 1.0);
    bench.push(Figure::new(format!("{key}.models_over_empirical_entropy"), tables, "%"));
    bench.push(Figure::new(format!("{key}.manifest_bytes"), o.manifest + o.proxy, "byte"));
    Ok(o)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_to_the_wire() {
        let scene = crate::setup::synth("figure", 1000, 6).unwrap();
        let stream = dgs1::stream(&scene, ProfileName::Dgs1, 1.0).unwrap();
        let o = Overhead::of(&stream.report.ledger);
        let sum = o.models + o.gap + o.lane_heads + o.headers + o.crc + o.manifest + o.proxy;
        assert!((sum - o.wire).abs() < 1.0, "{sum} of {}", o.wire);
        let stored: usize = stream.stream.packets().iter().map(Vec::len).sum::<usize>();
        assert!((stored as f64 + o.manifest + o.proxy - o.wire).abs() < 1.0);
        assert!(o.proxy > 0.0 && o.share() > 0.0 && o.share() < 1.0);
    }
}
