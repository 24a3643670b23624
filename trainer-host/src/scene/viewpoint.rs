//! Places cameras around a scene that came without any.
//!
//! *Validation* cameras, and cameras all around, are those on which choices are made (utilities, steps,
//! levels); quality is reported on *held-out* cameras. Each kind has elevations of its own, so that from
//! the middle of the scene a held-out camera is at least [`SEPARATION`] away from every camera that a
//! choice was made on, however many there are of each.

use render_host::{
    Camera,
    camera::{CameraError, DEFAULT_NEAR},
};

use crate::scene::{Scene, Up};

/// Smallest angle between a held-out camera and one that choices are made on, degrees.
pub const SEPARATION: f64 = 6.0;

/// Elevation of held-out cameras above the horizon, degrees.
const HELD_OUT: f64 = 20.0;
/// Elevation of validation cameras, degrees.
const VALIDATION_RING: f64 = 28.0;
/// Elevations of cameras all around, degrees: on both sides of the held-out ones.
const AROUND: [(f64, f64); 2] = [(-20.0, HELD_OUT - SEPARATION), (HELD_OUT + SEPARATION, 60.0)];
/// Distance of a camera from the target, radii.
const DISTANCE: f64 = 2.6;
/// Vertical field of view where nothing else is asked for, degrees.
pub const FIELD_OF_VIEW: f64 = 45.0;
/// Nearest near plane, scene units.
const MIN_NEAR: f64 = 1e-9;
/// Frames that a scene is measured at.
const FRAMES: usize = 8;

/// The golden angle, radians.
const GOLDEN: f64 = 2.399_963_229_728_653;

/// Which ring a camera is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ring {
    /// For measurements that choices depend on.
    Validation,
    /// For reported quality.
    HeldOut,
}

/// Where the camera ring goes: what to look at, how large it is, which way is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Median position over sampled frames.
    pub target: [f64; 3],
    /// Radius that holds 98 % of the positions of sampled frames.
    pub radius: f64,
    /// Up, a unit vector.
    pub up: [f64; 3],
}

impl Framing {
    /// Measures `scene` at up to eight frames; far outliers do not count, nor does the order of Gaussians.
    pub fn of(scene: &Scene) -> Self {
        let mut positions: Vec<&[[f32; 3]]> = Vec::new();
        for frame in Self::sampled(scene.frames()) {
            if let Some((epoch, t)) = scene.locate(frame) {
                let epoch = &scene.epochs()[epoch];
                positions.push(epoch.attributes().positions.frame(t, epoch.count()));
            }
        }
        Self::of_positions(&positions, scene.up)
    }

    /// The frames, of so many, that are measured: up to eight, evenly spread from the first.
    pub fn sampled(frames: usize) -> impl Iterator<Item = usize> {
        let sampled = frames.min(FRAMES);
        (0..sampled).map(move |k| k * frames / sampled)
    }

    /// Measures the positions of [`Framing::sampled`] frames.
    pub fn of_positions(positions: &[&[[f32; 3]]], up: Up) -> Self {
        let points = || positions.iter().copied().flatten();
        let median = |axis: usize| {
            let values: Vec<f64> = points().map(|p| f64::from(p[axis])).collect();
            ranked(values, |count| count / 2).unwrap_or(0.0)
        };
        let target = [median(0), median(1), median(2)];
        let from_target =
            |p: &[f32; 3]| (0..3).map(|d| (f64::from(p[d]) - target[d]).powi(2)).sum::<f64>().sqrt();
        let distances = points().map(from_target).collect();
        let radius = ranked(distances, |count| (count - 1) * 98 / 100).unwrap_or(1.0);
        Self { target, radius: if radius > 1e-9 { radius } else { 1.0 }, up: up.vector() }
    }

    /// The same with up and down exchanged: rings are then as far below the horizon as they were above.
    #[must_use]
    pub fn upside_down(self) -> Self {
        Self { up: self.up.map(|v| -v), ..self }
    }

    /// `count` cameras of `size` (width, height) all around, from 20° below the horizon to 60° above, at
    /// 2.6 radii, 45° field of view. For measurements that choices depend on: the band of elevations
    /// around [`Ring::HeldOut`] is left out.
    ///
    /// # Errors
    /// A size the camera refuses.
    pub fn around(&self, count: usize, size: (u32, u32)) -> Result<Vec<Camera>, CameraError> {
        let [(low, below), (above, high)] = AROUND.map(|(a, b)| (a.to_radians().sin(), b.to_radians().sin()));
        let mut cameras = Vec::with_capacity(count);
        for i in 0..count {
            // Equal areas, each a golden angle on from the one before.
            let share = (i as f64 + 0.5) / count as f64;
            let height = low + (below - low + high - above) * share;
            let height = if height > below { height + (above - below) } else { height };
            cameras.push(self.camera(GOLDEN * i as f64, height, size)?);
        }
        Ok(cameras)
    }

    /// `count` cameras of `size` (width, height) on a ring at 2.6 radii, 45° field of view: 20° above the
    /// horizon if held out, 28° if validation.
    ///
    /// # Errors
    /// A size the camera refuses.
    pub fn ring(&self, ring: Ring, count: usize, size: (u32, u32)) -> Result<Vec<Camera>, CameraError> {
        let (start, elevation) = match ring {
            Ring::Validation => (0.0, VALIDATION_RING),
            Ring::HeldOut => (std::f64::consts::PI / count.max(1) as f64 + 0.1, HELD_OUT),
        };
        let angle = |i: usize| start + std::f64::consts::TAU * i as f64 / count as f64;
        (0..count).map(|i| self.camera(angle(i), elevation.to_radians().sin(), size)).collect()
    }

    /// `count` cameras of `size` (width, height) in a full circle at 2.6 radii, 20° above the horizon, with a
    /// vertical field of view of `degrees`.
    ///
    /// # Errors
    /// A size or field of view the camera refuses.
    pub fn turntable(
        &self,
        count: usize,
        size: (u32, u32),
        degrees: f64,
    ) -> Result<Vec<Camera>, CameraError> {
        let height = HELD_OUT.to_radians().sin();
        let angle = |i: usize| std::f64::consts::TAU * i as f64 / count as f64;
        let camera = |i| self.seen_from(angle(i), height, degrees, size);
        (0..count).map(camera).collect()
    }

    /// The near plane of a camera whose target is `distance` away, both in scene units: a tenth of the
    /// distance, at most [`DEFAULT_NEAR`].
    pub fn near_at(distance: f64) -> f64 {
        DEFAULT_NEAR.min(0.1 * distance).max(MIN_NEAR)
    }

    /// A camera at `angle` about `up`, radians, the sine of whose elevation is `height`.
    fn camera(&self, angle: f64, height: f64, size: (u32, u32)) -> Result<Camera, CameraError> {
        self.seen_from(angle, height, FIELD_OF_VIEW, size)
    }

    /// A camera at `angle` about `up`, radians, the sine of whose elevation is `height`, with a vertical
    /// field of view of `degrees`.
    fn seen_from(
        &self,
        angle: f64,
        height: f64,
        degrees: f64,
        size: (u32, u32),
    ) -> Result<Camera, CameraError> {
        let [ux, uy, uz] = self.up;
        // Two axes across `up`.
        let least_aligned = if ux.abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let unit = |a: [f64; 3]| {
            let length = a.iter().map(|v| v * v).sum::<f64>().sqrt();
            a.map(|v| v / length)
        };
        let side = unit(cross([ux, uy, uz], least_aligned));
        let front = cross(side, [ux, uy, uz]);
        let distance = DISTANCE * self.radius;
        let flat = (1.0 - height * height).sqrt();
        let eye = [0, 1, 2].map(|d| {
            let across = front[d] * angle.cos() + side[d] * angle.sin();
            self.target[d] + distance * (flat * across + height * self.up[d])
        });
        let camera = Camera::look_at(eye, self.target, self.up, degrees.to_radians(), size.0, size.1)?;
        camera.with_near(Self::near_at(distance))
    }
}

/// The value that would be at place `rank(count)` if `values` were sorted; `None` of none.
fn ranked(mut values: Vec<f64>, rank: impl Fn(usize) -> usize) -> Option<f64> {
    if values.is_empty() {
        return None;
    }
    let place = rank(values.len());
    Some(*values.select_nth_unstable_by(place, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use codec_core::ShDegree;
    use rand::{RngExt, seq::SliceRandom};
    use rand_pcg::rand_core::SeedableRng;

    use super::*;
    use crate::scene::{Attributes, Epoch, Track};

    const UNIT: Framing = Framing { target: [0.0; 3], radius: 1.0, up: [0.0, 1.0, 0.0] };

    /// Smallest angle between the directions of two cameras around [`UNIT`], degrees.
    fn closest(some: &[Camera], others: &[Camera]) -> f64 {
        let mut smallest = f64::INFINITY;
        for (a, b) in some.iter().flat_map(|a| others.iter().map(move |b| (a.centre(), b.centre()))) {
            let dot: f64 = (0..3).map(|d| a[d] * b[d]).sum();
            smallest = smallest.min((dot / (DISTANCE * DISTANCE)).clamp(-1.0, 1.0).acos().to_degrees());
        }
        smallest
    }

    #[test]
    fn held_out_cameras_keep_their_distance_from_every_camera_that_chooses() {
        let size = (8, 8);
        let counts = || (1..=64).chain([100, 1024]);
        for held_out in 1..=64 {
            let held_out = UNIT.ring(Ring::HeldOut, held_out, size).unwrap();
            assert!(closest(&held_out, &held_out) < 1e-3, "a camera is where it is");
            for count in counts() {
                // Pictures that steps follow.
                let around = UNIT.around(count, size).unwrap();
                // Utilities, targets and tables.
                let validation = UNIT.ring(Ring::Validation, count, size).unwrap();
                // Truncation looks from below too.
                let below = UNIT.upside_down().ring(Ring::Validation, count, size).unwrap();
                assert_eq!([around.len(), validation.len(), below.len()], [count; 3]);
                for (name, chosen_on) in [("around", around), ("validation", validation), ("below", below)] {
                    let angle = closest(&held_out, &chosen_on);
                    assert!(angle > SEPARATION - 1e-6, "{name} of {count}: {angle}");
                }
            }
        }
    }

    #[test]
    fn a_tiny_scene_is_beyond_the_near_plane_and_others_have_the_usual_one() {
        let nearest = |radius: f64| {
            let camera = &Framing { radius, ..UNIT }.ring(Ring::HeldOut, 1, (8, 8)).unwrap()[0];
            (camera.near(), camera.to_camera([0.0; 3])[2] - radius)
        };
        for radius in [1e-6, 1e-3, 0.02, 0.05, 1.0, 1e3] {
            let (near, content) = nearest(radius);
            assert!(near < content, "radius {radius}: near plane at {near}, content at {content}");
            assert_eq!(near == DEFAULT_NEAR, radius > 0.04, "radius {radius}");
        }
    }

    #[test]
    fn rings_at_one_elevation_would_come_too_close() {
        let held_out = UNIT.ring(Ring::HeldOut, 1, (8, 8)).unwrap();
        let camera = |i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / 4.0;
            UNIT.camera(angle, HELD_OUT.to_radians().sin(), (8, 8)).unwrap()
        };
        let same_elevation: Vec<Camera> = (0..4).map(camera).collect();
        assert!(closest(&held_out, &same_elevation) < SEPARATION);
    }

    fn scene(positions: Vec<[f32; 3]>) -> Scene {
        let n = positions.len();
        let attributes = Attributes {
            positions: Track::Constant(positions),
            rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; n]),
            log_scales: Track::Constant(vec![[-3.0; 3]; n]),
            opacity_logits: Track::Constant(vec![0.0; n]),
            sh0: Track::Constant(vec![[0.0; 3]; n]),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        };
        Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap()
    }

    #[test]
    fn cameras_do_not_depend_on_the_order_of_gaussians() {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(5);
        let mut positions: Vec<[f32; 3]> = (0..9001)
            .map(|i| [i as f32 / 9001.0, rng.random::<f32>().powi(3), rng.random::<f32>()])
            .collect();
        let framing = |positions: &[[f32; 3]]| Framing::of(&scene(positions.to_vec()));
        let cameras = |framing: Framing| framing.ring(Ring::HeldOut, 3, (64, 64)).unwrap();
        let first = framing(&positions);
        for _ in 0..4 {
            positions.shuffle(&mut rng);
            let shuffled = framing(&positions);
            assert_eq!(shuffled, first);
            assert_eq!(cameras(shuffled), cameras(first));
        }
        positions.truncate(4500);
        assert_ne!(framing(&positions), first, "half of the Gaussians are framed otherwise");
    }

    #[test]
    fn cameras_stand_upright_whichever_way_is_up() {
        let mut scene = scene(vec![[0.0; 3], [1.0, 2.0, 3.0], [-1.0, 0.5, 0.2]]);
        for up in [Up::X, Up::Y, Up::Z, Up::MinusX, Up::MinusY, Up::MinusZ] {
            scene.up = up;
            let framing = Framing::of(&scene);
            for camera in framing.ring(Ring::HeldOut, 5, (8, 8)).unwrap() {
                // Rows of the rotation are right, down and forward.
                let [right, down, _] = camera.rotation();
                let along = |axis: [f64; 3]| (0..3).map(|d| axis[d] * up.vector()[d]).sum::<f64>();
                assert!(along(right).abs() < 1e-9 && along(down) < -0.9, "{up:?}");
            }
        }
    }
}
