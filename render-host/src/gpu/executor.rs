//! The executor compiles kernels, binds recordings to their buffers and submits them.

use std::{
    collections::HashMap,
    sync::{Arc, Mutex, PoisonError},
};

use super::{
    Clock, Device, GpuError,
    layout::ARGS_STRIDE,
    recording::{Dispatch, Recording, Workgroups},
    source::{Bind, Kernel},
};

/// Runs recordings on one device. Kernels are compiled when they are first needed and kept. Cheap to clone;
/// clones share device and kernels.
#[derive(Clone, Debug)]
pub struct Executor {
    device: Device,
    pipelines: Arc<Mutex<HashMap<Kernel, Pipeline>>>,
}

#[derive(Clone, Debug)]
struct Pipeline {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

/// A recording with its kernels compiled and its buffers bound: ready to be submitted, any number of times.
#[derive(Debug)]
pub struct BoundRecording {
    recording: Recording,
    passes: Vec<BoundPass>,
}

/// Per dispatch of a pass, what runs on what.
type BoundPass = Vec<(wgpu::ComputePipeline, wgpu::BindGroup)>;

impl Executor {
    /// An executor without kernels on `device`.
    pub fn new(device: &Device) -> Self {
        Self { device: device.clone(), pipelines: Arc::default() }
    }

    /// The device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Compiles what is not compiled yet, and binds all buffers.
    ///
    /// # Errors
    /// The device refuses a shader or a buffer.
    pub fn bind(&self, recording: Recording) -> Result<BoundRecording, GpuError> {
        let passes = self.device.guarded("bind groups", || self.bind_all(&recording))??;
        Ok(BoundRecording { recording, passes })
    }

    /// As [`Executor::bind`], unless `kept` is this very recording already bound.
    ///
    /// # Errors
    /// As [`Executor::bind`].
    pub fn bind_again<'a>(
        &self,
        recording: Recording,
        cache: &'a mut Option<BoundRecording>,
    ) -> Result<&'a BoundRecording, GpuError> {
        let bound = match cache.take() {
            Some(bound) if bound.recording == recording => bound,
            _ => self.bind(recording)?,
        };
        Ok(cache.insert(bound))
    }

    /// Submits; nothing is waited for. With a clock, stages are timed.
    pub fn submit(&self, bound: &BoundRecording, mut clock: Option<&mut Clock>) {
        let raw = self.device.raw();
        let mut encoder = raw.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        if let Some(clock) = &mut clock {
            clock.start();
        }
        for (pass, ready) in bound.recording.passes.iter().zip(&bound.passes) {
            for buffer in &pass.cleared {
                encoder.clear_buffer(buffer, 0, None);
            }
            let timed = clock.as_deref_mut().zip(pass.stage);
            let timestamp_writes = timed.and_then(|(clock, stage)| clock.stage(stage));
            let label = pass.stage;
            let mut open =
                encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label, timestamp_writes });
            for (dispatch, (pipeline, group)) in pass.dispatches.iter().zip(ready) {
                open.set_pipeline(pipeline);
                open.set_bind_group(0, group, &[]);
                match &dispatch.workgroups {
                    Workgroups::Counted([x, y, z]) => open.dispatch_workgroups(*x, *y, *z),
                    Workgroups::Indirect { arguments, place } => {
                        open.dispatch_workgroups_indirect(arguments, place * ARGS_STRIDE);
                    }
                }
            }
        }
        if let Some(clock) = clock {
            clock.finish(&mut encoder);
        }
        self.device.queue().submit([encoder.finish()]);
    }

    /// Binds and submits.
    ///
    /// # Errors
    /// As [`Executor::bind`].
    pub fn run(&self, recording: Recording) -> Result<(), GpuError> {
        self.submit(&self.bind(recording)?, None);
        Ok(())
    }

    fn bind_all(&self, recording: &Recording) -> Result<Vec<BoundPass>, GpuError> {
        let mut passes = Vec::with_capacity(recording.passes.len());
        for pass in &recording.passes {
            let mut bound = Vec::with_capacity(pass.dispatches.len());
            for dispatch in &pass.dispatches {
                let Pipeline { pipeline, layout } = self.pipeline(&dispatch.kernel)?;
                bound.push((pipeline, self.group(&layout, dispatch)));
            }
            passes.push(bound);
        }
        Ok(passes)
    }

    fn pipeline(&self, kernel: &Kernel) -> Result<Pipeline, GpuError> {
        let mut pipelines = self.pipelines.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = pipelines.get(kernel) {
            return Ok(found.clone());
        }
        let compiled = self.compile(kernel)?;
        pipelines.insert(kernel.clone(), compiled.clone());
        Ok(compiled)
    }

    fn compile(&self, kernel: &Kernel) -> Result<Pipeline, GpuError> {
        let (raw, source) = (self.device.raw(), kernel.source);
        self.device.guarded(kernel.entry, || {
            let entries: Vec<_> =
                (0u32..).zip(source.bindings).map(|(i, &(_, bind))| layout_entry(i, bind)).collect();
            let layout = raw.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(source.name),
                entries: &entries,
            });
            let pipeline_layout = raw.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(source.name),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            let module = self.device.module(source.name, &source.text());
            let constants: Vec<_> =
                kernel.constants.iter().map(|&(name, value)| (name, f64::from(value))).collect();
            let pipeline = raw.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(kernel.entry),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(kernel.entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants: &constants,
                    // Each kernel writes its workgroup memory before it reads it.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            });
            Pipeline { pipeline, layout }
        })
    }

    fn group(&self, layout: &wgpu::BindGroupLayout, dispatch: &Dispatch) -> wgpu::BindGroup {
        let entries: Vec<_> = (0u32..)
            .zip(&dispatch.buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        self.device.raw().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(dispatch.kernel.entry),
            layout,
            entries: &entries,
        })
    }
}

fn layout_entry(binding: u32, bind: Bind) -> wgpu::BindGroupLayoutEntry {
    let ty = match bind {
        Bind::Uniform => wgpu::BufferBindingType::Uniform,
        Bind::Read => wgpu::BufferBindingType::Storage { read_only: true },
        Bind::Write => wgpu::BufferBindingType::Storage { read_only: false },
    };
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
        count: None,
    }
}
