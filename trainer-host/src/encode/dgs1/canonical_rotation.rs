//! Chooses which of its equivalent rotations a Gaussian is sent with.
//!
//! A covariance R·S²·Rᵀ stays what it is under R → R·G, S → GᵀSG for the 24 rotations G that permute and flip
//! the axes, under turns about the third axis where the other two scales are equal, and under all turns where
//! all three are. The least turn has small Rodrigues parameters, and one or all of them are zero for discs
//! and balls; but axes change places between neighbours. Which is cheaper depends on the scene, so
//! [`CanonicalRotation`] names the choices and the encoder tries them on a part of it.
//!
//! G is the same at every frame, so motion, which is coded as turns on the left, does not change.
//! A disc may besides turn in its plane as it likes, and so follow its cluster.

use rayon::prelude::*;

use super::super::{
    decisions::CanonicalRotation,
    factorise::{mean_turn, quat_mul, rotation_matrix},
};
use crate::scene::{Attributes, Epoch, Track};

/// Log-scales this close are equal: a change of covariance by 1e-6.
const EQUAL: f32 = 5e-7;

type Quat = [f64; 4];

/// The forms worth a trial for `epoch`.
pub(super) fn candidates(epoch: &Epoch) -> &'static [CanonicalRotation] {
    use CanonicalRotation::{AsGiven, FollowingCluster, LeastTurn};
    let moving = !epoch.attributes().rotations.is_constant();
    if moving { &[AsGiven, LeastTurn, FollowingCluster] } else { &[AsGiven, LeastTurn] }
}

/// `epoch` with the rotation and scales of every Gaussian of `sets` in `form`; every covariance at
/// every frame is what it was to 1e-6 of its size.
pub(super) fn reduced(epoch: &Epoch, sets: &[Vec<u32>], form: CanonicalRotation) -> Epoch {
    if form == CanonicalRotation::AsGiven {
        return epoch.clone();
    }
    let (n, a) = (epoch.count(), epoch.attributes());
    let group = group();
    let changes: Vec<Vec<Change>> =
        sets.par_iter().map(|set| set.iter().map(|&i| change(epoch, i as usize, &group)).collect()).collect();
    let mut rotations = a.rotations.clone();
    let mut log_scales = a.log_scales.clone();
    for (&i, change) in sets.iter().flatten().zip(changes.iter().flatten()) {
        let i = i as usize;
        if change.axes != [0, 1, 2] {
            for frame in frames(&mut log_scales, n) {
                let s = frame[i];
                frame[i] = change.axes.map(|axis| s[axis]);
            }
        }
        for frame in frames(&mut rotations, n) {
            frame[i] = quat_mul(frame[i].map(f64::from), change.turn).map(|v| v as f32);
        }
    }
    if form == CanonicalRotation::FollowingCluster
        && let Track::PerFrame(values) = &mut rotations
    {
        follow(epoch, sets, &changes, values);
    }
    let attributes = Attributes { rotations, log_scales, ..a.clone() };
    // Cannot fail: lengths are those of an epoch, and products of unit quaternions are finite.
    Epoch::new(epoch.frames(), attributes).unwrap_or_else(|_| epoch.clone())
}

fn frames<T>(track: &mut Track<T>, n: usize) -> std::slice::ChunksMut<'_, T> {
    match track {
        Track::Constant(values) | Track::PerFrame(values) => values.chunks_mut(n.max(1)),
    }
}

/// Lets discs and balls turn with their cluster, about the axes that do not show.
fn follow(epoch: &Epoch, sets: &[Vec<u32>], changes: &[Vec<Change>], rotations: &mut [[f32; 4]]) {
    let (n, source) = (epoch.count(), &epoch.attributes().rotations);
    let turned: Vec<Vec<(usize, [f32; 4])>> = sets
        .par_iter()
        .zip(changes)
        .map(|(set, changes)| {
            let mut out = Vec::new();
            if changes.iter().all(|c| c.free == Free::None) {
                return out;
            }
            let pick =
                |t: usize| -> Vec<[f32; 4]> { set.iter().map(|&i| source.frame(t, n)[i as usize]).collect() };
            let start = pick(0);
            let mut turn = [1.0, 0.0, 0.0, 0.0];
            for t in 1..epoch.frames() {
                turn = mean_turn(&start, &pick(t), turn);
                for (&i, change) in set.iter().zip(changes) {
                    let i = i as usize;
                    let rest = rotations[i].map(f64::from);
                    let turned = quat_mul(turn, rest);
                    let own = rotations[t * n + i].map(f64::from);
                    let relative = quat_mul(conjugate(turned), own);
                    let new = match change.free {
                        Free::None => continue,
                        Free::Plane => quat_mul(own, conjugate(twist(relative))),
                        Free::All => turned,
                    };
                    out.push((t * n + i, new.map(|v| v as f32)));
                }
            }
            out
        })
        .collect();
    for (at, rotation) in turned.into_iter().flatten() {
        rotations[at] = rotation;
    }
}

/// Which turns do not show.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Free {
    /// None but the group's.
    None,
    /// Those about the third axis.
    Plane,
    /// All.
    All,
}

/// What happens to a Gaussian.
#[derive(Clone, Copy, Debug)]
struct Change {
    /// Multiplied to its rotation from the right.
    turn: Quat,
    /// Its new axes in terms of the old.
    axes: [usize; 3],
    free: Free,
}

fn change(epoch: &Epoch, i: usize, group: &[(Quat, [usize; 3])]) -> Change {
    let (n, a) = (epoch.count(), epoch.attributes());
    let scales = match &a.log_scales {
        Track::Constant(values) | Track::PerFrame(values) => values.as_slice(),
    };
    let equal =
        |x: usize, y: usize| scales.chunks(n.max(1)).all(|frame| (frame[i][x] - frame[i][y]).abs() <= EQUAL);
    let q = a.rotations.frame(0, n)[i].map(f64::from);
    let (xy, yz, xz) = (equal(0, 1), equal(1, 2), equal(0, 2));
    if xy && yz && xz {
        return Change { turn: conjugate(q), axes: [0, 1, 2], free: Free::All };
    }
    // The axis that must become the third, if two others are equal.
    let odd = if xy {
        Some(2)
    } else if yz {
        Some(0)
    } else if xz {
        Some(1)
    } else {
        None
    };
    let mut best = Change { turn: [1.0, 0.0, 0.0, 0.0], axes: [0, 1, 2], free: Free::None };
    let mut largest = -1.0f64;
    for &(turn, axes) in group {
        let (turn, free) = match odd {
            Some(odd) if axes[2] != odd => continue,
            Some(_) => (quat_mul(turn, conjugate(twist(quat_mul(q, turn)))), Free::Plane),
            None => (turn, Free::None),
        };
        // The largest scalar part is the least turn; the margin keeps ties with the first.
        let scalar = quat_mul(q, turn)[0].abs();
        if scalar > largest + 1e-6 {
            (best, largest) = (Change { turn, axes, free }, scalar);
        }
    }
    best
}

fn conjugate([w, x, y, z]: Quat) -> Quat {
    [w, -x, -y, -z]
}

/// The turn about the third axis in `q` = swing · twist.
fn twist([w, _, _, z]: Quat) -> Quat {
    let length = (w * w + z * z).sqrt();
    // Half a turn about an axis in the plane: any twist does.
    if length < 1e-9 { [1.0, 0.0, 0.0, 0.0] } else { [w / length, 0.0, 0.0, z / length] }
}

/// The 24 rotations that permute and flip the axes, and which old axis each new one is.
pub(in crate::encode) fn group() -> Vec<(Quat, [usize; 3])> {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    // Unit quaternions with one, two or four non-zero parts of equal size, one of each pair ±q.
    let mut group: Vec<(Quat, [usize; 3])> = Vec::new();
    for code in 0..81 {
        let parts: [i32; 4] = std::array::from_fn(|k| code / 3i32.pow(k as u32) % 3 - 1);
        let first = parts.iter().copied().find(|p| *p != 0);
        let size = match parts.iter().filter(|p| **p != 0).count() {
            1 => 1.0,
            2 => half,
            4 => 0.5,
            _ => continue,
        };
        if first == Some(1) {
            let q = parts.map(|p| f64::from(p) * size);
            let matrix = rotation_matrix(q);
            let axes = [0, 1, 2].map(|new| (0..3).find(|&old| matrix[(old, new)].abs() > 0.5).unwrap_or(new));
            group.push((q, axes));
        }
    }
    // The identity first: it wins ties.
    group.sort_by(|a, b| b.0[0].total_cmp(&a.0[0]));
    group
}

#[cfg(test)]
mod tests {
    use super::*;
    use codec_core::ShDegree;

    fn noise(i: usize) -> f32 {
        ((i * 7919 + 13) % 1009) as f32 / 504.5 - 1.0
    }

    /// Needles, discs along each axis, and balls, all turning.
    fn epoch(n: usize, frames: usize) -> Epoch {
        let shapes =
            [[-2.0, -3.0, -4.5], [-2.0, -2.0, -4.0], [-4.0, -2.0, -2.0], [-2.0, -4.0, -2.0], [-3.0; 3]];
        Epoch::new(
            frames,
            Attributes {
                positions: Track::Constant((0..n).map(|i| [noise(i), noise(i + 5), noise(3 * i)]).collect()),
                rotations: Track::PerFrame(
                    (0..n * frames)
                        .map(|i| [noise(i), noise(i + 11), noise(7 * i + 1), noise(5 * i + 2)])
                        .collect(),
                ),
                log_scales: Track::PerFrame(
                    (0..n * frames)
                        .map(|i| shapes[i % n % shapes.len()].map(|s| s + 0.2 * (i / n) as f32))
                        .collect(),
                ),
                opacity_logits: Track::Constant(vec![1.0; n]),
                sh0: Track::Constant(vec![[0.1; 3]; n]),
                sh_rest: Vec::new(),
                sh_degree: ShDegree::ZERO,
            },
        )
        .unwrap()
    }

    fn covariance(epoch: &Epoch, t: usize, i: usize) -> nalgebra::Matrix3<f64> {
        let (n, a) = (epoch.count(), epoch.attributes());
        // As renderers do, at unit length: stored ones are so to f32's rounding.
        let q = a.rotations.frame(t, n)[i].map(f64::from);
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let r = rotation_matrix(q.map(|v| v / length));
        let s = a.log_scales.frame(t, n)[i].map(|s| (2.0 * f64::from(s)).exp());
        r * nalgebra::Matrix3::from_diagonal(&s.into()) * r.transpose()
    }

    #[test]
    fn covariances_stay() {
        let source = epoch(100, 4);
        let sets: Vec<Vec<u32>> = vec![(0..37).collect(), (37..100).collect()];
        for &form in candidates(&source) {
            let reduced = reduced(&source, &sets, form);
            for t in 0..4 {
                for i in 0..100 {
                    let (a, b) = (covariance(&source, t, i), covariance(&reduced, t, i));
                    assert!((a - b).norm() <= 1e-6 * a.norm(), "{form:?}, frame {t}, Gaussian {i}: {a} {b}");
                }
            }
        }
    }

    #[test]
    fn turns_are_small_and_flat_where_they_may_be() {
        let source = epoch(100, 2);
        let reduced = reduced(&source, &[(0..100).collect()], CanonicalRotation::LeastTurn);
        for (i, q) in reduced.attributes().rotations.frame(0, 100).iter().enumerate() {
            match i % 5 {
                // No rotation is farther than 62.8° from its nearest of the group.
                0 => assert!(q[0].abs() > 0.853, "{q:?}"),
                4 => assert!(q[0].abs() > 0.999_999, "{q:?}"),
                _ => assert!(q[3].abs() < 1e-6 && q[0].abs() > 0.707, "{q:?}"),
            }
        }
    }

    #[test]
    fn the_group_has_24_members_and_permutes() {
        let group = group();
        assert_eq!(group.len(), 24);
        assert_eq!(group[0].1, [0, 1, 2]);
        for (_, axes) in group {
            let mut sorted = axes;
            sorted.sort_unstable();
            assert_eq!(sorted, [0, 1, 2]);
        }
    }
}
