//! Runs a public renderer beside ours: crate `wgpu-3dgs-viewer`, offscreen, on the same device in the same
//! run.
//!
//! It compiles wgpu with all backends and a shader language, so it is behind feature `gpu-peer`.

/// What [`Peer`] is compared as.
pub(super) const NAME: &str = "wgpu-3dgs-viewer 0.8";

#[cfg(feature = "gpu-peer")]
pub(super) use viewer::Peer;
#[cfg(not(feature = "gpu-peer"))]
pub(super) use without::Peer;

/// Why there is no peer, if there is none.
pub(super) fn absent() -> Option<String> {
    (!cfg!(feature = "gpu-peer")).then(|| {
        format!(
            "{NAME} offscreen: not in this binary; \
             `cargo run --profile dist -p dgs-lab --features gpu-peer -- gpu` has it"
        )
    })
}

#[cfg(not(feature = "gpu-peer"))]
mod without {
    use anyhow::Result;
    use codec_core::Gaussian;
    use render_host::{Camera, Image, gpu::Device};

    /// Nobody.
    pub(crate) enum Peer {}

    impl Peer {
        pub(crate) fn new(_: &Device, _: &[Gaussian], _: &Camera) -> Result<Option<Self>> {
            Ok(None)
        }

        pub(crate) fn draw(&self) -> Result<()> {
            match *self {}
        }

        pub(crate) fn picture(&self) -> Result<Image> {
            match *self {}
        }
    }
}

#[cfg(feature = "gpu-peer")]
mod viewer {
    use anyhow::{Context, Result};
    use codec_core::Gaussian;
    use render_host::{
        Camera, Image,
        gpu::{Device, wgpu},
    };
    use wgpu_3dgs_viewer::{
        CameraPod, Viewer,
        core::{
            Gaussian as Theirs, GaussianDisplayMode, GaussianMaxStdDev,
            GaussianPodWithShNoneCov3dSingleConfigs, GaussianShDegree,
            glam::{Mat4, Quat, UVec2, Vec3, Vec4},
        },
    };

    /// What a viewer draws to.
    const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;
    /// Their alpha at a distance of `d` standard deviations is exp(-4 d² / s²) for a largest deviation `s`:
    /// at 2 √2 it is a Gaussian's, cut at 4 deviations. Their default of 3 draws larger ones.
    const LARGEST: f32 = 2.0 * std::f32::consts::SQRT_2;
    /// Near and far, scene units.
    const DEPTHS: [f32; 2] = [0.01, 100.0];

    /// The viewer, its scene without harmonics (its smallest record), and what it draws to.
    pub(crate) struct Peer {
        device: Device,
        viewer: Viewer<GaussianPodWithShNoneCov3dSingleConfigs>,
        target: wgpu::Texture,
        size: [u32; 2],
    }

    impl Peer {
        pub(crate) fn new(device: &Device, gaussians: &[Gaussian], camera: &Camera) -> Result<Option<Self>> {
            let size = [camera.width(), camera.height()];
            let scene: Vec<Theirs> = gaussians.iter().map(theirs).collect();
            let viewer = device.guarded("peer", || Viewer::new(device.raw(), FORMAT, &scene))?;
            let mut viewer = viewer.context("the peer cannot be made")?;
            let queue = device.queue();
            viewer.update_model_transform(queue, Vec3::ZERO, Quat::IDENTITY, Vec3::ONE);
            viewer.update_gaussian_transform(
                queue,
                1.0,
                GaussianDisplayMode::Splat,
                GaussianShDegree::new(0).context("the peer has no degree 0")?,
                false,
                GaussianMaxStdDev::new(LARGEST).context("the peer has another range of deviations")?,
            );
            viewer.update_camera_with_pod(queue, &seen_by(camera));
            let target = device.guarded("peer", || {
                device.raw().create_texture(&wgpu::TextureDescriptor {
                    label: Some("peer"),
                    size: wgpu::Extent3d { width: size[0], height: size[1], depth_or_array_layers: 1 },
                    mip_level_count: 1,
                    sample_count: 1,
                    dimension: wgpu::TextureDimension::D2,
                    format: FORMAT,
                    usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
                    view_formats: &[],
                })
            })?;
            Ok(Some(Self { device: device.clone(), viewer, target, size }))
        }

        /// Submits one frame.
        pub(crate) fn draw(&self) -> Result<()> {
            let view = self.target.create_view(&wgpu::TextureViewDescriptor::default());
            let mut encoder = self.encoder();
            self.viewer.render(&mut encoder, &view);
            self.device.queue().submit([encoder.finish()]);
            Ok(())
        }

        /// The frame drawn last.
        pub(crate) fn picture(&self) -> Result<Image> {
            let [width, height] = self.size;
            let row = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
            let bytes = u64::from(row * height);
            let usage = wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
            let landing = self.device.buffer("peer", bytes, usage)?;
            let mut encoder = self.encoder();
            encoder.copy_texture_to_buffer(
                self.target.as_image_copy(),
                wgpu::TexelCopyBufferInfo {
                    buffer: &landing,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(row),
                        rows_per_image: None,
                    },
                },
                self.target.size(),
            );
            self.device.queue().submit([encoder.finish()]);
            let texels = self.device.read(&landing, bytes)?;
            let rows = texels.chunks_exact(row as usize).map(|row| &row[..4 * width as usize]);
            let pixels = rows.flat_map(|row| row.chunks_exact(4));
            let rgb = pixels.flat_map(|p| [p[0], p[1], p[2]]).map(|v| f32::from(v) / 255.0).collect();
            Ok(Image::new(width, height, rgb)?)
        }

        fn encoder(&self) -> wgpu::CommandEncoder {
            self.device.raw().create_command_encoder(&wgpu::CommandEncoderDescriptor::default())
        }
    }

    fn theirs(g: &Gaussian) -> Theirs {
        let byte = |v: f32| (255.0 * v).round().clamp(0.0, 255.0) as u8;
        let [r, g_, b] = g.sh0.map(|v| byte(0.5 + Theirs::SH0_TO_LINEAR_FACTOR * v));
        let [w, x, y, z] = g.rotation;
        Theirs {
            rot: Quat::from_xyzw(x, y, z, w).normalize(),
            pos: Vec3::from_array(g.position),
            color: [r, g_, b, byte(g.opacity)].into(),
            sh: [Vec3::ZERO; 15],
            scale: Vec3::from_array(g.scale),
        }
    }

    /// `camera` in their axes: x right, y up, z towards the viewer; depths 0 to 1.
    fn seen_by(camera: &Camera) -> CameraPod {
        let (r, t, i) = (camera.rotation(), camera.translation(), camera.intrinsics());
        let turn = [1.0, -1.0, -1.0];
        let column = |k: usize| {
            Vec4::from_array(std::array::from_fn(|j| match (j, k) {
                (3, 3) => 1.0,
                (3, _) => 0.0,
                (_, 3) => (turn[j] * t[j]) as f32,
                _ => (turn[j] * r[j][k]) as f32,
            }))
        };
        let view = Mat4::from_cols(column(0), column(1), column(2), column(3));
        let [near, far] = DEPTHS;
        let (width, height) = (f64::from(i.width), f64::from(i.height));
        let proj = Mat4::from_cols(
            Vec4::new((2.0 * i.fx / width) as f32, 0.0, 0.0, 0.0),
            Vec4::new(0.0, (2.0 * i.fy / height) as f32, 0.0, 0.0),
            Vec4::new(
                (1.0 - 2.0 * i.cx / width) as f32,
                (2.0 * i.cy / height - 1.0) as f32,
                far / (near - far),
                -1.0,
            ),
            Vec4::new(0.0, 0.0, near * far / (near - far), 0.0),
        );
        let size = UVec2::new(i.width, i.height).as_vec2();
        CameraPod { view, proj, size, _padding: [0; 2] }
    }
}
