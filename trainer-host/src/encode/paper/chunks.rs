//! Entropy-codes completion groups into chunks that each fit a packet.

use std::num::NonZero;

use codec_core::internals::{
    ids::{Level, PacketId},
    layout::paper as layout,
    limits,
    rans::{
        bytes::{self, ByteTable},
        context::{self, Decision, Place},
    },
    wire::{
        manifest::Quant,
        packet::{Chunk, PARITY_OVERHEAD_BYTES},
    },
};

use super::plan::{Cell, EpochPlan, quant_index};
use crate::encode::{EncodeError, decisions::PaperDecisions};

/// One completion group, entropy-coded.
pub(super) struct Group {
    /// For low bytes and high bytes; the context coder has none.
    pub tables: Option<[ByteTable; 2]>,
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

/// How the symbols of a group are coded.
enum Coder {
    /// By a table for low bytes and one for high bytes; what each byte costs, bits.
    Tables(Box<[ByteTable; 2]>, Box<[[f32; 256]; 2]>),
    /// By probabilities that follow the symbols of a chunk; where the group's first symbol lies.
    Context(Place),
}

/// Codes the four groups of `cell`, cluster `cluster` of the stream: each with a table pair of its own, or
/// with the context coder.
pub(super) fn groups(
    cluster: usize,
    plan: &EpochPlan,
    cell: &Cell,
    quants: &[Quant],
    decisions: &PaperDecisions,
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
        let coder = if decisions.context_coder {
            let gaussians = NonZero::new(cell.levels[0].len() / layout::BASE);
            let none = EncodeError::Bound { what: "clusters without Gaussians", found: 1, most: 0 };
            let gaussians = gaussians.ok_or(none)?;
            Coder::Context(Place { level, first: 0, gaussians, rank: plan.rank, frames: plan.frames })
        } else {
            let [low, high] = &counts;
            let tables = [ByteTable::from_counts(low)?, ByteTable::from_counts(high)?];
            Coder::Tables(Box::new(tables), Box::new(tables.map(|t| costs(&t))))
        };
        let limit = match decisions.repair.of(false, level) {
            Some(_) => limits::MAX_PAYLOAD_BYTES - 32 - PARITY_OVERHEAD_BYTES,
            None => limits::MAX_PAYLOAD_BYTES,
        };
        let mut chunks = Vec::new();
        let mut at = 0;
        while at < symbols.len() {
            let (take, payload) = coder.chunk(symbols, at, limit)?;
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
        let monolithic = coder.monolithic(symbols)?;
        groups.push(Group {
            tables: coder.tables(),
            chunks,
            symbols: symbols.len(),
            entropy_bytes,
            monolithic,
        });
    }
    groups.try_into().map_err(|_| EncodeError::Bound { what: "levels", found: 0, most: 4 })
}

impl Coder {
    fn tables(&self) -> Option<[ByteTable; 2]> {
        match self {
            Self::Tables(tables, _) => Some(**tables),
            Self::Context(_) => None,
        }
    }

    /// As many symbols from `at` on as fit `limit` bytes: how many, and the payload.
    fn chunk(&self, symbols: &[i16], at: usize, limit: usize) -> Result<(usize, Vec<u8>), EncodeError> {
        let mut scratch = vec![0u8; 4 * limit];
        let room = scratch.len();
        let rest = &symbols[at..];
        let (mut take, decisions) = match self {
            Self::Tables(_, costs) => (expected(rest, costs, limit), Vec::new()),
            Self::Context(place) => expected_decisions(rest, Place { first: at, ..*place }, limit)?,
        };
        loop {
            let start = match self {
                Self::Tables(tables, _) => bytes::encode(&rest[..take], tables.each_ref(), &mut scratch),
                Self::Context(_) => {
                    let end = decisions.partition_point(|&(symbol, _)| symbol < take);
                    context::encode(decisions[..end].iter().map(|&(_, decision)| decision), &mut scratch)
                }
            };
            match start {
                Ok(start) if room - start <= limit => return Ok((take, scratch.split_off(start))),
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
        }
    }

    /// Bytes of the whole group in one piece.
    fn monolithic(&self, symbols: &[i16]) -> Result<usize, EncodeError> {
        if symbols.is_empty() {
            return Ok(0);
        }
        let mut whole = vec![0u8; symbols.len() * 5 + 16];
        let start = match self {
            Self::Tables(tables, _) => bytes::encode(symbols, tables.each_ref(), &mut whole)?,
            Self::Context(place) => {
                let mut all = Vec::new();
                context::decisions(&mut symbols.to_vec(), *place, |_, decision| {
                    all.push(decision);
                    true
                })?;
                context::encode(all.into_iter(), &mut whole)?
            }
        };
        Ok(whole.len() - start)
    }
}

/// How many symbols are expected to fit `limit` bytes, and the decisions that code them with the symbol of
/// each.
fn expected_decisions(
    symbols: &[i16],
    place: Place,
    limit: usize,
) -> codec_core::Result<(usize, Vec<(usize, Decision)>)> {
    let most = symbols.len().min(usize::from(u16::MAX));
    let budget = budget_bits(limit);
    let mut values = symbols[..most].to_vec();
    let (mut bits, mut take, mut decisions) = (0.0f64, most, Vec::new());
    context::decisions(&mut values, place, |symbol, decision| {
        bits += decision.bits();
        decisions.push((symbol, decision));
        if bits > budget {
            take = symbol.max(1);
        }
        // A first symbol that is over the budget is coded to its end.
        bits <= budget || symbol == 0
    })?;
    Ok((take, decisions))
}

/// Bits of symbols that a payload of `limit` bytes holds beside its state.
fn budget_bits(limit: usize) -> f64 {
    8.0 * (limit - bytes::STATE_BYTES) as f64 + 4.0
}

fn costs(table: &ByteTable) -> [f32; 256] {
    std::array::from_fn(|b| match table.frequency(b as u8) {
        0 => 0.0,
        f => (bytes::SCALE as f32 / f as f32).log2(),
    })
}

/// How many symbols are expected to fit `limit` bytes.
fn expected(symbols: &[i16], costs: &[[f32; 256]; 2], limit: usize) -> usize {
    let budget = budget_bits(limit);
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
