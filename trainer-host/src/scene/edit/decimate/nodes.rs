//! Groups of Gaussians on their way to become one: what they are together, and what becoming one costs.

use nalgebra::Matrix3;

use super::shape::{self, Covariance, Seen};
use crate::{
    encode::factorise::rotation_matrix,
    scene::{Epoch, activation::SH_C0},
};

/// Display colour per unit of band 0, and, root mean square over directions, per unit of any harmonic.
const COLOUR: f64 = SH_C0 as f64;
/// What a difference in coverage weighs beside one of colour. What shows through a gap is mostly of the same
/// colour, since it is what lies near.
const COVERAGE: f64 = 0.05;
/// Prices are per mass to this power. By 0, all that is small would go first; by 1, errors of the same share
/// count alike at every size; what is a little above that spares detail most.
const PER_MASS: f64 = 1.3;

/// A group at one frame.
#[derive(Clone, Copy, Debug)]
struct State {
    /// Mean of its members.
    position: [f32; 3],
    /// Band 0, likewise.
    sh0: [f32; 3],
    /// How many times wider it is than at the first frame.
    growth: f32,
    /// Opacity integrated over the mean projected area, over 2π.
    mass: f64,
}

/// The groups of an epoch; a group has the number of its first member.
pub(super) struct Nodes<'e> {
    epoch: &'e Epoch,
    /// The frames that are looked at, ascending; at the first, covariances are what they are.
    frames: Vec<usize>,
    /// One per frame for each group.
    states: Vec<State>,
    /// Covariances at the first frame.
    shapes: Vec<Covariance>,
    /// What each Gaussian weighs in means: its mass, mean over the frames.
    own: Vec<f64>,
    /// The same of all members of a group.
    weights: Vec<f64>,
    /// The heaviest member.
    leaders: Vec<u32>,
    /// Higher bands.
    rest: Vec<f32>,
}

impl<'e> Nodes<'e> {
    /// Every Gaussian of `epoch` alone, looked at at `frames`, of which there is one at least.
    pub(super) fn new(epoch: &'e Epoch, frames: Vec<usize>) -> Self {
        let (n, a) = (epoch.count(), epoch.attributes());
        let first = frames[0];
        let mut states = Vec::with_capacity(n * frames.len());
        let (mut shapes, mut own) = (Vec::with_capacity(n), Vec::with_capacity(n));
        for i in 0..n {
            let mut mass = 0.0;
            for &t in &frames {
                let state = State {
                    position: a.positions.frame(t, n)[i],
                    sh0: a.sh0.frame(t, n)[i],
                    growth: growth(epoch, i, first, t).exp() as f32,
                    mass: self::mass(epoch, i, t),
                };
                mass += state.mass / frames.len() as f64;
                states.push(state);
            }
            shapes.push(shape_at(epoch, i, first));
            own.push(mass.max(f64::MIN_POSITIVE));
        }
        let (weights, leaders) = (own.clone(), (0..n as u32).collect());
        Self { epoch, frames, states, shapes, own, weights, leaders, rest: a.sh_rest.clone() }
    }

    /// Gaussians there are.
    pub(super) fn count(&self) -> usize {
        self.own.len()
    }

    /// The frame at which covariances are what they are.
    pub(super) fn first_frame(&self) -> usize {
        self.frames[0]
    }

    pub(super) fn position(&self, group: usize) -> [f32; 3] {
        self.state(group, 0).position
    }

    pub(super) fn shape(&self, group: usize) -> &Covariance {
        &self.shapes[group]
    }

    /// The mass at the first frame.
    pub(super) fn mass(&self, group: usize) -> f64 {
        self.state(group, 0).mass
    }

    /// Its higher bands.
    pub(super) fn rest(&self, group: usize) -> &[f32] {
        let bands = self.epoch.attributes().sh_degree.rest_len();
        &self.rest[group * bands..][..bands]
    }

    /// What Gaussian `i` is of the group `group` that it belongs to, a share.
    pub(super) fn share(&self, i: usize, group: usize) -> f64 {
        self.own[i] / self.weights[group]
    }

    /// The member whose turns the group follows.
    pub(super) fn leader(&self, group: usize) -> usize {
        self.leaders[group] as usize
    }

    fn state(&self, group: usize, at: usize) -> State {
        self.states[group * self.frames.len() + at]
    }

    /// From `j` to `i` at a frame.
    fn apart(&self, i: usize, j: usize, at: usize) -> [f64; 3] {
        let (a, b) = (self.state(i, at).position, self.state(j, at).position);
        std::array::from_fn(|axis| f64::from(a[axis]) - f64::from(b[axis]))
    }

    /// What is `i` of both.
    fn part(&self, i: usize, j: usize) -> f64 {
        self.weights[i] / (self.weights[i] + self.weights[j])
    }

    fn heavier(&self, i: usize, j: usize) -> usize {
        if self.weights[i] >= self.weights[j] { i } else { j }
    }

    /// The turn of group `i` from the first frame to that at `at`.
    fn turn(&self, i: usize, at: usize) -> Matrix3<f64> {
        let (n, leader) = (self.epoch.count(), self.leader(i));
        let rotation =
            |t: usize| rotation_matrix(self.epoch.attributes().rotations.frame(t, n)[leader].map(f64::from));
        rotation(self.frames[at]) * rotation(self.frames[0]).transpose()
    }

    /// What it costs that groups `i` and `j` become one: the squared difference of colour and coverage,
    /// integrated over pictures along the three axes, mean over the frames, over their mass.
    pub(super) fn price(&self, i: usize, j: usize) -> f64 {
        let p = self.part(i, j);
        let leads = self.heavier(i, j);
        let joint = shape::together(&self.shapes[i], &self.shapes[j], p, self.apart(i, j, 0));
        let bands = self.rest(i).iter().zip(self.rest(j));
        let rest = bands.map(|(a, b)| f64::from((a - b) * (a - b))).sum::<f64>();
        let (mut sum, mut mass) = (0.0, 0.0);
        for at in 0..self.frames.len() {
            let (a, b) = (self.state(i, at), self.state(j, at));
            let shapes = match at {
                0 => [self.shapes[i], self.shapes[j], joint],
                _ => [
                    shape::turned(&self.shapes[i], &self.turn(i, at), f64::from(a.growth)),
                    shape::turned(&self.shapes[j], &self.turn(j, at), f64::from(b.growth)),
                    shape::turned(&joint, &self.turn(leads, at), grown(&a, &b, p)),
                ],
            };
            let band0 = (0..3).map(|channel| f64::from(a.sh0[channel] - b.sh0[channel]).powi(2)).sum::<f64>();
            let colours = COLOUR * COLOUR * (band0 + rest);
            sum += difference([a.mass, b.mass], &shapes, p, self.apart(i, j, at), colours);
            mass += a.mass + b.mass;
        }
        sum / mass.max(f64::MIN_POSITIVE).powf(PER_MASS)
    }

    /// Makes group `j` a part of group `i`.
    pub(super) fn join(&mut self, i: usize, j: usize) {
        let p = self.part(i, j);
        let joint = shape::together(&self.shapes[i], &self.shapes[j], p, self.apart(i, j, 0));
        let mean = |a: f32, b: f32| (p * f64::from(a) + (1.0 - p) * f64::from(b)) as f32;
        let area = shape::area(&joint);
        for at in 0..self.frames.len() {
            let (a, b) = (self.state(i, at), self.state(j, at));
            let growth = grown(&a, &b, p);
            self.states[i * self.frames.len() + at] = State {
                position: std::array::from_fn(|axis| mean(a.position[axis], b.position[axis])),
                sh0: std::array::from_fn(|channel| mean(a.sh0[channel], b.sh0[channel])),
                growth: growth as f32,
                // No more than opaque.
                mass: (a.mass + b.mass).min(area * growth * growth),
            };
        }
        let bands = self.epoch.attributes().sh_degree.rest_len();
        for k in 0..bands {
            self.rest[i * bands + k] = mean(self.rest[i * bands + k], self.rest[j * bands + k]);
        }
        self.shapes[i] = joint;
        self.leaders[i] = self.leaders[self.heavier(i, j)];
        self.weights[i] += self.weights[j];
    }
}

/// How many times wider both are together than at the first frame.
fn grown(a: &State, b: &State, p: f64) -> f64 {
    (p * f64::from(a.growth).ln() + (1.0 - p) * f64::from(b.growth).ln()).exp()
}

/// The squared difference at one frame between two groups of these masses, of which the first is `p` of
/// both, and what they become. `shapes` are theirs and that of both, `apart` is from the second to the
/// first, `colours` the squared difference of their colours.
fn difference(
    [first, second]: [f64; 2],
    shapes: &[Covariance; 3],
    p: f64,
    apart: [f64; 3],
    colours: f64,
) -> f64 {
    let q = 1.0 - p;
    let opacity = |mass: f64, shape: &Covariance| (mass / shape::area(shape).max(f64::MIN_POSITIVE)).min(1.0);
    let (x, y) = (opacity(first, &shapes[0]), opacity(second, &shapes[1]));
    let z = opacity(first + second, &shapes[2]);
    let [a, b, both] = [Seen::of(&shapes[0]), Seen::of(&shapes[1]), Seen::of(&shapes[2])];
    let across = |[x, y, z]: [f64; 3]| [[y, z], [x, z], [x, y]];
    let between = across(apart);
    let (from_a, from_b) = (across(apart.map(|v| v * q)), across(apart.map(|v| v * p)));
    let mut sum = 0.0;
    for axis in 0..3 {
        let (aa, bb) = (x * x * a[axis].square(), y * y * b[axis].square());
        let ab = x * y * a[axis].product(&b[axis], between[axis]);
        // Both lose what sets their colour apart from the mean: q and p of the difference, of opposite sign.
        sum += colours * (q * q * aa - 2.0 * p * q * ab + p * p * bb);
        let am = x * z * a[axis].product(&both[axis], from_a[axis]);
        let bm = y * z * b[axis].product(&both[axis], from_b[axis]);
        sum += COVERAGE * (aa + bb + z * z * both[axis].square() + 2.0 * (ab - am - bm));
    }
    sum.max(0.0)
}

/// The covariance of Gaussian `i` at frame `t`.
fn shape_at(epoch: &Epoch, i: usize, t: usize) -> Covariance {
    let (n, a) = (epoch.count(), epoch.attributes());
    shape::of_axes(a.log_scales.frame(t, n)[i], a.rotations.frame(t, n)[i])
}

/// The mass of Gaussian `i` at frame `t`.
pub(super) fn mass(epoch: &Epoch, i: usize, t: usize) -> f64 {
    let logit = f64::from(epoch.attributes().opacity_logits.frame(t, epoch.count())[i]);
    shape::area(&shape_at(epoch, i, t)) / (1.0 + (-logit).exp())
}

/// The natural log of how many times wider Gaussian `i` is at frame `t` than at frame `first`.
pub(super) fn growth(epoch: &Epoch, i: usize, first: usize, t: usize) -> f64 {
    let logs = |t: usize| epoch.attributes().log_scales.frame(t, epoch.count())[i];
    let (then, now) = (logs(first), logs(t));
    (0..3).map(|axis| f64::from(now[axis]) - f64::from(then[axis])).sum::<f64>() / 3.0
}
