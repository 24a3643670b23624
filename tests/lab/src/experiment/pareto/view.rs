//! Holds views: a scene at one frame, seen from one camera.

use anyhow::Result;
use codec_core::{Gaussian, ShDegree};
use render_host::{Camera, Settings, Splats};
use trainer_host::{
    Scene,
    viewpoint::{Framing, Ring},
};

use crate::experiment::cloud::{TestRng, camera};

/// A scene at one frame, and the camera that looks at it.
pub(super) struct View {
    pub name: String,
    pub gaussians: Vec<Gaussian>,
    pub rest: Vec<f32>,
    pub degree: ShDegree,
    pub camera: Camera,
}

impl View {
    pub fn splats(&self) -> Result<Splats<'_>> {
        Ok(Splats::new(&self.gaussians, &self.rest, self.degree)?)
    }

    pub fn of(name: String, scene: &Scene, side: u32) -> Result<Self> {
        let instant = scene.instant(scene.frames() / 2).unwrap_or_default();
        let camera = Framing::of(scene).ring(Ring::HeldOut, 3, (side, side))?.swap_remove(0);
        let (gaussians, rest, degree) = (instant.gaussians, instant.sh_rest, instant.sh_degree);
        Ok(Self { name, gaussians, rest, degree, camera })
    }

    /// `n` Gaussians in [-1, 1]³ with harmonics of degree 3, seen from 3.2 away with a focal length of 0.9 of
    /// the width: the random scene of the renderer's goals.
    pub fn random(n: usize, side: u32) -> Result<Self> {
        let mut r = TestRng(7);
        let mut between = |low: f32, high: f32| r.between(low, high);
        let degree = ShDegree::MAX;
        let (low, high) = (0.004f32.ln(), 0.02f32.ln());
        let gaussians = (0..n)
            .map(|_| Gaussian {
                position: [0; 3].map(|_| between(-1.0, 1.0)),
                scale: [0; 3].map(|_| between(low, high).exp()),
                rotation: [0; 4].map(|_| between(-1.0, 1.0)),
                opacity: between(0.02, 1.0),
                sh0: [0; 3].map(|_| between(-1.7, 1.7)),
            })
            .collect();
        let rest = (0..n * degree.rest_len()).map(|_| between(-0.1, 0.1)).collect();
        let camera = camera(side)?;
        Ok(Self { name: format!("random-{n}"), gaussians, rest, degree, camera })
    }
}

/// The exact picture, the reference: without cut and stop.
pub(super) fn exact() -> Settings {
    // Beyond 1e-12, a hundred thousand splats add less than 1e-7.
    Settings { alpha_cutoff: 1e-12, ..Settings::exact() }
}
