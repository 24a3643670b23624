//! Where a stream's content lies: how much memory it needs, whose that is, and which of it counts.

use super::repair;
use crate::{
    closure::Arrived,
    error::{ErrorKind, Result},
    ids::{ClusterId, EpochId, Level, Span, WindowId},
    layout::Shape,
    rans::{bytes, form::Form},
    wire::{
        cursor::in_range,
        manifest::{Manifest, Profile},
    },
};

/// Where a cell's data starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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
    /// Bytes of `parity` for full repair; less repairs fewer sets.
    pub parity: usize,
}

impl Requirements {
    /// What `manifest` needs.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if the symbols exceed 2^31.
    pub fn of(manifest: &Manifest<'_>) -> Result<Self> {
        let mut need = Self { cells: manifest.cells() + 1, ..Self::default() };
        for_each_cell(manifest, |_, _, shape| {
            need.symbols = need.symbols.saturating_add(shape.len());
            need.blocks = need.blocks.saturating_add(shape.blocks());
        });
        in_range("manifest.symbols", 0, need.symbols as u64, 0, 1 << 31)
            .map_err(|e| e.kind(ErrorKind::Capacity))?;
        need.seen = (manifest.head().packets as usize).div_ceil(32);
        need.parity = repair::memory_bytes(manifest);
        match manifest.profile() {
            Profile::Dgs1 => {
                let tables = usize::from(manifest.head().tables);
                need.slots = tables * Form::Slots.words();
                need.least_slots = tables * Form::Compact.words();
            }
            Profile::Paper => {
                need.slots = 2 * bytes::SLOTS / 4;
                need.least_slots = need.slots;
                need.progress = manifest.cells() * Level::COUNT;
            }
        }
        Ok(need)
    }
}

/// Calls `visit` with every cell in lattice order: canonical cells, then motion cells.
pub fn for_each_cell(manifest: &Manifest<'_>, mut visit: impl FnMut(Span, ClusterId, Shape)) {
    let mut walk = |span, clusters: u32| {
        for c in 0..clusters {
            let cluster = ClusterId(c as u16);
            if let Some(shape) = Shape::of(manifest, span, cluster) {
                visit(span, cluster, shape);
            }
        }
    };
    for (e, epoch) in manifest.epochs().enumerate() {
        walk(Span::Canonical(EpochId(e as u16)), epoch.clusters);
    }
    for (w, window) in manifest.windows().enumerate() {
        let clusters = manifest.epoch(EpochId(window.epoch)).map_or(0, |e| e.clusters);
        walk(Span::Motion(WindowId(w as u16)), clusters);
    }
}

/// The caller's memory. Contents do not matter; [`Receiver::control`](super::Receiver::control)
/// initialises what it uses.
#[derive(Debug, Default)]
pub struct Memory<'a> {
    /// The unpacked manifest ([`Sealed::raw_len`](crate::wire::manifest::Sealed::raw_len) bytes).
    pub manifest: &'a mut [u8],
    /// Where cells start.
    pub cells: &'a mut [Cell],
    /// Decoded symbols.
    pub symbols: &'a mut [i16],
    /// Arrival masks, one per block and cell.
    pub blocks: &'a mut [u8],
    /// Bitmap of packets.
    pub seen: &'a mut [u32],
    /// Entropy decode tables: [`Requirements::slots`] for the fast form, or down to
    /// [`Requirements::least_slots`] for the compact one.
    pub slots: &'a mut [u32],
    /// Symbols arrived per group (`paper`).
    pub progress: &'a mut [u32],
    /// Sums of the repair sets.
    pub parity: &'a mut [u8],
    /// Media that arrives before the manifest.
    pub early: &'a mut [u8],
}

/// The decoded content of a stream so far, and which of it counts.
#[derive(Clone, Copy, Debug)]
pub struct Content<'m> {
    /// The manifest.
    pub manifest: Manifest<'m>,
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

    /// The cell of `cluster` in `span`.
    pub fn cell(&self, span: Span, cluster: ClusterId) -> Option<Cell> {
        self.cells.get(self.manifest.cell(span, cluster)?.index()).copied()
    }

    /// Levels of block `block` of a cell that have arrived.
    pub fn arrived(&self, cell: Cell, block: usize) -> Arrived {
        Arrived(self.blocks.get(cell.blocks as usize + block).copied().unwrap_or(0))
    }
}
