//! Two scenes cut into groups, states in which groups are missing, and a picture to judge them by.
//!
//! Scene A is a uniform volume cut into 64 cells, the worst case for interleaved depths; scene B is 64
//! overlapping ellipsoid shells. Every cluster has two additive levels; a state lacks one cluster in ten
//! and has a random level of the others. Everything is random, and the same every time.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::counterfactual::{Lattice, States, Variants, brute};
use render_host::{Camera, Image, Settings, Splats};

/// Clusters and levels of both scenes: 128 groups.
pub(crate) const LATTICE: Lattice = Lattice { clusters: 64, levels: 2 };

/// Numbers from a seed (a 64-bit linear congruence; top bits).
struct Numbers(u64);

impl Numbers {
    /// Uniform in 0..1.
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 40) as f32 / (1u64 << 24) as f32
    }

    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.unit()
    }

    /// Roughly normal, variance 1.
    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.unit()).sum::<f32>() - 6.0
    }
}

/// A scene, its groups, a camera and what its pictures are judged by.
pub(crate) struct Partial {
    pub gaussians: Vec<Gaussian>,
    pub groups: Vec<u32>,
    pub camera: Camera,
    /// The full picture, dimmed and with a pattern added.
    pub against: Image,
}

impl Partial {
    /// Scene `kind`, A or B, of `n` Gaussians at `side` × `side` pixels.
    pub(crate) fn new(kind: char, n: usize, side: u32, settings: &Settings) -> Result<Self> {
        Self::turned(kind, n, side, 0.0, settings)
    }

    /// As [`Partial::new`], every centre turned by `angle` radians about z.
    pub(crate) fn turned(kind: char, n: usize, side: u32, angle: f32, settings: &Settings) -> Result<Self> {
        let (mut gaussians, groups) = scene(kind, n);
        let (sin, cos) = angle.sin_cos();
        for Gaussian { position: [x, y, _], .. } in &mut gaussians {
            (*x, *y) = (cos * *x - sin * *y, sin * *x + cos * *y);
        }
        let fov_y = 2.0 * (0.5f64 / 0.9).atan();
        let camera = Camera::look_at([1.9, -2.1, 1.45], [0.0; 3], [0.0, 0.0, 1.0], fov_y, side, side)?;
        let mut out = Self { gaussians, groups, camera, against: Image::filled(side, side, [0.0; 3])? };
        let full = States::full(LATTICE.groups());
        let picture = brute::image(&out.variants()?, &full, 0, &out.camera, settings)?;
        let noisy = |(i, v): (usize, &f32)| v * 0.97 + 0.01 * ((i * 7919 % 101) as f32 / 101.0);
        out.against = Image::new(side, side, picture.rgb().iter().enumerate().map(noisy).collect())?;
        Ok(out)
    }

    pub(crate) fn splats(&self) -> Splats<'_> {
        Splats::plain(&self.gaussians)
    }

    pub(crate) fn variants(&self) -> Result<Variants<'_>> {
        Ok(Variants::new(self.splats(), &self.groups, LATTICE.groups())?)
    }
}

fn scene(kind: char, n: usize) -> (Vec<Gaussian>, Vec<u32>) {
    let mut r = Numbers(7);
    let shells: Vec<[[f32; 3]; 3]> = (0..LATTICE.clusters)
        .map(|_| [[-0.9, 0.9], [0.08, 0.3], [0.0, 1.0]].map(|[a, b]| [0; 3].map(|_| r.between(a, b))))
        .collect();
    let mut one = |i: usize| {
        let grow = |size: f32, r: &mut Numbers| size * (0.4 * r.normal()).exp();
        let (position, scale, colour, cluster, bias) = if kind == 'A' {
            let position = [0; 3].map(|_| r.between(-1.0, 1.0));
            let cell = |p: f32| (((p + 1.0) * 2.0) as usize).min(3);
            let cluster = cell(position[0]) + 4 * cell(position[1]) + 16 * cell(position[2]);
            (position, [0; 3].map(|_| grow(0.012, &mut r)), [0; 3].map(|_| r.unit()), cluster, 0.0)
        } else {
            let [centre, radii, base] = shells[i % LATTICE.clusters];
            let d = [0; 3].map(|_| r.normal());
            let length = d.iter().map(|v| v * v).sum::<f32>().sqrt();
            let position = std::array::from_fn(|k| centre[k] + radii[k] * d[k] / length);
            let scale = [grow(0.013, &mut r), grow(0.013, &mut r), 0.25 * 0.013];
            let colour = base.map(|c| (c + 0.2 * r.normal()).clamp(0.0, 1.0));
            (position, scale, colour, i % LATTICE.clusters, 1.0)
        };
        let q = [0; 4].map(|_| r.normal());
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let opacity = 1.0 / (1.0 + (-(bias + 1.5 * r.normal())).exp());
        let sh0 = colour.map(|c| (c - 0.5) / 0.282_094_8);
        let level = usize::from(r.unit() < 0.5);
        let gaussian = Gaussian { position, scale, rotation: q.map(|v| v / length), opacity, sh0 };
        (gaussian, LATTICE.group(cluster, level) as u32)
    };
    (0..n).map(&mut one).unzip()
}

/// What `worlds` receivers may hold.
pub(crate) fn deliveries(worlds: usize) -> States {
    deliveries_of(LATTICE, worlds)
}

/// What `worlds` receivers of clusters and levels of `lattice` may hold: a random number of levels of each
/// cluster, none of one in ten. A lattice of as many groups as [`LATTICE`] cuts the same scenes otherwise.
pub(crate) fn deliveries_of(lattice: Lattice, worlds: usize) -> States {
    let mut r = Numbers(99);
    let mut states = States::new(lattice.groups());
    for _ in 0..worlds {
        let mut depth = || match r.unit() < 0.1 {
            true => 0,
            false => 1 + (r.unit() * lattice.levels as f32) as usize,
        };
        let depth: Vec<usize> = (0..lattice.clusters).map(|_| depth()).collect();
        lattice.push_additive(&mut states, |cluster, level| level < depth[cluster]);
    }
    states
}
