//! Writes frames in formats that others read: bytes out, no file access.
//!
//! A frame is written from its [`Attributes`](crate::scene::Attributes), not from a rendered instant,
//! so logs and logits survive without a detour through `exp` and `ln`. Axes are those of the scene: who
//! writes a scene turns it first to [`default_up`](crate::import::default_up) of the format.

pub mod compressed_ply;
mod file_format;
pub mod fourdgs;
pub mod gltf;
pub mod ply;
pub mod sog;
pub mod splat;
pub mod spz;

use std::io;

pub use file_format::{FileFormat, FrameFiles};

use super::{
    Epoch,
    activation::{SH_C0, sigmoid},
};

/// Display colour, 0 to 1 for what a screen shows, of a band-0 coefficient.
fn display_colour(sh0: f32) -> f32 {
    0.5 + SH_C0 * sh0
}

/// That a file would hold nothing, which readers refuse.
fn nothing_to_write() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "no Gaussian is left; at least one is needed in a file")
}

/// What is said of `count` Gaussians whose `what` is beyond `range`, if there are any.
fn clamped(what: &str, count: usize, range: &str) -> Option<String> {
    let gaussians = if count == 1 { "Gaussian" } else { "Gaussians" };
    let said = || format!("{what} of {count} {gaussians} were clamped to what the format holds, {range}");
    (count > 0).then(said)
}

/// Gaussians of `epoch` that have a harmonic above band 0 beyond what a format holds: `is_within` is given
/// the place of a coefficient in its row of `sh_rest`, and its value.
fn beyond_in_harmonics(epoch: &Epoch, is_within: impl Fn(usize, f32) -> bool) -> usize {
    let attributes = epoch.attributes();
    let rows = attributes.sh_rest.chunks_exact(attributes.sh_degree.rest_len().max(1));
    rows.filter(|row| !row.iter().enumerate().all(|(place, &value)| is_within(place, value))).count()
}

/// 0 to 1 as a byte.
fn byte(unit: f32) -> u8 {
    (unit * 255.0).round().clamp(0.0, 255.0) as u8
}

/// The place of the largest component of a quaternion wxyz, and the others in their order, with the sign that
/// makes the largest positive.
fn smallest_three(q: [f32; 4]) -> (usize, [f32; 3]) {
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let sign = if q[largest] < 0.0 { -1.0 } else { 1.0 };
    let mut others = (0..4).filter(|&i| i != largest).map(|i| sign * q[i]);
    (largest, std::array::from_fn(|_| others.next().unwrap_or(0.0)))
}

/// Rows in the order of a Morton curve through the positions' bounds; rows of one cell keep their order.
fn morton_order(positions: &[[f32; 3]]) -> Vec<u32> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in positions {
        for axis in 0..3 {
            (low[axis], high[axis]) = (low[axis].min(position[axis]), high[axis].max(position[axis]));
        }
    }
    let widest = (0..3).map(|axis| high[axis] - low[axis]).fold(f32::MIN_POSITIVE, f32::max);
    // Sixteen bits an axis, on one scale for all.
    let code = |position: &[f32; 3]| {
        let cell = |axis: usize| (((position[axis] - low[axis]) / widest) * 65_535.0) as u64;
        let spread =
            |cell: u64, axis: u32| (0..16).map(|bit| (cell >> bit & 1) << (3 * bit + axis)).sum::<u64>();
        spread(cell(0), 0) | spread(cell(1), 1) | spread(cell(2), 2)
    };
    let mut order: Vec<(u64, u32)> = positions.iter().map(code).zip(0..).collect();
    order.sort_unstable();
    order.into_iter().map(|(_, row)| row).collect()
}

#[cfg(test)]
pub(in crate::scene) mod tests {
    use codec_core::ShDegree;
    use rand::RngExt;
    use rand_pcg::rand_core::SeedableRng;

    use super::*;
    use crate::scene::{Attributes, Track};

    /// `n` Gaussians at random, with harmonics of `degree`.
    pub(in crate::scene) fn epoch(n: usize, degree: u8) -> Epoch {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(11);
        let mut within = |low: f32, high: f32| low + (high - low) * rng.random::<f32>();
        let mut three = |low: f32, high: f32| [within(low, high), within(low, high), within(low, high)];
        let sh_degree = ShDegree::new(degree).unwrap();
        let positions = (0..n).map(|_| three(-2.0, 2.0)).collect();
        let log_scales = (0..n).map(|_| three(-6.0, -2.0)).collect();
        let sh0 = (0..n).map(|_| three(-1.5, 1.5)).collect();
        let rotations = (0..n).map(|_| three(-1.0, 1.0)).map(|[x, y, z]| [0.3 - x * y, x, y, z]).collect();
        let opacity_logits = (0..n).map(|_| within(-4.0, 4.0)).collect();
        let sh_rest = (0..n * sh_degree.rest_len()).map(|_| within(-0.4, 0.4)).collect();
        let attributes = Attributes {
            positions: Track::Constant(positions),
            rotations: Track::Constant(rotations),
            log_scales: Track::Constant(log_scales),
            opacity_logits: Track::Constant(opacity_logits),
            sh0: Track::Constant(sh0),
            sh_rest,
            sh_degree,
        };
        Epoch::new(1, attributes).unwrap()
    }

    /// The rows of `epoch` in `order`.
    pub(super) fn in_order(epoch: &Epoch, order: &[u32]) -> Epoch {
        fn sorted<T: Copy + PartialEq>(track: &Track<T>, order: &[u32]) -> Track<T> {
            let rows = track.frame(0, order.len());
            Track::Constant(order.iter().map(|&i| rows[i as usize]).collect())
        }
        let a = epoch.attributes();
        let rest = a.sh_degree.rest_len();
        let bands = order.iter().flat_map(|&i| a.sh_rest[i as usize * rest..][..rest].iter().copied());
        let attributes = Attributes {
            positions: sorted(&a.positions, order),
            rotations: sorted(&a.rotations, order),
            log_scales: sorted(&a.log_scales, order),
            opacity_logits: sorted(&a.opacity_logits, order),
            sh0: sorted(&a.sh0, order),
            sh_rest: bands.collect(),
            sh_degree: a.sh_degree,
        };
        Epoch::new(1, attributes).unwrap()
    }

    /// Fails unless `of` is within `tolerance` for every row; a quaternion may be its negative.
    pub(super) fn assert_close(
        what: &str,
        a: &Epoch,
        b: &Epoch,
        tolerance: f32,
        of: impl Fn(&Attributes, usize, usize) -> Vec<f32>,
    ) {
        assert_eq!(a.count(), b.count(), "{what}");
        for i in 0..a.count() {
            let (x, y) = (of(a.attributes(), a.count(), i), of(b.attributes(), b.count(), i));
            assert_eq!(x.len(), y.len(), "{what}");
            let apart = |sign: f32| x.iter().zip(&y).map(|(x, y)| (x - sign * y).abs()).fold(0.0, f32::max);
            let found = if what == "rotation" { apart(1.0).min(apart(-1.0)) } else { apart(1.0) };
            assert!(found <= tolerance, "{what} of row {i}: {x:?} and {y:?}");
        }
    }

    #[test]
    #[should_panic(expected = "colour of row 3")]
    fn a_row_that_is_off_is_noticed() {
        let (a, mut other) = (epoch(9, 0), epoch(9, 0).attributes().clone());
        if let Track::Constant(values) = &mut other.sh0 {
            values[3][1] += 0.1;
        }
        let b = Epoch::new(1, other).unwrap();
        assert_close("colour", &a, &b, 0.05, |a, n, i| a.sh0.frame(0, n)[i].to_vec());
    }

    #[test]
    fn a_morton_order_has_every_row_once_and_neighbours_near() {
        let epoch = epoch(500, 0);
        let positions = epoch.attributes().positions.frame(0, 500);
        let order = morton_order(positions);
        let mut rows = order.clone();
        rows.sort_unstable();
        assert_eq!(rows, (0..500).collect::<Vec<u32>>());
        let path = |order: &[u32]| -> f32 {
            let step = |pair: &[u32]| {
                let (a, b) = (positions[pair[0] as usize], positions[pair[1] as usize]);
                (0..3).map(|d| (a[d] - b[d]).powi(2)).sum::<f32>().sqrt()
            };
            order.windows(2).map(step).sum()
        };
        let in_file_order: Vec<u32> = (0..500).collect();
        assert!(path(&order) < 0.4 * path(&in_file_order));
        assert_eq!(morton_order(&[[1.0; 3]; 3]), [0, 1, 2]);
    }

    #[test]
    fn the_largest_component_is_left_out_and_positive() {
        assert_eq!(smallest_three([0.1, -0.9, 0.2, 0.3]), (1, [-0.1, -0.2, -0.3]));
        assert_eq!(smallest_three([0.5; 4]), (0, [0.5; 3]));
    }
}
