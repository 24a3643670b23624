//! The scene that all parts draw.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::{Camera, counterfactual::States};

/// Numbers from a seed: a 64-bit linear congruence, top bits.
pub struct Numbers(pub u64);

impl Numbers {
    /// Uniform in 0..1.
    pub fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Roughly normal, variance 1.
    pub fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.unit()).sum::<f32>() - 6.0
    }
}

/// `n` Gaussians in [-1, 1]³, about 0.012 wide, half of them rather opaque.
pub fn volume(n: usize) -> Vec<Gaussian> {
    let mut r = Numbers(7);
    let gaussian = |_| {
        let position = [0; 3].map(|_| 2.0 * r.unit() - 1.0);
        let scale = [0; 3].map(|_| 0.012 * (0.4 * r.normal()).exp());
        let q = [0; 4].map(|_| r.normal());
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
        let opacity = 1.0 / (1.0 + (-1.5 * r.normal()).exp());
        let sh0 = [0; 3].map(|_| (r.unit() - 0.5) / 0.282_094_8);
        Gaussian { position, scale, rotation: q.map(|v| v / length), opacity, sh0 }
    };
    (0..n).map(gaussian).collect()
}

/// Cells of a 4 × 4 × 4 grid with two levels each: 128 groups.
pub const GROUPS: usize = 128;

/// The group of each Gaussian: its cell, and a level by index.
pub fn groups(gaussians: &[Gaussian]) -> Vec<u32> {
    let cell = |p: f32| (((p + 1.0) * 2.0) as u32).min(3);
    let group = |(i, g): (usize, &Gaussian)| {
        let [x, y, z] = g.position.map(cell);
        2 * (x + 4 * y + 16 * z) + (i % 2) as u32
    };
    gaussians.iter().enumerate().map(group).collect()
}

/// `worlds` deliveries: a cell in ten is missing, half of the others lack their second level.
pub fn deliveries(worlds: usize) -> States {
    let mut r = Numbers(99);
    let mut states = States::new(GROUPS);
    for _ in 0..worlds {
        let depth: Vec<usize> = (0..GROUPS / 2)
            .map(|_| if r.unit() < 0.1 { 0 } else { 1 + usize::from(r.unit() < 0.5) })
            .collect();
        states.push(|group| group % 2 < depth[group / 2]);
    }
    states
}

/// A camera 3.2 from the origin with a focal length of 0.9 of the width, square.
pub fn camera(side: u32) -> Result<Camera> {
    let fov_y = 2.0 * (0.5f64 / 0.9).atan();
    Ok(Camera::look_at([1.9, -2.1, 1.45], [0.0; 3], [0.0, 0.0, 1.0], fov_y, side, side)?)
}
