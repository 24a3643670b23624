//! Covariances of Gaussians, and how large they look.

use nalgebra::{Matrix3, Rotation3, SymmetricEigen, UnitQuaternion};

use crate::encode::factorise::rotation_matrix;

/// A covariance: xx, xy, xz, yy, yz, zz.
pub(super) type Covariance = [f64; 6];

/// Directions to the corners of an icosahedron, one of each opposite pair: an even sample of all views.
const VIEWS: [[f64; 3]; 6] = {
    const SHORT: f64 = 0.525_731_112_119_133_6;
    const LONG: f64 = 0.850_650_808_352_039_9;
    [
        [0.0, SHORT, LONG],
        [0.0, SHORT, -LONG],
        [SHORT, LONG, 0.0],
        [SHORT, -LONG, 0.0],
        [LONG, 0.0, SHORT],
        [-LONG, 0.0, SHORT],
    ]
};

/// Least variance of what is written, squared scene units: that of the least scale of a scene.
const LEAST: f64 = 4e-18;

/// The covariance of these natural-log scales, turned by `rotation`.
pub(super) fn of_axes(log_scales: [f32; 3], rotation: [f32; 4]) -> Covariance {
    let turn = rotation_matrix(rotation.map(f64::from));
    let scale = log_scales.map(|log| f64::from(log).exp());
    let half = turn * Matrix3::from_diagonal(&scale.into());
    packed(&(half * half.transpose()))
}

/// Natural-log scales, longest first, and the quaternion (wxyz) whose axes they are along.
pub(super) fn axes(covariance: &Covariance) -> ([f32; 3], [f32; 4]) {
    let eigen = SymmetricEigen::new(full(covariance));
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]));
    let mut turn = Matrix3::from_fn(|row, column| eigen.eigenvectors[(row, order[column])]);
    if turn.determinant() < 0.0 {
        turn.column_mut(2).neg_mut();
    }
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(turn));
    let log_scales = order.map(|at| (0.5 * eigen.eigenvalues[at].max(LEAST).ln()) as f32);
    (log_scales, [q.w, q.i, q.j, q.k].map(|v| v as f32))
}

/// `covariance` turned by `turn` and made `growth` times as wide.
pub(super) fn turned(covariance: &Covariance, turn: &Matrix3<f64>, growth: f64) -> Covariance {
    packed(&(turn * full(covariance) * turn.transpose() * (growth * growth)))
}

/// Mean over all views of the square root of the projected covariance's determinant: the projected area
/// over 2π.
pub(super) fn area(&[xx, xy, xz, yy, yz, zz]: &Covariance) -> f64 {
    // Along d it is the square root of dᵀ adj(Σ) d.
    let (axx, ayy, azz) = (yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy);
    let (axy, axz, ayz) = (xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz);
    let along = |[x, y, z]: [f64; 3]| {
        let value = axx * x * x + ayy * y * y + azz * z * z + 2.0 * (axy * x * y + axz * x * z + ayz * y * z);
        value.max(0.0).sqrt()
    };
    VIEWS.into_iter().map(along).sum::<f64>() / VIEWS.len() as f64
}

/// The covariance of two clouds together, of shares `p` and `1 - p`, whose means are `apart`.
pub(super) fn together(a: &Covariance, b: &Covariance, p: f64, apart: [f64; 3]) -> Covariance {
    let (q, [x, y, z]) = (1.0 - p, apart);
    let spread = [x * x, x * y, x * z, y * y, y * z, z * z];
    std::array::from_fn(|at| p * a[at] + q * b[at] + p * q * spread[at])
}

fn full(&[xx, xy, xz, yy, yz, zz]: &Covariance) -> Matrix3<f64> {
    Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
}

fn packed(m: &Matrix3<f64>) -> Covariance {
    [m[(0, 0)], m[(0, 1)], m[(0, 2)], m[(1, 1)], m[(1, 2)], m[(2, 2)]]
}

/// A Gaussian seen along one axis of the scene: its covariance in the picture, xx, xy, yy, and the square
/// root of the determinant of that.
#[derive(Clone, Copy)]
pub(super) struct Seen {
    xx: f64,
    xy: f64,
    yy: f64,
    root: f64,
}

impl Seen {
    /// Along x, y and z.
    pub(super) fn of(&[xx, xy, xz, yy, yz, zz]: &Covariance) -> [Self; 3] {
        [(yy, yz, zz), (xx, xz, zz), (xx, xy, yy)].map(|(xx, xy, yy)| Self {
            xx,
            xy,
            yy,
            root: (xx * yy - xy * xy).max(0.0).sqrt(),
        })
    }

    /// Over 2π, the integral over the picture of its square.
    pub(super) fn square(&self) -> f64 {
        0.5 * self.root
    }

    /// Over 2π, the integral over the picture of its product with another whose mean is `apart` from its own.
    pub(super) fn product(&self, other: &Self, [x, y]: [f64; 2]) -> f64 {
        let (xx, xy, yy) = (self.xx + other.xx, self.xy + other.xy, self.yy + other.yy);
        let determinant = xx * yy - xy * xy;
        if determinant <= 1e-60 {
            return 0.0;
        }
        let squared = (yy * x * x - 2.0 * xy * x * y + xx * y * y) / determinant;
        self.root * other.root / determinant.sqrt() * (-0.5 * squared).exp()
    }
}
