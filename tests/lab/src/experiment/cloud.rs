//! Makes random scenes of known sizes and groups, for timing: a volume and a set of shells.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::{Camera, Image, counterfactual::States};
use trainer_host::activation::{SH_C0, sigmoid};

/// Groups laid out as `cluster · levels + level`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Lattice {
    /// Number of clusters.
    pub(crate) clusters: usize,
    /// Levels of each cluster, 0 is the base.
    pub(crate) levels: usize,
}

impl Lattice {
    /// Number of groups.
    pub(crate) fn groups(self) -> usize {
        self.clusters * self.levels
    }

    /// Group of `level` of `cluster`.
    pub(crate) fn group(self, cluster: usize, level: usize) -> usize {
        cluster * self.levels + level
    }

    /// Adds a world to `states` in which each level adds Gaussians of its own: present is what was delivered
    /// together with everything below it.
    pub(crate) fn push(self, states: &mut States, delivered: impl Fn(usize, usize) -> bool) {
        states.push(|group| {
            let (cluster, level) = (group / self.levels, group % self.levels);
            (0..=level).all(|below| delivered(cluster, below))
        });
    }
}

/// Clusters and additive levels of each scene: 128 groups.
pub(super) const LATTICE: Lattice = Lattice { clusters: 64, levels: 2 };

/// Which scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CloudShape {
    /// Evenly in [-1, 1]³; clusters are 4×4×4 cells. The worst case for interleaved depths.
    Volume,
    /// On overlapping ellipsoid shells, flat along one axis; clusters are the shells.
    Shells,
}

impl CloudShape {
    /// Both, and the letter of each in keys of figures.
    pub(super) const ALL: [(Self, char); 2] = [(Self::Volume, 'A'), (Self::Shells, 'B')];
}

/// Gaussians of degree 0 and the group of each.
#[derive(Clone, Debug)]
pub(super) struct Cloud {
    pub(super) gaussians: Vec<Gaussian>,
    pub(super) groups: Vec<u32>,
}

/// Numbers from a seed: a 64-bit linear congruence, top bits.
#[derive(Clone, Debug)]
pub(super) struct TestRng(pub(super) u64);

impl TestRng {
    /// Uniform in 0..1.
    pub(super) fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    /// Uniform in `low..high`.
    pub(super) fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Roughly normal, variance 1.
    pub(super) fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.unit()).sum::<f32>() - 6.0
    }
}

/// `n` Gaussians: scales of 0.012 (shells 0.013) times a log-normal of σ = 0.4, opacities the logistic of
/// a normal of σ = 1.5.
pub(super) fn cloud(kind: CloudShape, n: usize) -> Cloud {
    let mut r = TestRng(7);
    let shells: Vec<[[f32; 3]; 3]> = (0..LATTICE.clusters)
        .map(|_| [[-0.9, 0.9], [0.08, 0.3], [0.0, 1.0]].map(|[a, b]| [0; 3].map(|_| r.between(a, b))))
        .collect();
    let mut one = |i: usize| {
        let grow = |size: f32, r: &mut TestRng| size * (0.4 * r.normal()).exp();
        let (position, scale, colour, cluster, bias) = match kind {
            CloudShape::Volume => {
                let position = [0; 3].map(|_| r.between(-1.0, 1.0));
                let cell = |p: f32| (((p + 1.0) * 2.0) as usize).min(3);
                let cluster = cell(position[0]) + 4 * cell(position[1]) + 16 * cell(position[2]);
                (position, [0; 3].map(|_| grow(0.012, &mut r)), [0; 3].map(|_| r.unit()), cluster, 0.0)
            }
            CloudShape::Shells => {
                let [centre, radii, base] = shells[i % LATTICE.clusters];
                let d = [0; 3].map(|_| r.normal());
                let length = d.iter().map(|v| v * v).sum::<f32>().sqrt();
                let position = std::array::from_fn(|k| centre[k] + radii[k] * d[k] / length);
                let scale = [grow(0.013, &mut r), grow(0.013, &mut r), 0.25 * 0.013];
                let colour = base.map(|c| (c + 0.2 * r.normal()).clamp(0.0, 1.0));
                (position, scale, colour, i % LATTICE.clusters, 1.0)
            }
        };
        let q = [0; 4].map(|_| r.normal());
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let opacity = sigmoid(bias + 1.5 * r.normal());
        let sh0 = colour.map(|c| (c - 0.5) / SH_C0);
        let level = usize::from(r.unit() < 0.5);
        let gaussian = Gaussian { position, scale, rotation: q.map(|v| v / length), opacity, sh0 };
        (gaussian, LATTICE.group(cluster, level) as u32)
    };
    let (gaussians, groups) = (0..n).map(&mut one).unzip();
    Cloud { gaussians, groups }
}

/// A camera 3.2 from the origin, oblique to all axes, focal length 0.9 of the width, `side` pixels square.
///
/// # Errors
/// A side that no camera has.
pub(super) fn camera(side: u32) -> Result<Camera> {
    let fov = 2.0 * (0.5f64 / 0.9).atan();
    Ok(Camera::look_at([1.9, -2.1, 1.45], [0.0; 3], [0.0, 0.0, 1.0], fov, side, side)?)
}

/// `picture` in slightly other colours, so that no error is 0.
///
/// # Errors
/// An empty picture.
pub(super) fn beside(picture: &Image) -> Result<Image> {
    let noisy = |(i, v): (usize, &f32)| v * 0.97 + 0.01 * ((i * 7919 % 101) as f32 / 101.0);
    let rgb = picture.rgb().iter().enumerate().map(noisy).collect();
    Ok(Image::new(picture.width(), picture.height(), rgb)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_level_needs_those_below() {
        let lattice = Lattice { clusters: 3, levels: 3 };
        // Cluster 0: nothing. Cluster 1: levels 0 and 1. Cluster 2: levels 0 and 2, so 2 is unusable.
        let mut states = States::new(lattice.groups());
        lattice.push(&mut states, |c, l| matches!((c, l), (1, 0 | 1) | (2, 0 | 2)));
        assert_eq!((0..9).filter(|&g| states.has(0, g)).collect::<Vec<_>>(), [3, 4, 6]);
        assert_eq!(lattice.group(2, 0), 6);
    }
}
