//! Turns vectors by quaternions (wxyz) and takes gradients back through the turn.

use codec_core::internals::math::rows_from_quat;
use glam::Mat3;

/// A quaternion, wxyz.
pub(super) type Quaternion = [f32; 4];

/// The turn the other way round.
pub(super) fn conjugate(q: Quaternion) -> Quaternion {
    [q[0], -q[1], -q[2], -q[3]]
}

/// Sum of products.
pub(super) fn dot(a: Quaternion, b: Quaternion) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]
}

/// The matrix of a quaternion of length 1.
pub(super) fn matrix(q: Quaternion) -> Mat3 {
    Mat3::from_cols_array_2d(&rows_from_quat(q)).transpose()
}

/// Gradient with respect to the four numbers of [`matrix()`] from `gradient`, that of its nine.
pub(super) fn matrix_gradient([w, x, y, z]: Quaternion, gradient: &Mat3) -> Quaternion {
    // g(r, c) is the gradient of row r, column c.
    let g = |r: usize, c: usize| gradient.col(c)[r];
    [
        2.0 * (-z * g(0, 1) + y * g(0, 2) + z * g(1, 0) - x * g(1, 2) - y * g(2, 0) + x * g(2, 1)),
        2.0 * (y * (g(0, 1) + g(1, 0)) + z * (g(0, 2) + g(2, 0)) - 2.0 * x * (g(1, 1) + g(2, 2))
            + w * (g(2, 1) - g(1, 2))),
        2.0 * (x * (g(0, 1) + g(1, 0)) + z * (g(1, 2) + g(2, 1)) - 2.0 * y * (g(0, 0) + g(2, 2))
            + w * (g(0, 2) - g(2, 0))),
        2.0 * (x * (g(0, 2) + g(2, 0)) + y * (g(1, 2) + g(2, 1)) - 2.0 * z * (g(0, 0) + g(1, 1))
            + w * (g(1, 0) - g(0, 1))),
    ]
}

#[cfg(test)]
mod tests {
    use codec_core::internals::math::quat_mul;
    use glam::Vec3;

    use super::*;

    #[test]
    fn products_turn_one_after_the_other() {
        let unit = |q: Quaternion| q.map(|v| v / dot(q, q).sqrt());
        let (a, b) = (unit([0.9, 0.1, -0.3, 0.2]), unit([0.4, -0.5, 0.2, 0.7]));
        let v = Vec3::new(0.3, -1.2, 0.7);
        let twice = matrix(a) * (matrix(b) * v);
        assert!((matrix(quat_mul(a, b)) * v - twice).length() < 1e-6);
        assert!((matrix(conjugate(a)) * (matrix(a) * v) - v).length() < 1e-6);
    }

    #[test]
    fn matrix_gradient_is_the_difference_quotient() {
        let q = [0.8, -0.3, 0.4, 0.33];
        let weights = Mat3::from_cols_array(&[0.3, -1.0, 0.5, 0.2, 0.9, -0.4, 1.1, 0.6, -0.7]);
        let value = |q: Quaternion| -> f64 {
            let m = matrix(q).to_cols_array();
            m.iter().zip(weights.to_cols_array()).map(|(a, b)| f64::from(a * b)).sum()
        };
        let gradient = matrix_gradient(q, &weights);
        for k in 0..4 {
            let (mut more, mut less) = (q, q);
            more[k] += 1e-2;
            less[k] -= 1e-2;
            let expected = (value(more) - value(less)) / 2e-2;
            assert!((f64::from(gradient[k]) - expected).abs() < 1e-4, "{k}: {} {expected}", gradient[k]);
        }
    }
}
