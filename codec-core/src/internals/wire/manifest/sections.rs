//! Cuts an unpacked manifest body into its sections, each an array of records.

use super::{
    profile::Profile,
    proxy::Proxy,
    record::{Cluster, Epoch, Head, Motion, Quant, Repair, Window},
    stream,
    table_set::TableSet,
};
use crate::{
    cursor::Reader,
    error::{Error, Result},
    ids::Level,
    quant::Quantiser,
    rans::bytes,
};

/// One quantisation profile: its quantisers.
pub(super) type QuantRecord = [[u8; Quantiser::BYTES]; Quant::QUANTISERS];

/// Sizes of the lattice that the head does not say.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LatticeSize {
    /// Windows × clusters of their epochs.
    pub motion_cells: usize,
    /// Canonical blocks of all epochs.
    pub blocks: u64,
    /// Blocks of all cells, motion included.
    pub state_blocks: u64,
    /// Canonical blocks of the epoch that has most.
    pub largest_blocks: u32,
    /// Gaussians of the largest epoch.
    pub largest_epoch: u32,
}

/// The sections, in the order in which they lie; those that a profile has not are empty.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sections<'a> {
    pub epochs: &'a [[u8; Epoch::BYTES]],
    pub windows: &'a [[u8; Window::BYTES]],
    pub clusters: &'a [[u8; Cluster::BYTES]],
    pub motions: &'a [[u8; Motion::BYTES]],
    pub quants: &'a [QuantRecord],
    pub table_sets: &'a [[u8; TableSet::BYTES]],
    pub repairs: &'a [[u8; Repair::BYTES]],
    /// Bases of windows (`dgs1`).
    pub window_basis: &'a [[u8; 2]],
    /// Bases of epochs (`paper`).
    pub epoch_basis: &'a [[u8; 4]],
    pub transforms: &'a [[u8; 4]],
    pub byte_tables: &'a [[u8; bytes::TABLE_BYTES]],
    /// Plane after plane, each a byte per block.
    pub proxies: &'a [u8],
    /// Entropy tables, which differ in length.
    pub tables: &'a [u8],
}

impl<'a> Sections<'a> {
    /// The first sections: epochs, windows and clusters. What is behind them follows from those.
    ///
    /// # Errors
    /// Short bytes.
    pub fn lattice(reader: &mut Reader<'a>, head: &Head) -> Result<Self> {
        Ok(Self {
            epochs: records(reader, "manifest.epochs", u64::from(head.epochs))?,
            windows: records(reader, "manifest.windows", u64::from(head.windows))?,
            clusters: records(reader, "manifest.clusters", u64::from(head.clusters))?,
            ..Self::default()
        })
    }

    /// These and all others, which `reader` goes on to.
    ///
    /// # Errors
    /// Short bytes.
    pub fn with_others(self, mut reader: Reader<'a>, head: &Head, size: &LatticeSize) -> Result<Self> {
        let reader = &mut reader;
        let is_dgs1 = head.profile == Profile::Dgs1 as u8;
        let has_byte_tables = head.profile == Profile::Paper as u8;
        let only = |is: bool, count: u64| if is { count } else { 0 };
        let streams = only(is_dgs1, stream::COUNT as u64);
        let basis = u64::from(head.basis_values);
        let byte_tables = only(has_byte_tables, u64::from(head.clusters) * Level::COUNT as u64 * 2);
        let quantisers = u64::from(head.quants) * Quant::QUANTISERS as u64;
        let proxies = only(head.proxies == 1, size.blocks);
        Ok(Self {
            motions: records(reader, "manifest.motions", size.motion_cells as u64)?,
            quants: records::<{ Quantiser::BYTES }>(reader, "manifest.quants", quantisers)?.as_chunks().0,
            table_sets: records(reader, "manifest.streams", streams)?,
            repairs: records(reader, "manifest.repairs", u64::from(head.repairs))?,
            window_basis: records(reader, "manifest.basis", only(is_dgs1, basis))?,
            epoch_basis: records(reader, "manifest.basis", only(!is_dgs1, basis))?,
            transforms: records(reader, "manifest.transforms", u64::from(head.transform_values))?,
            byte_tables: records(reader, "manifest.byte_tables", byte_tables)?,
            proxies: records::<{ Proxy::BYTES }>(reader, "manifest.proxies", proxies)?.as_flattened(),
            tables: reader.bytes("manifest.tables", reader.left())?,
            ..self
        })
    }
}

/// The next `count` records of `N` bytes.
fn records<'a, const N: usize>(
    reader: &mut Reader<'a>,
    field: &'static str,
    count: u64,
) -> Result<&'a [[u8; N]]> {
    let len = count * N as u64;
    let Ok(len) = usize::try_from(len) else {
        // More than an address space holds.
        return Err(Error { allowed: (len, len), ..Error::short(field, reader.offset(), reader.left(), 0) });
    };
    Ok(reader.bytes(field, len)?.as_chunks().0)
}
