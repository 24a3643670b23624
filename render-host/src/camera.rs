//! A camera is a perspective pinhole; constructors bring every convention to one.
//!
//! Inside there is one convention: OpenCV axes (x right, y down, z forward), a world-to-camera rotation
//! and translation, focal lengths and principal point in pixels, and pixel `(x, y)` centred at
//! `(x + 0.5, y + 0.5)`, so a centred principal point is `(width / 2, height / 2)`. A `K` measured with
//! pixel centres on integers needs 0.5 added to `cx` and `cy` first.
//!
//! Invariants: every number is finite and in the range its constructor names, the rotation is
//! orthonormal to 1e-9 and right-handed. A camera that exists can be rendered from.
//!
//! Deliberately absent: lens distortion (readers say when they ignored some) and rolling shutter.

pub mod blender;
pub mod colmap;
mod error;

use codec_core::internals::wire::receipt::ViewerPose;
pub use error::CameraError;
use serde::{Deserialize, Serialize};

/// Largest width or height of an image, pixels.
pub const MAX_SIDE: u32 = 16_384;
/// Near plane a camera starts with, scene units.
pub const DEFAULT_NEAR: f64 = 0.01;

/// What the largest and smallest fields of view of the smallest and largest images need.
const FOCAL: (f64, f64) = (1e-7, 1e11);
const PRINCIPAL: (f64, f64) = (-1e9, 1e9);
const TRANSLATION: (f64, f64) = (-1e15, 1e15);
const NEAR: (f64, f64) = (1e-9, 1e9);
/// How far an entry of a matrix's last row may be from 0 0 0 1.
const LAST_ROW_OFF: f64 = 1e-6;
/// Radians.
const FIELD_OF_VIEW: (f64, f64) = (1e-6, std::f64::consts::PI - 1e-6);

/// What the image plane looks like: image size, focal lengths, principal point. All in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Image width, 1..=16384.
    pub width: u32,
    /// Image height, 1..=16384.
    pub height: u32,
    /// Focal length along x, 1e-7..=1e11 pixels.
    pub fx: f64,
    /// Focal length along y, 1e-7..=1e11 pixels.
    pub fy: f64,
    /// Principal point from the left edge, ±1e9 pixels.
    pub cx: f64,
    /// Principal point from the top edge, ±1e9 pixels.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels and a centred principal point from a horizontal field of view in radians,
    /// 1e-6 to π − 1e-6.
    ///
    /// # Errors
    /// A field of view out of range.
    pub fn from_fov_x(fov_x: f64, width: u32, height: u32) -> Result<Self, CameraError> {
        Self::from_fov("fov_x", fov_x, width, width, height)
    }

    /// Square pixels and a centred principal point from a vertical field of view in radians,
    /// 1e-6 to π − 1e-6.
    ///
    /// # Errors
    /// A field of view out of range.
    pub fn from_fov_y(fov_y: f64, width: u32, height: u32) -> Result<Self, CameraError> {
        Self::from_fov("fov_y", fov_y, height, width, height)
    }

    /// From the field of view `fov` (radians), named `field`, over `side` pixels.
    fn from_fov(
        field: &'static str,
        fov: f64,
        side: u32,
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        in_range(field, fov, FIELD_OF_VIEW)?;
        Ok(Self::centred(0.5 * f64::from(side) / (0.5 * fov).tan(), width, height))
    }

    fn centred(f: f64, width: u32, height: u32) -> Self {
        Self { width, height, fx: f, fy: f, cx: 0.5 * f64::from(width), cy: 0.5 * f64::from(height) }
    }
}

/// A camera with the name and the instant its source gives it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct View {
    /// Image name or path, as the source wrote it.
    pub name: String,
    /// Instant in the source's own unit (0..=1 in D-NeRF files); `None` where the source has none.
    pub time: Option<f64>,
    /// The camera.
    pub camera: Camera,
}

/// A perspective pinhole camera. See the module documentation for its axes.
///
/// ```
/// use render_host::Camera;
///
/// let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 640, 480)?;
/// // Four units in front of the camera.
/// assert_eq!(camera.to_camera([0.0; 3]), [0.0, 0.0, 4.0]);
/// // The same view on a quarter of the pixels, and its upper left corner.
/// let corner = camera.scaled(0.5)?.cropped(0, 0, 64, 64)?;
/// assert_eq!((corner.width(), corner.height()), (64, 64));
/// # Ok::<(), render_host::CameraError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Plain", into = "Plain")]
pub struct Camera {
    /// Every number finite and in range.
    intrinsics: Intrinsics,
    /// World to camera, row-major; orthonormal to 1e-9, determinant +1.
    rotation: [[f64; 3]; 3],
    /// World to camera, scene units; finite.
    translation: [f64; 3],
    /// Finite and above 0, scene units.
    near: f64,
}

impl Camera {
    /// A camera from intrinsics and a world-to-camera `rotation` (row-major) and `translation`.
    ///
    /// A rotation that is off by up to 1e-3 (files store few digits) is made orthonormal.
    ///
    /// # Errors
    /// A number out of its range, or a rotation further off.
    pub fn new(
        intrinsics: Intrinsics,
        rotation: [[f64; 3]; 3],
        translation: [f64; 3],
    ) -> Result<Self, CameraError> {
        let Intrinsics { width, height, fx, fy, cx, cy } = intrinsics;
        let side = (1.0, f64::from(MAX_SIDE));
        in_range("width", f64::from(width), side)?;
        in_range("height", f64::from(height), side)?;
        in_range("fx", fx, FOCAL)?;
        in_range("fy", fy, FOCAL)?;
        in_range("cx", cx, PRINCIPAL)?;
        in_range("cy", cy, PRINCIPAL)?;
        for t in translation {
            in_range("translation", t, TRANSLATION)?;
        }
        Ok(Self { intrinsics, rotation: orthonormal(rotation)?, translation, near: DEFAULT_NEAR })
    }

    /// From OpenCV's 3×3 `k` and 4×4 world-to-camera matrix, both row-major.
    ///
    /// # Errors
    /// As [`Camera::new`]; or `k` has skew, or a last row other than 0 0 1; or the last row of
    /// `world_to_camera` differs from 0 0 0 1 by more than 1e-6, as that of a transposed matrix does.
    pub fn from_opencv(
        k: [[f64; 3]; 3],
        world_to_camera: [[f64; 4]; 4],
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        for (row, column, allowed) in [(0, 1, 0.0), (1, 0, 0.0), (2, 0, 0.0), (2, 1, 0.0), (2, 2, 1.0)] {
            let found = k[row][column];
            let difference = (found - allowed).abs();
            if difference > 1e-9 || difference.is_nan() {
                return Err(CameraError::Matrix { row, column, found, allowed });
            }
        }
        let intrinsics = Intrinsics { width, height, fx: k[0][0], fy: k[1][1], cx: k[0][2], cy: k[1][2] };
        let (rotation, translation) = split("world_to_camera", &world_to_camera)?;
        Self::new(intrinsics, rotation, translation)
    }

    /// From a frame of a Blender/NeRF `transforms_*.json`: a 4×4 row-major camera-to-world matrix with
    /// OpenGL axes (x right, y up, z backward) and the horizontal field of view in radians.
    ///
    /// # Errors
    /// As [`Camera::from_opengl`]; or a field of view outside 1e-6..=π − 1e-6.
    pub fn from_blender(
        camera_to_world: [[f64; 4]; 4],
        camera_angle_x: f64,
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        let intrinsics = Intrinsics::from_fov("camera_angle_x", camera_angle_x, width, width, height)?;
        Self::from_opengl(camera_to_world, intrinsics)
    }

    /// From a 4×4 row-major camera-to-world matrix with OpenGL axes (x right, y up, z backward).
    ///
    /// # Errors
    /// As [`Camera::new`]; or the last row differs from 0 0 0 1 by more than 1e-6, as that of a transposed
    /// matrix does.
    pub fn from_opengl(camera_to_world: [[f64; 4]; 4], intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let (c2w, eye) = split("camera_to_world", &camera_to_world)?;
        // Rows of world-to-camera are columns of camera-to-world; y and z change sign.
        let sign = [1.0, -1.0, -1.0];
        let rotation = std::array::from_fn(|i| std::array::from_fn(|j| sign[i] * c2w[j][i]));
        let rotation = orthonormal(rotation)?;
        let translation = std::array::from_fn(|i| -dot(rotation[i], eye));
        Self::new(intrinsics, rotation, translation)
    }

    /// From COLMAP's world-to-camera quaternion (wxyz, any length but zero) and translation.
    ///
    /// # Errors
    /// As [`Camera::new`]; or a zero quaternion.
    pub fn from_colmap(qvec: [f64; 4], tvec: [f64; 3], intrinsics: Intrinsics) -> Result<Self, CameraError> {
        let length = qvec.iter().map(|v| v * v).sum::<f64>().sqrt();
        in_range("length of qvec", length, (1e-6, 1e6))?;
        Self::new(intrinsics, rotation_matrix(qvec.map(|v| v / length)), tvec)
    }

    /// A camera at `eye` looking at `target` with `up` upwards in the picture; `fov_y` is the vertical
    /// field of view in radians, 1e-6 to π − 1e-6. Square pixels, centred principal point.
    ///
    /// # Errors
    /// `eye` equals `target`, `up` is along the view, or a number out of range.
    pub fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov_y: f64,
        width: u32,
        height: u32,
    ) -> Result<Self, CameraError> {
        let intrinsics = Intrinsics::from_fov_y(fov_y, width, height)?;
        for (field, point) in [("eye", eye), ("target", target)] {
            point.into_iter().try_for_each(|value| in_range(field, value, TRANSLATION))?;
        }
        let forward = unit(sub(target, eye)).ok_or(CameraError::Direction("target - eye"))?;
        let up = unit(up).ok_or(CameraError::Direction("up"))?;
        let right = unit(cross(forward, up)).ok_or(CameraError::Direction(CameraError::ALONG_UP))?;
        let rotation = [right, cross(forward, right), forward];
        let translation = rotation.map(|row| -dot(row, eye));
        Self::new(intrinsics, rotation, translation)
    }

    /// The same camera with another near plane, 1e-9..=1e9 scene units: what is nearer is not drawn.
    ///
    /// # Errors
    /// `near` out of range.
    pub fn with_near(mut self, near: f64) -> Result<Self, CameraError> {
        in_range("near", near, NEAR)?;
        self.near = near;
        Ok(self)
    }

    /// The same view on an image of `width` × `height`: intrinsics scale by the ratio of sizes.
    ///
    /// # Errors
    /// A size or scaled intrinsic out of range.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self, CameraError> {
        let i = &self.intrinsics;
        let (sx, sy) = (f64::from(width) / f64::from(i.width), f64::from(height) / f64::from(i.height));
        let intrinsics =
            Intrinsics { width, height, fx: i.fx * sx, fy: i.fy * sy, cx: i.cx * sx, cy: i.cy * sy };
        Self::new(intrinsics, self.rotation, self.translation)?.with_near(self.near)
    }

    /// The same view with both sides `factor` times as long, rounded to whole pixels (at least 1).
    ///
    /// # Errors
    /// A size out of range.
    pub fn scaled(&self, factor: f64) -> Result<Self, CameraError> {
        in_range("factor", factor, (1e-6, 1e6))?;
        let side = |v: u32| (f64::from(v) * factor).round().clamp(1.0, 1e9) as u32;
        self.resized(side(self.intrinsics.width), side(self.intrinsics.height))
    }

    /// The camera of a rectangle of the image, whose first pixel is in column `left` and row `top`: the same
    /// rays through a shifted principal point.
    ///
    /// # Errors
    /// A rectangle that is empty or not inside the image.
    pub fn cropped(&self, left: u32, top: u32, width: u32, height: u32) -> Result<Self, CameraError> {
        let i = &self.intrinsics;
        in_range("width", f64::from(width), (1.0, f64::from(i.width)))?;
        in_range("height", f64::from(height), (1.0, f64::from(i.height)))?;
        in_range("left", f64::from(left), (0.0, f64::from(i.width - width)))?;
        in_range("top", f64::from(top), (0.0, f64::from(i.height - height)))?;
        let (cx, cy) = (i.cx - f64::from(left), i.cy - f64::from(top));
        let intrinsics = Intrinsics { width, height, cx, cy, ..*i };
        Self::new(intrinsics, self.rotation, self.translation)?.with_near(self.near)
    }

    /// Image size, focal lengths and principal point.
    pub fn intrinsics(&self) -> Intrinsics {
        self.intrinsics
    }

    /// Image width, pixels.
    pub fn width(&self) -> u32 {
        self.intrinsics.width
    }

    /// Image height, pixels.
    pub fn height(&self) -> u32 {
        self.intrinsics.height
    }

    /// World-to-camera rotation, row-major.
    pub fn rotation(&self) -> [[f64; 3]; 3] {
        self.rotation
    }

    /// World-to-camera translation, scene units.
    pub fn translation(&self) -> [f64; 3] {
        self.translation
    }

    /// Near plane, scene units.
    pub fn near(&self) -> f64 {
        self.near
    }

    /// Where the camera is in the world, scene units.
    pub fn centre(&self) -> [f64; 3] {
        std::array::from_fn(|j| -(0..3).map(|i| self.rotation[i][j] * self.translation[i]).sum::<f64>())
    }

    /// The same as a receipt tells it: centre, and the quaternion of camera to world.
    pub fn pose(&self) -> ViewerPose {
        let r = &self.rotation;
        // Of the four ways to read a quaternion off a matrix the one without cancellation: the square of a
        // component is a sum of the diagonal. World to camera is read, its conjugate is camera to world.
        let [a, b, c] = [r[0][0], r[1][1], r[2][2]];
        let squares = [1.0 + a + b + c, 1.0 + a - b - c, 1.0 - a + b - c, 1.0 - a - b + c];
        let largest = (1..4).fold(0, |best, at| if squares[at] > squares[best] { at } else { best });
        let (x, y, z) = (r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]);
        let (xy, xz, yz) = (r[0][1] + r[1][0], r[0][2] + r[2][0], r[1][2] + r[2][1]);
        let read = match largest {
            0 => [squares[0], x, y, z],
            1 => [x, squares[1], xy, xz],
            2 => [y, xy, squares[2], yz],
            _ => [z, xz, yz, squares[3]],
        };
        let scale = 0.5 / squares[largest].sqrt();
        let [w, x, y, z] = read.map(|v| (v * scale) as f32);
        ViewerPose { position: self.centre().map(|v| v as f32), rotation: [w, -x, -y, -z] }
    }

    /// `point` in camera axes, scene units. Both renderers call this one function, so their depth keys
    /// agree to the last bit.
    #[inline]
    pub fn to_camera(&self, point: [f32; 3]) -> [f64; 3] {
        let p = point.map(f64::from);
        let (r, t) = (&self.rotation, &self.translation);
        [dot(r[0], p) + t[0], dot(r[1], p) + t[1], dot(r[2], p) + t[2]]
    }
}

/// What is stored of a camera; read back through [`Camera::new`].
#[derive(Serialize, Deserialize)]
#[serde(rename = "Camera")]
struct Plain {
    #[serde(flatten)]
    intrinsics: Intrinsics,
    rotation: [[f64; 3]; 3],
    translation: [f64; 3],
    #[serde(default = "default_near")]
    near: f64,
}

fn default_near() -> f64 {
    DEFAULT_NEAR
}

impl From<Camera> for Plain {
    fn from(camera: Camera) -> Self {
        let Camera { intrinsics, rotation, translation, near } = camera;
        Self { intrinsics, rotation, translation, near }
    }
}

impl TryFrom<Plain> for Camera {
    type Error = CameraError;

    fn try_from(plain: Plain) -> Result<Self, CameraError> {
        Self::new(plain.intrinsics, plain.rotation, plain.translation)?.with_near(plain.near)
    }
}

/// The matrix of a unit quaternion wxyz, row-major.
pub(crate) fn rotation_matrix([w, x, y, z]: [f64; 4]) -> [[f64; 3]; 3] {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

fn in_range(field: &'static str, found: f64, (low, high): (f64, f64)) -> Result<(), CameraError> {
    if found >= low && found <= high { Ok(()) } else { Err(CameraError::Range { field, found, low, high }) }
}

/// The rotation and translation of the matrix called `matrix`, whose last row must be 0 0 0 1.
fn split(matrix: &'static str, m: &[[f64; 4]; 4]) -> Result<([[f64; 3]; 3], [f64; 3]), CameraError> {
    for (column, (&found, allowed)) in m[3].iter().zip([0.0, 0.0, 0.0, 1.0]).enumerate() {
        let difference = (found - allowed).abs();
        if difference > LAST_ROW_OFF || difference.is_nan() {
            return Err(CameraError::LastRow { matrix, column, found, allowed });
        }
    }
    Ok((std::array::from_fn(|i| std::array::from_fn(|j| m[i][j])), std::array::from_fn(|i| m[i][3])))
}

/// `r` itself when it is orthonormal to 1e-9, made so when it is to 1e-3, else an error.
fn orthonormal(r: [[f64; 3]; 3]) -> Result<[[f64; 3]; 3], CameraError> {
    let mut off = (dot(cross(r[0], r[1]), r[2]) - 1.0).abs();
    for i in 0..3 {
        for j in 0..3 {
            let difference = (dot(r[i], r[j]) - f64::from(u8::from(i == j))).abs();
            off = if difference <= off { off } else { difference };
        }
    }
    if off <= 1e-9 {
        return Ok(r);
    }
    let failed = CameraError::Rotation { found: off };
    if off > 1e-3 || off.is_nan() {
        return Err(failed);
    }
    let x = unit(r[0]);
    let z = x.and_then(|x| unit(cross(x, r[1])));
    match (x, z) {
        (Some(x), Some(z)) => Ok([x, cross(z, x), z]),
        _ => Err(failed),
    }
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `v` at length 1, unless it has no direction.
fn unit(v: [f64; 3]) -> Option<[f64; 3]> {
    let length = dot(v, v).sqrt();
    (length > 1e-12 && length.is_finite()).then(|| v.map(|c| c / length))
}

#[cfg(test)]
mod tests;
