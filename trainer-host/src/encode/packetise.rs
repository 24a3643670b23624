//! Packets of `dgs1`: slices until the packet is full, then the next one.

use codec_core::{
    Error, ErrorKind,
    ids::{BlockId, ClusterId, Level, PacketId, Span},
    layout::Shape,
    limits,
    rans::lanes,
    wire::packet::{Slice, Slices},
};

use super::{EncodeError, statistics::Model};

/// The symbols of one cell, level by level, in storage order.
#[derive(Clone, Debug)]
pub(super) struct CellSymbols {
    pub shape: Shape,
    pub levels: [Vec<i16>; Level::COUNT],
}

/// All clusters' data of one level in one span: what is packed together.
pub(super) struct Lot<'c> {
    pub span: Span,
    pub level: Level,
    pub cells: &'c [CellSymbols],
}

/// A packet that still lacks its id.
#[derive(Clone, Debug)]
pub(super) struct Proto {
    slices: Vec<Slice>,
    body: Vec<u8>,
}

/// What cannot be divided: one block, or a whole cell for tracks.
#[derive(Clone, Copy)]
struct Item {
    cluster: usize,
    block: usize,
    whole: bool,
    bits: f64,
}

/// Fixed bytes of a packet: id 3, CRC 4, and what the body takes beyond its values' bits.
const FIXED_BYTES: usize = 14;

/// Packs a lot into packets of at most `limit` bytes.
pub(super) fn packetise(lot: &Lot<'_>, model: &Model, limit: usize) -> Result<Vec<Proto>, EncodeError> {
    let items = items(lot, model);
    let symbols: Vec<lanes::Symbols> = model.tables.iter().map(lanes::Symbols::new).collect();
    let mut packets = Vec::new();
    let mut at = 0;
    while at < items.len() {
        let mut take = fill(lot, &items[at..], limit);
        let proto = loop {
            match encode(lot, &items[at..at + take], model, &symbols, limit) {
                Ok(proto) if proto.wire_len() <= limit => break proto,
                Ok(_) if take > 1 => take -= 1,
                Err(EncodeError::Format(e)) if e.kind == ErrorKind::Capacity && take > 1 => take -= 1,
                Ok(proto) => {
                    let short = Error::short("body", 0, limit, proto.wire_len());
                    return Err(short.kind(ErrorKind::Capacity).into());
                }
                Err(error) => return Err(error),
            }
        };
        packets.push(proto);
        at += take;
    }
    Ok(packets)
}

fn items(lot: &Lot<'_>, model: &Model) -> Vec<Item> {
    let mut items = Vec::new();
    for (cluster, cell) in lot.cells.iter().enumerate() {
        let shape = &cell.shape;
        if shape.level_len(lot.level) == 0 {
            continue;
        }
        let whole = shape.is_whole(lot.level);
        for block in 0..if whole { 1 } else { shape.blocks() } {
            let blocks = if whole { 0..shape.blocks() } else { block..block + 1 };
            let mut rest = symbols(cell, lot.level, blocks.clone());
            let mut bits = 0.0;
            let run = |stream: usize, n: usize| -> Result<(), EncodeError> {
                let (run, tail) = rest.split_at(n);
                rest = tail;
                bits += model.bits(stream, run);
                Ok(())
            };
            // The closure above cannot fail.
            let _ = shape.runs(lot.level, blocks, run);
            items.push(Item { cluster, block, whole, bits });
        }
    }
    items
}

/// The symbols of `blocks` of a cell at `level`.
fn symbols(cell: &CellSymbols, level: Level, blocks: std::ops::Range<usize>) -> &[i16] {
    let (level_start, _) = cell.shape.range(level, 0..0);
    let (start, len) = cell.shape.range(level, blocks);
    let from = if cell.shape.is_whole(level) { 0 } else { start - level_start };
    &cell.levels[level.index()][from..from + len]
}

/// How many of `items` are expected to fit.
fn fill(lot: &Lot<'_>, items: &[Item], limit: usize) -> usize {
    let mut bits = 0.0;
    for (n, item) in items.iter().enumerate() {
        bits += item.bits;
        let slices = slices(lot, &items[..=n]);
        let headers: usize = slices.iter().map(Slice::header_len).sum();
        let bytes = FIXED_BYTES + headers + (bits / 8.0).ceil() as usize;
        if n > 0 && (bytes > limit || slices.len() > limits::MAX_SLICES) {
            return n;
        }
    }
    items.len()
}

/// Neighbouring blocks of one cell make one slice.
fn slices(lot: &Lot<'_>, items: &[Item]) -> Vec<Slice> {
    let mut slices: Vec<Slice> = Vec::new();
    let mut last: Option<Item> = None;
    for item in items {
        let all = lot.cells[item.cluster].shape.blocks();
        if let Some(before) = last
            && before.cluster == item.cluster
            && let Some(slice) = slices.last_mut()
            && let Some((first, count)) = slice.blocks
        {
            let count = count + 1;
            slice.blocks = (usize::from(count) < all).then_some((first, count));
        } else {
            let whole = item.whole || all == 1;
            slices.push(Slice {
                span: lot.span,
                cluster: ClusterId(item.cluster as u16),
                level: lot.level,
                blocks: (!whole).then_some((BlockId(item.block as u16), 1)),
            });
        }
        last = Some(*item);
    }
    slices
}

fn encode(
    lot: &Lot<'_>,
    items: &[Item],
    model: &Model,
    symbols: &[lanes::Symbols],
    limit: usize,
) -> Result<Proto, EncodeError> {
    let slices = slices(lot, items);
    let (mut values, mut runs) = (Vec::new(), Vec::<lanes::Run>::new());
    for item in items {
        let cell = &lot.cells[item.cluster];
        let blocks = if item.whole { 0..cell.shape.blocks() } else { item.block..item.block + 1 };
        values.extend_from_slice(self::symbols(cell, lot.level, blocks.clone()));
        let run = |stream: usize, n: usize| -> Result<(), EncodeError> {
            let table = model.table_of[stream];
            match runs.last_mut() {
                Some(last) if last.table == table => last.len += n,
                _ => runs.push(lanes::Run { table, len: n }),
            }
            Ok(())
        };
        cell.shape.runs(lot.level, blocks, run)?;
    }
    let mut body = vec![0u8; limit + 64];
    let encoded = lanes::encode(&values, &runs, symbols, &mut body)?;
    body.truncate(encoded.len);
    Ok(Proto { slices, body })
}

impl Proto {
    fn packet(&self, id: PacketId) -> Slices<'_> {
        Slices { id, slices: self.slices.iter().copied().collect(), body: &self.body }
    }

    /// Bytes of the whole packet.
    pub fn wire_len(&self) -> usize {
        if self.slices.len() > limits::MAX_SLICES {
            return usize::MAX;
        }
        self.packet(PacketId::default()).wire_len()
    }

    /// Bytes of the entropy-coded body.
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
