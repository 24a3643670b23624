//! Compute pipelines of the shaders in [`super::wgsl`].

use super::wgsl::{Bind, Source};
use super::{Device, GpuError};

/// Workgroups along x at most; the rest goes to y. Below WebGPU's 65535.
const ROW: u32 = 32_768;

/// One entry point, ready to run.
#[derive(Debug)]
pub struct Kernel {
    name: &'static str,
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
}

impl Kernel {
    /// Compiles entry point `entry` of `source` with the values of its override constants.
    ///
    /// # Errors
    /// The device refuses the shader.
    pub fn new(
        device: &Device,
        source: &Source,
        entry: &'static str,
        constants: &[(&str, f64)],
    ) -> Result<Self, GpuError> {
        device.guarded(entry, || {
            let raw = device.raw();
            let entries: Vec<_> =
                (0u32..).zip(source.bindings).map(|(i, &(_, bind))| slot(i, bind)).collect();
            let layout = raw.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: Some(source.name),
                entries: &entries,
            });
            let pipeline_layout = raw.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some(source.name),
                bind_group_layouts: &[Some(&layout)],
                immediate_size: 0,
            });
            let module = device.module(source.name, &source.text());
            let pipeline = raw.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: Some(&pipeline_layout),
                module: &module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    // Each kernel writes its workgroup memory before it reads it.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            });
            Self { name: entry, pipeline, layout }
        })
    }

    /// Binds buffers in the order of the source's bindings.
    pub fn bind(&self, device: &Device, buffers: &[&wgpu::Buffer]) -> wgpu::BindGroup {
        let entries: Vec<_> = (0u32..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding, resource: buffer.as_entire_binding() })
            .collect();
        device.raw().create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.name),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Runs `groups` workgroups.
    pub fn run(&self, pass: &mut wgpu::ComputePass, bound: &wgpu::BindGroup, groups: [u32; 3]) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, bound, &[]);
        pass.dispatch_workgroups(groups[0], groups[1], groups[2]);
    }

    /// Runs as many workgroups as the device wrote to place `slot` of `args` (see
    /// [`super::layout::ARGS_STRIDE`]).
    pub fn run_indirect(
        &self,
        pass: &mut wgpu::ComputePass,
        bound: &wgpu::BindGroup,
        args: &wgpu::Buffer,
        slot: u64,
    ) {
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, bound, &[]);
        pass.dispatch_workgroups_indirect(args, slot * super::layout::ARGS_STRIDE);
    }
}

fn slot(binding: u32, bind: Bind) -> wgpu::BindGroupLayoutEntry {
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

/// `groups` workgroups as two dimensions that WebGPU allows; a kernel counts them as
/// `id.x + id.y * count.x` and leaves what is too many.
pub fn groups_2d(groups: u32) -> [u32; 3] {
    [groups.min(ROW), groups.div_ceil(ROW), 1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_dimensions_hold_all_groups_and_stay_below_the_limit() {
        for groups in [0, 1, ROW, ROW + 1, 65_536, u32::MAX / 1024] {
            let [x, y, z] = groups_2d(groups);
            assert!(x * y * z >= groups && x <= 65_535 && (y <= 65_535 || groups > ROW * 65_535), "{groups}");
        }
    }
}
