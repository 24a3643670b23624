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

use super::{
    crc::{CRC_BYTES, Crc32, checked, crc32},
    cursor::{Reader, Writer, in_range},
};
use crate::{
    error::{Error, ErrorKind, Result},
    gaussian::ShDegree,
    ids::{CellId, ClusterId, EpochId, Level, Span, WindowId},
    limits,
    pack::{pack, unpack},
    quant::{Class, Quantiser},
    rans::{bytes, table::Table},
};

/// First four bytes of a manifest.
pub const MAGIC: [u8; 4] = *b"DGSM";
/// Version this crate reads and writes.
pub const VERSION: u8 = 1;
/// Bytes before the packed body.
pub const HEADER_BYTES: usize = 16;
/// Table index of a stream that never occurs.
pub const NO_TABLE: u8 = 255;

/// The named sets of format choices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Profile {
    /// The paper's format: all-or-nothing groups, per-frame residuals, byte-wise rANS.
    Paper = 0,
    /// This project's format: slices that decode alone, transformed motion, four-lane rANS.
    Dgs1 = 1,
}

/// Symbol streams of `dgs1`, each with its own table.
pub mod stream {
    use super::{Class, Level};

    /// Streams of the cluster track: (linear, translation, rotation) × three frequency bands.
    pub const TRACK_FIRST: usize = Class::COUNT * Level::COUNT;
    const COEFFICIENT_FIRST: usize = TRACK_FIRST + 9;
    /// Number of streams.
    pub const COUNT: usize = COEFFICIENT_FIRST + Class::MOVING * 3 * 2;

    /// Canonical attribute `class` at `level`.
    pub const fn canonical(class: Class, level: Level) -> usize {
        class.index() * Level::COUNT + level.index()
    }

    /// Track parameter `parameter` (0..9 linear, 9..12 translation, 12..16 rotation) at temporal
    /// frequency `k`.
    pub const fn track(parameter: usize, k: usize) -> usize {
        let kind = match parameter {
            0..=8 => 0,
            9..=11 => 1,
            _ => 2,
        };
        let band = match k {
            0 => 0,
            1..=3 => 1,
            _ => 2,
        };
        TRACK_FIRST + kind * 3 + band
    }

    /// Motion coefficient `k` of `class` (one of the moving ones) at `level` 1..=3.
    pub const fn coefficient(class: Class, level: Level, k: usize) -> usize {
        let level = (level.index() + 2) % 3;
        COEFFICIENT_FIRST + (class.index() % Class::MOVING * 3 + level) * 2 + if k == 0 { 0 } else { 1 }
    }
}

/// Parameters of a cluster track: 9 linear, 3 translation, 4 rotation.
pub const TRACK_PARAMETERS: usize = 16;

macro_rules! record {
    (
        $(#[$doc:meta])*
        $name:ident, $prefix:literal, $bytes:literal { $($(#[$field_doc:meta])* $field:ident: $type:ty = $read:ident),* $(,)? } pad $pad:literal
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        #[cfg_attr(feature = "defmt", derive(defmt::Format))]
        pub struct $name { $($(#[$field_doc])* pub $field: $type),* }

        impl $name {
            /// Bytes of one record.
            pub const BYTES: usize = $bytes;

            /// The record's bytes.
            pub fn to_bytes(&self) -> [u8; $bytes] {
                let mut bytes = [0u8; $bytes];
                let mut at = 0usize;
                $({
                    let field = self.$field.to_le_bytes();
                    bytes[at..at + field.len()].copy_from_slice(&field);
                    at += field.len();
                })*
                debug_assert_eq!(at + $pad, $bytes);
                bytes
            }

            fn read(reader: &mut Reader<'_>) -> Result<Self> {
                let record = Self { $($field: reader.$read(concat!($prefix, stringify!($field)))?),* };
                let start = reader.offset();
                for &byte in reader.bytes(concat!($prefix, "reserved"), $pad)? {
                    in_range(concat!($prefix, "reserved"), start, byte, 0, 0)?;
                }
                Ok(record)
            }
        }
    };
}

record! {
    /// Fixed head of the manifest body.
    Head, "manifest.", 44 {
        /// [`Profile`] as a number.
        profile: u8 = u8,
        /// Highest harmonic degree of any cluster.
        sh_degree: u8 = u8,
        /// Gaussians per block, the last block of a cluster may hold fewer.
        block_len: u16 = u16,
        /// Frames of the stream.
        frames: u32 = u32,
        /// Frame rate, numerator (frames).
        rate_frames: u32 = u32,
        /// Frame rate, denominator (seconds).
        rate_seconds: u32 = u32,
        /// Packets of the stream, parity included: ids are below this.
        packets: u32 = u32,
        /// Number of epochs.
        epochs: u16 = u16,
        /// Number of windows.
        windows: u16 = u16,
        /// Number of clusters over all epochs.
        clusters: u32 = u32,
        /// Number of quantisation profiles.
        quants: u16 = u16,
        /// Number of entropy tables.
        tables: u16 = u16,
        /// Number of repair ranges.
        repairs: u16 = u16,
        /// Zero.
        reserved: u16 = u16,
        /// i16 values of window bases (`dgs1`) or f32 values of epoch bases (`paper`).
        basis_values: u32 = u32,
        /// f32 values of cluster transforms (`paper`), else 0.
        transform_values: u32 = u32,
    } pad 0
}

record! {
    /// A span of frames over which identity is fixed.
    Epoch, "epoch.", 52 {
        /// First frame, counted over the stream.
        first_frame: u32 = u32,
        /// Number of frames.
        frames: u32 = u32,
        /// Number of Gaussians.
        gaussians: u32 = u32,
        /// Index of the first cluster in the list of all clusters.
        first_cluster: u32 = u32,
        /// Number of clusters.
        clusters: u32 = u32,
        /// Index of the first window.
        first_window: u32 = u32,
        /// Number of windows.
        windows: u32 = u32,
        /// World position of index 0, x.
        origin_x: f32 = f32,
        /// World position of index 0, y.
        origin_y: f32 = f32,
        /// World position of index 0, z.
        origin_z: f32 = f32,
        /// First value of the temporal basis (`paper`): `frames × rank` f32, frame-major.
        basis_first: u32 = u32,
        /// First value of the cluster transforms (`paper`): clusters × frames × 12 f32, row-major.
        transform_first: u32 = u32,
        /// Rank of the temporal basis (`paper`).
        rank: u8 = u8,
    } pad 3
}

record! {
    /// The temporal coverage of motion data inside an epoch.
    Window, "window.", 20 {
        /// Epoch it lies in.
        epoch: u16 = u16,
        /// Number of frames, 1..=64.
        frames: u16 = u16,
        /// First frame, counted over the stream.
        first_frame: u32 = u32,
        /// Index of the motion cell of its first cluster.
        first_cell: u32 = u32,
        /// First value of its learned basis: `rank × frames` i16, vector-major, unit 2^-14.
        basis_first: u32 = u32,
        /// Vectors in its learned basis.
        rank: u8 = u8,
    } pad 3
}

record! {
    /// Gaussians that lie and move together.
    Cluster, "cluster.", 12 {
        /// Number of Gaussians.
        gaussians: u16 = u16,
        /// Index of its quantisation profile.
        quant: u8 = u8,
        /// Harmonic degree of its Gaussians.
        sh_degree: u8 = u8,
        /// Centre, x, in base-level position steps from the epoch's origin.
        centre_x: i16 = i16,
        /// Centre, y.
        centre_y: i16 = i16,
        /// Centre, z.
        centre_z: i16 = i16,
        /// Radius in base-level position steps, ≥ 1: linear track parameters move a point this
        /// far by one translation step.
        radius: u16 = u16,
    } pad 0
}

record! {
    /// How one cluster moves in one window (`dgs1`).
    Motion, "motion.", 8 {
        /// 1 if a track is sent (motion level 0), else the cluster is static but for coefficients.
        track: u8 = u8,
        /// The track's step is the position step times 2 to this.
        track_shift: u8 = u8,
        /// Coefficients of position per component: vectors of the window's learned basis.
        position: u8 = u8,
        /// Coefficients of log-scale per component: cosine basis.
        scale: u8 = u8,
        /// Coefficients of relative rotation per component: cosine basis.
        rotation: u8 = u8,
        /// Coefficients of opacity: cosine basis.
        opacity: u8 = u8,
        /// Coefficients of band-0 colour per component: cosine basis.
        sh0: u8 = u8,
    } pad 1
}

impl Motion {
    /// Coefficients per component of a moving class.
    pub const fn rank(&self, class: Class) -> usize {
        (match class {
            Class::Position => self.position,
            Class::Scale => self.scale,
            Class::Rotation => self.rotation,
            Class::Opacity => self.opacity,
            Class::Sh0 => self.sh0,
            _ => 0,
        }) as usize
    }

    /// True when nothing at all is sent for this cluster in this window.
    pub fn is_static(&self) -> bool {
        self.track == 0 && Class::ALL.into_iter().all(|c| self.rank(c) == 0)
    }
}

record! {
    /// A range of packets protected by XOR parity.
    ///
    /// The range is split into `ceil(packets / set_len)` interleaved sets: packet
    /// `first_packet + j` belongs to set `j mod sets`, and set `s` is covered by parity packet
    /// `first_parity + s`. Interleaving spreads a burst over many sets.
    Repair, "repair.", 16 {
        /// First protected packet.
        first_packet: u32 = u32,
        /// Number of protected packets, ≥ 1.
        packets: u32 = u32,
        /// First parity packet.
        first_parity: u32 = u32,
        /// Most packets in one set, 2..=32.
        set_len: u8 = u8,
    } pad 3
}

impl Repair {
    /// Number of sets, and of parity packets.
    pub const fn sets(&self) -> u32 {
        match self.set_len {
            0 => 0,
            len => self.packets.div_ceil(len as u32),
        }
    }

    /// The set and the position in it of packet `id`, if the range protects it.
    pub fn set_of(&self, id: u32) -> Option<(u32, u32)> {
        let offset = id.checked_sub(self.first_packet).filter(|&o| o < self.packets)?;
        Some((offset % self.sets(), offset / self.sets()))
    }

    /// Packets in set `set`.
    pub const fn members(&self, set: u32) -> u32 {
        match self.sets() {
            0 => 0,
            sets => (self.packets + sets - 1 - set % sets) / sets,
        }
    }
}

/// A quantisation profile: quantisers of the canonical classes, then of the moving ones.
///
/// In `dgs1` a moving class appears at level 1. In `paper`, `canonical` gives the steps of the
/// base and its refinements, and `motion[0]` those of q (level 1), δ2 and δ3 (levels 2 and 3).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quant {
    /// Per [`Class`].
    pub canonical: [Quantiser; Class::COUNT],
    /// Per moving class.
    pub motion: [Quantiser; Class::MOVING],
}

impl Quant {
    /// Bytes on the wire.
    pub const BYTES: usize = (Class::COUNT + Class::MOVING) * Quantiser::BYTES;

    fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let first = Quantiser::read(reader)?;
        let mut quant = Self { canonical: [first; Class::COUNT], motion: [first; Class::MOVING] };
        for target in quant.canonical.iter_mut().skip(1).chain(&mut quant.motion) {
            *target = Quantiser::read(reader)?;
        }
        Ok(quant)
    }

    /// Calls `emit` with its bytes on the wire.
    pub fn write(&self, mut emit: impl FnMut(&[u8])) {
        self.canonical.iter().chain(&self.motion).for_each(|q| emit(&q.to_bytes()));
    }
}

/// What the head of a DGSM message says, before anything is unpacked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sealed {
    /// Bytes of the body once unpacked.
    pub raw_len: usize,
    /// Bytes of the whole message.
    pub wire_len: usize,
}

impl Sealed {
    /// Reads the 16-byte head.
    ///
    /// # Errors
    /// Short bytes, another magic or version, lengths over the limits.
    pub fn parse(message: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(message);
        let magic = u32::from_le_bytes(reader.array("manifest.magic")?);
        let wanted = u32::from_le_bytes(MAGIC);
        in_range("manifest.magic", 0, magic, wanted, wanted).map_err(|e| e.kind(ErrorKind::Unknown))?;
        let version = reader.u8("manifest.version")?;
        in_range("manifest.version", 4, version, VERSION, VERSION).map_err(|e| e.kind(ErrorKind::Unknown))?;
        for byte in reader.array::<3>("manifest.reserved")? {
            in_range("manifest.reserved", 5, byte, 0, 0)?;
        }
        let most = limits::MAX_MANIFEST_BYTES as u32;
        let raw_len = in_range("manifest.raw_len", 8, reader.u32("manifest.raw_len")?, 1, most)?;
        let packed = in_range("manifest.packed_len", 12, reader.u32("manifest.packed_len")?, 1, most)?;
        Ok(Self { raw_len: raw_len as usize, wire_len: HEADER_BYTES + packed as usize + CRC_BYTES })
    }
}

/// Checks a whole DGSM message and unpacks its body into the front of `raw`.
///
/// # Errors
/// What [`Sealed::parse`] refuses; a CRC that does not match; leftovers;
/// [`ErrorKind::Capacity`] if `raw` is too small.
pub fn open<'a>(message: &[u8], crc: Crc32, raw: &'a mut [u8]) -> Result<&'a [u8]> {
    let sealed = Sealed::parse(message)?;
    let whole = message.get(..sealed.wire_len);
    let whole = whole.ok_or(Error::short("manifest", 0, message.len(), sealed.wire_len))?;
    let content = checked("manifest.crc", whole, crc)?;
    if message.len() > whole.len() {
        let over = (message.len() - whole.len()) as u64;
        return Err(Error::illegal("manifest.leftover", whole.len(), over, (0, 0)));
    }
    let room = raw.len();
    let target = raw.get_mut(..sealed.raw_len);
    let target =
        target.ok_or(Error::short("manifest.raw_len", 8, room, sealed.raw_len).kind(ErrorKind::Capacity))?;
    unpack(content.get(HEADER_BYTES..).unwrap_or(&[]), target)?;
    Ok(target)
}

/// Packs `raw` and seals it as a DGSM message at the front of `out`; returns its length.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small; an empty or oversized body.
pub fn seal(raw: &[u8], out: &mut [u8]) -> Result<usize> {
    let most = limits::MAX_MANIFEST_BYTES as u64;
    in_range("manifest.raw_len", 8, raw.len() as u64, 1, most)?;
    let room = out.len();
    let body = out.get_mut(HEADER_BYTES..);
    let body = body.ok_or(Error::short("manifest", 0, room, HEADER_BYTES).kind(ErrorKind::Capacity))?;
    let packed = pack(raw, body)?;
    let mut writer = Writer::new(out);
    writer.bytes(&MAGIC)?;
    writer.bytes(&[VERSION, 0, 0, 0])?;
    writer.bytes(&(raw.len() as u32).to_le_bytes())?;
    writer.bytes(&(packed as u32).to_le_bytes())?;
    let end = HEADER_BYTES + packed;
    let crc = crc32(out.get(..end).unwrap_or(&[])).to_le_bytes();
    let full = Error::short("manifest.crc", end, room - end, CRC_BYTES).kind(ErrorKind::Capacity);
    out.get_mut(end..end + CRC_BYTES).ok_or(full)?.copy_from_slice(&crc);
    Ok(end + CRC_BYTES)
}

/// A checked view of an unpacked manifest body.
#[derive(Clone, Copy, Debug)]
pub struct Manifest<'a> {
    /// Invariant: every section lies inside and every record has been checked by `parse`.
    raw: &'a [u8],
    head: Head,
    profile: Profile,
    sections: Sections,
    motion_cells: usize,
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
            other => {
                return Err(
                    Error::illegal("manifest.profile", 0, other.into(), (0, 1)).kind(ErrorKind::Unknown)
                );
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
        let partial = Self { raw, head, profile, sections, motion_cells: 0 };
        let motion_cells = partial.check_lattice()?;
        take(motion_cells * Motion::BYTES, &mut sections.motions, "manifest.motions")?;
        take(usize::from(head.quants) * Quant::BYTES, &mut sections.quants, "manifest.quants")?;
        take(if is_dgs1 { stream::COUNT } else { 0 }, &mut sections.streams, "manifest.streams")?;
        take(usize::from(head.repairs) * Repair::BYTES, &mut sections.repairs, "manifest.repairs")?;
        let basis_width = if is_dgs1 { 2 } else { 4 };
        take(head.basis_values as usize * basis_width, &mut sections.basis, "manifest.basis")?;
        take(head.transform_values as usize * 4, &mut sections.transforms, "manifest.transforms")?;
        let byte_tables = if is_dgs1 { 0 } else { clusters * Level::COUNT * 2 * bytes::TABLE_BYTES };
        take(byte_tables, &mut sections.byte_tables, "manifest.byte_tables")?;
        sections.tables = reader.offset();
        for _ in 0..head.tables {
            Table::read(&mut reader)?;
        }
        reader.finish("manifest.leftover")?;
        let whole = Self { raw, head, profile, sections, motion_cells };
        whole.check_records()?;
        Ok(whole)
    }

    /// Checks epochs, windows and clusters; returns the number of motion cells.
    fn check_lattice(&self) -> Result<usize> {
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
                let record = self.cluster_record((cluster + c) as usize).unwrap_or_default();
                let most = limits::MAX_CLUSTER_LEN as u16;
                in_range("cluster.gaussians", place, record.gaussians, 1, most)?;
                let quants = (self.head.quants - 1).min(255) as u8;
                in_range("cluster.quant", place, record.quant, 0, quants)?;
                in_range("cluster.sh_degree", place, record.sh_degree, 0, self.head.sh_degree)?;
                in_range("cluster.radius", place, record.radius, 1, u16::MAX)?;
                gaussians += u64::from(record.gaussians);
            }
            let all = u64::from(epoch.gaussians);
            in_range("epoch.gaussians", place, all, gaussians, gaussians)
                .map_err(|e| e.kind(ErrorKind::Contradiction))?;
            let mut window_frame = frame;
            for w in 0..epoch.windows {
                let place = at(self.sections.windows, (window + w) as usize, Window::BYTES);
                let record = self.window(WindowId((window + w) as u16)).unwrap_or_default();
                in_range("window.epoch", place, record.epoch, e as u16, e as u16)?;
                in_range("window.first_frame", place, record.first_frame, window_frame, window_frame)?;
                let left = (frame + epoch.frames - window_frame).min(limits::MAX_WINDOW_FRAMES as u32);
                in_range("window.frames", place, u32::from(record.frames), 1, left)?;
                in_range("window.first_cell", place, u64::from(record.first_cell), cell, cell)?;
                let values =
                    u64::from(record.basis_first) + u64::from(record.rank) * u64::from(record.frames);
                in_range("window.basis_first", place, values, 0, u64::from(self.head.basis_values))?;
                in_range("window.rank", place, u16::from(record.rank), 0, record.frames)?;
                window_frame += u32::from(record.frames);
                cell += u64::from(epoch.clusters);
            }
            if epoch.windows > 0 {
                let end = frame + epoch.frames;
                in_range("epoch.windows", place, window_frame, end, end)
                    .map_err(|e| e.kind(ErrorKind::Contradiction))?;
            }
            if self.profile == Profile::Paper {
                in_range("epoch.windows", place, epoch.windows, 0, 0)?;
                in_range("epoch.rank", place, epoch.rank, 0, limits::MAX_RANK as u8)?;
                let frames = u64::from(epoch.frames);
                let basis = u64::from(epoch.basis_first) + frames * u64::from(epoch.rank);
                in_range("epoch.basis_first", place, basis, 0, u64::from(self.head.basis_values))?;
                let values = u64::from(epoch.transform_first) + frames * u64::from(epoch.clusters) * 12;
                in_range("epoch.transform_first", place, values, 0, u64::from(self.head.transform_values))?;
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
            read(&mut Reader::new(self.raw.get(place..).unwrap_or(&[])))
                .map_err(|e| Error { offset: e.offset.saturating_add(place as u32), ..e })?;
        }
        Ok(())
    }

    fn check_records(&self) -> Result<()> {
        self.check_reserved()?;
        for (w, window) in self.windows().enumerate() {
            let epoch = self.epoch(EpochId(window.epoch)).unwrap_or_default();
            for c in 0..epoch.clusters {
                let index = window.first_cell as usize + c as usize;
                let place = self.sections.motions + index * Motion::BYTES;
                let motion = self.motion(WindowId(w as u16), ClusterId(c as u16)).unwrap_or_default();
                in_range("motion.track", place, motion.track, 0, 1)?;
                in_range("motion.track_shift", place, motion.track_shift, 0, 24)?;
                in_range("motion.position", place, motion.position, 0, window.rank)?;
                for rank in [motion.scale, motion.rotation, motion.opacity, motion.sh0] {
                    in_range("motion.rank", place, u16::from(rank), 0, window.frames)?;
                }
            }
        }
        for index in 0..usize::from(self.head.quants) {
            let place = self.sections.quants + index * Quant::BYTES;
            let mut reader = Reader::new(self.raw.get(place..).unwrap_or(&[]));
            let quant =
                Quant::read(&mut reader).map_err(|e| Error { offset: e.offset + place as u32, ..e })?;
            if self.profile == Profile::Dgs1 {
                for quantiser in quant.canonical.iter().chain(&quant.motion) {
                    in_range("quantiser.ratio", place, u8::from(quantiser.nests()), 1, 1)?;
                }
            }
        }
        for s in 0..stream::COUNT * usize::from(self.profile == Profile::Dgs1) {
            let place = self.sections.streams + s;
            let table = self.table_of(s);
            if table != NO_TABLE && u16::from(table) >= self.head.tables {
                let last = u64::from(self.head.tables).checked_sub(1).unwrap_or(NO_TABLE.into());
                return Err(Error::illegal("stream.table", place, table.into(), (0, last)));
            }
        }
        let mut sets = 0u64;
        for (r, repair) in self.repairs().enumerate() {
            let place = self.sections.repairs + r * Repair::BYTES;
            let all = self.head.packets;
            let most = limits::MAX_REPAIR_SET as u8;
            in_range("repair.set_len", place, repair.set_len, 2, most)?;
            in_range("repair.first_packet", place, repair.first_packet, 0, all)?;
            in_range("repair.packets", place, repair.packets, 1, all - repair.first_packet.min(all))?;
            in_range("repair.first_parity", place, repair.first_parity, 0, all)?;
            in_range("repair.sets", place, repair.sets(), 1, all - repair.first_parity.min(all))?;
            // Each set has a parity packet of its own.
            sets += u64::from(repair.sets());
            in_range("repair.sets", place, sets, 1, all.into())
                .map_err(|e| e.kind(ErrorKind::Contradiction))?;
        }
        for index in 0..self.head.transform_values as usize {
            finite("manifest.transforms", self.sections.transforms + 4 * index, self.transform_value(index))?;
        }
        if self.profile == Profile::Paper {
            for index in 0..self.head.basis_values as usize {
                finite("manifest.basis", self.sections.basis + 4 * index, self.paper_basis(index))?;
            }
            for index in 0..self.head.clusters as usize * Level::COUNT * 2 {
                self.read_byte_table(index)?;
            }
        }
        Ok(())
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
        read(&mut Reader::new(self.raw.get(section + index * bytes..)?)).ok()
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

    /// Quantisation profile `index`.
    pub fn quant(&self, index: u8) -> Option<Quant> {
        let count = usize::from(self.head.quants);
        self.record(self.sections.quants, usize::from(index), count, Quant::BYTES, Quant::read)
    }

    /// Table index of stream `stream`, [`NO_TABLE`] if it never occurs.
    pub fn table_of(&self, stream: usize) -> u8 {
        if self.profile != Profile::Dgs1 || stream >= stream::COUNT {
            return NO_TABLE;
        }
        self.raw.get(self.sections.streams + stream).copied().unwrap_or(NO_TABLE)
    }

    /// All entropy tables of `dgs1`, in order.
    pub fn tables(&self) -> impl Iterator<Item = Table> + use<'a> {
        let mut reader = Reader::new(self.raw.get(self.sections.tables..).unwrap_or(&[]));
        (0..self.head.tables).map_while(move |_| Table::read(&mut reader).ok())
    }

    /// Low and high byte table of a `paper` group; `cluster` counts over all epochs.
    pub fn byte_tables(&self, cluster: usize, level: Level) -> Option<[bytes::ByteTable; 2]> {
        if self.profile != Profile::Paper || cluster >= self.head.clusters as usize {
            return None;
        }
        let first = (cluster * Level::COUNT + level.index()) * 2;
        Some([self.read_byte_table(first).ok()?, self.read_byte_table(first + 1).ok()?])
    }

    fn read_byte_table(&self, index: usize) -> Result<bytes::ByteTable> {
        let place = self.sections.byte_tables + index * bytes::TABLE_BYTES;
        let mut reader = Reader::new(self.raw.get(place..).unwrap_or(&[]));
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

fn check_head(head: &Head) -> Result<()> {
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
    in32("manifest.reserved", 34, head.reserved.into(), 0, 0)?;
    in32("manifest.basis_values", 36, head.basis_values, 0, limits::MAX_MANIFEST_BYTES as u32 / 4)?;
    in32("manifest.transform_values", 40, head.transform_values, 0, limits::MAX_MANIFEST_BYTES as u32 / 4)
}

fn finite(field: &'static str, place: usize, value: f32) -> Result<()> {
    // 1e9 scene units is far beyond what f32 positions resolve; it keeps later sums finite.
    if value.is_finite() && (-1e9..=1e9).contains(&value) {
        return Ok(());
    }
    Err(Error::illegal(field, place, value.to_bits().into(), (0, 1_000_000_000)))
}
