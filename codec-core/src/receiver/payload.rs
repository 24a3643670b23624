//! From a packet's payload to its place in the symbol store: what is checked before a symbol is
//! decoded, and what is recorded once the coder ended as it should.

use super::{Cell, Memory, Receiver};
use crate::{
    closure::Arrived,
    error::{Error, ErrorKind, Result},
    ids::{ClusterId, EpochId, Level, Span},
    layout::Shape,
    rans::{bytes, form::View, lanes},
    wire::{
        bits::Bits,
        manifest::{Manifest, Profile},
        packet::{Chunk, Extent, Packet, Slices},
    },
};

impl Receiver<'_> {
    /// Decodes one media packet to its place and records its arrival.
    ///
    /// # Errors
    /// Why it is refused; then no arrival is recorded.
    pub(super) fn decode(&mut self, manifest: &Manifest<'_>, packet: &Packet<'_>) -> Result<()> {
        let (wanted, found) = match packet {
            Packet::Slices(_) => (Profile::Dgs1, manifest.profile()),
            Packet::Chunk(_) => (Profile::Paper, manifest.profile()),
            Packet::Parity(_) => return Err(Error::illegal("packet.kind", 0, 6, (4, 5))),
        };
        if wanted != found {
            let allowed = (found as u64, found as u64);
            return Err(
                Error::illegal("packet.profile", 0, wanted as u64, allowed).kind(ErrorKind::Contradiction)
            );
        }
        match packet {
            Packet::Slices(slices) => self.decode_slices(manifest, slices),
            Packet::Chunk(chunk) => self.decode_chunk(manifest, chunk),
            Packet::Parity(_) => Ok(()),
        }
    }

    fn decode_slices(&mut self, manifest: &Manifest<'_>, packet: &Slices<'_>) -> Result<()> {
        let Memory { cells, symbols, blocks, slots, .. } = &mut self.memory;
        let (form, slots) = (self.form, &**slots);
        let (table_sets, raw_bits_of) = (&self.table_sets, &self.raw_bits);
        let table_at = |stream: usize, table_indices: &mut Bits<'_>| -> Result<(View<'_>, u8)> {
            let index = table_sets.get(stream).copied().unwrap_or_default().select(table_indices)?;
            let found = form.table(slots, index.into()).zip(raw_bits_of.get(usize::from(index)));
            let last = u64::from(manifest.head().tables).saturating_sub(1);
            let missing = Error::illegal("slice.table", 0, index.into(), (0, last));
            found.map(|(table, &bits)| (table, bits)).ok_or(missing.kind(ErrorKind::Contradiction))
        };
        // Table indices come first, so that the size of everything behind them is known.
        let mut table_indices = Bits::new(packet.body);
        let (mut values, mut raw_bits) = (0usize, 0usize);
        for (i, extent) in packet.extents.iter().enumerate() {
            let overlaps = |earlier: &Extent| overlap(earlier, extent);
            let twice = packet.extents.iter().take(i).any(overlaps);
            for_each_slice(manifest, cells, extent, i, |place| {
                let masks = blocks.get(place.masks.clone()).unwrap_or(&[]);
                if twice || masks.iter().any(|&m| Arrived(m).has(extent.level)) {
                    let level = u64::from(extent.level.get());
                    return Err(Error::illegal("slice", i, level, (level, level)).kind(ErrorKind::Duplicate));
                }
                place.shape.runs(extent.level, place.blocks.clone(), |stream, n| {
                    values += n;
                    raw_bits += n * usize::from(table_at(stream, &mut table_indices)?.1);
                    Ok(())
                })
            })?;
        }
        let mut decoder = lanes::Decoder::new(table_indices.finish()?, values, raw_bits)?;
        let mut table_indices = Bits::new(packet.body);
        for (i, extent) in packet.extents.iter().enumerate() {
            for_each_slice(manifest, cells, extent, i, |place| {
                let mut rest = symbols.get_mut(place.symbols.clone()).unwrap_or(&mut []);
                place.shape.runs(extent.level, place.blocks.clone(), |stream, n| {
                    let (table, bits) = table_at(stream, &mut table_indices)?;
                    let whole = core::mem::take(&mut rest);
                    let n = n.min(whole.len());
                    let (run, tail) = whole.split_at_mut(n);
                    rest = tail;
                    table.run(&mut decoder, bits, run)
                })
            })?;
        }
        decoder.finish()?;
        for (i, extent) in packet.extents.iter().enumerate() {
            for_each_slice(manifest, cells, extent, i, |place| {
                for mask in blocks.get_mut(place.masks).unwrap_or(&mut []) {
                    *mask = Arrived(*mask).with(extent.level).0;
                }
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Kept apart, so that its byte tables do not weigh on the stack of `dgs1`.
    #[inline(never)]
    fn decode_chunk(&mut self, manifest: &Manifest<'_>, chunk: &Chunk<'_>) -> Result<()> {
        let Memory { cells, symbols, blocks, slots, progress, .. } = &mut self.memory;
        let contradiction = |field, offset, found: u64, allowed| {
            Err(Error::illegal(field, offset, found, allowed).kind(ErrorKind::Contradiction))
        };
        let cluster = u32::from(chunk.cluster);
        let found = manifest
            .epochs()
            .enumerate()
            .find(|(_, e)| cluster.checked_sub(e.first_cluster).is_some_and(|offset| offset < e.clusters));
        let Some((e, epoch)) = found else {
            let last = u64::from(manifest.head().clusters.saturating_sub(1));
            return contradiction("chunk.cluster", 4, cluster.into(), (0, last));
        };
        let span = Span::Canonical(EpochId(e as u16));
        let local = ClusterId((cluster - epoch.first_cluster) as u16);
        let Some(shape) = Shape::of(manifest, span, local) else {
            return contradiction("chunk.cluster", 4, cluster.into(), (0, 0));
        };
        let level_len = shape.level_len(chunk.level) as u64;
        let end = u64::from(chunk.first_symbol) + u64::from(chunk.symbols);
        for (field, offset, found, wanted) in [
            ("chunk.first_frame", 6, u32::from(chunk.first_frame), epoch.first_frame & 0xffff),
            ("chunk.frames", 8, u32::from(chunk.frames), epoch.frames & 0xffff),
            ("chunk.quant", 10, u32::from(chunk.quant), u32::from(shape.cluster.quant)),
        ] {
            if found != wanted {
                return contradiction(field, offset, found.into(), (wanted.into(), wanted.into()));
            }
        }
        if end > level_len {
            return contradiction("chunk.symbols", 18, end, (1, level_len));
        }
        let group = cluster * Level::COUNT as u32 + u32::from(chunk.level.get());
        // Chunks of a group never overlap, so that together they never bring more than it has.
        let arrived = u64::from(progress.get(group as usize).copied().unwrap_or(0));
        let left = level_len.saturating_sub(arrived);
        if u64::from(chunk.symbols) > left {
            return contradiction("chunk.symbols", 18, chunk.symbols.into(), (0, left));
        }
        let needs = usize::from(chunk.level > Level::BASE);
        if chunk.dependencies.len() != needs {
            return contradiction(
                "chunk.dependencies",
                11,
                chunk.dependencies.len() as u64,
                (needs as u64, needs as u64),
            );
        }
        if let Some(&word) = chunk.dependencies.first()
            && word != group - 1
        {
            let below = u64::from(group - 1);
            return contradiction("chunk.dependency", 22, word.into(), (below, below));
        }
        let Some([low, high]) = manifest.byte_tables(cluster as usize, chunk.level) else {
            return contradiction("chunk.tables", 0, 0, (1, 1));
        };
        let slots: &mut [u8] = bytemuck::cast_slice_mut(slots);
        let Some([low_slots, high_slots]) = slots.as_chunks_mut::<{ bytes::SLOTS }>().0.get_mut(..2) else {
            return contradiction("memory.slots", 0, 0, (2, 2));
        };
        low.fill_slots(low_slots);
        high.fill_slots(high_slots);
        let cell = cells.get(cluster as usize).copied().unwrap_or_default();
        let (level_start, _) = shape.range(chunk.level, 0..1);
        let start = cell.symbols as usize + level_start + chunk.first_symbol as usize;
        let target = symbols.get_mut(start..start + usize::from(chunk.symbols)).unwrap_or(&mut []);
        bytes::decode(chunk.payload, [&low, &high], [low_slots, high_slots], target)?;
        if let Some(progress) = progress.get_mut(group as usize) {
            *progress += u32::from(chunk.symbols);
            if u64::from(*progress) >= level_len
                && let Some(mask) = blocks.get_mut(cell.blocks as usize)
            {
                *mask = Arrived(*mask).with(chunk.level).0;
            }
        }
        Ok(())
    }
}

/// Whether two extents bring the same level of the same block.
pub(super) fn overlap(a: &Extent, b: &Extent) -> bool {
    let (a_end, b_end) = (a.first.saturating_add(a.blocks), b.first.saturating_add(b.blocks));
    (a.span, a.level) == (b.span, b.level) && a.first < b_end && b.first < a_end
}

/// Calls `visit` with every slice of extent `index` of a packet that carries symbols, in order.
pub(super) fn for_each_slice(
    manifest: &Manifest<'_>,
    cells: &[Cell],
    extent: &Extent,
    index: usize,
    mut visit: impl FnMut(Place) -> Result<()>,
) -> Result<()> {
    let contradiction = |field, found: u64, allowed| {
        Err(Error::illegal(field, index, found, allowed).kind(ErrorKind::Contradiction))
    };
    let Some(first) = manifest.cell(extent.span, ClusterId(0)) else {
        return contradiction("extent.span", 0, (0, 0));
    };
    let clusters = manifest.clusters_of(extent.span) as usize;
    let range = first.index()..first.index() + clusters;
    let cells = cells.get(range.start..=range.end).unwrap_or(&[]);
    let start = cells.first().map_or(0, |c| c.blocks);
    let all = cells.last().map_or(0, |c| c.blocks) - start;
    let end = u64::from(extent.first) + u64::from(extent.blocks);
    if end > all.into() {
        return contradiction("extent.blocks", end, (1, all.into()));
    }
    let end = end as u32;
    // The last cluster that begins at or before the first block; clusters are never empty.
    let begin = cells.partition_point(|c| c.blocks - start <= extent.first).saturating_sub(1);
    let mut symbols = 0;
    for (c, pair) in cells.windows(2).enumerate().skip(begin) {
        let &[cell, next] = pair else { continue };
        let (low, high) = (cell.blocks - start, next.blocks - start);
        if low >= end {
            break;
        }
        let Some(shape) = Shape::of(manifest, extent.span, ClusterId(c as u16)) else { continue };
        if shape.level_len(extent.level) == 0 {
            continue;
        }
        let local = |block: u32| (block.min(high).saturating_sub(low)) as usize;
        let (blocks, all) = (local(extent.first)..local(end), shape.blocks());
        if shape.is_whole(extent.level) && blocks != (0..all) {
            return contradiction("slice.blocks", blocks.len() as u64, (all as u64, all as u64));
        }
        let (offset, len) = shape.range(extent.level, blocks.clone());
        symbols += len;
        let first = cell.symbols as usize + offset;
        let mask = cell.blocks as usize;
        visit(Place {
            symbols: first..first + len,
            masks: mask + blocks.start..mask + blocks.end,
            shape,
            blocks,
        })?;
    }
    if symbols == 0 {
        return contradiction("extent.level", extent.level.get().into(), (0, 3));
    }
    Ok(())
}

/// Where a slice's symbols and masks lie.
pub(super) struct Place {
    pub shape: Shape,
    /// Blocks of the cell.
    pub blocks: core::ops::Range<usize>,
    pub symbols: core::ops::Range<usize>,
    pub masks: core::ops::Range<usize>,
}
