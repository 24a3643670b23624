//! Where a stream's content lies: how much memory it needs, whose that is, and which of it counts.

use bytemuck::{Pod, Zeroable};

use super::sets;
use crate::{
    caps::{Caps, within},
    closure::Arrived,
    error::{Error, Result},
    ids::{ClusterId, EpochId, Level, Span, WindowId},
    layout::Shape,
    limits,
    rans::{bytes, form::Form},
    wire::manifest::{ChunkCoder, Manifest, Profile},
};

/// Where a cell's data starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Cell {
    /// First symbol.
    pub symbols: u32,
    /// First block.
    pub blocks: u32,
}

/// How much memory a stream needs, in elements of each [`Memory`] field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requirements {
    /// Elements of `cells`.
    pub cells: usize,
    /// Elements of `symbols`.
    pub symbols: usize,
    /// Elements of `blocks`.
    pub blocks: usize,
    /// Elements of `seen`.
    pub seen: usize,
    /// Elements of `slots` for the fast form of tables.
    pub slots: usize,
    /// Elements of `slots` for the compact form: fewer are refused.
    pub least_slots: usize,
    /// Elements of `progress`.
    pub progress: usize,
    /// Bytes of `parity`: for full repair, or as many as the caps allow; less repairs fewer sets.
    pub parity: usize,
}

impl Requirements {
    /// What `manifest` needs of a receiver that takes on at most `caps`.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) naming the first count over its cap. Counts
    /// that are known without a walk over the cells come first, the number of cells among them.
    pub fn of(manifest: &Manifest<'_>, caps: &Caps) -> Result<Self> {
        let head = manifest.head();
        let gaussians = manifest.largest_epoch();
        let blocks = manifest.state_blocks();
        for (field, found, most) in [
            ("manifest.raw_len", manifest.raw().len() as u64, caps.manifest_bytes),
            ("manifest.frames", head.frames.into(), caps.frames),
            ("manifest.packets", head.packets.into(), caps.packets),
            ("manifest.tables", head.tables.into(), caps.tables),
            ("manifest.cells", manifest.cells() as u64, caps.cells),
            ("manifest.blocks", blocks, caps.blocks),
            ("epoch.gaussians", gaussians.into(), caps.gaussians_per_epoch),
        ] {
            within(field, found, most)?;
        }
        let mut symbols = 0u64;
        for_each_cell(manifest, |_, _, shape| {
            symbols = symbols.saturating_add(shape.len() as u64);
            Ok(())
        })?;
        within("manifest.symbols", symbols, caps.symbols.min(limits::MAX_SYMBOLS))?;
        let mut need = Self {
            cells: manifest.cells() + 1,
            symbols: symbols as usize,
            blocks: blocks as usize,
            seen: (head.packets as usize).div_ceil(32),
            parity: sets::memory_bytes(manifest).min(caps.parity_bytes as usize),
            ..Self::default()
        };
        match manifest.profile() {
            Profile::Dgs1 => {
                let tables = usize::from(manifest.head().tables);
                need.slots = tables * Form::Slots.words();
                need.least_slots = tables * Form::Compact.words();
            }
            Profile::Paper => {
                let tables = manifest.chunk_coder() == Some(ChunkCoder::Tables);
                need.slots = if tables { 2 * bytes::SLOTS / 4 } else { 0 };
                need.least_slots = need.slots;
                need.progress = manifest.cells() * Level::COUNT + need.symbols.div_ceil(32);
            }
        }
        Ok(need)
    }

    /// What no stream within `caps` exceeds, whatever its profile.
    pub const fn most(caps: &Caps) -> Self {
        let (slots, least) =
            (caps.tables as usize * Form::Slots.words(), caps.tables as usize * Form::Compact.words());
        let (cells, paper) = (caps.cells as usize, 2 * bytes::SLOTS / 4);
        // Only `paper` asks for progress, whose cells are clusters: it has no windows.
        let clusters = if caps.cells < limits::MAX_CLUSTERS { caps.cells } else { limits::MAX_CLUSTERS };
        Self {
            cells: cells.saturating_add(1),
            symbols: caps.symbols as usize,
            blocks: caps.blocks as usize,
            seen: (caps.packets as usize).div_ceil(32),
            slots: if slots > paper { slots } else { paper },
            least_slots: if least > paper { least } else { paper },
            progress: clusters as usize * Level::COUNT + (caps.symbols as usize).div_ceil(32),
            parity: caps.parity_bytes as usize,
        }
    }
}

/// Calls `visit` with every cell in lattice order: canonical cells, then motion cells.
///
/// # Errors
/// Whatever `visit` returns, which ends the walk.
pub fn for_each_cell(
    manifest: &Manifest<'_>,
    mut visit: impl FnMut(Span, ClusterId, Shape) -> Result<()>,
) -> Result<()> {
    let mut walk = |span| {
        let none = Error::illegal("manifest.windows", 0, 0, (0, 0));
        for c in 0..manifest.clusters_of(span).ok_or(none)? {
            let cluster = ClusterId(c as u16);
            visit(span, cluster, Shape::in_lattice(manifest, span, cluster)?)?;
        }
        Ok(())
    };
    for e in 0..manifest.head().epochs {
        walk(Span::Canonical(EpochId(e)))?;
    }
    for w in 0..manifest.head().windows {
        walk(Span::Motion(WindowId(w)))?;
    }
    Ok(())
}

/// The caller's memory, cut from an arena by [`Plan::divide`](crate::arena::Plan::divide). Contents do
/// not matter: [`Receiver::new`](super::Receiver::new) initialises what it uses.
#[derive(Debug, Default)]
pub struct Memory<'a> {
    /// Where cells start.
    pub(crate) cells: &'a mut [Cell],
    /// Decoded symbols.
    pub(crate) symbols: &'a mut [i16],
    /// Arrival masks, one per block and cell.
    pub(crate) blocks: &'a mut [u8],
    /// Bitmap of packets.
    pub(crate) seen: &'a mut [u32],
    /// Entropy decode tables: [`Requirements::slots`] for the fast form, or down to
    /// [`Requirements::least_slots`] for the compact one.
    pub(crate) slots: &'a mut [u32],
    /// Symbols arrived per group, then a bit per symbol that has (`paper`).
    pub(crate) progress: &'a mut [u32],
    /// Sums of the repair sets.
    pub(crate) parity: &'a mut [u8],
}

/// The decoded content of a stream so far, and which of it counts.
#[derive(Clone, Copy, Debug)]
pub struct Content<'m> {
    /// The manifest.
    pub manifest: &'m Manifest<'m>,
    /// Where cells start.
    pub cells: &'m [Cell],
    /// Symbols.
    pub symbols: &'m [i16],
    /// The state: arrival masks. Any list of this length is a valid state.
    pub blocks: &'m [u8],
}

impl<'m> Content<'m> {
    /// The same content in another state.
    #[must_use]
    pub const fn with_state(mut self, blocks: &'m [u8]) -> Self {
        self.blocks = blocks;
        self
    }

    /// The cell of `cluster` in `span`, if there is one.
    pub fn cell(&self, span: Span, cluster: ClusterId) -> Option<Cell> {
        self.cells.get(self.manifest.cell(span, cluster)?.index()).copied()
    }

    /// The cell of `cluster` in `span`, which the lattice has.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity): there is no such cell.
    pub fn cell_in_lattice(&self, span: Span, cluster: ClusterId) -> Result<Cell> {
        let (have, need) = (self.cells.len(), self.manifest.cells());
        self.cell(span, cluster).ok_or_else(|| Error::too_small("memory.cells", have, need))
    }

    /// Levels of block `block` of a cell that have arrived.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity): the state has no such block.
    pub fn arrived(&self, cell: Cell, block: usize) -> Result<Arrived> {
        let (have, at) = (self.blocks.len(), cell.blocks as usize + block);
        let mask = self.blocks.get(at).ok_or_else(|| Error::too_small("memory.blocks", have, at + 1));
        mask.copied().map(Arrived)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use std::vec;

    use super::*;
    use crate::{
        arena::Plan,
        error::ErrorKind,
        receiver::Receiver,
        wire::{crc::crc32, file, manifest::ManifestHead},
    };

    /// All of `list` but its first element.
    fn shorten<T>(list: &mut &mut [T]) {
        let (_, rest) = core::mem::take(list).split_first_mut().unwrap();
        *list = rest;
    }

    #[test]
    fn memory_that_is_short_is_named() {
        let (message, _) = file::parts(include_bytes!("../../../tests/conformance/one.dgs")).unwrap();
        let sealed = ManifestHead::parse(message).unwrap();
        let mut raw = vec![0; sealed.raw_len];
        sealed.open(message, crc32, &mut raw).unwrap();
        let manifest = Manifest::parse(&raw).unwrap();
        let plan = Plan::of(&manifest, &Caps::SMALL).unwrap();
        let refused = |change: fn(&mut Memory<'_>)| {
            let mut arena = vec![0; plan.words()];
            let mut memory = plan.divide(&mut arena).unwrap().receiver;
            change(&mut memory);
            Receiver::new(memory, manifest, Caps::SMALL).map(|_| ()).map_err(|error| {
                assert_eq!(error.kind, ErrorKind::Capacity, "{error}");
                error.field
            })
        };
        assert_eq!(refused(|_| ()), Ok(()));
        assert_eq!(refused(|memory| shorten(&mut memory.cells)), Err("memory.cells"));
        assert_eq!(refused(|memory| shorten(&mut memory.symbols)), Err("memory.symbols"));
        assert_eq!(refused(|memory| shorten(&mut memory.blocks)), Err("memory.blocks"));
        assert_eq!(refused(|memory| shorten(&mut memory.seen)), Err("memory.seen"));
        assert_eq!(refused(|memory| memory.slots = &mut []), Err("memory.slots"));
    }
}
