//! Buffers that grow.

use super::{Device, GpuError};

/// A storage buffer that is replaced by a larger one when it must hold more; what it held is lost.
#[derive(Debug)]
pub struct Growing {
    what: &'static str,
    usage: wgpu::BufferUsages,
    buffer: Option<wgpu::Buffer>,
}

impl Growing {
    /// No buffer yet. `extra` is added to storage and copying in both directions.
    pub fn new(what: &'static str, extra: wgpu::BufferUsages) -> Self {
        let usage =
            wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST | extra;
        Self { what, usage, buffer: None }
    }

    /// The buffer with room for `bytes`; true when it was replaced.
    ///
    /// # Errors
    /// As [`Device::buffer`]; the old buffer is then still there.
    pub fn reserve(&mut self, device: &Device, bytes: u64) -> Result<bool, GpuError> {
        if self.buffer.as_ref().is_some_and(|b| b.size() >= bytes) {
            return Ok(false);
        }
        self.buffer = Some(device.buffer(self.what, bytes, self.usage)?);
        Ok(true)
    }

    /// As [`Growing::reserve`], then writes `data` to its start.
    ///
    /// # Errors
    /// As [`Growing::reserve`].
    pub fn write(&mut self, device: &Device, data: &[u8]) -> Result<bool, GpuError> {
        let replaced = self.reserve(device, data.len() as u64)?;
        if let Some(buffer) = &self.buffer
            && !data.is_empty()
        {
            device.queue().write_buffer(buffer, 0, data);
        }
        Ok(replaced)
    }

    /// Bytes it holds; 0 before the first [`Growing::reserve`].
    pub fn bytes(&self) -> u64 {
        self.buffer.as_ref().map_or(0, wgpu::Buffer::size)
    }

    /// The buffer.
    ///
    /// # Errors
    /// [`GpuError::Refused`] before the first [`Growing::reserve`].
    pub fn get(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffer
            .as_ref()
            .ok_or_else(|| GpuError::Refused { what: self.what, message: "never reserved".into() })
    }
}
