//! DGSM, the control manifest: everything a receiver must know before the first packet means
//! anything.
//!
//! On the wire: `"DGSM"`, version, three zero bytes, raw length, packed length, the packed body,
//! CRC-32. The unpacked body is fixed-width records in sections, so that a view can answer any
//! question by offset, without a heap. [`Manifest::parse`] walks it once and checks every number
//! and every cross-reference; after that no accessor can fail, and none can panic: an index out
//! of range gives the last record's defaults through `Option`.
//!
//! `SPEC.md` gives every byte.

mod check;
mod profile;
mod proxy;
mod record;
mod seal;
pub mod stream;
mod table_set;

pub use profile::{ChunkCoder, PAPER_CONTEXT, Profile};
pub use proxy::Proxy;
pub use record::{Cluster, Epoch, Head, Motion, Quant, Repair, Track, Window};
pub use seal::{Sealed, open, seal};
pub use table_set::{MAX_TABLE_SET_BITS, TableSet};

use core::ops::Range;

use super::packet::Extent;
use crate::{
    cursor::Reader,
    error::{Error, ErrorKind, Result},
    gaussian::ShDegree,
    ids::{CellId, ClusterId, EpochId, Level, Span, WindowId},
    limits,
    rans::{bytes, table::Table},
};
use check::check_head;
use profile::byte_tables;

/// First four bytes of a manifest.
pub const MAGIC: [u8; 4] = *b"DGSM";
/// Version this crate reads and writes.
pub const VERSION: u8 = 2;
/// Bytes before the packed body.
pub const HEADER_BYTES: usize = 16;

/// A checked view of an unpacked manifest body.
#[derive(Clone, Copy, Debug)]
pub struct Manifest<'a> {
    /// Invariant: every section lies inside and every record has been checked by `parse`.
    raw: &'a [u8],
    head: Head,
    profile: Profile,
    sections: Sections,
    motion_cells: usize,
    /// Canonical blocks of all epochs.
    blocks: usize,
}

/// Byte offsets of the sections.
#[derive(Clone, Copy, Debug, Default)]
struct Sections {
    epochs: usize,
    windows: usize,
    clusters: usize,
    motions: usize,
    quants: usize,
    streams: usize,
    repairs: usize,
    tables: usize,
    basis: usize,
    transforms: usize,
    byte_tables: usize,
    proxies: usize,
}

impl<'a> Manifest<'a> {
    /// Checks `raw` (an unpacked body) from end to end.
    ///
    /// # Errors
    /// Short bytes; a number outside its limits; records that contradict each other; leftovers.
    pub fn parse(raw: &'a [u8]) -> Result<Self> {
        let mut reader = Reader::new(raw);
        let head = Head::read(&mut reader)?;
        let profile = match head.profile {
            0 => Profile::Paper,
            1 => Profile::Dgs1,
            #[cfg(feature = "paper-context")]
            PAPER_CONTEXT => Profile::Paper,
            other => {
                let last = if cfg!(feature = "paper-context") { PAPER_CONTEXT } else { 1 };
                let unknown = Error::illegal("manifest.profile", 0, other.into(), (0, last.into()));
                return Err(unknown.kind(ErrorKind::Unknown));
            }
        };
        check_head(&head)?;
        let is_dgs1 = profile == Profile::Dgs1;
        let mut sections = Sections::default();
        let mut take = |len: usize, target: &mut usize, field| -> Result<()> {
            *target = reader.offset();
            reader.bytes(field, len).map(|_| ())
        };
        let clusters = head.clusters as usize;
        take(usize::from(head.epochs) * Epoch::BYTES, &mut sections.epochs, "manifest.epochs")?;
        take(usize::from(head.windows) * Window::BYTES, &mut sections.windows, "manifest.windows")?;
        take(clusters * Cluster::BYTES, &mut sections.clusters, "manifest.clusters")?;
        let partial = Self { raw, head, profile, sections, motion_cells: 0, blocks: 0 };
        let motion_cells = partial.check_lattice()?;
        let records = (0..clusters).filter_map(|c| partial.cluster_record(c));
        let blocks: usize = records.map(|c| partial.blocks_of(&c) as usize).sum();
        take(motion_cells * Motion::BYTES, &mut sections.motions, "manifest.motions")?;
        take(usize::from(head.quants) * Quant::BYTES, &mut sections.quants, "manifest.quants")?;
        let table_sets = if is_dgs1 { stream::COUNT * TableSet::BYTES } else { 0 };
        take(table_sets, &mut sections.streams, "manifest.streams")?;
        take(usize::from(head.repairs) * Repair::BYTES, &mut sections.repairs, "manifest.repairs")?;
        let basis_width = if is_dgs1 { 2 } else { 4 };
        take(head.basis_values as usize * basis_width, &mut sections.basis, "manifest.basis")?;
        take(head.transform_values as usize * 4, &mut sections.transforms, "manifest.transforms")?;
        let byte_tables = byte_tables(&head) * bytes::TABLE_BYTES;
        take(byte_tables, &mut sections.byte_tables, "manifest.byte_tables")?;
        let proxies = if head.proxies == 1 { blocks * Proxy::BYTES } else { 0 };
        take(proxies, &mut sections.proxies, "manifest.proxies")?;
        sections.tables = reader.offset();
        for _ in 0..head.tables {
            Table::read(&mut reader)?;
        }
        reader.finish("manifest.leftover")?;
        let whole = Self { raw, head, profile, sections, motion_cells, blocks };
        whole.check_records()?;
        Ok(whole)
    }

    /// The same view over `raw`: the bytes that this one was made of, at another place.
    pub(crate) const fn over<'b>(&self, raw: &'b [u8]) -> Manifest<'b> {
        let Self { head, profile, sections, motion_cells, blocks, .. } = *self;
        Manifest { raw, head, profile, sections, motion_cells, blocks }
    }

    /// The unpacked bytes this view reads.
    pub const fn raw(&self) -> &'a [u8] {
        self.raw
    }

    /// The fixed head.
    pub const fn head(&self) -> &Head {
        &self.head
    }

    /// The profile.
    pub const fn profile(&self) -> Profile {
        self.profile
    }

    /// The name of the profile and its coder, as people type it.
    pub const fn profile_name(&self) -> &'static str {
        match self.chunk_coder() {
            Some(ChunkCoder::Tables) => "paper",
            Some(ChunkCoder::Context) => "paper-context",
            None => "dgs1",
        }
    }

    /// How the symbols of chunks are coded; `None` in `dgs1`, which has no chunks.
    pub const fn chunk_coder(&self) -> Option<ChunkCoder> {
        match self.head.profile {
            0 => Some(ChunkCoder::Tables),
            PAPER_CONTEXT => Some(ChunkCoder::Context),
            _ => None,
        }
    }

    /// Gaussians per block (`paper`: a whole cluster is one block).
    pub const fn block_len(&self) -> usize {
        match self.profile {
            Profile::Paper => limits::MAX_CLUSTER_LEN,
            Profile::Dgs1 => self.head.block_len as usize,
        }
    }

    /// Highest harmonic degree of any cluster.
    pub fn sh_degree(&self) -> ShDegree {
        ShDegree::new(self.head.sh_degree).unwrap_or_default()
    }

    /// Frames per second.
    pub fn frames_per_second(&self) -> f64 {
        f64::from(self.head.rate_frames) / f64::from(self.head.rate_seconds)
    }

    fn record<T>(
        &self,
        section: usize,
        index: usize,
        count: usize,
        bytes: usize,
        read: impl Fn(&mut Reader<'a>) -> Result<T>,
    ) -> Option<T> {
        if index >= count {
            return None;
        }
        read(&mut Reader::at(self.raw, section + index * bytes)).ok()
    }

    /// Epoch `id`.
    pub fn epoch(&self, id: EpochId) -> Option<Epoch> {
        let count = usize::from(self.head.epochs);
        self.record(self.sections.epochs, id.index(), count, Epoch::BYTES, Epoch::read)
    }

    /// All epochs in display order.
    pub fn epochs(&self) -> impl ExactSizeIterator<Item = Epoch> + use<'a> {
        let this = *self;
        (0..self.head.epochs).map(move |e| this.epoch(EpochId(e)).unwrap_or_default())
    }

    /// Window `id`.
    pub fn window(&self, id: WindowId) -> Option<Window> {
        let count = usize::from(self.head.windows);
        self.record(self.sections.windows, id.index(), count, Window::BYTES, Window::read)
    }

    /// All windows in display order.
    pub fn windows(&self) -> impl ExactSizeIterator<Item = Window> + use<'a> {
        let this = *self;
        (0..self.head.windows).map(move |w| this.window(WindowId(w)).unwrap_or_default())
    }

    fn cluster_record(&self, index: usize) -> Option<Cluster> {
        let count = self.head.clusters as usize;
        self.record(self.sections.clusters, index, count, Cluster::BYTES, Cluster::read)
    }

    /// Cluster `id` of `epoch`.
    pub fn cluster(&self, epoch: EpochId, id: ClusterId) -> Option<Cluster> {
        let epoch = self.epoch(epoch)?;
        if u32::from(id.0) >= epoch.clusters {
            return None;
        }
        self.cluster_record(epoch.first_cluster as usize + id.index())
    }

    /// How cluster `cluster` moves in `window` (`dgs1`).
    pub fn motion(&self, window: WindowId, cluster: ClusterId) -> Option<Motion> {
        let record = self.window(window)?;
        let epoch = self.epoch(EpochId(record.epoch))?;
        if u32::from(cluster.0) >= epoch.clusters {
            return None;
        }
        let index = record.first_cell as usize + cluster.index();
        self.record(self.sections.motions, index, self.motion_cells, Motion::BYTES, Motion::read)
    }

    /// Number of motion cells: windows × clusters of their epochs.
    pub const fn motion_cells(&self) -> usize {
        self.motion_cells
    }

    /// Number of cells of the lattice: canonical, then motion.
    pub const fn cells(&self) -> usize {
        self.head.clusters as usize + self.motion_cells
    }

    /// The cell of `cluster` in `span`, if there is one.
    pub fn cell(&self, span: Span, cluster: ClusterId) -> Option<CellId> {
        let (epoch, first) = match span {
            Span::Canonical(id) => {
                let epoch = self.epoch(id)?;
                (epoch, epoch.first_cluster)
            }
            Span::Motion(id) => {
                let window = self.window(id)?;
                (self.epoch(EpochId(window.epoch))?, self.head.clusters + window.first_cell)
            }
        };
        (u32::from(cluster.0) < epoch.clusters).then_some(CellId(first + u32::from(cluster.0)))
    }

    /// Blocks of all cells: the bytes of a state. May exceed 32 bits, which caps refuse.
    pub fn state_blocks(&self) -> u64 {
        let mut blocks = 0u64;
        for epoch in self.epochs() {
            let clusters = epoch.first_cluster..epoch.first_cluster.saturating_add(epoch.clusters);
            let canonical: u64 = clusters
                .filter_map(|c| self.cluster_record(c as usize))
                .map(|record| u64::from(self.blocks_of(&record)))
                .sum();
            // Each window has a motion cell for every cluster of its epoch.
            blocks = blocks.saturating_add(canonical.saturating_mul(1 + u64::from(epoch.windows)));
        }
        blocks
    }

    /// Quantisation profile `index`.
    pub fn quant(&self, index: u8) -> Option<Quant> {
        let count = usize::from(self.head.quants);
        self.record(self.sections.quants, usize::from(index), count, Quant::BYTES, Quant::read)
    }

    /// The tables that runs of stream `stream` choose from; empty if it never occurs.
    pub fn table_set(&self, stream: usize) -> TableSet {
        let count = if self.profile == Profile::Dgs1 { stream::COUNT } else { 0 };
        self.record(self.sections.streams, stream, count, TableSet::BYTES, TableSet::read).unwrap_or_default()
    }

    /// Blocks of cluster `cluster` (`paper`: one).
    fn blocks_of(&self, cluster: &Cluster) -> u32 {
        // At least 1 since `parse`; said again, so that no compiler sees a division by zero.
        u32::from(cluster.gaussians).div_ceil((self.block_len() as u32).max(1))
    }

    /// Clusters of the epoch that `span` is or lies in; 0 for a span that does not exist.
    pub fn clusters_of(&self, span: Span) -> u32 {
        self.epoch_of(span).and_then(|id| self.epoch(id)).map_or(0, |e| e.clusters)
    }

    /// The epoch that `span` is or lies in.
    pub fn epoch_of(&self, span: Span) -> Option<EpochId> {
        match span {
            Span::Canonical(id) => Some(id),
            Span::Motion(id) => self.window(id).map(|w| EpochId(w.epoch)),
        }
    }

    /// The slices of `extent`, in order: cluster, and its blocks inside the extent. Clusters that
    /// carry nothing at the level are among them. An extent past the span's end stops there.
    pub fn slices(&self, extent: Extent) -> impl Iterator<Item = (ClusterId, Range<u32>)> + use<'a> {
        let this = *self;
        let epoch = this.epoch_of(extent.span).and_then(|id| this.epoch(id)).unwrap_or_default();
        let end = extent.first.saturating_add(extent.blocks);
        let mut before = 0u32;
        (0..epoch.clusters)
            .map_while(move |c| {
                let record = this.cluster_record((epoch.first_cluster + c) as usize)?;
                let (first, last) = (before, before + this.blocks_of(&record));
                before = last;
                (first < end).then(|| {
                    let local = |block: u32| block.min(last).saturating_sub(first);
                    let inside = local(extent.first)..local(end);
                    (ClusterId(c as u16), inside)
                })
            })
            .filter(|(_, blocks)| !blocks.is_empty())
    }

    /// The proxy of canonical block `block`, counted over all clusters of all epochs.
    pub fn proxy(&self, block: usize) -> Option<Proxy> {
        if self.head.proxies == 0 || block >= self.blocks {
            return None;
        }
        let plane = |i: usize| self.raw.get(self.sections.proxies + i * self.blocks + block).copied();
        let mut bytes = [0; Proxy::BYTES];
        for (i, byte) in bytes.iter_mut().enumerate() {
            *byte = plane(i)?;
        }
        Some(Proxy::from_bytes(bytes))
    }

    /// All entropy tables of `dgs1`, in order.
    pub fn tables(&self) -> impl Iterator<Item = Table> + use<'a> {
        let mut reader = Reader::at(self.raw, self.sections.tables);
        (0..self.head.tables).map_while(move |_| Table::read(&mut reader).ok())
    }

    /// Low and high byte table of a `paper` group, where its coder has tables; `cluster` counts over all
    /// epochs.
    pub fn byte_tables(&self, cluster: usize, level: Level) -> Option<[bytes::ByteTable; 2]> {
        if self.chunk_coder() != Some(ChunkCoder::Tables) || cluster >= self.head.clusters as usize {
            return None;
        }
        let first = (cluster * Level::COUNT + level.index()) * 2;
        Some([self.read_byte_table(first).ok()?, self.read_byte_table(first + 1).ok()?])
    }

    fn read_byte_table(&self, index: usize) -> Result<bytes::ByteTable> {
        let place = self.sections.byte_tables + index * bytes::TABLE_BYTES;
        let mut reader = Reader::at(self.raw, place);
        let raw = reader.array("manifest.byte_tables")?;
        bytes::ByteTable::from_bytes(&raw).map_err(|e| Error { offset: place as u32, ..e })
    }

    /// All repair ranges.
    pub fn repairs(&self) -> impl ExactSizeIterator<Item = Repair> + use<'a> {
        let this = *self;
        let count = usize::from(self.head.repairs);
        (0..count).map(move |r| {
            this.record(this.sections.repairs, r, count, Repair::BYTES, Repair::read).unwrap_or_default()
        })
    }

    /// Value `index` of the window bases (`dgs1`), scaled to −2..2.
    pub fn basis(&self, index: usize) -> f32 {
        let place = self.sections.basis + 2 * index;
        let pair = self.raw.get(place..place + 2).unwrap_or(&[0, 0]);
        f32::from(i16::from_le_bytes([pair[0], pair[1]])) * (1.0 / 16384.0)
    }

    fn float(&self, place: usize) -> f32 {
        let b = self.raw.get(place..place + 4).unwrap_or(&[0; 4]);
        f32::from_le_bytes([b[0], b[1], b[2], b[3]])
    }

    /// Value `index` of the epoch bases (`paper`).
    pub fn paper_basis(&self, index: usize) -> f32 {
        self.float(self.sections.basis + 4 * index)
    }

    /// Value `index` of the cluster transforms (`paper`).
    pub fn transform_value(&self, index: usize) -> f32 {
        self.float(self.sections.transforms + 4 * index)
    }

    /// The epoch that `frame` lies in.
    pub fn epoch_at(&self, frame: u32) -> Option<EpochId> {
        let found = self.search(usize::from(self.head.epochs), frame, |i| {
            let e = self.epoch(EpochId(i as u16)).unwrap_or_default();
            (e.first_frame, e.frames)
        });
        found.map(|i| EpochId(i as u16))
    }

    /// The window that `frame` lies in.
    pub fn window_at(&self, frame: u32) -> Option<WindowId> {
        let found = self.search(usize::from(self.head.windows), frame, |i| {
            let w = self.window(WindowId(i as u16)).unwrap_or_default();
            (w.first_frame, u32::from(w.frames))
        });
        found.map(|i| WindowId(i as u16))
    }

    /// Binary search of ordered (first frame, frames) spans.
    fn search(&self, count: usize, frame: u32, span: impl Fn(usize) -> (u32, u32)) -> Option<usize> {
        let (mut low, mut high) = (0usize, count);
        while low < high {
            let middle = low + (high - low) / 2;
            let (first, frames) = span(middle);
            if frame < first {
                high = middle;
            } else if frame - first >= frames {
                low = middle + 1;
            } else {
                return Some(middle);
            }
        }
        None
    }
}
