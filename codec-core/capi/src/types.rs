//! Declares what `include/dgs.h` does: statuses, and structs laid out as C lays them out.

use codec_core::{
    Caps, Error, ErrorKind, Gaussian,
    player::{Accepted, Counters, Frame, StreamInfo, Usable},
};

/// Done.
pub const DGS_OK: i32 = 0;
/// The bytes end before the field does.
pub const DGS_SHORT: i32 = 1;
/// The field holds a value the format forbids.
pub const DGS_ILLEGAL: i32 = 2;
/// A magic, version or profile that this library does not know.
pub const DGS_UNKNOWN: i32 = 3;
/// A CRC does not match.
pub const DGS_CHECKSUM: i32 = 4;
/// At odds with the manifest or with what already arrived.
pub const DGS_CONTRADICTION: i32 = 5;
/// Arrived before; nothing new in it.
pub const DGS_DUPLICATE: i32 = 6;
/// The caller's memory is too small for it, or it is over a bound of `dgs_caps`.
pub const DGS_CAPACITY: i32 = 7;
/// A pointer is null that must not be.
pub const DGS_NULL: i32 = 8;
/// A pointer is misaligned, overlaps the player's block, or is no player.
pub const DGS_MISUSE: i32 = 9;
/// The manifest has not arrived.
pub const DGS_NO_MANIFEST: i32 = 10;

/// Alignment of a player's block, bytes.
pub const DGS_ALIGN: usize = 16;
/// No packet.
pub const DGS_NONE: u32 = 0xffff_ffff;
/// Most packets that one arrival recovers.
pub const DGS_MAX_RECOVERED: usize = 8;
/// Number of refusal counters: statuses 1 to 7, in that order.
pub const DGS_REFUSALS: usize = 7;
/// Number of levels.
pub const DGS_LEVELS: usize = 4;
/// Digest of nothing, where `dgs_digest` starts.
pub const DGS_DIGEST_START: u64 = 0xcbf2_9ce4_8422_2325;
/// Largest receipt, bytes.
pub const DGS_RECEIPT_BYTES: usize = 1200;

/// What is wrong, in which field, where, what was found and what is allowed.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DgsError {
    /// Status of the call.
    pub status: i32,
    /// Byte offset of the field in the input.
    pub offset: u32,
    /// The value found; bytes there are, for `DGS_SHORT`. For `DGS_CAPACITY` what there is of the caller's
    /// memory, if it is below `least`, or else a count that is over a bound of `dgs_caps`.
    pub found: u64,
    /// Smallest allowed value; what is needed, for `DGS_SHORT` and for memory.
    pub least: u64,
    /// Largest allowed value; what is needed, for `DGS_SHORT` and for memory.
    pub most: u64,
    /// Name of the field or argument, ASCII, `field_len` bytes without a final zero; a constant.
    pub field: *const u8,
    /// Bytes of `field`.
    pub field_len: usize,
}

impl DgsError {
    /// An error of the caller's making: `status` because of `argument`.
    pub const fn argument(status: i32, argument: &'static str) -> Self {
        let field = argument.as_ptr();
        Self { status, offset: 0, found: 0, least: 0, most: 0, field, field_len: argument.len() }
    }
}

impl From<Error> for DgsError {
    fn from(error: Error) -> Self {
        let status = match error.kind {
            ErrorKind::Short => DGS_SHORT,
            ErrorKind::Illegal => DGS_ILLEGAL,
            ErrorKind::Unknown => DGS_UNKNOWN,
            ErrorKind::Checksum => DGS_CHECKSUM,
            ErrorKind::Contradiction => DGS_CONTRADICTION,
            ErrorKind::Duplicate => DGS_DUPLICATE,
            ErrorKind::Capacity => DGS_CAPACITY,
        };
        let (least, most) = error.allowed;
        let Error { offset, found, .. } = error;
        Self { offset, found, least, most, ..Self::argument(status, error.field) }
    }
}

/// The most that a player takes on; every field is a largest allowed value. See codec-core's `Caps`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DgsCaps {
    /// Gaussians of one epoch.
    pub gaussians_per_epoch: u32,
    /// Frames of the stream.
    pub frames: u32,
    /// Cells: clusters of all epochs, and again of every window.
    pub cells: u32,
    /// Symbols of all cells.
    pub symbols: u32,
    /// Blocks of all cells.
    pub blocks: u32,
    /// Packets of the stream.
    pub packets: u32,
    /// Entropy tables.
    pub tables: u32,
    /// Bytes of the unpacked manifest.
    pub manifest_bytes: u32,
    /// Bytes of repair; what lies beyond is not repaired.
    pub parity_bytes: u32,
    /// Bytes for packets before the manifest; each takes 2 more than its length.
    pub early_bytes: u32,
    /// Blocks that the extents of one packet span.
    pub blocks_per_packet: u32,
    /// Values of one packet.
    pub values_per_packet: u32,
}

/// What became of a packet.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DgsPushed {
    /// Its id, or `DGS_NONE` while it waits for the manifest.
    pub id: u32,
    /// Packets that repair recovered with it.
    pub recovered: u32,
    /// Their ids, ascending; the rest is `DGS_NONE`.
    pub recovered_ids: [u32; DGS_MAX_RECOVERED],
}

impl DgsPushed {
    /// Of a packet that waits for the manifest.
    pub(crate) const fn waiting() -> Self {
        Self { id: DGS_NONE, recovered: 0, recovered_ids: [DGS_NONE; DGS_MAX_RECOVERED] }
    }
}

impl From<Accepted> for DgsPushed {
    fn from(accepted: Accepted) -> Self {
        let mut pushed = Self { id: accepted.id.get(), ..Self::waiting() };
        for (place, id) in pushed.recovered_ids.iter_mut().zip(accepted.recovered.iter()) {
            *place = id.get();
            pushed.recovered += 1;
        }
        pushed
    }
}

/// What happened to packets.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DgsCounters {
    /// Media packets accepted.
    pub media: u32,
    /// Parity packets accepted.
    pub parity: u32,
    /// Packets that waited for the manifest.
    pub early: u32,
    /// Packets recovered by repair.
    pub recovered: u32,
    /// Repaired packets that failed their own checks.
    pub repair_failed: u32,
    /// Packets refused, by status less one.
    pub refused: [u32; DGS_REFUSALS],
}

impl From<Counters> for DgsCounters {
    fn from(counters: Counters) -> Self {
        let Counters { media, parity, early, recovered, repair_failed, refused } = counters;
        Self { media, parity, early, recovered, repair_failed, refused }
    }
}

/// What the manifest says of the stream.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DgsStream {
    /// Frames.
    pub frames: u32,
    /// Frame rate, numerator: frames.
    pub rate_frames: u32,
    /// Frame rate, denominator: seconds.
    pub rate_seconds: u32,
    /// Packets, parity included.
    pub packets: u32,
    /// Gaussians of the largest epoch.
    pub gaussians: u32,
    /// Higher harmonic coefficients per Gaussian, all channels: 0, 9, 24 or 45.
    pub sh_rest: u32,
    /// How Gaussians are drawn: 0 variance 0.3 pixels² is added; 1 the same, and dimmed as much; 2 0.1
    /// pixels², and dimmed as much.
    pub footprint: u32,
    /// Which axis of the scene points up: 0 +y, 1 +x, 2 +z, 3 −x, 4 −y, 5 −z.
    pub up: u32,
}

/// One Gaussian of one frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DgsGaussian {
    /// Centre, scene units.
    pub position: [f32; 3],
    /// Standard deviations along the local axes, scene units.
    pub scale: [f32; 3],
    /// Unit quaternion, w x y z, local axes to world.
    pub rotation: [f32; 4],
    /// Peak opacity, 0 to 1; 0 draws nothing.
    pub opacity: f32,
    /// Harmonic band 0: colour is 0.5 + 0.28209479 sh0.
    pub sh0: [f32; 3],
}

// One is read where the other was written.
const _: () = {
    use core::mem::{align_of, offset_of, size_of};
    assert!(size_of::<DgsGaussian>() == size_of::<Gaussian>());
    assert!(align_of::<DgsGaussian>() == align_of::<Gaussian>());
    assert!(offset_of!(DgsGaussian, position) == offset_of!(Gaussian, position));
    assert!(offset_of!(DgsGaussian, scale) == offset_of!(Gaussian, scale));
    assert!(offset_of!(DgsGaussian, rotation) == offset_of!(Gaussian, rotation));
    assert!(offset_of!(DgsGaussian, opacity) == offset_of!(Gaussian, opacity));
    assert!(offset_of!(DgsGaussian, sh0) == offset_of!(Gaussian, sh0));
    assert!(DGS_REFUSALS == ErrorKind::COUNT);
    assert!(DGS_LEVELS == codec_core::internals::ids::Level::COUNT);
    assert!(DGS_MAX_RECOVERED == codec_core::internals::limits::MAX_REPAIR_PARITY);
    assert!(DGS_DIGEST_START == codec_core::internals::digest::Digest::new().get());
    assert!(DGS_RECEIPT_BYTES == codec_core::internals::limits::MAX_RECEIPT_BYTES);
};

/// Viewer's pose in a receipt.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DgsPose {
    /// Camera centre, scene units.
    pub position: [f32; 3],
    /// Camera to world, unit quaternion, w x y z.
    pub rotation: [f32; 4],
}

/// A decoded frame, in the player's block until the next call with the player.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DgsFrame {
    /// The Gaussians of the frame's epoch.
    pub gaussians: *const DgsGaussian,
    /// Number of them.
    pub gaussians_len: usize,
    /// Their higher harmonic coefficients: Gaussian by Gaussian, then coefficient, then channel.
    pub sh_rest: *const f32,
    /// Number of all of them.
    pub sh_rest_len: usize,
    /// The epoch shown.
    pub epoch: u32,
    /// Blocks whose base is there.
    pub present_blocks: u32,
    /// Blocks of the epoch.
    pub blocks: u32,
}

impl From<Frame<'_>> for DgsFrame {
    fn from(frame: Frame<'_>) -> Self {
        let Frame { gaussians, sh_rest, decoded, .. } = frame;
        Self {
            gaussians: gaussians.as_ptr().cast(),
            gaussians_len: gaussians.len(),
            sh_rest: sh_rest.as_ptr(),
            sh_rest_len: sh_rest.len(),
            epoch: decoded.epoch.0.into(),
            present_blocks: decoded.present_blocks,
            blocks: decoded.blocks,
        }
    }
}

/// How many blocks of a frame are usable up to each level.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DgsUsable {
    /// Blocks of the frame's epoch.
    pub blocks: u32,
    /// Blocks whose canonical attributes are usable up to the level.
    pub canonical: [u32; DGS_LEVELS],
    /// Blocks that are present and whose motion is usable up to the level.
    pub motion: [u32; DGS_LEVELS],
}

impl From<Usable> for DgsUsable {
    fn from(usable: Usable) -> Self {
        let Usable { blocks, canonical, motion } = usable;
        Self { blocks, canonical, motion }
    }
}

impl From<StreamInfo> for DgsStream {
    fn from(info: StreamInfo) -> Self {
        let StreamInfo {
            frames,
            frames_per_seconds: (rate_frames, rate_seconds),
            packets,
            gaussians,
            sh_degree,
            footprint,
            up,
        } = info;
        let (sh_rest, footprint) = (sh_degree.rest_len() as u32, footprint as u32);
        Self { frames, rate_frames, rate_seconds, packets, gaussians, sh_rest, footprint, up: up as u32 }
    }
}

/// Both ways between structs of the same fields.
macro_rules! same_fields {
    ($a:ident, $b:ident, $($field:ident),+) => {
        impl From<$a> for $b {
            fn from(value: $a) -> Self {
                let $a { $($field),+ } = value;
                Self { $($field),+ }
            }
        }

        impl From<$b> for $a {
            fn from(value: $b) -> Self {
                let $b { $($field),+ } = value;
                Self { $($field),+ }
            }
        }
    };
}

same_fields!(
    Caps,
    DgsCaps,
    gaussians_per_epoch,
    frames,
    cells,
    symbols,
    blocks,
    packets,
    tables,
    manifest_bytes,
    parity_bytes,
    early_bytes,
    blocks_per_packet,
    values_per_packet
);
same_fields!(Gaussian, DgsGaussian, position, scale, rotation, opacity, sh0);
