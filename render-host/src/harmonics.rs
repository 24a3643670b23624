//! Evaluates real spherical harmonics of degree 0..=3 in the sign convention of 3DGS (−y, +z, −x for band 1).
//!
//! Both renderers weigh the same basis; the reference sums in f64, the renderer in f32.

/// Band 0, 1 / (2 √π): display colour is `0.5 + C0 · sh0 + …`.
pub const C0: f64 = 0.282_094_791_773_878_14;
pub(crate) const C1: f64 = 0.488_602_511_9;
pub(crate) const C2: [f64; 5] =
    [1.092_548_430_6, -1.092_548_430_6, 0.315_391_565_3, -1.092_548_430_6, 0.546_274_215_3];
pub(crate) const C3: [f64; 7] = [
    -0.590_043_589_9,
    2.890_611_442_6,
    -0.457_045_799_5,
    0.373_176_332_6,
    -0.457_045_799_5,
    1.445_305_721_3,
    -0.590_043_589_9,
];

/// Values of bands 1..=`degree` towards the unit vector `[x, y, z]` (camera centre to Gaussian); entries
/// of higher bands are 0.
pub fn basis(degree: u8, [x, y, z]: [f64; 3]) -> [f64; 15] {
    let mut b = [0.0; 15];
    if degree >= 1 {
        b[0] = -C1 * y;
        b[1] = C1 * z;
        b[2] = -C1 * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[3] = C2[0] * x * y;
        b[4] = C2[1] * y * z;
        b[5] = C2[2] * (2.0 * zz - xx - yy);
        b[6] = C2[3] * x * z;
        b[7] = C2[4] * (xx - yy);
    }
    if degree >= 3 {
        b[8] = C3[0] * y * (3.0 * xx - yy);
        b[9] = C3[1] * x * y * z;
        b[10] = C3[2] * y * (4.0 * zz - xx - yy);
        b[11] = C3[3] * z * (2.0 * zz - 3.0 * xx - 3.0 * yy);
        b[12] = C3[4] * x * (4.0 * zz - xx - yy);
        b[13] = C3[5] * z * (xx - yy);
        b[14] = C3[6] * x * (xx - 3.0 * yy);
    }
    b
}

/// Coefficients per channel in bands 1..=`degree`.
pub(crate) fn count(degree: u8) -> usize {
    let d = usize::from(degree) + 1;
    d * d - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Orthonormality over the sphere pins every constant and sign up to a joint sign per function.
    #[test]
    fn the_basis_is_orthonormal() {
        let (nt, np) = (64, 64);
        let mut gram = [[0.0; 16]; 16];
        for i in 0..nt {
            // Midpoints in cos θ and φ; exact enough for polynomials of degree 6.
            let z: f64 = -1.0 + (f64::from(i) + 0.5) * 2.0 / f64::from(nt);
            for j in 0..np {
                let (s, c) = ((f64::from(j) + 0.5) * std::f64::consts::TAU / f64::from(np)).sin_cos();
                let r = (1.0 - z * z).sqrt();
                let b = basis(3, [r * c, r * s, z]);
                let full: [f64; 16] = std::array::from_fn(|k| if k == 0 { C0 } else { b[k - 1] });
                let area = 4.0 * std::f64::consts::PI / f64::from(nt * np);
                (0..16).for_each(|a| (0..16).for_each(|k| gram[a][k] += area * full[a] * full[k]));
            }
        }
        for (a, row) in gram.iter().enumerate() {
            for (k, value) in row.iter().enumerate() {
                let expected = f64::from(u8::from(a == k));
                assert!((value - expected).abs() < 4e-3, "{a} {k}: {value}");
            }
        }
    }

    #[test]
    fn band_one_has_the_signs_of_the_field() {
        assert_eq!(basis(1, [0.0, 1.0, 0.0])[0], -C1);
        assert_eq!(basis(1, [0.0, 0.0, 1.0])[1], C1);
        assert_eq!(basis(1, [1.0, 0.0, 0.0])[2], -C1);
        assert_eq!((count(0), count(1), count(3)), (0, 3, 15));
        assert!(basis(1, [0.5, 0.5, 0.7])[3..].iter().all(|&v| v == 0.0));
    }
}
