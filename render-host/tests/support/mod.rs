//! Scenes for tests and benches: random, but the same every time.

use codec_core::{Gaussian, ShDegree};
use render_host::{Camera, Splats};

/// Numbers from a seed (a 64-bit linear congruence; top bits).
pub struct TestRng(pub u64);

impl TestRng {
    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform in `low..high`.
    pub fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }
}

/// Gaussians and their harmonics.
pub struct Scene {
    pub gaussians: Vec<Gaussian>,
    pub rest: Vec<f32>,
    pub degree: ShDegree,
}

impl Scene {
    /// `n` Gaussians in [-1, 1]³ with scales of `smallest` to `largest`, evenly in their logarithm.
    pub fn random(n: usize, degree: u8, smallest: f32, largest: f32, seed: u64) -> Self {
        let mut r = TestRng(seed);
        let degree = ShDegree::new(degree).unwrap();
        let (low, high) = (smallest.ln(), largest.ln());
        let gaussians = (0..n)
            .map(|_| {
                let q = [0; 4].map(|_| r.between(-1.0, 1.0));
                let length = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
                Gaussian {
                    position: [0; 3].map(|_| r.between(-1.0, 1.0)),
                    scale: [0; 3].map(|_| r.between(low, high).exp()),
                    rotation: q.map(|v| v / length),
                    opacity: r.between(0.02, 1.0),
                    sh0: [0; 3].map(|_| r.between(-1.7, 1.7)),
                }
            })
            .collect();
        let rest = (0..n * degree.rest_len()).map(|_| r.between(-0.3, 0.3)).collect();
        Self { gaussians, rest, degree }
    }

    pub fn splats(&self) -> Splats<'_> {
        Splats::new(&self.gaussians, &self.rest, self.degree).unwrap()
    }
}

/// A camera 3.2 from the origin with a focal length of 0.9 of the width.
pub fn camera(width: u32, height: u32) -> Camera {
    let fov_y = 2.0 * (0.5 * f64::from(height) / (0.9 * f64::from(width))).atan();
    Camera::look_at([1.9, -2.1, 1.45], [0.0; 3], [0.0, 0.0, 1.0], fov_y, width, height).unwrap()
}
