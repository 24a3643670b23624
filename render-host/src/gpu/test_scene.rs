//! Tests of engines over states share scenes and one executor.

use std::sync::OnceLock;

use codec_core::{Gaussian, ShDegree};

use super::{Device, DeviceOptions, Executor, GpuError};
use crate::{
    Camera, Image, Splats,
    counterfactual::{States, Variants},
};

/// The executor of all tests, with run-time checks in every shader; `None`, with a notice, where there is no
/// adapter. A build server must have one.
pub(super) fn executor() -> Option<&'static Executor> {
    static SHARED: OnceLock<Result<Executor, GpuError>> = OnceLock::new();
    let options = DeviceOptions { checked: true, ..DeviceOptions::from_env() };
    match SHARED.get_or_init(|| Ok(Executor::new(&Device::open(&options)?))) {
        Ok(executor) => Some(executor),
        Err(error) => {
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{error}");
            eprintln!("skipped: {error}");
            None
        }
    }
}

/// Numbers from a seed (a 64-bit linear congruence; top bits).
pub(super) struct TestRng(pub u64);

impl TestRng {
    /// Uniform in 0..1.
    pub(super) fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

/// A scene whose groups are cells of space, so that they overlap in the picture and in depth.
pub(super) struct TestScene {
    pub(super) gaussians: Vec<Gaussian>,
    pub(super) rest: Vec<f32>,
    pub(super) degree: ShDegree,
    pub(super) ids: Vec<u32>,
    pub(super) groups: usize,
    pub(super) camera: Camera,
    pub(super) against: Image,
}

impl TestScene {
    pub(super) fn new(n: usize, degree: u8, groups: usize, [width, height]: [u32; 2], seed: u64) -> Self {
        let mut r = TestRng(seed);
        let degree = ShDegree::new(degree).unwrap();
        let gaussians: Vec<Gaussian> = (0..n)
            .map(|_| {
                let q = [0; 4].map(|_| r.between(-1.0, 1.0));
                let length = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
                Gaussian {
                    position: [0; 3].map(|_| r.between(-1.0, 1.0)),
                    scale: [0; 3].map(|_| r.between(-4.6, -2.1).exp()),
                    rotation: q.map(|v| v / length),
                    opacity: r.between(0.02, 1.0),
                    sh0: [0; 3].map(|_| r.between(-1.7, 1.7)),
                }
            })
            .collect();
        let rest = (0..n * degree.rest_len()).map(|_| r.between(-0.3, 0.3)).collect();
        let cell = |p: f32| ((p + 1.0) * 1.5) as usize;
        let id = |p: [f32; 3]| ((cell(p[0]) + 3 * cell(p[1]) + 9 * cell(p[2])) % groups) as u32;
        let ids = gaussians.iter().map(|g| id(g.position)).collect();
        let fov = 2.0 * (0.5 * f64::from(height) / (0.9 * f64::from(width))).atan();
        let camera =
            Camera::look_at([1.9, -2.1, 1.45], [0.0; 3], [0.0, 0.0, 1.0], fov, width, height).unwrap();
        let rgb = (0..3 * width * height).map(|_| r.unit()).collect();
        let against = Image::new(width, height, rgb).unwrap();
        Self { gaussians, rest, degree, ids, groups, camera, against }
    }

    pub(super) fn splats(&self) -> Splats<'_> {
        Splats::new(&self.gaussians, &self.rest, self.degree).unwrap()
    }

    pub(super) fn variants(&self) -> Variants<'_> {
        Variants::new(self.splats(), &self.ids, self.groups).unwrap()
    }

    /// Random worlds that hold each group with probability 0.7.
    pub(super) fn states(&self, worlds: usize, seed: u64) -> States {
        let mut r = TestRng(seed);
        let mut states = States::new(self.groups);
        (0..worlds).for_each(|_| states.push(|_| r.unit() < 0.7));
        states
    }
}
