//! A presenter shows the picture that the stages made on a texture: one triangle, one pass.

use render_host::gpu::{Device, GpuError, wgpu};

/// Bytes of `Shape` in `present.wgsl`.
const SHAPE_BYTES: u64 = 32;

/// The pass, for textures of one format.
#[derive(Debug)]
pub(crate) struct Presenter {
    pipeline: wgpu::RenderPipeline,
    shape: wgpu::Buffer,
    bound: Option<(wgpu::Buffer, wgpu::BindGroup)>,
}

/// What a picture is and where it goes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    pub background: [f32; 3],
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
    /// Width and height of the texture, pixels.
    pub shown: [u32; 2],
}

impl Presenter {
    /// The pass for textures of `format`, which is no sRGB format: display colours are written as they are.
    pub fn new(device: &Device, format: wgpu::TextureFormat) -> Result<Self, GpuError> {
        let uniform = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let shape = device.buffer("shape", SHAPE_BYTES, uniform)?;
        Ok(Self { pipeline: pipeline(device.raw(), format), shape, bound: None })
    }

    /// Submits the pass: `image` of the renderer, over its background, on `view`.
    pub fn show(&mut self, device: &Device, image: &wgpu::Buffer, view: &wgpu::TextureView, shape: Shape) {
        device.queue().write_buffer(&self.shape, 0, &bytes(shape));
        let group = self.group(device.raw(), image);
        let mut encoder = device.raw().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("present"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &group, &[]);
            pass.draw(0..3, 0..1);
        }
        device.queue().submit([encoder.finish()]);
    }

    /// What the pass reads. The same as long as the renderer keeps its buffer.
    fn group(&mut self, device: &wgpu::Device, image: &wgpu::Buffer) -> wgpu::BindGroup {
        if let Some((bound, group)) = &self.bound
            && bound == image
        {
            return group.clone();
        }
        let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("picture"),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: self.shape.as_entire_binding() },
                wgpu::BindGroupEntry { binding: 1, resource: image.as_entire_binding() },
            ],
        });
        self.bound = Some((image.clone(), group.clone()));
        group
    }
}

/// `Shape` as `present.wgsl` has it.
fn bytes(shape: Shape) -> [u8; SHAPE_BYTES as usize] {
    let mut bytes = [0u8; SHAPE_BYTES as usize];
    let [r, g, b] = shape.background.map(f32::to_bits);
    let ([width, height], [columns, rows]) = (shape.size, shape.shown);
    let words = [r, g, b, 0, width, height, columns, rows];
    for (out, word) in bytes.chunks_exact_mut(4).zip(words) {
        out.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

fn pipeline(device: &wgpu::Device, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
    let source = wgpu::ShaderSource::Wgsl(include_str!("present.wgsl").into());
    let module =
        device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("present.wgsl"), source });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("present"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("colour"),
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
