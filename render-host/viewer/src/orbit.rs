//! An orbit moves a camera around a point: turn, pan, dolly, and back to where it began.

use std::f64::consts::{FRAC_PI_2, TAU};

use codec_core::internals::wire::receipt::ViewerPose;
use render_host::{Camera, CameraError};

/// Vertical field of view, radians.
const FOV_Y: f64 = 0.8;
/// Where a camera starts: a little to the side of the front and a little above.
const HOME: [f64; 2] = [0.35, 0.2];
/// Highest and lowest elevation: at the pole itself no direction is up.
const STEEPEST: f64 = FRAC_PI_2 - 0.01;
/// Radians per pixel of a drag over a picture of [`REFERENCE`] pixels.
const TURN: f64 = 0.008;
const REFERENCE: f64 = 600.0;
/// Distances from the target, in radii of the scene.
const NEAREST: f64 = 1e-3;
const FARTHEST: f64 = 1e3;

/// Which way is up in the scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Up {
    axis: usize,
    minus: bool,
}

/// y, as most scenes have it.
impl Default for Up {
    fn default() -> Self {
        Self { axis: 1, minus: false }
    }
}

impl Up {
    /// All of them, in the order of [`Up::next`].
    const NAMES: [(&'static str, Up); 6] = [
        ("y", Up { axis: 1, minus: false }),
        ("minus-y", Up { axis: 1, minus: true }),
        ("z", Up { axis: 2, minus: false }),
        ("minus-z", Up { axis: 2, minus: true }),
        ("x", Up { axis: 0, minus: false }),
        ("minus-x", Up { axis: 0, minus: true }),
    ];

    /// The one called `name`, as on the command line: `y`, `minus-y` and so on.
    pub fn named(name: &str) -> Option<Self> {
        Self::NAMES.iter().find(|(known, _)| *known == name).map(|&(_, up)| up)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|&&(_, up)| up == self).map_or("y", |&(name, _)| name)
    }

    /// The one after it, for a key that goes through all.
    #[must_use]
    pub fn next(self) -> Self {
        let at = Self::NAMES.iter().position(|&(_, up)| up == self).unwrap_or(0);
        Self::NAMES[(at + 1) % Self::NAMES.len()].1
    }

    /// Two directions across and the one up, right-handed.
    fn basis(self) -> [[f64; 3]; 3] {
        let sign = if self.minus { -1.0 } else { 1.0 };
        let unit = |axis: usize, sign: f64| std::array::from_fn(|k| if k == axis % 3 { sign } else { 0.0 });
        [unit(self.axis + 1, 1.0), unit(self.axis + 2, sign), unit(self.axis, sign)]
    }
}

/// A camera that looks at a target from a distance. Angles in radians, lengths in scene units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    target: [f64; 3],
    distance: f64,
    azimuth: f64,
    elevation: f64,
    up: Up,
    /// Middle and radius of the scene: where the camera starts from, and what bounds distances.
    middle: [f64; 3],
    radius: f64,
}

impl Default for Orbit {
    fn default() -> Self {
        Self::around([0.0; 3], 1.0, 1.0, Up::default())
    }
}

impl Orbit {
    /// A view of everything within `radius` of `middle`, in a picture `aspect` times as wide as high.
    pub fn around(middle: [f64; 3], radius: f64, aspect: f64, up: Up) -> Self {
        let radius = if radius.is_finite() && radius > 0.0 { radius } else { 1.0 };
        let middle = if middle.iter().all(|v| v.is_finite()) { middle } else { [0.0; 3] };
        // The narrower side must hold the scene.
        let narrow = (0.5 * FOV_Y).tan() * if aspect.is_finite() { aspect.clamp(0.1, 1.0) } else { 1.0 };
        let distance = radius / narrow.atan().sin();
        let [azimuth, elevation] = HOME;
        Self { target: middle, distance, azimuth, elevation, up, middle, radius }
    }

    /// The view it began with.
    #[must_use]
    pub fn home(&self, aspect: f64) -> Self {
        Self::around(self.middle, self.radius, aspect, self.up)
    }

    /// The same view with another way up.
    #[must_use]
    pub fn with_up(self, up: Up) -> Self {
        Self { up, ..self }
    }

    /// Which way is up.
    pub fn up(&self) -> Up {
        self.up
    }

    /// Turns around the target by a drag of `dx`, `dy` pixels in a picture `height` pixels high.
    pub fn turn(&mut self, dx: f64, dy: f64, height: f64) {
        let step = TURN * REFERENCE / height.max(1.0);
        self.azimuth = finite_or(self.azimuth - dx * step, self.azimuth).rem_euclid(TAU);
        self.elevation = finite_or(self.elevation + dy * step, self.elevation).clamp(-STEEPEST, STEEPEST);
    }

    /// Moves the target so that what is under the pointer stays under it.
    pub fn pan(&mut self, dx: f64, dy: f64, height: f64) {
        let unit = 2.0 * self.distance * (0.5 * FOV_Y).tan() / height.max(1.0);
        let [right, above, _] = self.axes();
        for k in 0..3 {
            let moved = self.target[k] + (above[k] * dy - right[k] * dx) * unit;
            self.target[k] = finite_or(moved, self.target[k]);
        }
    }

    /// Comes `factor` times as near: above 1 nearer, below 1 farther.
    pub fn zoom(&mut self, factor: f64) {
        let distance = finite_or(self.distance / factor, self.distance);
        self.distance = distance.clamp(NEAREST * self.radius, FARTHEST * self.radius);
    }

    /// Moves camera and target together: right, up and forward, in shares of the distance.
    pub fn fly(&mut self, right: f64, up: f64, forward: f64) {
        let [r, u, ahead] = self.axes();
        for k in 0..3 {
            let moved = self.target[k] + (r[k] * right + u[k] * up + ahead[k] * forward) * self.distance;
            self.target[k] = finite_or(moved, self.target[k]);
        }
    }

    /// Right, up in the picture, forward.
    fn axes(&self) -> [[f64; 3]; 3] {
        let [a, b, up] = self.up.basis();
        let ((sin_a, cos_a), (sin_e, cos_e)) = (self.azimuth.sin_cos(), self.elevation.sin_cos());
        let out: [f64; 3] = std::array::from_fn(|k| cos_a * a[k] + sin_a * b[k]);
        let right = std::array::from_fn(|k| cos_a * b[k] - sin_a * a[k]);
        let above = std::array::from_fn(|k| cos_e * up[k] - sin_e * out[k]);
        let forward = std::array::from_fn(|k| -(cos_e * out[k] + sin_e * up[k]));
        [right, above, forward]
    }

    /// The camera on a picture of `width` × `height` pixels.
    ///
    /// # Errors
    /// A size that no camera has.
    pub fn camera(&self, width: u32, height: u32) -> Result<Camera, CameraError> {
        let [_, above, forward] = self.axes();
        let eye = std::array::from_fn(|k| self.target[k] - forward[k] * self.distance);
        let near = (1e-3 * self.distance).min(1e-2 * self.radius).clamp(1e-9, 1e9);
        Camera::look_at(eye, self.target, above, FOV_Y, width, height)?.with_near(near)
    }

    /// Where the camera is, as a receipt tells it; none for a view that no camera has.
    pub fn pose(&self) -> Option<ViewerPose> {
        // A pose says nothing of the picture's size.
        self.camera(1, 1).ok().map(|camera| camera.pose())
    }

    /// The view as numbers for an address: azimuth, elevation, distance, target.
    pub fn numbers(&self) -> [f64; 6] {
        let [x, y, z] = self.target;
        [self.azimuth, self.elevation, self.distance, x, y, z]
    }

    /// The view of [`Orbit::numbers`] around the same scene; `None` if one is no view's.
    pub fn at(&self, numbers: [f64; 6]) -> Option<Self> {
        let [azimuth, elevation, distance, x, y, z] = numbers;
        let near = [x, y, z].iter().all(|v| v.abs() <= 1e9) && azimuth.abs() <= 1e3;
        (near && elevation.abs() <= FRAC_PI_2 && distance > 0.0 && distance < 1e9).then(|| Self {
            azimuth: azimuth.rem_euclid(TAU),
            elevation: elevation.clamp(-STEEPEST, STEEPEST),
            distance: distance.clamp(NEAREST * self.radius, FARTHEST * self.radius),
            target: [x, y, z],
            ..*self
        })
    }
}

fn finite_or(value: f64, otherwise: f64) -> f64 {
    if value.is_finite() { value } else { otherwise }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where `point` is in the picture of `orbit`, pixels.
    fn pixel(orbit: &Orbit, point: [f64; 3]) -> [f64; 2] {
        let camera = orbit.camera(800, 600).unwrap();
        let [x, y, z] = camera.to_camera(point.map(|v| v as f32));
        let i = camera.intrinsics();
        [i.fx * x / z + i.cx, i.fy * y / z + i.cy]
    }

    #[test]
    fn every_way_up_is_up_in_the_picture() {
        for (name, up) in Up::NAMES {
            assert_eq!((Up::named(name), up.name()), (Some(up), name));
            let orbit = Orbit::around([1.0, 2.0, 3.0], 2.0, 1.0, up);
            let [_, _, direction] = up.basis();
            let above = std::array::from_fn(|k| [1.0, 2.0, 3.0][k] + direction[k]);
            let ([x, y], [x0, y0]) = (pixel(&orbit, above), pixel(&orbit, [1.0, 2.0, 3.0]));
            assert!(y < y0 - 10.0 && (x - x0).abs() < 1e-3, "{name}: {x} {y}");
        }
        assert_eq!((Up::named("up"), Up::default().name()), (None, "y"));
        let mut up = Up::default();
        (0..6).for_each(|_| up = up.next());
        assert_eq!(up, Up::default());
    }

    #[test]
    fn a_pan_moves_the_picture_with_the_pointer() {
        let mut orbit = Orbit::around([0.0; 3], 1.0, 1.0, Up::named("z").unwrap());
        let before = pixel(&orbit, [0.0; 3]);
        orbit.pan(30.0, -20.0, 600.0);
        let after = pixel(&orbit, [0.0; 3]);
        assert!((after[0] - before[0] - 30.0).abs() < 0.5, "{after:?}");
        assert!((after[1] - before[1] + 20.0).abs() < 0.5, "{after:?}");
    }

    #[test]
    fn a_turn_to_the_right_shows_what_was_on_the_left() {
        let mut orbit = Orbit::default();
        // A point in front of the target, on the camera's side.
        let eye = orbit.camera(800, 600).unwrap().centre();
        let near = eye.map(|v| 0.1 * v);
        orbit.turn(50.0, 0.0, 600.0);
        assert!(pixel(&orbit, near)[0] > 405.0);
        orbit.turn(0.0, 1e9, 600.0);
        assert!(orbit.camera(800, 600).is_ok(), "the pole itself is never reached");
    }

    #[test]
    fn the_scene_fits_whatever_the_aspect() {
        for aspect in [0.4, 1.0, 2.5] {
            let orbit = Orbit::around([0.0; 3], 1.0, aspect, Up::default());
            let camera = orbit.camera((600.0 * aspect) as u32, 600).unwrap();
            let i = camera.intrinsics();
            let distance = camera.to_camera([0.0; 3])[2];
            let reach = i.fx / (distance * distance - 1.0).sqrt();
            assert!(reach <= 0.5 * f64::from(i.width.min(i.height)) + 1.0, "{aspect}: {reach}");
        }
    }

    #[test]
    fn numbers_of_an_address_give_the_view_back_and_nonsense_none() {
        let mut orbit = Orbit::around([0.5; 3], 3.0, 1.5, Up::default());
        orbit.turn(40.0, 10.0, 500.0);
        orbit.zoom(1.7);
        orbit.fly(0.1, 0.2, -0.3);
        assert_eq!(Orbit::around([0.5; 3], 3.0, 1.5, Up::default()).at(orbit.numbers()), Some(orbit));
        assert_eq!(orbit.at([0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0]), None);
        assert_eq!(orbit.at([0.0, 0.0, 1.0, 1e12, 0.0, 0.0]), None);
        // Input that is no number moves nothing.
        let before = orbit;
        orbit.turn(f64::NAN, f64::INFINITY, 1.0);
        orbit.pan(f64::NAN, 0.0, 0.0);
        orbit.zoom(0.0);
        assert_eq!(orbit.numbers()[3..], before.numbers()[3..]);
        assert!(orbit.camera(16, 16).is_ok());
    }
}
