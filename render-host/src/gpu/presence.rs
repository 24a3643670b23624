//! Presence says on the device which worlds include which groups: a bit per group and world.

use super::{Device, GpuError, GrowableBuffer};
use crate::counterfactual::States;

/// Which worlds hold which groups: for every group `words` words, a bit per world.
#[derive(Debug)]
pub struct Presence {
    buffer: GrowableBuffer,
    worlds: u32,
    groups: u32,
    words: u32,
}

impl Presence {
    /// Uploads `states`.
    ///
    /// # Errors
    /// The device has no room, or there is no world.
    pub fn new(device: &Device, states: &States) -> Result<Self, GpuError> {
        if states.is_empty() {
            return Err(GpuError::Length { field: "worlds", found: 0, needed: 1 });
        }
        let words = states.len().div_ceil(32);
        let mut bits = vec![0u32; states.groups() * words];
        for (group, row) in bits.chunks_exact_mut(words).enumerate() {
            for world in 0..states.len() {
                row[world / 32] |= u32::from(states.has(world, group)) << (world % 32);
            }
        }
        let mut buffer = GrowableBuffer::new("presence");
        buffer.reserve(device, 16)?;
        buffer.write(device, bytemuck::cast_slice(&bits))?;
        Ok(Self { buffer, worlds: states.len() as u32, groups: states.groups() as u32, words: words as u32 })
    }

    /// Number of worlds.
    pub fn worlds(&self) -> u32 {
        self.worlds
    }

    /// Number of groups.
    pub fn groups(&self) -> u32 {
        self.groups
    }

    /// Words per group.
    pub fn words(&self) -> u32 {
        self.words
    }

    /// The bits.
    ///
    /// # Errors
    /// Never, once made.
    pub fn buffer(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffer.get()
    }
}
