//! Cameras around a scene that came without any.
//!
//! Two disjoint rings: *measuring* cameras, on which choices are made (utilities), and *held-out*
//! cameras, on which quality is reported. No camera is ever in both. Choices may also be made on cameras
//! all around, none of which is a held-out one either.

use render_host::{Camera, camera::CameraError};

use crate::scene::Scene;

/// The golden angle, radians.
const GOLDEN: f64 = 2.399_963_229_728_653;

/// Which ring a camera is on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ring {
    /// For measurements that choices depend on.
    Measuring,
    /// For reported quality.
    HeldOut,
}

/// Where the camera ring goes: what to look at, how large it is, which way is up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Median position over sampled frames.
    pub target: [f64; 3],
    /// Radius that holds 98 % of the sampled positions.
    pub radius: f64,
    /// Up.
    pub up: [f64; 3],
}

impl Framing {
    /// Measures `scene` at up to eight frames; far outliers do not count.
    pub fn of(scene: &Scene, up: [f64; 3]) -> Self {
        let frames = scene.frames();
        let mut points: Vec<[f32; 3]> = Vec::new();
        for k in 0..frames.min(8) {
            if let Some((epoch, t)) = scene.locate(k * frames / frames.min(8)) {
                let epoch = &scene.epochs()[epoch];
                let positions = epoch.attributes().positions.frame(t, epoch.count());
                points.extend(positions.iter().step_by((positions.len() / 4000).max(1)));
            }
        }
        let median = |d: usize| {
            let mut values: Vec<f32> = points.iter().map(|p| p[d]).collect();
            values.sort_unstable_by(f32::total_cmp);
            values.get(values.len() / 2).map_or(0.0, |v| f64::from(*v))
        };
        let target = [median(0), median(1), median(2)];
        let mut distances: Vec<f64> = points
            .iter()
            .map(|p| (0..3).map(|d| (f64::from(p[d]) - target[d]).powi(2)).sum::<f64>().sqrt())
            .collect();
        distances.sort_unstable_by(f64::total_cmp);
        let radius = distances.get(distances.len().saturating_sub(1) * 98 / 100).copied().unwrap_or(1.0);
        Self { target, radius: if radius > 1e-9 { radius } else { 1.0 }, up }
    }

    /// `count` cameras of `size` (width, height) all around, from 20° below the horizon to 60° above, at
    /// 2.6 radii, 45° field of view. For measurements that choices depend on: none is a camera of
    /// [`Ring::HeldOut`].
    ///
    /// # Errors
    /// A size the camera refuses.
    pub fn around(&self, count: usize, size: (u32, u32)) -> Result<Vec<Camera>, CameraError> {
        let (low, high) = (-20f64.to_radians().sin(), 60f64.to_radians().sin());
        (0..count)
            .map(|i| {
                // Equal areas, each a golden angle on from the one before.
                let height = low + (high - low) * (i as f64 + 0.5) / count as f64;
                self.camera(GOLDEN * i as f64, height, size)
            })
            .collect()
    }

    /// `count` cameras of `size` (width, height) on a ring, 20° above the horizon, at 2.6 radii,
    /// 45° field of view.
    ///
    /// # Errors
    /// A size the camera refuses.
    pub fn ring(&self, ring: Ring, count: usize, size: (u32, u32)) -> Result<Vec<Camera>, CameraError> {
        let start = match ring {
            Ring::Measuring => 0.0,
            Ring::HeldOut => std::f64::consts::PI / count.max(1) as f64 + 0.1,
        };
        let angle = |i: usize| start + std::f64::consts::TAU * i as f64 / count as f64;
        (0..count).map(|i| self.camera(angle(i), 20f64.to_radians().sin(), size)).collect()
    }

    /// A camera at `angle` about `up`, radians, the sine of whose elevation is `height`.
    fn camera(&self, angle: f64, height: f64, size: (u32, u32)) -> Result<Camera, CameraError> {
        let [ux, uy, uz] = self.up;
        // Two axes across `up`.
        let helper = if ux.abs() < 0.9 { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] };
        let cross = |a: [f64; 3], b: [f64; 3]| {
            [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
        };
        let unit = |a: [f64; 3]| {
            let length = a.iter().map(|v| v * v).sum::<f64>().sqrt();
            a.map(|v| v / length)
        };
        let side = unit(cross([ux, uy, uz], helper));
        let front = cross(side, [ux, uy, uz]);
        let distance = 2.6 * self.radius;
        let flat = (1.0 - height * height).sqrt();
        let eye = [0, 1, 2].map(|d| {
            let across = front[d] * angle.cos() + side[d] * angle.sin();
            self.target[d] + distance * (flat * across + height * self.up[d])
        });
        Camera::look_at(eye, self.target, self.up, 45f64.to_radians(), size.0, size.1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Distance of the closest two eyes, in radii.
    fn closest(some: &[Camera], others: &[Camera]) -> f64 {
        let apart = |a: &Camera, b: &Camera| {
            let (a, b) = (a.centre(), b.centre());
            (0..3).map(|d| (a[d] - b[d]).powi(2)).sum::<f64>().sqrt()
        };
        let pairs = some.iter().flat_map(|a| others.iter().map(move |b| apart(a, b)));
        pairs.fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn nothing_is_chosen_on_a_held_out_camera() {
        let framing = Framing { target: [0.0; 3], radius: 1.0, up: [0.0, 1.0, 0.0] };
        for held_out in 1..=8 {
            let held_out = framing.ring(Ring::HeldOut, held_out, (8, 8)).unwrap();
            assert!(closest(&held_out, &held_out) < 1e-9);
            for count in [1, 2, 3, 4, 8, 16, 48, 64] {
                let around = framing.around(count, (8, 8)).unwrap();
                assert_eq!(around.len(), count);
                assert!(closest(&held_out, &around) > 1e-3, "{} of {count}", held_out.len());
            }
        }
    }
}
