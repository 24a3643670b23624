//! Entropy-codes completion groups into chunks that each fit a packet.

use codec_core::internals::{
    ids::{Level, PacketId},
    limits,
    rans::bytes::{self, ByteTable},
    wire::{
        manifest::Quant,
        packet::{Chunk, PARITY_OVERHEAD_BYTES},
    },
};

use super::plan::{Cell, EpochPlan, quant_index};
use crate::encode::{EncodeError, Protection};

/// One completion group, entropy-coded.
pub(super) struct Group {
    pub tables: [ByteTable; 2],
    pub chunks: Vec<OwnedChunk>,
    pub symbols: usize,
    pub entropy_bytes: f64,
    pub monolithic: usize,
}

/// A chunk before it has an id.
pub(super) struct OwnedChunk {
    level: Level,
    quant: u8,
    cluster: u16,
    first_frame: u16,
    frames: u16,
    first_symbol: u32,
    symbols: u16,
    pub payload: Vec<u8>,
}

impl OwnedChunk {
    pub fn packet(&self, id: PacketId) -> Chunk<'_> {
        let group = u32::from(self.cluster) * 4 + u32::from(self.level.get());
        Chunk {
            level: self.level,
            id,
            cluster: self.cluster,
            first_frame: self.first_frame,
            frames: self.frames,
            quant: self.quant,
            first_symbol: self.first_symbol,
            symbols: self.symbols,
            dependencies: (self.level > Level::BASE).then(|| group - 1).into_iter().collect(),
            payload: &self.payload,
        }
    }
}

/// Codes the four groups of `cell`, cluster `cluster` of the stream, each with a table pair of its own.
pub(super) fn groups(
    cluster: usize,
    plan: &EpochPlan,
    cell: &Cell,
    quants: &[Quant],
    repair: &Protection,
) -> Result<[Group; Level::COUNT], EncodeError> {
    let mut groups = Vec::with_capacity(Level::COUNT);
    for level in Level::ALL {
        let symbols = cell.levels[level.index()].as_slice();
        let mut counts = [[0u64; 256]; 2];
        for symbol in symbols {
            let [low, high] = symbol.to_le_bytes();
            counts[0][usize::from(low)] += 1;
            counts[1][usize::from(high)] += 1;
        }
        let entropy = |counts: &[u64; 256]| -> f64 {
            let total = symbols.len() as f64;
            counts.iter().filter(|&&c| c > 0).map(|&c| c as f64 * (total / c as f64).log2()).sum()
        };
        let entropy_bytes = (entropy(&counts[0]) + entropy(&counts[1])) / 8.0;
        let tables = counts.map(|c| ByteTable::from_counts(&c));
        let pair = [&tables[0], &tables[1]];
        let costs = tables.map(|t| costs(&t));
        let limit = match repair.of(false, level) {
            Some(_) => limits::MAX_PAYLOAD_BYTES - 32 - PARITY_OVERHEAD_BYTES,
            None => limits::MAX_PAYLOAD_BYTES,
        };
        let mut scratch = vec![0u8; 4 * limit];
        let mut chunks = Vec::new();
        let mut at = 0;
        while at < symbols.len() {
            let mut take = expected(&symbols[at..], &costs, limit);
            let payload = loop {
                let room = scratch.len();
                match bytes::encode(&symbols[at..at + take], pair, &mut scratch) {
                    Ok(start) if room - start <= limit => break scratch[start..].to_vec(),
                    // A few symbols less: the estimate is within a few bytes of the truth.
                    _ if take > 1 => take -= (take / 256).max(1),
                    Ok(_) => {
                        return Err(EncodeError::Bound {
                            what: "bytes per symbol",
                            found: limit + 1,
                            most: limit,
                        });
                    }
                    Err(error) => return Err(error.into()),
                }
            };
            chunks.push(OwnedChunk {
                level,
                quant: quant_index(quants, plan),
                cluster: cluster as u16,
                first_frame: plan.first_frame as u16,
                frames: plan.frames as u16,
                first_symbol: at as u32,
                symbols: take as u16,
                payload,
            });
            at += take;
        }
        let mut whole = vec![0u8; symbols.len() * 4 + 16];
        let monolithic = match symbols.is_empty() {
            true => 0,
            false => whole.len() - bytes::encode(symbols, pair, &mut whole)?,
        };
        groups.push(Group { tables, chunks, symbols: symbols.len(), entropy_bytes, monolithic });
    }
    groups.try_into().map_err(|_| EncodeError::Bound { what: "levels", found: 0, most: 4 })
}

fn costs(table: &ByteTable) -> [f32; 256] {
    std::array::from_fn(|b| match table.frequency(b as u8) {
        0 => 0.0,
        f => (bytes::SCALE as f32 / f as f32).log2(),
    })
}

/// How many symbols are expected to fit `limit` bytes.
fn expected(symbols: &[i16], costs: &[[f32; 256]; 2], limit: usize) -> usize {
    let budget = 8.0 * (limit - bytes::STATE_BYTES) as f64 + 4.0;
    let mut bits = 0.0f64;
    for (n, symbol) in symbols.iter().enumerate().take(usize::from(u16::MAX)) {
        let [low, high] = symbol.to_le_bytes();
        bits += f64::from(costs[0][usize::from(low)] + costs[1][usize::from(high)]);
        if bits > budget {
            return n.max(1);
        }
    }
    symbols.len().min(usize::from(u16::MAX))
}
