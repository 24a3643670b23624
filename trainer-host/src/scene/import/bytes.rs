//! Reads little-endian values from untrusted bytes: every read is checked, none allocates.

/// The `N` bytes at `offset`, if they are there.
pub(super) fn array<const N: usize>(bytes: &[u8], offset: usize) -> Option<[u8; N]> {
    bytes.get(offset..offset.checked_add(N)?)?.try_into().ok()
}

pub(super) fn u16_at(bytes: &[u8], offset: usize) -> Option<u16> {
    array(bytes, offset).map(u16::from_le_bytes)
}

pub(super) fn u32_at(bytes: &[u8], offset: usize) -> Option<u32> {
    array(bytes, offset).map(u32::from_le_bytes)
}

pub(super) fn u64_at(bytes: &[u8], offset: usize) -> Option<u64> {
    array(bytes, offset).map(u64::from_le_bytes)
}

pub(super) fn f32_at(bytes: &[u8], offset: usize) -> Option<f32> {
    array(bytes, offset).map(f32::from_le_bytes)
}

/// The low `bits` of `value >> shift` as 0..=1.
pub(super) fn unorm(value: u32, shift: u32, bits: u32) -> f32 {
    let mask = (1u32 << bits) - 1;
    ((value >> shift) & mask) as f32 / mask as f32
}

/// `lo` at 0, `hi` at 1.
pub(super) fn lerp(lo: f32, hi: f32, t: f32) -> f32 {
    lo * (1.0 - t) + hi * t
}
