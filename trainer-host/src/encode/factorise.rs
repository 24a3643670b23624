//! Factorises motion: cluster poses by least squares, a shared temporal basis by SVD.
//!
//! All in f64; what is sent is quantised elsewhere. (Paper section 3, equation 1: the affine
//! A_{c,t}, the basis b_{t,r} and coefficients q_{i,r}.)

use nalgebra::{DMatrix, Matrix3, Rotation3, SymmetricEigen, UnitQuaternion, Vector3};

/// A cluster's pose at one frame, relative to its canonical pose, about its centre:
/// `x = centre + translation + linear · (p − centre)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Linear part.
    pub linear: Matrix3<f64>,
    /// Translation.
    pub translation: Vector3<f64>,
    /// Unit quaternion by which the Gaussians themselves turn, wxyz.
    pub rotation: [f64; 4],
}

/// The pose that takes `canonical` offsets from `centre` to `target` positions with the least
/// squared error.
///
/// Flat and thin clusters leave part of the linear map undetermined; there it follows `rotation`,
/// the mean turn of the Gaussians, by a small ridge (1e-3 of the mean variance).
pub fn fit_pose(canonical: &[[f64; 3]], target: &[[f64; 3]], centre: [f64; 3], rotation: [f64; 4]) -> Pose {
    let n = canonical.len().max(1) as f64;
    let centre = Vector3::from(centre);
    let mean = |points: &[[f64; 3]]| points.iter().fold(Vector3::zeros(), |s, p| s + Vector3::from(*p)) / n;
    let (mean_p, mean_x) = (mean(canonical), mean(target));
    let (mut pp, mut xp) = (Matrix3::zeros(), Matrix3::zeros());
    for (p, x) in canonical.iter().zip(target) {
        let (p, x) = (Vector3::from(*p) - mean_p, Vector3::from(*x) - mean_x);
        pp += p * p.transpose();
        xp += x * p.transpose();
    }
    let turn = rotation_matrix(rotation);
    let ridge = 1e-3 * pp.trace() / 3.0 + 1e-12;
    let regular = pp + Matrix3::identity() * ridge;
    let linear = regular.try_inverse().map_or(turn, |inverse| (xp + turn * ridge) * inverse);
    let translation = mean_x - centre - linear * (mean_p - centre);
    Pose { linear, translation, rotation }
}

/// The rigid pose that takes `canonical` offsets from `centre` to `target` positions with the least
/// squared error; what flat and thin clusters leave undetermined follows `rotation`, as in
/// [`fit_pose`]. Its `rotation` has the sign nearest `rotation`.
pub fn fit_rigid(canonical: &[[f64; 3]], target: &[[f64; 3]], centre: [f64; 3], rotation: [f64; 4]) -> Pose {
    let n = canonical.len().max(1) as f64;
    let centre = Vector3::from(centre);
    let mean = |points: &[[f64; 3]]| points.iter().fold(Vector3::zeros(), |s, p| s + Vector3::from(*p)) / n;
    let (mean_p, mean_x) = (mean(canonical), mean(target));
    let (mut xp, mut size) = (Matrix3::zeros(), 0.0);
    for (p, x) in canonical.iter().zip(target) {
        let (p, x) = (Vector3::from(*p) - mean_p, Vector3::from(*x) - mean_x);
        xp += x * p.transpose();
        size += p.norm_squared();
    }
    let turn = rotation_matrix(rotation);
    let svd = (xp + turn * (1e-3 * size / 3.0 + 1e-12)).svd(true, true);
    let linear = match (svd.u, svd.v_t) {
        (Some(u), Some(v_t)) => {
            let mirror = (u * v_t).determinant().signum();
            u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, mirror)) * v_t
        }
        _ => turn,
    };
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(linear));
    let q = [q.w, q.i, q.j, q.k];
    let sign = if (0..4).map(|d| q[d] * rotation[d]).sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
    let translation = mean_x - centre - linear * (mean_p - centre);
    Pose { linear, translation, rotation: q.map(|v| v * sign) }
}

/// The rotation matrix of unit quaternion `q`, wxyz.
pub fn rotation_matrix(q: [f64; 4]) -> Matrix3<f64> {
    let [w, x, y, z] = q;
    Matrix3::new(
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
}

/// Hamilton product a ⊗ b, wxyz.
pub fn quat_mul(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    let [aw, ax, ay, az] = a;
    let [bw, bx, by, bz] = b;
    [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
}

/// The mean turn from `before` to `after` (unit quaternions, wxyz), in the sign nearest `hint`.
pub fn mean_turn(before: &[[f32; 4]], after: &[[f32; 4]], hint: [f64; 4]) -> [f64; 4] {
    let mut sum = [0.0f64; 4];
    for (a, b) in before.iter().zip(after) {
        let inverse = [f64::from(a[0]), -f64::from(a[1]), -f64::from(a[2]), -f64::from(a[3])];
        let turn = quat_mul(b.map(f64::from), inverse);
        let same = (0..4).map(|d| turn[d] * hint[d]).sum::<f64>() >= 0.0;
        let sign = if same { 1.0 } else { -1.0 };
        (0..4).for_each(|d| sum[d] += sign * turn[d]);
    }
    let length = sum.iter().map(|v| v * v).sum::<f64>().sqrt();
    if length < 1e-9 { hint } else { sum.map(|v| v / length) }
}

/// An orthonormal temporal basis of `rows` (each `frames` long): the eigenvectors of their
/// second-moment matrix with the largest eigenvalues, at most `most`, and all eigenvalues.
///
/// This is the truncated SVD of the residual matrix. Signs are fixed (largest entry positive) so
/// that equal input gives equal bytes.
pub fn temporal_basis<'a>(
    rows: impl Iterator<Item = &'a [f64]>,
    frames: usize,
    most: usize,
) -> (Vec<Vec<f64>>, Vec<f64>) {
    let mut moment = DMatrix::<f64>::zeros(frames, frames);
    for row in rows {
        for (a, &x) in row.iter().enumerate() {
            if x != 0.0 {
                for (b, &y) in row.iter().enumerate().skip(a) {
                    moment[(a, b)] += x * y;
                }
            }
        }
    }
    for a in 0..frames {
        for b in 0..a {
            moment[(a, b)] = moment[(b, a)];
        }
    }
    let eigen = SymmetricEigen::new(moment);
    let mut order: Vec<usize> = (0..frames).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[b].total_cmp(&eigen.eigenvalues[a]).then(a.cmp(&b)));
    let vectors = order.iter().take(most).map(|&k| {
        let column: Vec<f64> = eigen.eigenvectors.column(k).iter().copied().collect();
        let peak = column.iter().copied().fold(0.0f64, |m, v| if v.abs() > m.abs() + 1e-12 { v } else { m });
        let sign = if peak < 0.0 { -1.0 } else { 1.0 };
        column.into_iter().map(|v| v * sign).collect()
    });
    let vectors = vectors.collect();
    (vectors, order.iter().map(|&k| eigen.eigenvalues[k].max(0.0)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rigid_move_of_a_flat_cluster_is_recovered_with_its_normal() {
        let angle = 0.7f64;
        let rotation = [(angle / 2.0).cos(), (angle / 2.0).sin(), 0.0, 0.0];
        let turn = rotation_matrix(rotation);
        let centre = [0.5, 0.5, 0.0];
        let canonical: Vec<[f64; 3]> =
            (0..50).map(|i| [f64::from(i % 7) / 7.0, f64::from(i % 5) / 5.0, 0.0]).collect();
        let shift = Vector3::new(0.1, -0.4, 2.0);
        let target: Vec<[f64; 3]> = canonical
            .iter()
            .map(|p| {
                (Vector3::from(centre) + shift + turn * (Vector3::from(*p) - Vector3::from(centre))).into()
            })
            .collect();
        let pose = fit_pose(&canonical, &target, centre, rotation);
        assert!((pose.linear - turn).norm() < 1e-9, "{}", pose.linear - turn);
        assert!((pose.translation - shift).norm() < 1e-9);
        let rigid = fit_rigid(&canonical, &target, centre, rotation.map(|v| -v));
        assert!((rigid.linear - turn).norm() < 1e-9 && (rigid.translation - shift).norm() < 1e-9);
        assert!((0..4).all(|d| (rigid.rotation[d] + rotation[d]).abs() < 1e-9), "{:?}", rigid.rotation);
    }

    #[test]
    fn the_basis_of_rank_two_motion_has_rank_two() {
        let frames = 16;
        let a: Vec<f64> = (0..frames).map(|t| (t as f64 * 0.3).sin()).collect();
        let b: Vec<f64> = (0..frames).map(|t| t as f64 / 16.0).collect();
        let rows: Vec<Vec<f64>> = (0..40)
            .map(|i| (0..frames).map(|t| f64::from(i) * a[t] - f64::from(i % 7) * b[t]).collect())
            .collect();
        let (basis, energy) = temporal_basis(rows.iter().map(Vec::as_slice), frames, 4);
        assert!(energy[2] < 1e-9 * energy[0]);
        for (i, u) in basis.iter().enumerate() {
            for (j, v) in basis.iter().enumerate() {
                let dot: f64 = u.iter().zip(v).map(|(a, b)| a * b).sum();
                assert!((dot - if i == j { 1.0 } else { 0.0 }).abs() < 1e-9);
            }
        }
    }

    #[test]
    fn mean_turn_ignores_quaternion_signs() {
        let before = vec![[1.0f32, 0.0, 0.0, 0.0]; 4];
        let (c, s) = (0.3f32.cos(), 0.3f32.sin());
        let after = vec![[c, 0.0, s, 0.0], [-c, 0.0, -s, 0.0], [c, 0.0, s, 0.0], [-c, 0.0, -s, 0.0]];
        let turn = mean_turn(&before, &after, [1.0, 0.0, 0.0, 0.0]);
        assert!((turn[0] - f64::from(c)).abs() < 1e-6 && (turn[2] - f64::from(s)).abs() < 1e-6);
    }
}
