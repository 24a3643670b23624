//! What `include/dgs.h` declares: statuses, and structs laid out as C lays them out.

use codec_core::{Error, ErrorKind, Gaussian, decode::Decoded, ids::PacketId, receiver};

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
/// The caller's memory is too small for it.
pub const DGS_CAPACITY: i32 = 7;
/// A pointer is null that must not be.
pub const DGS_NULL: i32 = 8;
/// A pointer is misaligned, overlaps the receiver's block, or is no receiver.
pub const DGS_MISUSE: i32 = 9;
/// The manifest has not arrived.
pub const DGS_NO_MANIFEST: i32 = 10;

/// Alignment of a receiver's block, bytes.
pub const DGS_ALIGN: usize = 16;
/// No packet.
pub const DGS_NONE: u32 = 0xffff_ffff;
/// Most packets that one arrival recovers.
pub const DGS_MAX_RECOVERED: usize = 8;
/// Number of refusal counters: statuses 1 to 7, in that order.
pub const DGS_REFUSALS: usize = 7;
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
    /// The value found; bytes there are, for `DGS_SHORT` and `DGS_CAPACITY`.
    pub found: u64,
    /// Smallest allowed value.
    pub least: u64,
    /// Largest allowed value; bytes needed, for `DGS_SHORT` and `DGS_CAPACITY`.
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

/// Sizes of everything in a receiver's block, in elements.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DgsSizes {
    /// Bytes of the unpacked manifest.
    pub manifest: usize,
    /// Cells of the lattice, and one.
    pub cells: usize,
    /// Symbols.
    pub symbols: usize,
    /// Blocks of all cells.
    pub blocks: usize,
    /// Words of the packet bitmap.
    pub seen: usize,
    /// Words of entropy decode tables. Three eighths of them (profile `dgs1`) decode as well, slower.
    pub slots: usize,
    /// Group counters (profile `paper`).
    pub progress: usize,
    /// Bytes of repair; 0 repairs nothing.
    pub parity: usize,
    /// Bytes for media that arrives before the manifest; each packet takes 2 more than its length.
    pub early: usize,
    /// Gaussians of the largest epoch.
    pub gaussians: usize,
}

/// What became of a packet.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DgsArrival {
    /// Its id, or `DGS_NONE` while it waits for the manifest.
    pub id: u32,
    /// Packets that repair recovered with it.
    pub recovered: u32,
    /// Their ids, ascending; the rest is `DGS_NONE`.
    pub recovered_ids: [u32; DGS_MAX_RECOVERED],
}

impl DgsArrival {
    /// Of a packet that waits for the manifest.
    pub(crate) const fn waiting() -> Self {
        Self { id: DGS_NONE, recovered: 0, recovered_ids: [DGS_NONE; DGS_MAX_RECOVERED] }
    }

    /// Of packet `id`, with which repair recovered `recovered`.
    pub(crate) fn accepted(id: PacketId, recovered: &[PacketId]) -> Self {
        let mut arrival = Self { id: id.get(), recovered: recovered.len() as u32, ..Self::waiting() };
        arrival.recovered_ids.iter_mut().zip(recovered).for_each(|(place, id)| *place = id.get());
        arrival
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

impl From<&receiver::Counters> for DgsCounters {
    fn from(counters: &receiver::Counters) -> Self {
        let receiver::Counters { media, parity, early, recovered, repair_failed, refused } = *counters;
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
    assert!(DGS_MAX_RECOVERED == codec_core::limits::MAX_REPAIR_PARITY);
    assert!(DGS_DIGEST_START == codec_core::digest::Digest::new().get());
    assert!(DGS_RECEIPT_BYTES == codec_core::limits::MAX_RECEIPT_BYTES);
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

/// What a decoded frame holds.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DgsDecoded {
    /// The epoch shown.
    pub epoch: u32,
    /// Gaussians written.
    pub gaussians: u32,
    /// Blocks whose base is there.
    pub present_blocks: u32,
    /// Blocks of the epoch.
    pub blocks: u32,
}

impl From<Decoded> for DgsDecoded {
    fn from(decoded: Decoded) -> Self {
        let Decoded { epoch, gaussians, present_blocks, blocks, .. } = decoded;
        Self { epoch: epoch.0.into(), gaussians: gaussians as u32, present_blocks, blocks }
    }
}

impl From<Gaussian> for DgsGaussian {
    fn from(gaussian: Gaussian) -> Self {
        let Gaussian { position, scale, rotation, opacity, sh0 } = gaussian;
        Self { position, scale, rotation, opacity, sh0 }
    }
}
