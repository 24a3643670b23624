//! What a manifest body must satisfy before a view of it exists.

use super::{
    Cluster, Epoch, Head, Manifest, Motion, Profile, Quant, Repair, TableSet, Track, Window, byte_tables,
    stream,
};
use crate::{
    cursor::{Reader, in_range},
    error::{Error, ErrorKind, Result},
    gaussian::ShDegree,
    ids::{ClusterId, EpochId, Level, PacketId, WindowId},
    limits,
    quant::{Class, Quantiser},
};

impl<'a> Manifest<'a> {
    /// Checks epochs, windows and clusters; returns the number of motion cells.
    pub(super) fn check_lattice(&self) -> Result<usize> {
        let at = |section: usize, index: usize, bytes: usize| section + index * bytes;
        let (mut frame, mut cluster, mut window) = (0u32, 0u32, 0u32);
        let mut cell = 0u64;
        for (e, epoch) in self.epochs().enumerate() {
            let place = at(self.sections.epochs, e, Epoch::BYTES);
            in_range("epoch.first_frame", place, epoch.first_frame, frame, frame)?;
            in_range("epoch.frames", place, epoch.frames, 1, self.head.frames - frame)?;
            in_range("epoch.gaussians", place, epoch.gaussians, 0, limits::MAX_EPOCH_GAUSSIANS)?;
            in_range("epoch.first_cluster", place, epoch.first_cluster, cluster, cluster)?;
            in_range("epoch.clusters", place, epoch.clusters, 0, self.head.clusters - cluster)?;
            in_range("epoch.clusters", place, epoch.clusters, 0, u32::from(u16::MAX))?;
            in_range("epoch.first_window", place, epoch.first_window, window, window)?;
            in_range("epoch.windows", place, epoch.windows, 0, u32::from(self.head.windows) - window)?;
            for origin in [epoch.origin_x, epoch.origin_y, epoch.origin_z] {
                finite("epoch.origin", place, origin)?;
            }
            let mut gaussians = 0u64;
            for c in 0..epoch.clusters {
                let place = at(self.sections.clusters, (cluster + c) as usize, Cluster::BYTES);
                let record = Cluster::read(&mut Reader::at(self.raw, place))?;
                let most = limits::MAX_CLUSTER_LEN as u16;
                in_range("cluster.gaussians", place, record.gaussians, 1, most)?;
                let quants = (self.head.quants - 1).min(255) as u8;
                in_range("cluster.quant", place, record.quant, 0, quants)?;
                in_range("cluster.kind", place, record.kind, 0, Cluster::MAX_KIND)?;
                in_range("cluster.sh_degree", place, record.sh_degree(), 0, self.head.sh_degree)?;
                in_range("cluster.radius", place, record.radius, 1, u16::MAX)?;
                gaussians += u64::from(record.gaussians);
            }
            let all = u64::from(epoch.gaussians);
            in_range("epoch.gaussians", place, all, gaussians, gaussians)
                .map_err(|e| e.kind(ErrorKind::Contradiction))?;
            let mut window_frame = frame;
            for w in 0..epoch.windows {
                let place = at(self.sections.windows, (window + w) as usize, Window::BYTES);
                let record = Window::read(&mut Reader::at(self.raw, place))?;
                in_range("window.epoch", place, record.epoch, e as u16, e as u16)?;
                in_range("window.first_frame", place, record.first_frame, window_frame, window_frame)?;
                let left = (frame + epoch.frames - window_frame).min(limits::MAX_WINDOW_FRAMES as u32);
                in_range("window.frames", place, u32::from(record.frames), 1, left)?;
                in_range("window.first_cell", place, u64::from(record.first_cell), cell, cell)?;
                let values = u64::from(record.rank) * u64::from(record.frames);
                self.check_basis("window.basis_first", place, record.basis_first, values)?;
                in_range("window.rank", place, u16::from(record.rank), 0, record.frames)?;
                window_frame += u32::from(record.frames);
                cell += u64::from(epoch.clusters);
            }
            if epoch.windows > 0 {
                let covered = window_frame - frame;
                in_range("epoch.frames", place, epoch.frames, covered, covered)
                    .map_err(|e| e.kind(ErrorKind::Contradiction))?;
            }
            if self.profile == Profile::Paper {
                in_range("epoch.windows", place, epoch.windows, 0, 0)?;
                in_range("epoch.rank", place, epoch.rank, 0, limits::MAX_RANK as u8)?;
                let frames = u64::from(epoch.frames);
                self.check_basis(
                    "epoch.basis_first",
                    place,
                    epoch.basis_first,
                    frames * u64::from(epoch.rank),
                )?;
                let (all, values) = (self.head.transform_values, frames * u64::from(epoch.clusters) * 12);
                let fields = ("epoch.transform_first", "manifest.transforms");
                check_part(fields, place, epoch.transform_first, values, all)?;
            }
            frame += epoch.frames;
            cluster += epoch.clusters;
            window += epoch.windows;
        }
        for (field, found, all) in [
            ("manifest.frames", frame, self.head.frames),
            ("manifest.clusters", cluster, self.head.clusters),
            ("manifest.windows", window, u32::from(self.head.windows)),
        ] {
            in_range(field, 0, found, all, all).map_err(|e| e.kind(ErrorKind::Contradiction))?;
        }
        in_range("manifest.cells", 0, cell, 0, u64::from(limits::MAX_CLUSTERS) * 64)?;
        Ok(cell as usize)
    }

    /// Reads each record once with its errors kept: accessors take an unreadable record for an
    /// absent one.
    fn check_reserved(&self) -> Result<()> {
        let Head { epochs, windows, repairs, .. } = self.head;
        self.each(self.sections.epochs, usize::from(epochs), Epoch::BYTES, Epoch::read)?;
        self.each(self.sections.windows, usize::from(windows), Window::BYTES, Window::read)?;
        self.each(self.sections.motions, self.motion_cells(), Motion::BYTES, Motion::read)?;
        let table_sets = if self.profile == Profile::Dgs1 { stream::COUNT } else { 0 };
        self.each(self.sections.streams, table_sets, TableSet::BYTES, TableSet::read)?;
        self.each(self.sections.repairs, usize::from(repairs), Repair::BYTES, Repair::read)
    }

    fn each<T>(
        &self,
        section: usize,
        count: usize,
        bytes: usize,
        read: impl Fn(&mut Reader<'a>) -> Result<T>,
    ) -> Result<()> {
        for index in 0..count {
            let place = section + index * bytes;
            read(&mut Reader::at(self.raw, place))?;
        }
        Ok(())
    }

    pub(super) fn check_records(&self) -> Result<()> {
        self.check_reserved()?;
        self.check_motions()?;
        self.check_quants()?;
        if self.profile == Profile::Dgs1 {
            self.check_table_sets()?;
        }
        self.check_repairs()?;
        self.check_values()
    }

    fn check_motions(&self) -> Result<()> {
        for (w, window) in self.windows().enumerate() {
            let epoch = self.epoch(EpochId(window.epoch)).unwrap_or_default();
            for c in 0..epoch.clusters {
                let index = window.first_cell as usize + c as usize;
                let place = self.sections.motions + index * Motion::BYTES;
                let motion = self.motion(WindowId(w as u16), ClusterId(c as u16)).unwrap_or_default();
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

    fn check_quants(&self) -> Result<()> {
        for index in 0..usize::from(self.head.quants) {
            let place = self.sections.quants + index * Quant::BYTES;
            let quant = Quant::read(&mut Reader::at(self.raw, place))?;
            let classes = Class::ALL.map(|class| self.profile == Profile::Dgs1 && class.decorrelates());
            let may = classes.into_iter().chain([false; Class::MOVING]);
            for ((q, quantiser), may) in quant.canonical.iter().chain(&quant.motion).enumerate().zip(may) {
                let place = place + q * Quantiser::BYTES;
                if !may && quantiser.decorrelated() {
                    in_range("quantiser.flags", place, quantiser.flags(), 0, 1)?;
                }
                if self.profile == Profile::Dgs1 {
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

    fn check_table_sets(&self) -> Result<()> {
        for s in 0..stream::COUNT {
            let place = self.sections.streams + s * TableSet::BYTES;
            let unknown = |&(table, _): &(u8, u8)| u16::from(table) >= self.head.tables;
            if let Some((table, _)) = self.table_set(s).choices().find(unknown) {
                let last = u64::from(self.head.tables).saturating_sub(1);
                return Err(Error::illegal("table_set.tables", place, table.into(), (0, last)));
            }
        }
        Ok(())
    }

    /// Ranges ascend and do not overlap, neither in what they protect nor in their parity packets: a
    /// packet belongs to one set, and all ranges together are no larger than the stream.
    fn check_repairs(&self) -> Result<()> {
        let all = self.head.packets;
        let (mut protected_end, mut parity_end) = (0u32, 0u32);
        for (r, repair) in self.repairs().enumerate() {
            let place = self.sections.repairs + r * Repair::BYTES;
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

    fn check_values(&self) -> Result<()> {
        for index in 0..self.head.transform_values as usize {
            finite("manifest.transforms", self.sections.transforms + 4 * index, self.transform_value(index))?;
        }
        if self.profile == Profile::Paper {
            for index in 0..self.head.basis_values as usize {
                finite("manifest.basis", self.sections.basis + 4 * index, self.paper_basis(index))?;
            }
            for index in 0..byte_tables(&self.head) {
                self.read_byte_table(index)?;
            }
        }
        Ok(())
    }

    fn check_basis(&self, field: &'static str, place: usize, first: u32, values: u64) -> Result<()> {
        check_part((field, "manifest.basis"), place, first, values, self.head.basis_values)
    }
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

pub(super) fn check_head(head: &Head) -> Result<()> {
    let in32 = |field, at, value: u32, low, high| in_range(field, at, value, low, high).map(|_| ());
    in32("manifest.sh_degree", 1, head.sh_degree.into(), 0, ShDegree::MAX.get().into())?;
    in32("manifest.block_len", 2, head.block_len.into(), 1, limits::MAX_BLOCK_LEN as u32)?;
    in32("manifest.frames", 4, head.frames, 1, limits::MAX_FRAMES)?;
    in32("manifest.rate_frames", 8, head.rate_frames, 1, 1_000_000_000)?;
    in32("manifest.rate_seconds", 12, head.rate_seconds, 1, 1_000_000_000)?;
    in32("manifest.packets", 16, head.packets, 0, crate::ids::PacketId::MAX)?;
    in32("manifest.epochs", 20, head.epochs.into(), 1, limits::MAX_EPOCHS as u32)?;
    in32("manifest.windows", 22, head.windows.into(), 0, limits::MAX_WINDOWS as u32)?;
    in32("manifest.clusters", 24, head.clusters, 0, limits::MAX_CLUSTERS)?;
    in32("manifest.quants", 28, head.quants.into(), 1, limits::MAX_QUANT_PROFILES as u32)?;
    in32("manifest.tables", 30, head.tables.into(), 0, limits::MAX_TABLES as u32)?;
    in32("manifest.proxies", 34, head.proxies.into(), 0, u32::from(head.profile == Profile::Dgs1 as u8))?;
    in32("manifest.basis_values", 36, head.basis_values, 0, limits::MAX_MANIFEST_BYTES as u32 / 4)?;
    in32("manifest.transform_values", 40, head.transform_values, 0, limits::MAX_MANIFEST_BYTES as u32 / 4)
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
