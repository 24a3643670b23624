//! The fixed-width records of the manifest body, in the order of their fields on the wire.

use core::num::NonZero;

use crate::{
    cursor::in_range,
    error::{Error, Result},
    ids::Level,
    limits::MAX_BLOCK_LEN,
    quant::{Class, Quantiser},
};

macro_rules! record {
    (
        $(#[$doc:meta])*
        $name:ident, $prefix:literal, $bytes:literal {
            $($(#[$field_doc:meta])* $field:ident: $type:ty),* $(,)?
        }
        $(reserved $reserved:literal)?
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
                debug_assert_eq!(at $(+ $reserved)?, $bytes);
                bytes
            }

            /// The record of `bytes`, whatever its reserved bytes are.
            pub(super) fn from_bytes(bytes: &[u8; $bytes]) -> Self {
                let mut at = 0usize;
                $(
                    let $field = <$type>::from_le_bytes(core::array::from_fn(|i| bytes[at + i]));
                    at += size_of::<$type>();
                )*
                debug_assert_eq!(at $(+ $reserved)?, $bytes);
                Self { $($field),* }
            }

            $(
                /// Refuses `bytes`, which lie at offset `place`, if a reserved one of them is not zero.
                pub(super) fn check_reserved(bytes: &[u8; $bytes], place: usize) -> Result<()> {
                    let start = $bytes - $reserved;
                    for &byte in bytes.iter().skip(start) {
                        in_range(concat!($prefix, "reserved"), place + start, byte, 0, 0)?;
                    }
                    Ok(())
                }
            )?
        }
    };
}

record! {
    /// Fixed head of the manifest body.
    Head, "manifest.", 44 {
        /// The profile as a number.
        profile: u8,
        /// Highest harmonic degree of any cluster.
        sh_degree: u8,
        /// Gaussians per block, the last block of a cluster may hold fewer.
        block_len: u16,
        /// Frames of the stream.
        frames: u32,
        /// Frame rate, numerator (frames).
        rate_frames: u32,
        /// Frame rate, denominator (seconds).
        rate_seconds: u32,
        /// Packets of the stream, parity included: ids are below this.
        packets: u32,
        /// Number of epochs.
        epochs: u16,
        /// Number of windows.
        windows: u16,
        /// Number of clusters over all epochs.
        clusters: u32,
        /// Number of quantisation profiles.
        quants: u16,
        /// Number of entropy tables.
        tables: u16,
        /// Number of repair ranges.
        repairs: u16,
        /// 1 if there is a proxy for every canonical block (`dgs1`), else 0.
        proxies: u8,
        /// How a scene is drawn: bits 0 to 3 the number of a [`Footprint`](crate::Footprint), bits 4 to 7
        /// that of an [`Up`](crate::Up).
        drawing: u8,
        /// i16 values of window bases (`dgs1`) or f32 values of epoch bases (`paper`).
        basis_values: u32,
        /// f32 values of cluster transforms (`paper`), else 0.
        transform_values: u32,
    }
}

record! {
    /// A span of frames over which identity is fixed.
    Epoch, "epoch.", 52 {
        /// First frame, counted over the stream.
        first_frame: u32,
        /// Number of frames.
        frames: u32,
        /// Number of Gaussians.
        gaussians: u32,
        /// Index of the first cluster in the list of all clusters.
        first_cluster: u32,
        /// Number of clusters.
        clusters: u32,
        /// Index of the first window.
        first_window: u32,
        /// Number of windows.
        windows: u32,
        /// World position of index 0, x.
        origin_x: f32,
        /// World position of index 0, y.
        origin_y: f32,
        /// World position of index 0, z.
        origin_z: f32,
        /// First value of the temporal basis (`paper`): `frames × rank` f32, frame-major.
        basis_first: u32,
        /// First value of the cluster transforms (`paper`): clusters × frames × 12 f32, row-major.
        transform_first: u32,
        /// Rank of the temporal basis (`paper`).
        rank: u8,
    } reserved 3
}

record! {
    /// The temporal coverage of motion data inside an epoch.
    Window, "window.", 20 {
        /// Epoch it lies in.
        epoch: u16,
        /// Number of frames, 1..=64.
        frames: u16,
        /// First frame, counted over the stream.
        first_frame: u32,
        /// Index of the motion cell of its first cluster.
        first_cell: u32,
        /// First value of its learned basis: `rank × frames` i16, vector-major, unit 2^-14.
        basis_first: u32,
        /// Vectors in its learned basis.
        rank: u8,
    } reserved 3
}

record! {
    /// Gaussians that lie and move together.
    Cluster, "cluster.", 12 {
        /// Number of Gaussians.
        gaussians: u16,
        /// Index of its quantisation profile.
        quant: u8,
        /// Harmonic degree of its Gaussians (bits 0 and 1) and levels left out at the top (bits 2
        /// and 3): see [`Cluster::kind_of`].
        kind: u8,
        /// Centre, x, in base-level position steps from the epoch's origin.
        centre_x: i16,
        /// Centre, y.
        centre_y: i16,
        /// Centre, z.
        centre_z: i16,
        /// Radius in base-level position steps, ≥ 1: linear track parameters move a point this
        /// far by one translation step.
        radius: u16,
    }
}

/// The highest level of `kind`, whose bits 2 and 3 count the levels left out.
const fn top(kind: u8) -> Level {
    Level::from_bits(3 - (kind >> 2 & 3))
}

/// The number of Gaussians per block `found`, if the format allows it.
///
/// # Errors
/// [`ErrorKind::Illegal`](crate::ErrorKind::Illegal).
pub fn block_len(found: u64) -> Result<NonZero<u32>> {
    let illegal = Error::illegal("manifest.block_len", 2, found, (1, MAX_BLOCK_LEN as u64));
    let allowed = found <= MAX_BLOCK_LEN as u64;
    NonZero::new(found as u32).filter(|_| allowed).ok_or(illegal)
}

impl Cluster {
    /// Largest [`Cluster::kind`].
    pub const MAX_KIND: u8 = 0xf;

    /// The [`Cluster::kind`] of a cluster of harmonic degree `sh_degree` (0..=3) whose levels above
    /// `top` carry nothing.
    pub const fn kind_of(sh_degree: u8, top: Level) -> u8 {
        sh_degree & 3 | (3 - top.get()) << 2
    }

    /// Harmonic degree of its Gaussians, 0..=3.
    pub const fn sh_degree(&self) -> u8 {
        self.kind & 3
    }

    /// Blocks of up to `block_len` Gaussians.
    pub fn blocks(&self, block_len: NonZero<u32>) -> u32 {
        // Rounded up; written so that no compiler sees a division by zero.
        (u32::from(self.gaussians) + (block_len.get() - 1)) / block_len
    }

    /// The highest level that carries canonical symbols.
    pub const fn top(&self) -> Level {
        top(self.kind)
    }
}

record! {
    /// How one cluster moves in one window (`dgs1`).
    Motion, "motion.", 8 {
        /// [`Track`] (bits 0 and 1) and levels left out at the top (bits 2 and 3): see
        /// [`Motion::kind_of`].
        kind: u8,
        /// The track's step is a quarter of the position step times 2 to this.
        track_shift: u8,
        /// Coefficients of each track parameter: the lowest frequencies of the cosine basis.
        track: u8,
        /// Coefficients of position per component: vectors of the window's learned basis.
        position: u8,
        /// Coefficients of log-scale per component: cosine basis.
        scale: u8,
        /// Coefficients of relative rotation per component: cosine basis.
        rotation: u8,
        /// Coefficients of opacity: cosine basis.
        opacity: u8,
        /// Coefficients of band-0 colour per component: cosine basis.
        sh0: u8,
    }
}

/// How a cluster moves as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Track {
    /// Not at all; no track is sent.
    #[default]
    Static = 0,
    /// Rotation and translation: 3 + 3 parameters.
    Rigid = 1,
    /// A linear map and translation: 9 + 3 parameters; Gaussians turn by the map's rotation.
    Affine = 2,
}

impl Track {
    /// Parameters that turn or bend: modified Rodrigues parameters, or I + these, row by row.
    pub const fn turning(self) -> usize {
        match self {
            Self::Static => 0,
            Self::Rigid => 3,
            Self::Affine => 9,
        }
    }

    /// All parameters: [`Track::turning`], then three of translation.
    pub const fn parameters(self) -> usize {
        match self {
            Self::Static => 0,
            _ => self.turning() + 3,
        }
    }
}

impl Motion {
    /// The [`Motion::kind`] of a cluster that moves by `track` and whose levels above `top` carry
    /// nothing.
    pub const fn kind_of(track: Track, top: Level) -> u8 {
        track as u8 | (3 - top.get()) << 2
    }

    /// How the cluster moves as a whole.
    pub const fn class(&self) -> Track {
        match self.kind & 3 {
            0 => Track::Static,
            1 => Track::Rigid,
            _ => Track::Affine,
        }
    }

    /// The highest level that carries motion symbols.
    pub const fn top(&self) -> Level {
        top(self.kind)
    }

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
}

record! {
    /// A range of packets protected by parity.
    ///
    /// The range is split into `ceil(packets / set_len)` interleaved sets, so that a burst is
    /// spread over many sets: packet `first_packet + j` belongs to set `j mod sets`. Row `i` of set
    /// `s` is parity packet `first_parity + i · sets + s`.
    Repair, "repair.", 16 {
        /// First protected packet.
        first_packet: u32,
        /// Number of protected packets, ≥ 1.
        packets: u32,
        /// First parity packet.
        first_parity: u32,
        /// Most packets in one set, 2..=64.
        set_len: u8,
        /// Parity packets of one set, 1..=8: as many losses are repaired.
        parity: u8,
        /// Bytes of the longest protected packet, 1..=1280.
        longest: u16,
    }
}

impl Repair {
    /// Number of sets.
    pub const fn sets(&self) -> u32 {
        match self.set_len {
            0 => 0,
            len => self.packets.div_ceil(len as u32),
        }
    }

    /// Number of parity packets of all sets.
    pub const fn parity_packets(&self) -> u64 {
        self.sets() as u64 * self.parity as u64
    }

    /// The set and the position in it of packet `id`, if the range protects it.
    pub fn set_of(&self, id: u32) -> Option<(u32, u32)> {
        let offset = id.checked_sub(self.first_packet).filter(|&o| o < self.packets)?;
        Some((offset.checked_rem(self.sets())?, offset.checked_div(self.sets())?))
    }

    /// The set and the row of parity packet `id`, if it is of this range.
    pub fn row_of(&self, id: u32) -> Option<(u32, u32)> {
        let offset = id.checked_sub(self.first_parity).filter(|&o| u64::from(o) < self.parity_packets())?;
        Some((offset.checked_rem(self.sets())?, offset.checked_div(self.sets())?))
    }

    /// Packets in set `set`.
    pub const fn members(&self, set: u32) -> u32 {
        match self.sets() {
            0 => 0,
            sets => (self.packets + sets - 1 - set % sets) / sets,
        }
    }

    /// The id of member `position` of set `set`.
    pub const fn member(&self, set: u32, position: u32) -> u32 {
        self.first_packet + set + position * self.sets()
    }

    /// The id of parity row `row` of set `set`.
    pub const fn parity_id(&self, set: u32, row: u32) -> u32 {
        self.first_parity + set + row * self.sets()
    }

    /// Bytes of a receiver's memory for one set.
    pub const fn set_bytes(&self) -> usize {
        crate::repair::set_bytes(self.parity as usize, self.longest as usize)
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
    /// Quantisers of one profile.
    pub(super) const QUANTISERS: usize = Class::COUNT + Class::MOVING;
    /// Bytes on the wire.
    pub const BYTES: usize = Self::QUANTISERS * Quantiser::BYTES;

    /// The profile of `quantisers`, which [`Quantiser::check`] has let pass.
    pub(super) fn from_bytes(quantisers: &[[u8; Quantiser::BYTES]; Self::QUANTISERS]) -> Self {
        let [position, scale, rotation, opacity, sh0, sh1, sh2, sh3, motion @ ..] = *quantisers;
        let canonical = [position, scale, rotation, opacity, sh0, sh1, sh2, sh3];
        Self { canonical: canonical.map(Quantiser::from_bytes), motion: motion.map(Quantiser::from_bytes) }
    }

    /// Calls `emit` with its bytes on the wire.
    pub fn write(&self, mut emit: impl FnMut(&[u8])) {
        self.canonical.iter().chain(&self.motion).for_each(|q| emit(&q.to_bytes()));
    }
}
