//! One number for a decoded frame, so that targets can be compared bit by bit.
//!
//! FNV-1a, 64 bits, over the bytes of every `f32` in little-endian order: fields of a [`Gaussian`]
//! as declared, Gaussian after Gaussian, then the higher bands. Two digests are equal if and,
//! chance aside, only if every bit is; rounding, flushed denormals or fused multiply-adds show.

use crate::gaussian::Gaussian;

/// A running digest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Digest(u64);

impl Default for Digest {
    fn default() -> Self {
        Self::new()
    }
}

impl Digest {
    /// The digest of nothing: the offset basis of FNV-1a.
    pub const fn new() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }

    /// A digest that goes on from [`Digest::get`].
    pub const fn resume(state: u64) -> Self {
        Self(state)
    }

    /// With `bytes` added.
    #[must_use]
    pub fn bytes(self, bytes: &[u8]) -> Self {
        let step = |hash: u64, byte: &u8| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
        Self(bytes.iter().fold(self.0, step))
    }

    /// With `values` added.
    #[must_use]
    pub fn values(self, values: &[f32]) -> Self {
        values.iter().fold(self, |digest, value| digest.bytes(&value.to_le_bytes()))
    }

    /// With a decoded frame added: its Gaussians, then its higher bands.
    #[must_use]
    pub fn frame(self, gaussians: &[Gaussian], sh_rest: &[f32]) -> Self {
        let add = |digest: Self, g: &Gaussian| {
            digest
                .values(&g.position)
                .values(&g.scale)
                .values(&g.rotation)
                .values(&[g.opacity])
                .values(&g.sh0)
        };
        gaussians.iter().fold(self, add).values(sh_rest)
    }

    /// As a number.
    pub const fn get(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_values_of_fnv_1a() {
        assert_eq!(Digest::new().get(), 0xcbf2_9ce4_8422_2325);
        assert_eq!(Digest::new().bytes(b"a").get(), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(Digest::new().bytes(b"foobar").get(), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn every_bit_of_a_frame_counts_and_so_does_its_place() {
        let gaussian = Gaussian { position: [1.0, 2.0, 3.0], ..Gaussian::ABSENT };
        let whole = Digest::new().frame(&[gaussian, Gaussian::ABSENT], &[0.5]);
        assert_ne!(whole, Digest::new().frame(&[Gaussian::ABSENT, gaussian], &[0.5]));
        assert_ne!(whole, Digest::new().frame(&[gaussian, Gaussian::ABSENT], &[-0.5]));
        for bit in 0..32 {
            let mut other = gaussian;
            other.sh0[1] = f32::from_bits(other.sh0[1].to_bits() ^ 1 << bit);
            assert_ne!(whole, Digest::new().frame(&[other, Gaussian::ABSENT], &[0.5]));
        }
        let parts = Digest::new().frame(&[gaussian], &[]).frame(&[Gaussian::ABSENT], &[0.5]);
        assert_eq!(whole, Digest::resume(parts.get()));
    }
}
