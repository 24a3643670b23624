//! Says what a manifest body must satisfy before a view of it exists.

use core::num::NonZero;

use super::{
    profile::Profile,
    record::{Cluster, Epoch, Head, Motion, Quant, Repair, Track, Window, block_len},
    sections::{LatticeSize, QuantRecord, Sections},
    table_set::TableSet,
};
use crate::{
    cursor::{Reader, in_range},
    error::{Error, ErrorKind, Result},
    footprint::Footprint,
    gaussian::ShDegree,
    ids::{Level, PacketId},
    limits,
    quant::{Class, Quantiser},
    rans::{bytes::ByteTable, table::Table},
    up::Up,
};

/// Records of a section with their offsets, the first of which is `start`.
fn placed<const N: usize>(records: &[[u8; N]], start: usize) -> impl Iterator<Item = (usize, &[u8; N])> {
    records.iter().enumerate().map(move |(index, bytes)| (start + index * N, bytes))
}

/// Fields of values, and the sections that the values lie in.
const BASIS_OF_WINDOW: (&str, &str) = ("window.basis_first", "manifest.basis");
const BASIS_OF_EPOCH: (&str, &str) = ("epoch.basis_first", "manifest.basis");
const TRANSFORMS: (&str, &str) = ("epoch.transform_first", "manifest.transforms");

/// Checks epochs, windows and clusters, whose blocks have `block_len` Gaussians; gives their sizes.
pub(super) fn check_lattice(
    sections: &Sections<'_>,
    head: &Head,
    profile: Profile,
    block_len: NonZero<u32>,
) -> Result<LatticeSize> {
    let windows_start = Head::BYTES + sections.epochs.as_flattened().len();
    let clusters_start = windows_start + sections.windows.as_flattened().len();
    let mut clusters = placed(sections.clusters, clusters_start);
    let mut windows = placed(sections.windows, windows_start);
    let (mut frame, mut cluster, mut window) = (0u32, 0u32, 0u32);
    let (mut cell, mut size) = (0u64, LatticeSize::default());
    for (e, (place, bytes)) in placed(sections.epochs, Head::BYTES).enumerate() {
        Epoch::check_reserved(bytes, place)?;
        let epoch = Epoch::from_bytes(bytes);
        in_range("epoch.first_frame", place, epoch.first_frame, frame, frame)?;
        in_range("epoch.frames", place, epoch.frames, 1, head.frames - frame)?;
        in_range("epoch.gaussians", place, epoch.gaussians, 0, limits::MAX_EPOCH_GAUSSIANS)?;
        in_range("epoch.first_cluster", place, epoch.first_cluster, cluster, cluster)?;
        in_range("epoch.clusters", place, epoch.clusters, 0, head.clusters - cluster)?;
        in_range("epoch.clusters", place, epoch.clusters, 0, u32::from(u16::MAX))?;
        in_range("epoch.first_window", place, epoch.first_window, window, window)?;
        in_range("epoch.windows", place, epoch.windows, 0, u32::from(head.windows) - window)?;
        for origin in [epoch.origin_x, epoch.origin_y, epoch.origin_z] {
            finite("epoch.origin", place, origin)?;
        }
        let (mut gaussians, mut blocks) = (0u64, 0u32);
        for (place, bytes) in clusters.by_ref().take(epoch.clusters as usize) {
            let record = Cluster::from_bytes(bytes);
            let most = limits::MAX_CLUSTER_LEN as u16;
            in_range("cluster.gaussians", place, record.gaussians, 1, most)?;
            in_range("cluster.quant", place, u16::from(record.quant), 0, head.quants - 1)?;
            in_range("cluster.kind", place, record.kind, 0, Cluster::MAX_KIND)?;
            in_range("cluster.sh_degree", place, record.sh_degree(), 0, head.sh_degree)?;
            in_range("cluster.radius", place, record.radius, 1, u16::MAX)?;
            gaussians += u64::from(record.gaussians);
            blocks += record.blocks(block_len);
        }
        let all = u64::from(epoch.gaussians);
        in_range("epoch.gaussians", place, all, gaussians, gaussians)
            .map_err(|e| e.kind(ErrorKind::Contradiction))?;
        let mut window_frame = frame;
        for (place, bytes) in windows.by_ref().take(epoch.windows as usize) {
            Window::check_reserved(bytes, place)?;
            let record = Window::from_bytes(bytes);
            in_range("window.epoch", place, record.epoch, e as u16, e as u16)?;
            in_range("window.first_frame", place, record.first_frame, window_frame, window_frame)?;
            let left = (frame + epoch.frames - window_frame).min(limits::MAX_WINDOW_FRAMES as u32);
            in_range("window.frames", place, u32::from(record.frames), 1, left)?;
            in_range("window.first_cell", place, u64::from(record.first_cell), cell, cell)?;
            let values = u64::from(record.rank) * u64::from(record.frames);
            check_part(BASIS_OF_WINDOW, place, record.basis_first, values, head.basis_values)?;
            in_range("window.rank", place, u16::from(record.rank), 0, record.frames)?;
            window_frame += u32::from(record.frames);
            cell += u64::from(epoch.clusters);
        }
        if epoch.windows > 0 {
            let covered = window_frame - frame;
            in_range("epoch.frames", place, epoch.frames, covered, covered)
                .map_err(|e| e.kind(ErrorKind::Contradiction))?;
        }
        if profile == Profile::Paper {
            in_range("epoch.windows", place, epoch.windows, 0, 0)?;
            in_range("epoch.rank", place, epoch.rank, 0, limits::MAX_RANK as u8)?;
            let frames = u64::from(epoch.frames);
            let values = frames * u64::from(epoch.rank);
            check_part(BASIS_OF_EPOCH, place, epoch.basis_first, values, head.basis_values)?;
            let values = frames * u64::from(epoch.clusters) * 12;
            check_part(TRANSFORMS, place, epoch.transform_first, values, head.transform_values)?;
        }
        size.blocks += u64::from(blocks);
        // Each window has a motion cell for every cluster of its epoch.
        size.state_blocks += u64::from(blocks) * (1 + u64::from(epoch.windows));
        size.largest_blocks = size.largest_blocks.max(blocks);
        size.largest_epoch = size.largest_epoch.max(epoch.gaussians);
        frame += epoch.frames;
        cluster += epoch.clusters;
        window += epoch.windows;
    }
    for (field, found, all) in [
        ("manifest.frames", frame, head.frames),
        ("manifest.clusters", cluster, head.clusters),
        ("manifest.windows", window, u32::from(head.windows)),
    ] {
        in_range(field, 0, found, all, all).map_err(|e| e.kind(ErrorKind::Contradiction))?;
    }
    in_range("manifest.cells", 0, cell, 0, u64::from(limits::MAX_CLUSTERS) * 64)?;
    Ok(LatticeSize { motion_cells: cell as usize, ..size })
}

/// Checks what lies behind the lattice: each section in turn, the last of which ends at `end`.
pub(super) fn check_records(
    sections: &Sections<'_>,
    head: &Head,
    profile: Profile,
    end: usize,
) -> Result<()> {
    let lattice = sections.epochs.as_flattened().len()
        + sections.windows.as_flattened().len()
        + sections.clusters.as_flattened().len();
    let mut place = Head::BYTES + lattice;
    check_motions(sections, place)?;
    place += sections.motions.as_flattened().len();
    check_quants(sections.quants, profile, place)?;
    place += size_of_val(sections.quants);
    check_table_sets(sections.table_sets, head, place)?;
    place += sections.table_sets.as_flattened().len();
    check_repairs(sections.repairs, head, place)?;
    place += sections.repairs.as_flattened().len() + sections.window_basis.as_flattened().len();
    check_finite("manifest.basis", sections.epoch_basis, place)?;
    place += sections.epoch_basis.as_flattened().len();
    check_finite("manifest.transforms", sections.transforms, place)?;
    place += sections.transforms.as_flattened().len();
    for (place, bytes) in placed(sections.byte_tables, place) {
        ByteTable::from_bytes(bytes).map_err(|e| Error { offset: place as u32, ..e })?;
    }
    let start = end - sections.tables.len();
    let in_body = |e: Error| Error { offset: e.offset + start as u32, ..e };
    let mut reader = Reader::new(sections.tables);
    for _ in 0..head.tables {
        Table::read(&mut reader).map_err(in_body)?;
    }
    reader.finish("manifest.leftover").map_err(in_body)
}

/// Checks the motion of every cluster in every window; they lie in order of the windows.
fn check_motions(sections: &Sections<'_>, start: usize) -> Result<()> {
    let mut motions = placed(sections.motions, start);
    for window in sections.windows.iter().map(Window::from_bytes) {
        let last = (sections.epochs.len() as u64).saturating_sub(1);
        let none = Error::illegal("window.epoch", 0, window.epoch.into(), (0, last));
        let bytes = sections.epochs.get(usize::from(window.epoch)).ok_or(none)?;
        let clusters = Epoch::from_bytes(bytes).clusters as usize;
        for (place, bytes) in motions.by_ref().take(clusters) {
            let motion = Motion::from_bytes(bytes);
            in_range("motion.kind", place, motion.kind, 0, Motion::kind_of(Track::Affine, Level::BASE))?;
            in_range("motion.track_class", place, motion.kind & 3, 0, Track::Affine as u8)?;
            in_range("motion.track_shift", place, motion.track_shift, 0, 24)?;
            let least = u16::from(motion.class() != Track::Static);
            in_range("motion.track", place, u16::from(motion.track), least, least * window.frames)?;
            in_range("motion.position", place, motion.position, 0, window.rank)?;
            for rank in [motion.scale, motion.rotation, motion.opacity, motion.sh0] {
                in_range("motion.rank", place, u16::from(rank), 0, window.frames)?;
            }
        }
    }
    Ok(())
}

/// Checks quantisers: which flags a class may have, and that ratios of `dgs1` are odd.
fn check_quants(profiles: &[QuantRecord], profile: Profile, start: usize) -> Result<()> {
    for (index, quantisers) in profiles.iter().enumerate() {
        let classes = Class::ALL.map(|class| profile == Profile::Dgs1 && class.decorrelates());
        let may = classes.into_iter().chain([false; Class::MOVING]);
        for ((place, bytes), may) in placed(quantisers, start + index * Quant::BYTES).zip(may) {
            let quantiser = Quantiser::check(*bytes, place)?;
            if !may && quantiser.decorrelated() {
                in_range("quantiser.flags", place, quantiser.flags(), 0, 1)?;
            }
            if profile == Profile::Dgs1 {
                for ratio in Level::ALL.map(|level| quantiser.ratio(level)) {
                    // Ratios are odd; what is allowed in place of an even one is the next below it.
                    let odd = ratio - 1 + ratio % 2;
                    in_range("quantiser.ratio", place, ratio, odd, odd)?;
                }
            }
        }
    }
    Ok(())
}

/// Checks that table sets are complete codes of tables that there are.
fn check_table_sets(sets: &[[u8; TableSet::BYTES]], head: &Head, start: usize) -> Result<()> {
    for (place, bytes) in placed(sets, start) {
        let set = TableSet::from_bytes(bytes);
        set.check(place)?;
        let unknown = |&(table, _): &(u8, u8)| u16::from(table) >= head.tables;
        if let Some((table, _)) = set.choices().find(unknown) {
            let Some(last) = head.tables.checked_sub(1) else {
                return Err(Error::illegal("table_set.count", place, set.choices().count() as u64, (0, 0)));
            };
            return Err(Error::illegal("table_set.tables", place, table.into(), (0, last.into())));
        }
    }
    Ok(())
}

/// Ranges ascend and do not overlap, neither in what they protect nor in their parity packets: a
/// packet belongs to one set, and all ranges together are no larger than the stream.
fn check_repairs(repairs: &[[u8; Repair::BYTES]], head: &Head, start: usize) -> Result<()> {
    let all = head.packets;
    let (mut protected_end, mut parity_end) = (0u32, 0u32);
    for (place, bytes) in placed(repairs, start) {
        let repair = Repair::from_bytes(bytes);
        let most = limits::MAX_REPAIR_SET as u8;
        in_range("repair.set_len", place, repair.set_len, 2, most)?;
        in_range("repair.parity", place, repair.parity, 1, limits::MAX_REPAIR_PARITY as u8)?;
        in_range("repair.longest", place, repair.longest, 1, limits::MAX_PACKET_BYTES as u16)?;
        in_range("repair.first_packet", place, repair.first_packet, protected_end, all)?;
        in_range("repair.packets", place, repair.packets, 1, all - repair.first_packet)?;
        let (rows, most) = (repair.parity_packets(), u64::from(PacketId::MAX));
        in_range("manifest.packets", place, u64::from(all), u64::from(parity_end) + rows, most)?;
        let (first, last) = (u64::from(repair.first_parity), u64::from(all) - rows);
        in_range("repair.first_parity", place, first, parity_end.into(), last)?;
        protected_end = repair.first_packet + repair.packets;
        parity_end = repair.first_parity + repair.parity_packets() as u32;
    }
    Ok(())
}

/// Checks that every one of `values` is a number of some reasonable size.
fn check_finite(field: &'static str, values: &[[u8; 4]], start: usize) -> Result<()> {
    for (place, bytes) in placed(values, start) {
        finite(field, place, f32::from_le_bytes(*bytes))?;
    }
    Ok(())
}

/// Checks that `values` values from `first` on lie among `all`; the two `fields` are that of `first`
/// and the section, which is to blame where no `first` would do.
fn check_part(
    fields: (&'static str, &'static str),
    place: usize,
    first: u32,
    values: u64,
    all: u32,
) -> Result<()> {
    let Some(last) = u64::from(all).checked_sub(values) else {
        return Err(Error::illegal(fields.1, place, all.into(), (values, limits::MAX_MANIFEST_BYTES as u64)));
    };
    in_range(fields.0, place, u64::from(first), 0, last).map(|_| ())
}

/// Checks the head's numbers on their own; gives the harmonic degree, the block length, the footprint and
/// which way is up.
pub(super) fn check_head(head: &Head) -> Result<(ShDegree, NonZero<u32>, Footprint, Up)> {
    let in32 = |field, at, value: u32, low, high| in_range(field, at, value, low, high).map(|_| ());
    let degrees = (0, ShDegree::MAX.get().into());
    let illegal = Error::illegal("manifest.sh_degree", 1, head.sh_degree.into(), degrees);
    let sh_degree = ShDegree::new(head.sh_degree).ok_or(illegal)?;
    let block_len = block_len(head.block_len.into())?;
    in32("manifest.frames", 4, head.frames, 1, limits::MAX_FRAMES)?;
    in32("manifest.rate_frames", 8, head.rate_frames, 1, 1_000_000_000)?;
    in32("manifest.rate_seconds", 12, head.rate_seconds, 1, 1_000_000_000)?;
    in32("manifest.packets", 16, head.packets, 0, PacketId::MAX)?;
    in32("manifest.epochs", 20, head.epochs.into(), 1, limits::MAX_EPOCHS as u32)?;
    in32("manifest.windows", 22, head.windows.into(), 0, limits::MAX_WINDOWS as u32)?;
    in32("manifest.clusters", 24, head.clusters, 0, limits::MAX_CLUSTERS)?;
    in32("manifest.quants", 28, head.quants.into(), 1, limits::MAX_QUANT_PROFILES as u32)?;
    in32("manifest.tables", 30, head.tables.into(), 0, limits::MAX_TABLES as u32)?;
    in32("manifest.proxies", 34, head.proxies.into(), 0, u32::from(head.profile == Profile::Dgs1 as u8))?;
    let illegal =
        |field, found: u8, count: usize| Error::illegal(field, 35, found.into(), (0, count as u64 - 1));
    let (low, high) = (head.drawing & 15, head.drawing >> 4);
    let footprint =
        Footprint::numbered(low).ok_or(illegal("manifest.footprint", low, Footprint::ALL.len()))?;
    let up = Up::numbered(high).ok_or(illegal("manifest.up", high, Up::ALL.len()))?;
    in32("manifest.basis_values", 36, head.basis_values, 0, limits::MAX_MANIFEST_BYTES as u32 / 4)?;
    in32("manifest.transform_values", 40, head.transform_values, 0, limits::MAX_MANIFEST_BYTES as u32 / 4)?;
    Ok((sh_degree, block_len, footprint, up))
}

fn finite(field: &'static str, place: usize, value: f32) -> Result<()> {
    // 1e9 scene units is far beyond what f32 positions resolve; it keeps later sums finite.
    if value.is_finite() && (-1e9..=1e9).contains(&value) {
        return Ok(());
    }
    // As a magnitude, rounded up; what is not a number is larger than any.
    let magnitude = if value.is_nan() { u64::MAX } else { libm::ceil(f64::from(value).abs()) as u64 };
    Err(Error::illegal(field, place, magnitude, (0, 1_000_000_000)))
}
