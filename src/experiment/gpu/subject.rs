//! The scenes of the engines over states: a volume cut into cells, and overlapping shells.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::counterfactual::{States, Variants, brute};
use render_host::{Camera, Image, Settings, Splats};

use super::scene::{self, GROUPS, Numbers};

/// A scene with groups, a camera and the picture wanted.
pub(super) struct Subject {
    /// A or B, and the side in pixels.
    pub(super) name: String,
    pub(super) gaussians: Vec<Gaussian>,
    pub(super) groups: Vec<u32>,
    pub(super) camera: Camera,
    /// The whole scene, a little darker and with a pattern: no error is near 0.
    pub(super) wanted: Image,
}

impl Subject {
    /// Scene A, a uniform volume in 64 cells, the worst case for interleaved depths, and B, 64 overlapping
    /// ellipsoid shells; 64 clusters of two levels each.
    /// Only A when it must be quick.
    pub(super) fn all(n: usize, side: u32, quick: bool) -> Result<Vec<Self>> {
        let volume = scene::volume(n);
        let cells = scene::groups(&volume);
        let mut out = vec![Self::new("A", volume, cells, side)?];
        if !quick {
            let (shells, clusters) = shells(n);
            out.push(Self::new("B", shells, clusters, side)?);
        }
        Ok(out)
    }

    fn new(name: &str, gaussians: Vec<Gaussian>, groups: Vec<u32>, side: u32) -> Result<Self> {
        let camera = scene::camera(side)?;
        let picture = {
            let variants = Variants::new(Splats::plain(&gaussians), &groups, GROUPS)?;
            brute::image(&variants, &States::full(GROUPS), 0, &camera, &Settings::default())?
        };
        let noisy = |(i, v): (usize, &f32)| v * 0.97 + 0.01 * ((i * 7919 % 101) as f32 / 101.0);
        let wanted = Image::new(side, side, picture.rgb().iter().enumerate().map(noisy).collect())?;
        Ok(Self { name: format!("{name}.{side}"), gaussians, groups, camera, wanted })
    }

    pub(super) fn splats(&self) -> Splats<'_> {
        Splats::plain(&self.gaussians)
    }

    pub(super) fn variants(&self) -> Result<Variants<'_>> {
        Ok(Variants::new(self.splats(), &self.groups, GROUPS)?)
    }
}

/// Gaussians on ellipsoid shells, thin across them, and their groups: shell by index, level by chance.
fn shells(n: usize) -> (Vec<Gaussian>, Vec<u32>) {
    let count = GROUPS / 2;
    let mut r = Numbers(11);
    let mut between = |low: f32, high: f32| [0; 3].map(|_| low + (high - low) * r.unit());
    let shells: Vec<[[f32; 3]; 3]> =
        (0..count).map(|_| [between(-0.9, 0.9), between(0.08, 0.3), between(0.0, 1.0)]).collect();
    let gaussian = |i: usize| {
        let [centre, radii, base] = shells[i % count];
        let d = [0; 3].map(|_| r.normal());
        let length = d.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
        let mut wide = || 0.013 * (0.4 * r.normal()).exp();
        let scale = [wide(), wide(), 0.25 * 0.013];
        let q = [0; 4].map(|_| r.normal());
        let norm = q.iter().map(|v| v * v).sum::<f32>().sqrt().max(1e-3);
        let gaussian = Gaussian {
            position: std::array::from_fn(|k| centre[k] + radii[k] * d[k] / length),
            scale,
            rotation: q.map(|v| v / norm),
            opacity: 1.0 / (1.0 + (-(1.0 + 1.5 * r.normal())).exp()),
            sh0: base.map(|c| ((c + 0.2 * r.normal()).clamp(0.0, 1.0) - 0.5) / 0.282_094_8),
        };
        (gaussian, (2 * (i % count)) as u32 + u32::from(r.unit() < 0.5))
    };
    (0..n).map(gaussian).unzip()
}
