//! Divides a caller's block of memory among the parts of a receiver and a decoder.
//!
//! The block is a slice of 64-bit words, so that every part can start aligned without `unsafe`.
//! [`Plan`] says how many words a stream needs and cuts the block into typed slices; everything that
//! receives a stream, on a microcontroller or on a host, gets its memory from here.

use bytemuck::Pod;

use crate::{
    caps::Caps,
    decode,
    error::{Error, Result},
    gaussian::{Gaussian, ShDegree},
    receiver::{self, Cell, Requirements},
    wire::manifest::Manifest,
};

/// Bytes of one word of an arena.
pub(crate) const WORD_BYTES: usize = size_of::<u64>();

/// How much memory a stream takes besides its manifest, in elements of each part.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// What the receiver keeps.
    receiver: Requirements,
    /// What frames take.
    frames: FrameRequirements,
}

/// How much memory the frames of a stream take, in elements of each part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameRequirements {
    /// Gaussians of the largest epoch.
    pub gaussians: usize,
    /// Canonical blocks of the epoch that has most.
    pub blocks: usize,
    /// Harmonic coefficients above band 0 of the largest epoch.
    pub sh_rest: usize,
}

impl FrameRequirements {
    /// What frames of the stream of `manifest` take.
    pub fn of(manifest: &Manifest<'_>) -> Self {
        let (gaussians, blocks) = (manifest.largest_epoch() as usize, manifest.largest_blocks() as usize);
        Self { gaussians, blocks, sh_rest: gaussians.saturating_mul(manifest.sh_degree().rest_len()) }
    }
}

/// The parts of an arena.
#[derive(Debug)]
pub struct Parts<'a> {
    /// What the receiver keeps.
    pub receiver: receiver::Memory<'a>,
    /// What the decoder keeps between frames.
    pub decoder: decode::Memory<'a>,
    /// Gaussians of the frame shown.
    pub gaussians: &'a mut [Gaussian],
    /// Higher harmonic bands of the frame shown.
    pub sh_rest: &'a mut [f32],
}

impl Plan {
    /// What the stream of `manifest` takes.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) naming the count that exceeds `caps`.
    pub fn of(manifest: &Manifest<'_>, caps: &Caps) -> Result<Self> {
        // First the counts that the caps bound, then the walk over what is counted.
        let receiver = Requirements::of(manifest, caps)?;
        Ok(Self { receiver, frames: FrameRequirements::of(manifest) })
    }

    /// What the largest stream within `caps` takes.
    pub const fn most(caps: &Caps) -> Self {
        let gaussians = caps.gaussians_per_epoch as usize;
        let blocks = if gaussians < caps.blocks as usize { gaussians } else { caps.blocks as usize };
        let sh_rest = gaussians.saturating_mul(ShDegree::MAX.rest_len());
        let frames = FrameRequirements { gaussians, blocks, sh_rest };
        Self { receiver: Requirements::most(caps), frames }
    }

    /// Words for everything, entropy tables in the fast form; saturates.
    pub const fn words(&self) -> usize {
        self.words_with(self.receiver.slots)
    }

    /// Words for everything, entropy tables in the compact form; saturates.
    pub const fn least_words(&self) -> usize {
        self.words_with(self.receiver.least_slots)
    }

    const fn words_with(&self, slots: usize) -> usize {
        let (need, frames) = (&self.receiver, &self.frames);
        let parts = [
            words_of::<Cell>(need.cells),
            words_of::<i16>(need.symbols),
            words_of::<u8>(need.blocks),
            words_of::<u32>(need.seen),
            words_of::<u32>(slots),
            words_of::<u32>(need.progress),
            words_of::<u8>(need.parity),
            words_of::<Gaussian>(frames.gaussians),
            words_of::<u8>(frames.blocks),
            words_of::<Gaussian>(frames.gaussians),
            words_of::<f32>(frames.sh_rest),
        ];
        let (mut sum, mut i) = (0usize, 0);
        while i < parts.len() {
            sum = sum.saturating_add(parts[i]);
            i += 1;
        }
        sum
    }

    /// Cuts the front of `arena` into parts: with tables in the fast form if they fit, else compact.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`](crate::ErrorKind::Capacity) if `arena` is shorter than
    /// [`Plan::least_words`]: bytes there are and
    /// bytes needed.
    pub fn divide<'a>(&self, arena: &'a mut [u64]) -> Result<Parts<'a>> {
        let (need, frames) = (&self.receiver, &self.frames);
        let slots = if self.words() <= arena.len() { need.slots } else { need.least_slots };
        let have = size_of_val(arena);
        let needed = self.least_words().saturating_mul(WORD_BYTES);
        let mut rest = Rest(arena);
        let parts = (|| {
            Some(Parts {
                receiver: receiver::Memory {
                    cells: rest.take(need.cells)?,
                    symbols: rest.take(need.symbols)?,
                    blocks: rest.take(need.blocks)?,
                    seen: rest.take(need.seen)?,
                    slots: rest.take(slots)?,
                    progress: rest.take(need.progress)?,
                    parity: rest.take(need.parity)?,
                },
                decoder: decode::Memory {
                    canonical: rest.take(frames.gaussians)?,
                    known: rest.take(frames.blocks)?,
                },
                gaussians: rest.take(frames.gaussians)?,
                sh_rest: rest.take(frames.sh_rest)?,
            })
        })();
        parts.ok_or_else(|| Error::too_small("arena", have, needed))
    }
}

/// Words that `count` elements take; saturates.
pub(crate) const fn words_of<T>(count: usize) -> usize {
    count.saturating_mul(size_of::<T>()).div_ceil(WORD_BYTES)
}

/// What is left of an arena.
pub(crate) struct Rest<'a>(pub(crate) &'a mut [u64]);

impl<'a> Rest<'a> {
    /// Cuts `count` elements off the front; `None`, and nothing is cut off, if there are fewer.
    pub(crate) fn take<T: Pod>(&mut self, count: usize) -> Option<&'a mut [T]> {
        let words = words_of::<T>(count);
        if words > self.0.len() {
            return None;
        }
        let (front, rest) = core::mem::take(&mut self.0).split_at_mut_checked(words)?;
        self.0 = rest;
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(front);
        // Words are rounded up: the last one may hold more bytes than the elements take.
        let exact = bytes.get_mut(..count.checked_mul(size_of::<T>())?)?;
        bytemuck::try_cast_slice_mut(exact).ok()
    }
}

impl Caps {
    /// Length of an arena, in 64-bit words, that holds every stream within these caps: the receiver's
    /// memory, the decoder's and that of the frame shown. Saturates.
    ///
    /// ```
    /// use codec_core::Caps;
    ///
    /// const CAPS: Caps = Caps { gaussians_per_epoch: 1000, early_bytes: 1200, ..Caps::SMALL };
    /// static ARENA: [u64; CAPS.arena_words()] = [0; CAPS.arena_words()];
    /// assert!(size_of_val(&ARENA) < 2 << 20);
    /// ```
    pub const fn arena_words(&self) -> usize {
        let manifest = words_of::<u8>(self.manifest_bytes as usize);
        let early = words_of::<u8>(self.early_bytes as usize);
        Plan::most(self).words().saturating_add(manifest).saturating_add(early)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ids::Level, limits};

    /// On targets of 32 bits numbers of words saturate.
    #[test]
    fn a_host_stays_under_a_gibibyte_and_a_microcontroller_under_a_mebibyte() {
        let bytes = |words: usize| WORD_BYTES as u64 * words as u64;
        let receiver = |caps: Caps| {
            let frames = Plan { receiver: Requirements::default(), ..Plan::most(&caps) };
            bytes(caps.arena_words()) - bytes(frames.words())
        };
        assert!(usize::BITS < 64 || receiver(Caps::HOST) < 1 << 30, "{}", receiver(Caps::HOST));
        assert!(receiver(Caps::SMALL) < 1 << 20, "{}", receiver(Caps::SMALL));
        let arena = |caps: Caps| bytes(caps.arena_words());
        assert!(arena(Caps::SMALL) < 9 << 18, "{}", arena(Caps::SMALL));
        assert!(usize::BITS < 64 || arena(Caps::HOST) < 3 << 30, "{}", arena(Caps::HOST));
    }

    /// Counters of symbols are for canonical cells, of which there are no more than clusters.
    #[test]
    fn counters_are_for_as_many_cells_as_there_are_clusters() {
        let most = |cells| Requirements::most(&Caps { cells, symbols: 0, ..Caps::HOST }).progress;
        assert_eq!(most(7), 7 * Level::COUNT);
        assert_eq!(most(u32::MAX), limits::MAX_CLUSTERS as usize * Level::COUNT);
    }
}
