//! Writes groups as Gaussians over all frames.

use nalgebra::{Quaternion, UnitQuaternion};

use super::{
    nodes::{self, Nodes},
    shape,
};
use crate::scene::{Attributes, Epoch, SceneError, Track};

/// An epoch of a Gaussian for each of `groups`, of which Gaussian `i` of `epoch` belongs to `parts[i]`.
pub(super) fn of_groups(
    epoch: &Epoch,
    nodes: &Nodes<'_>,
    groups: &[u32],
    parts: &[u32],
) -> Result<Epoch, SceneError> {
    Groups::new(epoch, nodes, groups, parts).written()
}

/// Groups in the order in which they are written.
struct Groups<'a> {
    epoch: &'a Epoch,
    nodes: &'a Nodes<'a>,
    groups: &'a [u32],
    /// Of each Gaussian: the place of its group in that order.
    places: Vec<u32>,
    /// Of each group: whether it has one member only.
    alone: Vec<bool>,
    /// Of each group: log scales and rotation at the first frame.
    axes: Vec<([f32; 3], [f32; 4])>,
}

impl<'a> Groups<'a> {
    fn new(epoch: &'a Epoch, nodes: &'a Nodes<'a>, groups: &'a [u32], parts: &[u32]) -> Self {
        let mut of_group = vec![0u32; parts.len()];
        for (place, &group) in groups.iter().enumerate() {
            of_group[group as usize] = place as u32;
        }
        let places: Vec<u32> = parts.iter().map(|&part| of_group[part as usize]).collect();
        let mut members = vec![0u32; groups.len()];
        places.iter().for_each(|&place| members[place as usize] += 1);
        let alone = members.iter().map(|&members| members == 1).collect();
        let axes = groups.iter().map(|&group| shape::axes(nodes.shape(group as usize))).collect();
        Self { epoch, nodes, groups, places, alone, axes }
    }

    fn written(&self) -> Result<Epoch, SceneError> {
        let (n, a) = (self.epoch.count(), self.epoch.attributes());
        let points = |track: &Track<[f32; 3]>| {
            self.track(
                track,
                |t| self.means(|i| track.frame(t, n)[i].map(f64::from)),
                |_, _, mean: [f64; 3]| mean.map(|v| v as f32),
            )
        };
        let first = self.nodes.first_frame();
        let rest = self.groups.iter().flat_map(|&group| self.nodes.rest(group as usize)).copied().collect();
        let attributes = Attributes {
            positions: points(&a.positions),
            sh0: points(&a.sh0),
            rotations: self.track(
                &a.rotations,
                |t| (0..self.groups.len()).map(|place| self.rotation(place, t)).collect(),
                |_, _, rotation| rotation,
            ),
            log_scales: self.track(
                &a.log_scales,
                |t| self.means(|i| [nodes::growth(self.epoch, i, first, t)]),
                |_, place, [growth]| self.axes[place].0.map(|log| log + growth as f32),
            ),
            opacity_logits: self.opacities(),
            sh_rest: rest,
            sh_degree: a.sh_degree,
        };
        Epoch::new(self.epoch.frames(), attributes)
    }

    /// What `track` becomes: of what is alone, its own values; else what `finished` makes of a frame, a place
    /// and the value of that place among `values` of the frame.
    fn track<T: Copy + PartialEq, V: Copy>(
        &self,
        track: &Track<T>,
        values: impl Fn(usize) -> Vec<V>,
        finished: impl Fn(usize, usize, V) -> T,
    ) -> Track<T> {
        let (n, constant) = (self.epoch.count(), matches!(track, Track::Constant(_)));
        let mut out = Vec::new();
        for t in if constant { 0..1 } else { 0..self.epoch.frames() } {
            let own = track.frame(t, n);
            let each = values(t).into_iter().enumerate();
            out.extend(each.map(|(place, value)| match self.alone[place] {
                true => own[self.groups[place] as usize],
                false => finished(t, place, value),
            }));
        }
        if constant { Track::Constant(out) } else { Track::PerFrame(out) }
    }

    /// Of each group: the mean of its members' values.
    fn means<const N: usize>(&self, value: impl Fn(usize) -> [f64; N]) -> Vec<[f64; N]> {
        let mut means = vec![[0.0; N]; self.groups.len()];
        for (i, &place) in self.places.iter().enumerate() {
            let share = self.nodes.share(i, self.groups[place as usize] as usize);
            let mean = &mut means[place as usize];
            mean.iter_mut().zip(value(i)).for_each(|(mean, value)| *mean += share * value);
        }
        means
    }

    /// The rotation of a group at frame `t`: it turns as its leader does.
    fn rotation(&self, place: usize, t: usize) -> [f32; 4] {
        let (n, rotations) = (self.epoch.count(), &self.epoch.attributes().rotations);
        let leader = self.nodes.leader(self.groups[place] as usize);
        let unit = |[w, x, y, z]: [f32; 4]| {
            UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z).cast::<f64>())
        };
        let of_leader = |t: usize| unit(rotations.frame(t, n)[leader]);
        let q = of_leader(t) * of_leader(self.nodes.first_frame()).inverse() * unit(self.axes[place].1);
        [q.w, q.i, q.j, q.k].map(|v| v as f32)
    }

    fn opacities(&self) -> Track<f32> {
        let track = &self.epoch.attributes().opacity_logits;
        let sums = |t: usize| {
            let mut sums = vec![(0.0, 0.0); self.groups.len()];
            for (i, &place) in self.places.iter().enumerate() {
                let (mass, growth) = &mut sums[place as usize];
                let group = self.groups[place as usize] as usize;
                *mass += nodes::mass(self.epoch, i, t);
                *growth +=
                    self.nodes.share(i, group) * nodes::growth(self.epoch, i, self.nodes.first_frame(), t);
            }
            sums
        };
        // Where opacities stay, what was clamped on the way counts.
        let still = matches!(track, Track::Constant(_));
        let masses = |t: usize| match still {
            true => self.groups.iter().map(|&group| (self.nodes.mass(group as usize), 0.0)).collect(),
            false => sums(t),
        };
        self.track(track, masses, |_, place, (mass, growth): (f64, f64)| {
            let area = shape::area(self.nodes.shape(self.groups[place] as usize)) * (2.0 * growth).exp();
            let opacity = (mass / area.max(f64::MIN_POSITIVE)).min(1.0);
            // Infinite logits are brought into range with all others.
            (opacity / (1.0 - opacity)).ln() as f32
        })
    }
}
