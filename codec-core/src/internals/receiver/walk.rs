//! Walks the slices of a `dgs1` packet to their places in the receiver's memory.
//!
//! There is one walk. What is done at each place is a [`Sink`]: looking ahead for what the packet
//! holds, decoding in place, copying what somebody else decoded, recording the arrival.

use core::ops::Range;

use super::Cell;
use crate::{
    caps::{Caps, within},
    closure::Arrived,
    cursor::varint_len,
    error::{Error, ErrorKind, Result},
    ids::{ClusterId, EpochId, Level, Span, WindowId},
    layout::Shape,
    wire::{
        manifest::Manifest,
        packet::{Extent, Slices},
    },
};

/// A slice of a packet: some blocks of one cell at one level, which carry symbols.
pub(super) struct Slice<'s> {
    /// Byte of the packet at which its extent starts.
    pub place: usize,
    pub level: Level,
    pub shape: &'s Shape,
    /// Blocks of the cell.
    pub blocks: Range<usize>,
    /// The place of its symbols.
    pub symbols: &'s mut [i16],
    /// Arrival masks of its blocks.
    pub masks: &'s mut [u8],
}

impl Slice<'_> {
    /// Refuses a slice one of whose blocks has the level already.
    pub fn check_free(&self) -> Result<()> {
        if self.masks.iter().any(|&mask| Arrived(mask).has(self.level)) {
            return Err(arrived_before(self.place, self.level));
        }
        Ok(())
    }
}

/// What is done with each slice of a packet.
pub(super) trait Sink {
    /// Takes the next slice.
    ///
    /// # Errors
    /// Why the packet is refused; the walk ends there.
    fn take(&mut self, slice: Slice<'_>) -> Result<()>;
}

/// Where a packet's slices lie.
pub(super) struct Places<'m, 'v> {
    pub manifest: &'m Manifest<'v>,
    pub cells: &'m [Cell],
    pub symbols: &'m mut [i16],
    pub blocks: &'m mut [u8],
    /// Of these, values and blocks of a packet.
    pub caps: &'m Caps,
}

/// Where an extent lies in its packet, and in the memory of its span.
#[derive(Clone, Copy)]
struct Inside<'m> {
    /// Byte of the packet at which it starts.
    place: usize,
    /// Cells from the extent's first on, and the cell behind each.
    cells: &'m [Cell],
    ends: &'m [Cell],
    /// Clusters before them.
    passed: usize,
    /// First block of the span.
    start: u32,
}

impl<'m> Places<'m, '_> {
    /// Gives every slice of `packet` that carries symbols to `sink`, in order. Work is bounded by
    /// caps before the first slice is taken.
    ///
    /// # Errors
    /// Extents outside the lattice or over each other, too many values, or whatever `sink` returns.
    pub fn walk(&mut self, packet: &Slices<'_>, sink: &mut impl Sink) -> Result<()> {
        let blocks = packet.extents.iter().map(|extent| u64::from(extent.blocks)).sum();
        within("packet.blocks", blocks, self.caps.blocks_per_packet)?;
        let mut values = 0;
        for (index, extent) in packet.extents.iter().enumerate() {
            let inside = self.inside(packet, index, extent)?;
            self.extent(&inside, extent, &mut values, sink)?;
        }
        Ok(())
    }

    /// Gives the slices of `extent`, which lies `inside`, to `sink`; `values` counts those of the packet so
    /// far.
    fn extent(
        &mut self,
        inside: &Inside<'_>,
        extent: &Extent,
        values: &mut u64,
        sink: &mut impl Sink,
    ) -> Result<()> {
        let Inside { place, cells, ends, passed, start } = *inside;
        let end = extent.first + extent.blocks;
        let before = *values;
        for ((c, cell), next) in (passed..).zip(cells).zip(ends) {
            let (low, high) = (cell.blocks - start, next.blocks - start);
            if low >= end {
                break;
            }
            let cluster = ClusterId(c as u16);
            let shape = Shape::in_lattice(self.manifest, extent.span, cluster)?;
            if shape.level_len(extent.level) == 0 {
                continue;
            }
            let local = |block: u32| (block.min(high).max(low) - low) as usize;
            let (blocks, all) = (local(extent.first)..local(end), shape.blocks());
            if shape.is_whole(extent.level) && blocks != (0..all) {
                let all = all as u64;
                return Err(contradiction("slice.blocks", place, blocks.len() as u64, (all, all)));
            }
            let (offset, len) = shape.range(extent.level, blocks.clone());
            *values += len as u64;
            within("packet.values", *values, self.caps.values_per_packet)?;
            let symbols = at(self.symbols, cell.symbols as usize + offset, len, "memory.symbols")?;
            let masks = at(self.blocks, cell.blocks as usize + blocks.start, blocks.len(), "memory.blocks")?;
            sink.take(Slice { place, level: extent.level, shape: &shape, blocks, symbols, masks })?;
        }
        if *values == before {
            let most = self.caps.values_per_packet.into();
            return Err(contradiction("extent.symbols", place, 0, (1, most)));
        }
        Ok(())
    }

    /// Where `extent`, number `index` of `packet`, lies. Not a part of the walk, of which there is one for
    /// each kind of sink.
    #[inline(never)]
    fn inside(&self, packet: &Slices<'_>, index: usize, extent: &Extent) -> Result<Inside<'m>> {
        let mut earlier = packet.extents.iter().take(index);
        // The id lies inside the first extent.
        let id_len = if index == 0 { 0 } else { varint_len(packet.id.get()) };
        let place = id_len + earlier.clone().map(Extent::header_len).sum::<usize>();
        if earlier.any(|earlier| overlap(earlier, extent)) {
            return Err(arrived_before(place, extent.level));
        }
        let contradiction = |field, found, allowed| Err(contradiction(field, place, found, allowed));
        let head = self.manifest.head();
        let (span, spans) = match extent.span {
            Span::Canonical(EpochId(epoch)) => (epoch, head.epochs),
            Span::Motion(WindowId(window)) => (window, head.windows),
        };
        let Some(last) = spans.checked_sub(1) else { return contradiction("extent.motion", 1, (0, 0)) };
        if span > last {
            return contradiction("extent.span", span.into(), (0, last.into()));
        }
        let cells = self.manifest.cell(extent.span, ClusterId(0)).zip(self.manifest.clusters_of(extent.span));
        // An epoch without clusters has no blocks.
        let Some((first, clusters)) = cells else {
            return contradiction("extent.blocks", extent.blocks.into(), (0, 0));
        };
        // The cells of the span, and the one behind them.
        let range = first.index()..=first.index() + clusters as usize;
        let (all_cells, need) = (self.cells, range.end() + 1);
        let found = all_cells.get(range).and_then(|cells| Some((cells, cells.get(1..)?)));
        let Some((cells @ [Cell { blocks: start, .. }, ..], ends @ [.., last])) = found else {
            return Err(Error::too_small("memory.cells", all_cells.len(), need));
        };
        let all = last.blocks - start;
        if extent.first >= all {
            return contradiction("extent.first", extent.first.into(), (0, u64::from(all).saturating_sub(1)));
        }
        let left = all - extent.first;
        if extent.blocks > left {
            return contradiction("extent.blocks", extent.blocks.into(), (1, left.into()));
        }
        // Clusters that end at or before the first block.
        let passed = ends.partition_point(|next| next.blocks - start <= extent.first);
        let left = cells.get(passed..).zip(ends.get(passed..));
        let (cells, ends) = left.ok_or_else(|| Error::too_small("memory.cells", cells.len(), passed))?;
        Ok(Inside { place, cells, ends, passed, start: *start })
    }
}

/// A field of the extent that starts at byte `place`, at odds with the manifest.
#[cold]
fn contradiction(field: &'static str, place: usize, found: u64, allowed: (u64, u64)) -> Error {
    Error::illegal(field, place, found, allowed).kind(ErrorKind::Contradiction)
}

/// `len` elements of `memory` from `start`.
fn at<'m, T>(memory: &'m mut [T], start: usize, len: usize, field: &'static str) -> Result<&'m mut [T]> {
    let (have, end) = (memory.len(), start + len);
    memory.get_mut(start..end).ok_or_else(|| Error::too_small(field, have, end))
}

/// Whether two extents bring the same level of the same block.
fn overlap(a: &Extent, b: &Extent) -> bool {
    let (a_end, b_end) = (a.first + a.blocks, b.first + b.blocks);
    (a.span, a.level) == (b.span, b.level) && a.first < b_end && b.first < a_end
}

/// A block of the extent that starts at byte `place` has `level` already.
fn arrived_before(place: usize, level: Level) -> Error {
    let level = u64::from(level.get());
    Error::illegal("slice", place, level, (level, level)).kind(ErrorKind::Duplicate)
}
