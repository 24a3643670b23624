//! Chooses how a cluster moves as a whole: the cheapest of static, rigid and affine, and how finely.
//!
//! Each candidate is quantised, reconstructed by the decoder's own function, and judged by its own
//! bits plus an estimate of what the per-Gaussian coefficients behind it would take, with the
//! distortion that they would leave. So a track never pays for what coefficients do better, nor the
//! other way round.

use codec_core::internals::{
    decode::motion::{Pose, cosine, pose, track_steps},
    ids::Level,
    layout::Shape,
    math,
    wire::manifest::{Motion, Track},
};
use glam::Vec3;

use super::{
    super::{
        decisions::{MotionDecisions, TrackForm},
        factorise::{self, fit_pose, fit_rigid, mean_turn},
    },
    rate_estimate::{RateEstimate, dot},
};
use crate::scene::Attributes;

/// One cluster in one window, as the decoder has it when nothing moves.
pub(super) struct Member<'a> {
    pub attributes: &'a Attributes,
    /// Gaussians of the epoch.
    pub count: usize,
    pub frames: std::ops::Range<usize>,
    pub members: &'a [u32],
    /// Decoded canonical positions.
    pub still: Vec<[f32; 3]>,
    /// Decoded canonical rotations.
    pub rest: Vec<[f32; 4]>,
    pub centre: Vec3,
}

impl Member<'_> {
    /// What position and rotation of member `i` lack after `poses`, per component over the frames;
    /// rotation in half-angle tangents, clamped near half a turn.
    pub fn leftover(&self, poses: &[Pose], i: usize) -> [Vec<f64>; 6] {
        let mut rows: [Vec<f64>; 6] = std::array::from_fn(|_| Vec::with_capacity(poses.len()));
        let g = self.members[i] as usize;
        let offset = Vec3::from_array(self.still[i]) - self.centre;
        for (pose, t) in poses.iter().zip(self.frames.clone()) {
            let x = pose.linear * offset + self.centre + pose.translation;
            let truth = self.attributes.positions.frame(t, self.count)[g];
            let [w, a, b, c] = math::quat_mul(pose.rotation, self.rest[i]);
            let turn = math::quat_mul(self.attributes.rotations.frame(t, self.count)[g], [w, -a, -b, -c]);
            let w = if turn[0].abs() < 0.05 { 0.05f32.copysign(turn[0]) } else { turn[0] };
            for d in 0..3 {
                rows[d].push(f64::from(truth[d]) - f64::from(x[d]));
                rows[3 + d].push(f64::from(turn[d + 1] / w));
            }
        }
        rows
    }
}

/// A track as it is sent.
pub(super) struct Chosen {
    pub motion: Motion,
    pub symbols: Vec<i16>,
    /// Poses of the frames, as the decoder makes them.
    pub poses: Vec<Pose>,
}

/// Gaussians of a cluster that a candidate is judged by, at most.
const SAMPLE: usize = 48;
/// Candidates of one class stop after this many coarser steps that cost more.
const PATIENCE: usize = 2;

/// The cheapest track. `still` is the shape without one; `rates` those of position and rotation
/// coefficients; `vectors` the cosine basis. A track takes at most `most_bits`, and behind it a position has
/// at most `rank` coefficients per component.
pub(super) fn choose(
    member: &Member<'_>,
    still: &Shape,
    rates: &[RateEstimate; 2],
    vectors: &[Vec<f64>],
    (most_bits, rank): (f64, usize),
) -> Chosen {
    let count = member.frames.len();
    let every = member.members.len().div_ceil(SAMPLE).max(1);
    let share = every as f64;
    let residual_bits = |poses: &[Pose]| -> f64 {
        let mut sum = 0.0;
        for i in (0..member.members.len()).step_by(every) {
            for (d, row) in member.leftover(poses, i).iter().enumerate() {
                let most = if d < 3 { rank } else { vectors.len() };
                sum += rates[d / 3].of_row(row, vectors, most);
            }
        }
        sum * share
    };
    let identity = vec![Pose::IDENTITY; count];
    let mut best_cost = residual_bits(&identity);
    let mut best = Chosen { motion: Motion::default(), symbols: Vec::new(), poses: identity };
    if best_cost <= 0.0 {
        return best;
    }
    let cosines: Vec<_> = (0..count).map(|t| cosine(count as u32, t as u32)).collect();
    let fits = fits(member);
    for track in [Track::Rigid, Track::Affine] {
        let coefficients = transform(track, &fits, vectors);
        let (mut least, mut worse) = (f64::INFINITY, 0);
        for shift in 0..=24u8 {
            let motion = track_motion(track, shift);
            let shape = with_motion(still, motion);
            let Some((coded, symbols)) = quantise(&shape, &coefficients, count) else { continue };
            if coded == 0 {
                break;
            }
            let bits = size_bits(&symbols);
            if bits > most_bits {
                continue;
            }
            let shape = with_motion(still, Motion { track: coded, ..motion });
            let poses = cosines.iter().map(|cosine| pose(&shape, &symbols, cosine));
            // A candidate that the decoder refuses is none.
            let Ok(poses) = poses.collect::<codec_core::Result<Vec<Pose>>>() else { continue };
            let cost = bits + residual_bits(&poses);
            if cost < best_cost {
                best_cost = cost;
                best = Chosen { motion: shape.motion, symbols, poses };
            }
            if cost < least {
                (least, worse) = (cost, 0);
            } else {
                worse += 1;
                if worse > PATIENCE {
                    break;
                }
            }
        }
    }
    best
}

/// The track that `decided` names; `None` if a coefficient does not fit its symbol.
pub(super) fn follow(
    member: &Member<'_>,
    still: &Shape,
    decided: &MotionDecisions,
    vectors: &[Vec<f64>],
) -> Option<Chosen> {
    let count = member.frames.len();
    let track = match decided.track {
        TrackForm::Static => {
            let poses = vec![Pose::IDENTITY; count];
            return Some(Chosen { motion: Motion::default(), symbols: Vec::new(), poses });
        }
        TrackForm::Rigid => Track::Rigid,
        TrackForm::Affine => Track::Affine,
    };
    let motion = track_motion(track, decided.track_shift);
    let coefficients = transform(track, &fits(member), vectors);
    let (coded, symbols) = match quantise(&with_motion(still, motion), &coefficients, count)? {
        // What moved when tracks were decided moves no more: the format has no shorter track than this.
        (0, _) => (1, vec![0; coefficients.len()]),
        coded => coded,
    };
    let motion = Motion { track: coded, ..motion };
    let shape = with_motion(still, motion);
    let pose_at = |t: usize| pose(&shape, &symbols, &cosine(count as u32, t as u32));
    let poses = (0..count).map(pose_at).collect::<codec_core::Result<Vec<Pose>>>().ok()?;
    Some(Chosen { motion, symbols, poses })
}

fn track_motion(track: Track, shift: u8) -> Motion {
    Motion { kind: Motion::kind_of(track, Level::ALL[3]), track_shift: shift, ..Motion::default() }
}

fn with_motion(still: &Shape, motion: Motion) -> Shape {
    Shape::dgs1(still.cluster, still.quant, Some(motion), still.frames, still.block_len)
}

/// The best poses of each frame: affine and rigid.
fn fits(member: &Member<'_>) -> Vec<[factorise::Pose; 2]> {
    let (a, n) = (member.attributes, member.count);
    let pick3 = |values: &[[f32; 3]]| -> Vec<[f64; 3]> {
        member.members.iter().map(|&i| values[i as usize].map(f64::from)).collect()
    };
    let pick4 = |values: &[[f32; 4]]| -> Vec<[f32; 4]> {
        member.members.iter().map(|&i| values[i as usize]).collect()
    };
    let p0: Vec<[f64; 3]> = member.still.iter().map(|p| p.map(f64::from)).collect();
    let start = pick4(a.rotations.frame(0, n));
    let centre = member.centre.to_array().map(f64::from);
    let mut turn = [1.0, 0.0, 0.0, 0.0];
    let mut rigid_turn = turn;
    let fit = |t: usize| {
        let target = pick3(a.positions.frame(t, n));
        turn = mean_turn(&start, &pick4(a.rotations.frame(t, n)), turn);
        let affine = fit_pose(&p0, &target, centre, turn);
        // The sign of the frame before keeps the parameters a continuous curve.
        let near = (0..4).map(|d| turn[d] * rigid_turn[d]).sum::<f64>();
        let hint = if near < 0.0 { turn.map(|v| -v) } else { turn };
        let rigid = fit_rigid(&p0, &target, centre, hint);
        rigid_turn = rigid.rotation;
        [affine, rigid]
    };
    member.frames.clone().map(fit).collect()
}

/// Cosine coefficients of a track's parameters: those that turn, then translation.
fn transform(track: Track, fits: &[[factorise::Pose; 2]], vectors: &[Vec<f64>]) -> Vec<Vec<f64>> {
    let rigid = track == Track::Rigid;
    let parameter = |fit: &[factorise::Pose; 2], p: usize| -> f64 {
        let pose = &fit[usize::from(rigid)];
        if p >= track.turning() {
            return pose.translation[p - track.turning()];
        }
        if rigid {
            // Modified Rodrigues parameters; below w = −0.9 (over 310°) another form would be due.
            return pose.rotation[1 + p] / (1.0 + pose.rotation[0].max(-0.9));
        }
        pose.linear[(p / 3, p % 3)] - if p.is_multiple_of(4) { 1.0 } else { 0.0 }
    };
    (0..track.parameters())
        .map(|p| {
            let series: Vec<f64> = fits.iter().map(|fit| parameter(fit, p)).collect();
            vectors.iter().map(|v| dot(&series, v)).collect()
        })
        .collect()
}

/// Coefficients kept per parameter and their symbols in storage order; `None` if one does not fit
/// i16.
fn quantise(shape: &Shape, coefficients: &[Vec<f64>], frames: usize) -> Option<(u8, Vec<i16>)> {
    let [translation, linear, rodrigues] = track_steps(shape);
    let track = shape.motion.class();
    let turning = track.turning();
    let turn_step = f64::from(if track == Track::Rigid { rodrigues } else { linear });
    let mut coded = 0;
    let mut quantised = vec![vec![0i16; coefficients.len()]; frames];
    for (p, list) in coefficients.iter().enumerate() {
        let step = if p < turning { turn_step } else { f64::from(translation) };
        for (k, &coefficient) in list.iter().enumerate() {
            let scaled = coefficient / step;
            // A little dead zone: a lone ±1 costs more than it mends.
            let symbol = if scaled.abs() < 0.62 { 0.0 } else { scaled.round() };
            if symbol.abs() > 32_767.0 {
                return None;
            }
            if symbol != 0.0 {
                coded = coded.max(k + 1);
            }
            quantised[k][p] = symbol as i16;
        }
    }
    quantised.truncate(coded);
    let turns = quantised.iter().flat_map(|row| &row[..turning]);
    let moves = quantised.iter().flat_map(|row| &row[turning..]);
    Some((coded as u8, turns.chain(moves).copied().collect()))
}

/// An estimate of what a track takes, bits.
fn size_bits(symbols: &[i16]) -> f64 {
    symbols.iter().map(|&s| if s == 0 { 0.4 } else { 2.4 + 1.5 * f64::from(s.unsigned_abs()).log2() }).sum()
}
