//! Turns, scales and moves a scene, harmonics included.
//!
//! Harmonics of a band turn among themselves. The matrix of a turn is found from the basis alone: it takes
//! the values of the basis in many directions to those in the directions turned back.

use std::str::FromStr;

use nalgebra::{DMatrix, Matrix3, Quaternion, Rotation3, Unit, UnitQuaternion, Vector3};
use render_host::harmonics;

use super::{EditError, edited};
use crate::scene::{Attributes, Epoch, Scene, Track, Up};

/// Directions that the matrix of a turn is found from: far more than coefficients in a band.
const DIRECTIONS: usize = 64;

/// Most that a number of a step may be, and least below 0.
const MOST: f64 = 1e9;
/// Least factor of a scale.
const LEAST_SCALE: f64 = 1e-9;

/// A turn, then a scale, then a shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// The turn, about the origin.
    pub rotation: Rotation3<f64>,
    /// The scale, above 0.
    pub scale: f64,
    /// The shift, scene units.
    pub translation: [f64; 3],
}

impl Default for Similarity {
    fn default() -> Self {
        Self { rotation: Rotation3::identity(), scale: 1.0, translation: [0.0; 3] }
    }
}

impl FromStr for Similarity {
    type Err = String;

    /// Steps joined by `;`, applied in order: `rotate=AXIS:DEGREES` (axis x, y or z; degrees from -1e9 to
    /// 1e9), `scale=FACTOR` (1e-9 to 1e9), `translate=X,Y,Z` (scene units, each from -1e9 to 1e9).
    fn from_str(text: &str) -> Result<Self, String> {
        let mut whole = Self::default();
        for step in text.split(';') {
            let refused = || {
                format!("{step}: rotate=x:DEGREES (or y:, z:), scale=FACTOR or translate=X,Y,Z is allowed")
            };
            let number = |text: &str, least: f64, allowed: &str| -> Result<f64, String> {
                let found = text.trim().parse::<f64>().map_err(|_| refused())?;
                if (least..=MOST).contains(&found) { Ok(found) } else { Err(allowed.to_owned()) }
            };
            let (name, value) = step.trim().split_once('=').ok_or_else(refused)?;
            let step = match name {
                "rotate" => {
                    let (axis, degrees) = value.split_once(':').ok_or_else(refused)?;
                    let axis = match axis.trim() {
                        "x" => Vector3::x_axis(),
                        "y" => Vector3::y_axis(),
                        "z" => Vector3::z_axis(),
                        _ => return Err(refused()),
                    };
                    let degrees = number(degrees, -MOST, "rotate: -1e9 to 1e9 degrees are allowed")?;
                    let rotation = Rotation3::from_axis_angle(&axis, degrees.to_radians());
                    Self { rotation, ..Self::default() }
                }
                "scale" => {
                    let allowed = "scale: a factor from 1e-9 to 1e9 is allowed";
                    let scale = number(value, LEAST_SCALE, allowed)?;
                    Self { scale, ..Self::default() }
                }
                "translate" => {
                    let shift = |text| number(text, -MOST, "translate: -1e9 to 1e9 each is allowed");
                    let values: Vec<f64> = value.split(',').map(shift).collect::<Result<_, _>>()?;
                    Self { translation: values.try_into().map_err(|_| refused())?, ..Self::default() }
                }
                _ => return Err(refused()),
            };
            whole = whole.then(&step);
        }
        Ok(whole)
    }
}

impl Similarity {
    /// A turn by the quaternion `rotation`, wxyz and of any length but zero, about the origin, then a scale
    /// by `scale`, then a shift by `translation`, scene units.
    ///
    /// ```
    /// use trainer_host::edit::Similarity;
    ///
    /// let half = std::f64::consts::FRAC_1_SQRT_2;
    /// let by = Similarity::new([half, 0.0, 0.0, half], 2.0, [1.0, 0.0, 0.0])?;
    /// let moved = by.point([1.0, 0.0, 0.0]);
    /// assert!((moved[0] - 1.0).abs() < 1e-12 && (moved[1] - 2.0).abs() < 1e-12);
    /// # Ok::<(), trainer_host::edit::EditError>(())
    /// ```
    ///
    /// # Errors
    /// A quaternion without a direction, a scale that is not above 0, or a number that is not finite.
    pub fn new(rotation: [f64; 4], scale: f64, translation: [f64; 3]) -> Result<Self, EditError> {
        let [w, x, y, z] = rotation;
        let quaternion = Quaternion::new(w, x, y, z);
        let length = quaternion.norm();
        if !(length > 1e-12 && length.is_finite()) {
            let allowed = "a finite length above 1e-12";
            return Err(EditError::Range { field: "length of the rotation", found: length, allowed });
        }
        let rotation = UnitQuaternion::new_normalize(quaternion).to_rotation_matrix();
        let made = Self { rotation, scale, translation };
        made.check()?;
        Ok(made)
    }

    /// Refuses a scale that is not above 0 and numbers that are not finite.
    fn check(&self) -> Result<(), EditError> {
        let finite = |field, found: f64| {
            let allowed = "a finite number";
            if found.is_finite() { Ok(()) } else { Err(EditError::Range { field, found, allowed }) }
        };
        self.rotation.matrix().iter().try_for_each(|&entry| finite("rotation", entry))?;
        self.translation.iter().try_for_each(|&shift| finite("translation", shift))?;
        if !(self.scale > 0.0 && self.scale.is_finite()) {
            let allowed = "a finite factor above 0";
            return Err(EditError::Range { field: "scale", found: self.scale, allowed });
        }
        Ok(())
    }

    /// This one, and `next` after it.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rotation: next.rotation * self.rotation,
            scale: next.scale * self.scale,
            translation: next.point(self.translation),
        }
    }

    /// Where a point goes.
    pub fn point(&self, point: [f64; 3]) -> [f64; 3] {
        let turned = self.rotation * Vector3::from(point) * self.scale;
        std::array::from_fn(|axis| turned[axis] + self.translation[axis])
    }
}

/// The turn that takes the axis `from` to `to`: half a turn about x where they are opposite along y or z (as
/// between the axes of captures and those of SPZ and glTF), and about y where they are along x.
pub fn turn_between(from: Up, to: Up) -> Rotation3<f64> {
    let (a, b) = (Vector3::from(from.vector()), Vector3::from(to.vector()));
    let across = a.cross(&b);
    if across.norm() > 0.5 {
        return Rotation3::from_axis_angle(&Unit::new_normalize(across), std::f64::consts::FRAC_PI_2);
    }
    if a.dot(&b) > 0.0 {
        return Rotation3::identity();
    }
    let axis = if a.x == 0.0 { Vector3::x_axis() } else { Vector3::y_axis() };
    Rotation3::from_axis_angle(&axis, std::f64::consts::PI)
}

/// `scene` with every Gaussian turned, scaled and moved by `by`, and its cameras left out: they would show
/// another place. Which way is up is turned too where it stays along an axis.
///
/// # Errors
/// A scale that is not above 0, a number of `by` that is not finite, or positions that are no longer.
pub fn transform(scene: &Scene, by: &Similarity) -> Result<Scene, EditError> {
    by.check()?;
    let matrix = rounded(by.rotation);
    let turn = UnitQuaternion::from_rotation_matrix(&by.rotation);
    let bands: Vec<DMatrix<f64>> = (1..=3).map(|degree| band_turn(degree, &matrix)).collect();
    let is_turned = matrix != Matrix3::identity();
    let log_scale = by.scale.ln() as f32;
    let mut out = edited(scene, |epoch| {
        let a = epoch.attributes();
        let place = |p: &[f32; 3]| {
            let turned = matrix * Vector3::from(p.map(f64::from)) * by.scale;
            std::array::from_fn(|axis| (turned[axis] + by.translation[axis]) as f32)
        };
        let orientation = |q: &[f32; 4]| {
            if !is_turned {
                return *q;
            }
            let [w, x, y, z] = q.map(f64::from);
            let turned = turn.into_inner() * Quaternion::new(w, x, y, z);
            [turned.w, turned.i, turned.j, turned.k].map(|v| v as f32)
        };
        let attributes = Attributes {
            positions: mapped(&a.positions, place),
            rotations: mapped(&a.rotations, orientation),
            log_scales: mapped(&a.log_scales, |s| s.map(|v| v + log_scale)),
            opacity_logits: a.opacity_logits.clone(),
            sh0: a.sh0.clone(),
            sh_rest: if is_turned { turned_harmonics(a, &bands) } else { a.sh_rest.clone() },
            sh_degree: a.sh_degree,
        };
        Epoch::new(epoch.frames(), attributes)
    })?;
    out.cameras.clear();
    let up = matrix * Vector3::from(scene.up.vector());
    let along = |axis: &Up| Vector3::from(axis.vector()).dot(&up) > 0.999_999;
    if let Some(up) = Up::ALL.iter().copied().find(|axis| along(axis)) {
        out.up = up;
    }
    Ok(out)
}

fn mapped<T, U>(track: &Track<T>, map: impl Fn(&T) -> U) -> Track<U> {
    match track {
        Track::Constant(values) => Track::Constant(values.iter().map(map).collect()),
        Track::PerFrame(values) => Track::PerFrame(values.iter().map(map).collect()),
    }
}

/// The matrix of a turn; entries that are whole numbers but for rounding are whole, so that quarter turns are
/// exact.
fn rounded(rotation: Rotation3<f64>) -> Matrix3<f64> {
    rotation.into_inner().map(|v| if (v - v.round()).abs() < 1e-12 { v.round() } else { v })
}

/// The matrix that takes coefficients of band `degree` to those of the scene turned by `turn`.
fn band_turn(degree: u8, turn: &Matrix3<f64>) -> DMatrix<f64> {
    let (first, len) = (usize::from(degree).pow(2) - 1, 2 * usize::from(degree) + 1);
    let directions: Vec<Vector3<f64>> = (0..DIRECTIONS).map(direction).collect();
    let values = |direction: Vector3<f64>| harmonics::basis(degree, direction.into());
    let basis = DMatrix::from_fn(DIRECTIONS, len, |k, i| values(directions[k])[first + i]);
    let back = turn.transpose();
    let turned = DMatrix::from_fn(DIRECTIONS, len, |k, i| values(back * directions[k])[first + i]);
    // Least squares; the directions are spread evenly, so the product below is close to a multiple of one.
    let square = basis.transpose() * &basis;
    let solved = square.cholesky().map(|found| found.solve(&(basis.transpose() * turned)));
    let matrix = solved.unwrap_or_else(|| DMatrix::identity(len, len));
    matrix.map(|v| if (v - v.round()).abs() < 1e-12 { v.round() } else { v })
}

/// Direction `k` of a spiral that covers the sphere.
fn direction(k: usize) -> Vector3<f64> {
    let height = 1.0 - (2.0 * k as f64 + 1.0) / DIRECTIONS as f64;
    let (angle, flat) = (2.399_963_229_728_653 * k as f64, (1.0 - height * height).sqrt());
    Vector3::new(flat * angle.cos(), flat * angle.sin(), height)
}

/// The harmonics of `a`, turned band by band.
fn turned_harmonics(a: &Attributes, bands: &[DMatrix<f64>]) -> Vec<f32> {
    let rest = a.sh_degree.rest_len();
    let mut out = Vec::with_capacity(a.sh_rest.len());
    for row in a.sh_rest.chunks_exact(rest.max(1)) {
        for (band, matrix) in bands.iter().take(a.sh_degree.get().into()).enumerate() {
            let (first, len) = ((band + 1).pow(2) - 1, 2 * band + 3);
            for i in 0..len {
                for channel in 0..3 {
                    let term = |j: usize| matrix[(i, j)] * f64::from(row[3 * (first + j) + channel]);
                    out.push((0..len).map(term).sum::<f64>() as f32);
                }
            }
        }
    }
    out
}
