//! A stage clock times the stages of a submission on the device.

use super::{Device, GpuError};

/// How long a stage took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageTime {
    /// Name of the stage.
    pub name: &'static str,
    /// Milliseconds on the device.
    pub ms: f64,
}

/// Stages timed at most per frame.
const STAGES: u32 = 16;
const BYTES: u64 = 16 * STAGES as u64;

/// Two timestamps per stage.
#[derive(Debug)]
pub struct Clock {
    set: wgpu::QuerySet,
    resolved: wgpu::Buffer,
    names: Vec<&'static str>,
}

impl Clock {
    /// A clock; `None` where the device has no timestamps.
    ///
    /// # Errors
    /// No memory for it.
    pub fn new(device: &Device) -> Result<Option<Self>, GpuError> {
        if !device.facts().has_timestamps {
            return Ok(None);
        }
        let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
        let resolved = device.buffer("timestamps", BYTES, usage)?;
        let descriptor = wgpu::QuerySetDescriptor {
            label: Some("stages"),
            ty: wgpu::QueryType::Timestamp,
            count: 2 * STAGES,
        };
        let set = device.guarded("timestamps", || device.raw().create_query_set(&descriptor))?;
        Ok(Some(Self { set, resolved, names: Vec::new() }))
    }

    /// Forgets the last frame.
    pub fn start(&mut self) {
        self.names.clear();
    }

    /// Where the pass of stage `name` writes its two times; `None` past the last place.
    pub fn stage(&mut self, name: &'static str) -> Option<wgpu::ComputePassTimestampWrites<'_>> {
        let at = self.names.len() as u32;
        if at == STAGES {
            return None;
        }
        self.names.push(name);
        Some(wgpu::ComputePassTimestampWrites {
            query_set: &self.set,
            beginning_of_pass_write_index: Some(2 * at),
            end_of_pass_write_index: Some(2 * at + 1),
        })
    }

    /// Ends the frame: call before the encoder is finished.
    pub fn finish(&self, encoder: &mut wgpu::CommandEncoder) {
        if !self.names.is_empty() {
            encoder.resolve_query_set(&self.set, 0..2 * self.names.len() as u32, &self.resolved, 0);
        }
    }

    /// Times of the last frame that was submitted.
    ///
    /// # Errors
    /// The device was lost.
    pub fn read(&self, device: &Device) -> Result<Vec<StageTime>, GpuError> {
        let bytes = device.read(&self.resolved, BYTES)?;
        let ticks: Vec<u64> = bytes.chunks_exact(8).map(bytemuck::pod_read_unaligned).collect();
        let ms = 1e-6 * f64::from(device.queue().get_timestamp_period());
        let span =
            |(name, t): (&&'static str, &[u64])| StageTime { name, ms: ms * t[1].wrapping_sub(t[0]) as f64 };
        Ok(self.names.iter().zip(ticks.chunks_exact(2)).map(span).collect())
    }
}
