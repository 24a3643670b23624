//! The adjoint of the harmonics takes the gradient of a colour back to coefficients and view direction.

use super::term::{Term, keep};
use crate::{
    camera::dot,
    harmonics::{C0, C1, C2, C3, basis},
};

/// Gradient of `basis(degree, d)` with respect to the three parts of `d`, taken as free.
fn slopes(degree: u8, [x, y, z]: [f64; 3]) -> [[f64; 3]; 15] {
    let mut s = [[0.0; 3]; 15];
    if degree >= 1 {
        s[0][1] = -C1;
        s[1][2] = C1;
        s[2][0] = -C1;
    }
    if degree >= 2 {
        s[3] = [C2[0] * y, C2[0] * x, 0.0];
        s[4] = [0.0, C2[1] * z, C2[1] * y];
        s[5] = [-2.0 * C2[2] * x, -2.0 * C2[2] * y, 4.0 * C2[2] * z];
        s[6] = [C2[3] * z, 0.0, C2[3] * x];
        s[7] = [2.0 * C2[4] * x, -2.0 * C2[4] * y, 0.0];
    }
    if degree >= 3 {
        let (xx, yy, zz) = (x * x, y * y, z * z);
        s[8] = [C3[0] * 6.0 * x * y, C3[0] * 3.0 * (xx - yy), 0.0];
        s[9] = [C3[1] * y * z, C3[1] * x * z, C3[1] * x * y];
        s[10] = [-C3[2] * 2.0 * x * y, C3[2] * (4.0 * zz - xx - 3.0 * yy), C3[2] * 8.0 * y * z];
        s[11] = [-C3[3] * 6.0 * x * z, -C3[3] * 6.0 * y * z, C3[3] * (6.0 * zz - 3.0 * xx - 3.0 * yy)];
        s[12] = [C3[4] * (4.0 * zz - 3.0 * xx - yy), -C3[4] * 2.0 * x * y, C3[4] * 8.0 * x * z];
        s[13] = [C3[5] * 2.0 * x * z, -C3[5] * 2.0 * y * z, C3[5] * (xx - yy)];
        s[14] = [C3[6] * 3.0 * (xx - yy), -C3[6] * 6.0 * x * y, 0.0];
    }
    s
}

/// Takes back the colour gradient `given` of a Gaussian at `offset` from the camera, where `rest` are its
/// coefficients up to `degree`. Writes gradients of `rest`, returns those of `sh0` and of `offset`.
pub(super) fn colour(
    degree: u8,
    offset: [f64; 3],
    rest: &[f32],
    given: [f64; 3],
    rest_out: &mut [f32],
) -> ([f64; 3], [f64; 3]) {
    let sh0 = given.map(|g| keep(Term::Band0, C0 * g));
    if rest.is_empty() {
        return (sh0, [0.0; 3]);
    }
    let length = dot(offset, offset).sqrt();
    let d = offset.map(|v| v / length);
    let (weights, slopes) = (basis(degree, d), slopes(degree, d));
    let mut towards = [0.0; 3];
    let triples = rest.chunks_exact(3).zip(rest_out.chunks_exact_mut(3));
    for ((triple, out), (weight, slope)) in triples.zip(weights.iter().zip(slopes)) {
        let mut pull = 0.0;
        for c in 0..3 {
            out[c] = keep(Term::Bands, given[c] * weight) as f32;
            pull += given[c] * f64::from(triple[c]);
        }
        (0..3).for_each(|k| towards[k] += pull * slope[k]);
    }
    // Only the direction counts, not the distance.
    let along = dot(towards, d);
    let moved = std::array::from_fn(|k| keep(Term::Direction, (towards[k] - along * d[k]) / length));
    (sh0, moved)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_the_differences_of_the_basis() {
        for d in [[0.3, -0.5, 0.8], [1.0, 0.0, 0.0], [-0.2, 0.9, -0.1]] {
            for degree in 0..=3 {
                let slopes = slopes(degree, d);
                for k in 0..3 {
                    let at = |h: f64| {
                        let mut p = d;
                        p[k] += h;
                        basis(degree, p)
                    };
                    let (a, b) = (at(1e-5), at(-1e-5));
                    for i in 0..15 {
                        let expected = (a[i] - b[i]) / 2e-5;
                        assert!((slopes[i][k] - expected).abs() < 1e-8, "{degree} {i} {k}");
                    }
                }
            }
        }
    }
}
