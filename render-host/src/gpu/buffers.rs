//! Buffers are made, filled, grown and read here.

use wgpu::BufferUsages as Usage;

use super::{Device, GpuError};

/// What every storage buffer is for: kernels, and copies both ways.
const STORAGE: Usage = Usage::STORAGE.union(Usage::COPY_SRC).union(Usage::COPY_DST);

impl Device {
    /// A storage buffer of at least `bytes` that can be copied both ways.
    pub(super) fn storage(&self, what: &'static str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
        self.buffer(what, bytes, STORAGE)
    }

    /// A storage buffer that holds `data`.
    pub(super) fn filled(&self, what: &'static str, data: &[u8]) -> Result<wgpu::Buffer, GpuError> {
        let buffer = self.storage(what, data.len() as u64)?;
        if !data.is_empty() {
            self.queue().write_buffer(&buffer, 0, data);
        }
        Ok(buffer)
    }

    /// A uniform buffer that holds `data`.
    pub(super) fn uniform(&self, what: &'static str, data: &[u8]) -> Result<wgpu::Buffer, GpuError> {
        let buffer = self.buffer(what, data.len() as u64, Usage::UNIFORM | Usage::COPY_DST)?;
        self.queue().write_buffer(&buffer, 0, data);
        Ok(buffer)
    }

    /// The first `count` numbers of `buffer`, once all that was submitted is done.
    pub(super) fn read_f32(&self, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<f32>, GpuError> {
        let bytes = self.read(buffer, 4 * count as u64)?;
        Ok(bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect())
    }
}

/// A storage buffer that is replaced by a larger one when it must hold more; its content is lost.
#[derive(Debug)]
pub struct GrowableBuffer {
    what: &'static str,
    buffer: Option<wgpu::Buffer>,
}

impl GrowableBuffer {
    /// No buffer yet.
    pub fn new(what: &'static str) -> Self {
        Self { what, buffer: None }
    }

    /// The buffer with room for `bytes`; true when it was replaced.
    ///
    /// # Errors
    /// As [`Device::buffer`]; the old buffer is then still there.
    pub fn reserve(&mut self, device: &Device, bytes: u64) -> Result<bool, GpuError> {
        if self.buffer.as_ref().is_some_and(|b| b.size() >= bytes) {
            return Ok(false);
        }
        self.buffer = Some(device.storage(self.what, bytes)?);
        Ok(true)
    }

    /// As [`GrowableBuffer::reserve`], then writes `data` to its start.
    ///
    /// # Errors
    /// As [`GrowableBuffer::reserve`].
    pub fn write(&mut self, device: &Device, data: &[u8]) -> Result<bool, GpuError> {
        let replaced = self.reserve(device, data.len() as u64)?;
        if let Some(buffer) = &self.buffer
            && !data.is_empty()
        {
            device.queue().write_buffer(buffer, 0, data);
        }
        Ok(replaced)
    }

    /// Bytes it holds; 0 before the first [`GrowableBuffer::reserve`].
    pub fn bytes(&self) -> u64 {
        self.buffer.as_ref().map_or(0, wgpu::Buffer::size)
    }

    /// The buffer.
    ///
    /// # Errors
    /// [`GpuError::Refused`] before the first [`GrowableBuffer::reserve`].
    pub fn get(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffer
            .as_ref()
            .ok_or_else(|| GpuError::Refused { what: self.what, message: "never reserved".into() })
    }
}
