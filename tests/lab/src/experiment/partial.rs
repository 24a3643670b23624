//! Makes random scenes cut into groups, states that lack groups, and the picture to compare with.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::{
    Camera, Image, Settings, Splats,
    counterfactual::{States, Variants, brute},
};

use super::cloud::{Cloud, CloudShape, LATTICE, Lattice, TestRng, beside, camera, cloud};

/// States that brute force renders per round; its time is scaled to all.
pub(super) const STATES_ALONE: usize = 16;

/// A scene, its groups, a camera and the picture that its pictures are compared with.
#[derive(Clone)]
pub(crate) struct Partial {
    pub gaussians: Vec<Gaussian>,
    pub groups: Vec<u32>,
    pub camera: Camera,
    /// The full picture, dimmed and with a pattern added.
    pub against: Image,
}

impl Partial {
    /// Scene `kind` of `n` Gaussians at `side` × `side` pixels.
    pub(crate) fn new(kind: CloudShape, n: usize, side: u32, settings: &Settings) -> Result<Self> {
        Self::turned(kind, n, side, 0.0, settings)
    }

    /// As [`Partial::new`], every centre turned by `angle` radians about z.
    pub(crate) fn turned(
        kind: CloudShape,
        n: usize,
        side: u32,
        angle: f32,
        settings: &Settings,
    ) -> Result<Self> {
        let Cloud { mut gaussians, groups } = cloud(kind, n);
        let (sin, cos) = angle.sin_cos();
        for Gaussian { position: [x, y, _], .. } in &mut gaussians {
            (*x, *y) = (cos * *x - sin * *y, sin * *x + cos * *y);
        }
        let mut out =
            Self { gaussians, groups, camera: camera(side)?, against: Image::filled(side, side, [0.0; 3])? };
        let full = States::full(LATTICE.groups());
        let picture = brute::image(&out.variants()?, &full, 0, &out.camera, settings)?;
        out.against = beside(&picture)?;
        Ok(out)
    }

    pub(crate) fn splats(&self) -> Splats<'_> {
        Splats::plain(&self.gaussians)
    }

    pub(crate) fn variants(&self) -> Result<Variants<'_>> {
        Ok(Variants::new(self.splats(), &self.groups, LATTICE.groups())?)
    }
}

/// What `worlds` receivers may hold.
pub(crate) fn deliveries(worlds: usize) -> States {
    deliveries_of(LATTICE, worlds)
}

/// What `worlds` receivers of clusters and levels of `lattice` may hold: a random number of levels of each
/// cluster, none of one in ten. A lattice of as many groups as [`LATTICE`] cuts the same scenes otherwise.
pub(crate) fn deliveries_of(lattice: Lattice, worlds: usize) -> States {
    let mut r = TestRng(99);
    let mut states = States::new(lattice.groups());
    for _ in 0..worlds {
        let mut depth = || match r.unit() < 0.1 {
            true => 0,
            false => 1 + (r.unit() * lattice.levels as f32) as usize,
        };
        let depth: Vec<usize> = (0..lattice.clusters).map(|_| depth()).collect();
        lattice.push(&mut states, |cluster, level| level < depth[cluster]);
    }
    states
}

/// Up to `count` worlds, evenly spread.
pub(super) fn spread(states: &States, count: usize) -> States {
    let mut out = States::new(states.groups());
    let step = states.len().div_ceil(count).max(1);
    (0..states.len()).step_by(step).for_each(|world| out.push(|g| states.has(world, g)));
    out
}
