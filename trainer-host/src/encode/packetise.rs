//! Cuts the cells of a slice batch into packets of `dgs1`: blocks until a packet is full, then the next one.

use std::ops::Range;

use codec_core::{
    ErrorKind,
    internals::{
        ids::{Level, PacketId, Span},
        layout::Shape,
        limits::{MAX_PACKET_BLOCKS, MAX_PACKET_VALUES},
        rans::lanes,
        wire::{
            bits::BitWriter,
            packet::{Extent, Slices},
        },
    },
};

use super::{EncodeError, statistics::Model};

/// The symbols of one cell, level by level, in storage order.
#[derive(Clone, Debug)]
pub(super) struct CellSymbols {
    pub shape: Shape,
    pub levels: [Vec<i16>; Level::COUNT],
    /// Per level, which table of its stream's set each symbol run takes; empty until that is decided.
    pub table_indices: [Vec<u8>; Level::COUNT],
}

/// All clusters' data of one level in one span: what is packed together.
pub(super) struct SliceBatch<'c> {
    pub span: Span,
    pub level: Level,
    pub cells: &'c [CellSymbols],
}

/// A packet that still lacks its id.
#[derive(Clone, Debug)]
pub(super) struct PacketDraft {
    extent: Extent,
    body: Vec<u8>,
}

/// What cannot be divided: one block, or a whole cell for tracks.
#[derive(Clone)]
struct Item {
    cluster: usize,
    blocks: Range<usize>,
    /// First block, counted over the span.
    first: u32,
    /// Choice of table per run, in order.
    choices: Vec<u8>,
    bits: f64,
}

/// Bytes of a packet besides extent and entropy-coded values: id ≤ 3, CRC 4, and what the body takes
/// beyond its values' bits.
const FIXED_BYTES: usize = 14;

/// Packs a batch into packets of at most `limit` bytes.
///
/// # Errors
/// A block that does not fit one packet.
pub(super) fn packetise(
    batch: &SliceBatch<'_>,
    model: &Model,
    limit: usize,
) -> Result<Vec<PacketDraft>, EncodeError> {
    let items = items(batch, model);
    let symbols: Vec<lanes::Symbols> = model.tables.iter().map(lanes::Symbols::new).collect();
    let mut packets = Vec::new();
    let mut at = 0;
    while at < items.len() {
        let mut take = fill(batch, &items[at..], limit);
        let draft = loop {
            match draft(batch, &items[at..at + take], model, &symbols, limit) {
                Ok(draft) if draft.wire_len() <= limit => break draft,
                Err(EncodeError::Format(e)) if e.kind != ErrorKind::Capacity => return Err(e.into()),
                Ok(_) | Err(EncodeError::Format(_)) if take > 1 => take -= 1,
                Ok(_) | Err(EncodeError::Format(_)) => {
                    let Item { cluster, blocks, .. } = &items[at];
                    let gaussians = batch.cells[*cluster].shape.block_gaussians(blocks.start);
                    let (level, cluster) = (batch.level.get(), *cluster);
                    return Err(EncodeError::BlockTooLarge { level, cluster, gaussians, limit });
                }
                Err(error) => return Err(error),
            }
        };
        packets.push(draft);
        at += take;
    }
    Ok(packets)
}

fn items(batch: &SliceBatch<'_>, model: &Model) -> Vec<Item> {
    let mut items = Vec::new();
    let mut first = 0;
    for (cluster, cell) in batch.cells.iter().enumerate() {
        let (shape, start) = (&cell.shape, first);
        first += shape.blocks() as u32;
        if shape.level_len(batch.level) == 0 {
            continue;
        }
        let whole = shape.is_whole(batch.level);
        let mut table_indices = cell.table_indices[batch.level.index()].iter().copied();
        for block in 0..if whole { 1 } else { shape.blocks() } {
            let blocks = if whole { 0..shape.blocks() } else { block..block + 1 };
            let (mut choices, mut bits) = (Vec::new(), 0.0);
            each_run(cell, batch.level, blocks.clone(), |stream, run| {
                let choice = table_indices.next().unwrap_or_default();
                choices.push(choice);
                bits += model.bits(stream, choice.into(), run);
            });
            items.push(Item { cluster, blocks, first: start + block as u32, choices, bits });
        }
    }
    items
}

/// Calls `visit` with stream and symbols of each run of `blocks` of a cell at `level`.
pub(super) fn each_run<'c>(
    cell: &'c CellSymbols,
    level: Level,
    blocks: Range<usize>,
    mut visit: impl FnMut(usize, &'c [i16]),
) {
    let mut rest = symbols(cell, level, blocks.clone());
    let run = |stream: usize, n: usize| -> Result<(), std::convert::Infallible> {
        let (run, tail) = rest.split_at(n);
        rest = tail;
        visit(stream, run);
        Ok(())
    };
    let Ok(()) = cell.shape.runs(level, blocks, run);
}

/// The symbols of `blocks` of a cell at `level`.
fn symbols(cell: &CellSymbols, level: Level, blocks: Range<usize>) -> &[i16] {
    let (level_start, _) = cell.shape.range(level, 0..0);
    let (start, len) = cell.shape.range(level, blocks);
    let from = if cell.shape.is_whole(level) { 0 } else { start - level_start };
    &cell.levels[level.index()][from..from + len]
}

/// How many of `items` are expected to fit.
fn fill(batch: &SliceBatch<'_>, items: &[Item], limit: usize) -> usize {
    let (mut bits, mut values) = (0.0, 0);
    for (n, item) in items.iter().enumerate() {
        bits += item.bits;
        values += batch.cells[item.cluster].shape.range(batch.level, item.blocks.clone()).1;
        let extent = extent(batch, &items[..=n]);
        let is_long = FIXED_BYTES + extent.header_len() + (bits / 8.0).ceil() as usize > limit;
        let is_large = values > MAX_PACKET_VALUES as usize || extent.blocks > MAX_PACKET_BLOCKS;
        if n > 0 && (is_long || is_large) {
            return n;
        }
    }
    items.len()
}

/// The blocks of `items`, which follow each other in `batch`.
fn extent(batch: &SliceBatch<'_>, items: &[Item]) -> Extent {
    let (first, last) = match items {
        [first, .., last] => (first, last),
        [only] => (only, only),
        [] => return Extent { span: batch.span, level: batch.level, first: 0, blocks: 0 },
    };
    let blocks = last.first + last.blocks.len() as u32 - first.first;
    Extent { span: batch.span, level: batch.level, first: first.first, blocks }
}

fn draft(
    batch: &SliceBatch<'_>,
    items: &[Item],
    model: &Model,
    symbols: &[lanes::Symbols],
    limit: usize,
) -> Result<PacketDraft, EncodeError> {
    let (mut values, mut runs) = (Vec::new(), Vec::<lanes::TableRun>::new());
    let mut body = vec![0u8; 2 * limit + 64];
    let mut code_words = BitWriter::new(&mut body);
    let mut full = Ok(());
    for item in items {
        let cell = &batch.cells[item.cluster];
        let mut choices = item.choices.iter();
        each_run(cell, batch.level, item.blocks.clone(), |stream, run| {
            let choice = choices.next().copied().unwrap_or_default();
            let (table, code, length) = model.code(stream, choice.into());
            let written = code_words.code(code, length);
            full = full.and(written);
            values.extend_from_slice(run);
            match runs.last_mut() {
                Some(last) if last.table == table => last.len += run.len(),
                _ => runs.push(lanes::TableRun { table, len: run.len() }),
            }
        });
    }
    full?;
    let code_words = code_words.finish();
    let encoded = lanes::encode(&values, &runs, symbols, &mut body[code_words..])?;
    body.truncate(code_words + encoded.len);
    Ok(PacketDraft { extent: extent(batch, items), body })
}

impl PacketDraft {
    fn packet(&self, id: PacketId) -> Slices<'_> {
        let extents = std::iter::once(self.extent).collect();
        Slices { id, extents, body: &self.body }
    }

    /// Bytes of the whole packet with the longest id.
    pub fn wire_len(&self) -> usize {
        self.packet(PacketId::new(PacketId::MAX).unwrap_or_default()).wire_len()
    }

    /// Bytes of the body: code words and entropy-coded values.
    pub fn body_len(&self) -> usize {
        self.body.len()
    }

    /// The bytes of packet `id`.
    pub fn write(&self, id: PacketId) -> Result<Vec<u8>, EncodeError> {
        let mut out = vec![0u8; self.wire_len()];
        let len = self.packet(id).write(&mut out)?;
        out.truncate(len);
        Ok(out)
    }
}

/// The packet with number `id`.
///
/// # Errors
/// More packets than the format numbers.
pub(super) fn packet_id(id: usize) -> Result<PacketId, EncodeError> {
    let most = PacketId::MAX as usize;
    u32::try_from(id).ok().and_then(PacketId::new).ok_or(EncodeError::Bound {
        what: "packets",
        found: id,
        most,
    })
}
