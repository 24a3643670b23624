//! A view of an unpacked manifest body answers questions by index, without a heap.

use core::{cmp::Ordering, num::NonZero, ops::Range};

use super::{
    check::{check_head, check_lattice, check_records},
    profile::{ChunkCoder, PAPER_CONTEXT, Profile},
    proxy::Proxy,
    record::{Cluster, Epoch, Head, Motion, Quant, Repair, Window},
    sections::{LatticeSize, Sections},
    table_set::TableSet,
};
use crate::{
    cursor::Reader,
    error::{Error, ErrorKind, Result},
    footprint::Footprint,
    gaussian::ShDegree,
    ids::{CellId, ClusterId, EpochId, Level, Span, WindowId},
    limits,
    rans::{bytes::ByteTable, table::Table},
    up::Up,
    wire::packet::Extent,
};

/// A checked view of an unpacked manifest body.
#[derive(Clone, Copy, Debug)]
pub struct Manifest<'a> {
    raw: &'a [u8],
    /// Invariant: every record has been checked by `parse`.
    sections: Sections<'a>,
    outline: Outline,
}

/// What is known of a checked manifest without its bytes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outline {
    head: Head,
    profile: Profile,
    sh_degree: ShDegree,
    footprint: Footprint,
    up: Up,
    block_len: NonZero<u32>,
    size: LatticeSize,
}

impl Outline {
    /// The manifest again, over `raw`: the bytes that it was made of, at another place.
    ///
    /// # Errors
    /// Fewer bytes than those.
    pub(crate) fn over(self, raw: &[u8]) -> Result<Manifest<'_>> {
        let mut reader = Reader::new(raw);
        reader.bytes("manifest.head", Head::BYTES)?;
        let lattice = Sections::lattice(&mut reader, &self.head)?;
        let sections = lattice.with_others(reader, &self.head, &self.size)?;
        Ok(Manifest { raw, sections, outline: self })
    }
}

impl<'a> Manifest<'a> {
    /// Checks `raw` (an unpacked body) from end to end.
    ///
    /// # Errors
    /// Short bytes; a number outside its limits; records that contradict each other; leftovers.
    pub fn parse(raw: &'a [u8]) -> Result<Self> {
        let mut reader = Reader::new(raw);
        let head = Head::from_bytes(&reader.array("manifest.head")?);
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
        let (sh_degree, block_len, footprint, up) = check_head(&head)?;
        // In `paper` a whole cluster is one block.
        let block_len = match profile {
            Profile::Paper => const { NonZero::new(limits::MAX_CLUSTER_LEN as u32).unwrap() },
            Profile::Dgs1 => block_len,
        };
        let lattice = Sections::lattice(&mut reader, &head)?;
        let size = check_lattice(&lattice, &head, profile, block_len)?;
        let sections = lattice.with_others(reader, &head, &size)?;
        check_records(&sections, &head, profile, raw.len())?;
        Ok(Self {
            raw,
            sections,
            outline: Outline { head, profile, sh_degree, footprint, up, block_len, size },
        })
    }

    /// What is known of this manifest without its bytes.
    pub(crate) const fn outline(&self) -> Outline {
        self.outline
    }

    /// The unpacked bytes this view reads.
    pub const fn raw(&self) -> &'a [u8] {
        self.raw
    }

    /// The fixed head.
    pub const fn head(&self) -> &Head {
        &self.outline.head
    }

    /// The profile.
    pub const fn profile(&self) -> Profile {
        self.outline.profile
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
        match self.head().profile {
            0 => Some(ChunkCoder::Tables),
            PAPER_CONTEXT => Some(ChunkCoder::Context),
            _ => None,
        }
    }

    /// Gaussians per block (`paper`: a whole cluster is one block).
    pub const fn block_len(&self) -> NonZero<u32> {
        self.outline.block_len
    }

    /// Highest harmonic degree of any cluster.
    pub const fn sh_degree(&self) -> ShDegree {
        self.outline.sh_degree
    }

    /// How Gaussians are drawn.
    pub const fn footprint(&self) -> Footprint {
        self.outline.footprint
    }

    /// Which way is up.
    pub const fn up(&self) -> Up {
        self.outline.up
    }

    /// Frames per second.
    pub fn frames_per_second(&self) -> f64 {
        f64::from(self.head().rate_frames) / f64::from(self.head().rate_seconds)
    }

    /// Epoch `id`.
    pub fn epoch(&self, id: EpochId) -> Option<Epoch> {
        self.sections.epochs.get(id.index()).map(Epoch::from_bytes)
    }

    /// All epochs in display order.
    pub fn epochs(&self) -> impl ExactSizeIterator<Item = Epoch> + use<'a> {
        self.sections.epochs.iter().map(Epoch::from_bytes)
    }

    /// Gaussians of the largest epoch.
    pub const fn largest_epoch(&self) -> u32 {
        self.outline.size.largest_epoch
    }

    /// Window `id`.
    pub fn window(&self, id: WindowId) -> Option<Window> {
        self.sections.windows.get(id.index()).map(Window::from_bytes)
    }

    /// All windows in display order.
    pub fn windows(&self) -> impl ExactSizeIterator<Item = Window> + use<'a> {
        self.sections.windows.iter().map(Window::from_bytes)
    }

    /// The clusters of `epoch`, an epoch of this manifest.
    fn clusters(&self, epoch: &Epoch) -> Option<&'a [[u8; Cluster::BYTES]]> {
        let (_, from) = self.sections.clusters.split_at_checked(epoch.first_cluster as usize)?;
        from.get(..epoch.clusters as usize)
    }

    /// Cluster `id` of `epoch`.
    pub fn cluster(&self, epoch: EpochId, id: ClusterId) -> Option<Cluster> {
        self.clusters(&self.epoch(epoch)?)?.get(id.index()).map(Cluster::from_bytes)
    }

    /// How cluster `cluster` moves in `window` (`dgs1`).
    pub fn motion(&self, window: WindowId, cluster: ClusterId) -> Option<Motion> {
        let record = self.window(window)?;
        let epoch = self.epoch(EpochId(record.epoch))?;
        if u32::from(cluster.0) >= epoch.clusters {
            return None;
        }
        let index = record.first_cell as usize + cluster.index();
        self.sections.motions.get(index).map(Motion::from_bytes)
    }

    /// Number of motion cells: windows × clusters of their epochs.
    pub const fn motion_cells(&self) -> usize {
        self.outline.size.motion_cells
    }

    /// Number of cells of the lattice: canonical, then motion.
    pub const fn cells(&self) -> usize {
        self.head().clusters as usize + self.motion_cells()
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
                (self.epoch(EpochId(window.epoch))?, self.head().clusters + window.first_cell)
            }
        };
        (u32::from(cluster.0) < epoch.clusters).then_some(CellId(first + u32::from(cluster.0)))
    }

    /// Canonical blocks of the epoch that has most.
    pub const fn largest_blocks(&self) -> u32 {
        self.outline.size.largest_blocks
    }

    /// Blocks of all cells: the bytes of a state. May exceed 32 bits, which caps refuse.
    pub const fn state_blocks(&self) -> u64 {
        self.outline.size.state_blocks
    }

    /// Quantisation profile `index`.
    pub fn quant(&self, index: u8) -> Option<Quant> {
        self.sections.quants.get(usize::from(index)).map(Quant::from_bytes)
    }

    /// The tables that runs of stream `stream` choose from: an empty set if it never occurs. There is one
    /// for each [`stream`](super::stream) of `dgs1`.
    pub fn table_set(&self, stream: usize) -> Option<TableSet> {
        self.sections.table_sets.get(stream).map(TableSet::from_bytes)
    }

    /// Clusters of the epoch that `span` is or lies in, if there is such a span.
    pub fn clusters_of(&self, span: Span) -> Option<u32> {
        Some(self.epoch(self.epoch_of(span)?)?.clusters)
    }

    /// The epoch that `span` is or lies in.
    pub fn epoch_of(&self, span: Span) -> Option<EpochId> {
        match span {
            Span::Canonical(id) => Some(id),
            Span::Motion(id) => self.window(id).map(|w| EpochId(w.epoch)),
        }
    }

    /// The slices of `extent`, in order: cluster, and its blocks inside the extent. Clusters that
    /// carry nothing at the level are among them. An extent past the span's end stops there; one of a
    /// span that does not exist has none.
    pub fn slices(&self, extent: Extent) -> Option<impl Iterator<Item = (ClusterId, Range<u32>)> + use<'a>> {
        let clusters = self.clusters(&self.epoch(self.epoch_of(extent.span)?)?)?;
        let (start, end) = (extent.first, extent.first.saturating_add(extent.blocks));
        let block_len = self.block_len();
        let mut before = 0u32;
        let slices = (0..).zip(clusters).map(move |(c, bytes)| {
            let (first, last) = (before, before + Cluster::from_bytes(bytes).blocks(block_len));
            before = last;
            let local = |block: u32| block.min(last).max(first) - first;
            (ClusterId(c), local(start)..local(end))
        });
        Some(slices.filter(|(_, blocks)| !blocks.is_empty()))
    }

    /// The proxy of canonical block `block`, counted over all clusters of all epochs; `None` if the
    /// stream has no proxies.
    ///
    /// # Errors
    /// A block that there is not.
    pub fn proxy(&self, block: usize) -> Result<Option<Proxy>> {
        let blocks = self.outline.size.blocks as usize;
        if self.sections.proxies.is_empty() {
            return Ok(None);
        }
        if block >= blocks {
            let last = blocks as u64 - 1;
            return Err(Error::illegal("manifest.proxies", 0, block as u64, (0, last)));
        }
        let mut bytes = [0; Proxy::BYTES];
        for (plane, byte) in bytes.iter_mut().enumerate() {
            let at = plane * blocks + block;
            let short = Error::short("manifest.proxies", at, self.sections.proxies.len(), at + 1);
            *byte = *self.sections.proxies.get(at).ok_or(short)?;
        }
        Ok(Some(Proxy::from_bytes(bytes)))
    }

    /// All entropy tables of `dgs1`, in order.
    pub fn tables(&self) -> impl Iterator<Item = Result<Table>> + use<'a> {
        let mut reader = Reader::new(self.sections.tables);
        (0..self.head().tables).map(move |_| Table::read(&mut reader))
    }

    /// Low and high byte table of a `paper` group; `cluster` counts over all epochs.
    ///
    /// # Errors
    /// A group that there is not, or a coder without tables.
    pub fn byte_tables(&self, cluster: usize, level: Level) -> Result<[ByteTable; 2]> {
        let (pairs, _) = self.sections.byte_tables.as_chunks::<2>();
        let group = cluster * Level::COUNT + level.index();
        let last = (pairs.len() as u64).saturating_sub(1);
        let none = Error::illegal("manifest.byte_tables", 0, group as u64, (0, last));
        let [low, high] = pairs.get(group).ok_or(none.kind(ErrorKind::Contradiction))?;
        Ok([ByteTable::from_bytes(low)?, ByteTable::from_bytes(high)?])
    }

    /// All repair ranges.
    pub fn repairs(&self) -> impl ExactSizeIterator<Item = Repair> + use<'a> {
        self.sections.repairs.iter().map(Repair::from_bytes)
    }

    /// The last repair range for which `first` is at most `id`, and its index; `first` is one of the
    /// fields that ascend from range to range.
    pub(crate) fn repair_at(&self, id: u32, first: impl Fn(&Repair) -> u32) -> Option<(usize, Repair)> {
        let repairs = self.sections.repairs;
        let past = repairs.partition_point(|bytes| first(&Repair::from_bytes(bytes)) <= id);
        let index = past.checked_sub(1)?;
        Some((index, Repair::from_bytes(repairs.get(index)?)))
    }

    /// Value `index` of the window bases (`dgs1`), scaled to −2..2.
    pub fn basis(&self, index: usize) -> Option<f32> {
        let value = i16::from_le_bytes(*self.sections.window_basis.get(index)?);
        Some(f32::from(value) * (1.0 / 16384.0))
    }

    /// Value `index` of the epoch bases (`paper`).
    pub fn paper_basis(&self, index: usize) -> Option<f32> {
        self.sections.epoch_basis.get(index).copied().map(f32::from_le_bytes)
    }

    /// Value `index` of the cluster transforms (`paper`).
    pub fn transform_value(&self, index: usize) -> Option<f32> {
        self.sections.transforms.get(index).copied().map(f32::from_le_bytes)
    }

    /// The epoch that `frame` lies in.
    pub fn epoch_at(&self, frame: u32) -> Option<EpochId> {
        let found = self.sections.epochs.binary_search_by(|bytes| {
            let epoch = Epoch::from_bytes(bytes);
            order(epoch.first_frame, epoch.frames, frame)
        });
        found.ok().map(|e| EpochId(e as u16))
    }

    /// The window that `frame` lies in.
    pub fn window_at(&self, frame: u32) -> Option<WindowId> {
        let found = self.sections.windows.binary_search_by(|bytes| {
            let window = Window::from_bytes(bytes);
            order(window.first_frame, window.frames.into(), frame)
        });
        found.ok().map(|w| WindowId(w as u16))
    }
}

/// Where `frames` frames from `first` on lie as seen from `frame`.
fn order(first: u32, frames: u32, frame: u32) -> Ordering {
    match frame.checked_sub(first) {
        None => Ordering::Greater,
        Some(inside) if inside >= frames => Ordering::Less,
        Some(_) => Ordering::Equal,
    }
}
