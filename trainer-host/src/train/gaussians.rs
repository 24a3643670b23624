//! Holds the Gaussians that are trained, attribute by attribute, at the canonical instant.

use codec_core::{Gaussian, ShDegree};
use glam::Vec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    motion::{FOLLOWED, PosedGradient, Skinned},
    parameter::{AdamStep, Parameter},
};
use crate::scene::{
    Instant,
    activation::{self, sigmoid},
};

/// Gaussians that one task poses.
const CHUNK: usize = 1024;

/// Attributes of N Gaussians in the domains that gradients are taken in.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct TrainedGaussians {
    /// Scene units.
    pub(super) position: Parameter,
    /// Natural logarithms of the standard deviations.
    pub(super) log_scale: Parameter,
    /// Quaternions wxyz, not normalised.
    pub(super) rotation: Parameter,
    /// Logits.
    pub(super) opacity: Parameter,
    /// Band 0 of the harmonics.
    pub(super) sh0: Parameter,
    /// Higher bands, laid out as in [`Instant`].
    pub(super) sh_rest: Parameter,
    /// Corrections of the weights of the nodes that each follows.
    pub(super) skin: Parameter,
    /// Degree of `sh_rest`.
    pub(super) degree: u8,
    /// Steps of the training before each higher band began.
    begun: [u32; 3],
}

/// A rate per attribute, for one step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct AttributeRates {
    pub(super) position: f32,
    pub(super) log_scale: f32,
    pub(super) rotation: f32,
    pub(super) opacity: f32,
    pub(super) sh0: f32,
    pub(super) sh_rest: f32,
    pub(super) skin: f32,
}

impl AttributeRates {
    /// All rates times `factor`.
    pub(super) fn scaled(self, factor: f32) -> Self {
        let Self { position, log_scale, rotation, opacity, sh0, sh_rest, skin } = self;
        let scaled = [position, log_scale, rotation, opacity, sh0, sh_rest, skin].map(|rate| factor * rate);
        let [position, log_scale, rotation, opacity, sh0, sh_rest, skin] = scaled;
        Self { position, log_scale, rotation, opacity, sh0, sh_rest, skin }
    }
}

impl TrainedGaussians {
    /// From the Gaussians of an instant, with harmonics of degree `degree` (those that are not there are 0).
    pub(super) fn new(instant: &Instant, degree: ShDegree) -> Self {
        let gaussians = &instant.gaussians;
        let count = gaussians.len();
        let floor = |v: f32| v.max(1e-12).ln();
        let logit = |o: f32| activation::logit(o.clamp(1e-4, 1.0 - 1e-4));
        let (width, given) = (degree.rest_len(), instant.sh_degree.rest_len());
        let mut sh_rest = vec![0.0; width * count];
        if width > 0 && given > 0 {
            let from = instant.sh_rest.chunks_exact(given);
            for (to, from) in sh_rest.chunks_exact_mut(width).zip(from) {
                to.iter_mut().zip(from).for_each(|(to, from)| *to = *from);
            }
        }
        Self {
            position: Parameter::new(3, gaussians.iter().flat_map(|g| g.position).collect()),
            log_scale: Parameter::new(3, gaussians.iter().flat_map(|g| g.scale.map(floor)).collect()),
            rotation: Parameter::new(4, gaussians.iter().flat_map(|g| g.rotation).collect()),
            opacity: Parameter::new(1, gaussians.iter().map(|g| logit(g.opacity)).collect()),
            sh0: Parameter::new(3, gaussians.iter().flat_map(|g| g.sh0).collect()),
            sh_rest: Parameter::new(width, sh_rest),
            skin: Parameter::new(FOLLOWED, vec![0.0; FOLLOWED * count]),
            degree: degree.get(),
            begun: [0; 3],
        }
    }

    /// Begins the bands up to `degree` that are not there, at 0 and with nothing remembered of them, after
    /// `steps` steps of the training. Returns whether there were any.
    pub(super) fn begin_bands(&mut self, degree: ShDegree, steps: u32) -> bool {
        let begins = self.degree < degree.get();
        if begins {
            self.begun[usize::from(self.degree)..usize::from(degree.get())].fill(steps);
            self.sh_rest.widen(degree.rest_len(), self.len());
            self.degree = degree.get();
        }
        begins
    }

    pub(super) fn len(&self) -> usize {
        self.position.items()
    }

    pub(super) fn positions(&self) -> &[[f32; 3]] {
        self.position.values().as_chunks().0
    }

    /// Opacity, 0 to 1.
    pub(super) fn opacity(&self, index: usize) -> f32 {
        sigmoid(self.opacity.item(index)[0])
    }

    fn skin_logits(&self) -> &[[f32; FOLLOWED]] {
        self.skin.values().as_chunks().0
    }

    pub(super) fn rotations(&self) -> &[[f32; 4]] {
        self.rotation.values().as_chunks().0
    }

    /// What of Gaussian `index` takes part in its motion.
    pub(super) fn rest<'a>(
        &'a self,
        index: usize,
        followed: &'a [Option<[u32; FOLLOWED]>],
    ) -> super::motion::Rest<'a> {
        super::motion::Rest {
            position: Vec3::from_array(self.positions()[index]),
            rotation: self.rotations()[index],
            followed: followed[index].as_ref(),
            logits: &self.skin_logits()[index],
        }
    }

    /// What a Gaussian follows, by the weights it has learnt.
    pub(super) fn follows(
        &self,
        index: usize,
        skinned: &Skinned,
        followed: &[Option<[u32; FOLLOWED]>],
    ) -> super::motion::Followed {
        let weights = skinned.weights(&self.rest(index, followed));
        super::motion::Followed { nodes: followed[index].unwrap_or_default(), weights }
    }

    /// All Gaussians as `skinned` moves them, into `out`.
    pub(super) fn pose_into(
        &self,
        skinned: &Skinned,
        followed: &[Option<[u32; FOLLOWED]>],
        out: &mut Instant,
    ) {
        out.gaussians.resize(self.len(), Gaussian::ABSENT);
        out.gaussians.par_iter_mut().with_min_len(CHUNK).enumerate().for_each(|(index, out)| {
            let posed = skinned.pose(&self.rest(index, followed));
            let (scale, sh0) = (self.log_scale.item(index), self.sh0.item(index));
            *out = Gaussian {
                position: posed.position.to_array(),
                scale: [scale[0].exp(), scale[1].exp(), scale[2].exp()],
                rotation: posed.rotation,
                opacity: self.opacity(index),
                sh0: [sh0[0], sh0[1], sh0[2]],
            };
        });
        out.sh_rest.clear();
        out.sh_rest.extend_from_slice(self.sh_rest.values());
        out.sh_degree = ShDegree::new(self.degree).unwrap_or_default();
    }

    /// Writes the gradients of all attributes from those of the posed Gaussians; returns what the nodes get.
    pub(super) fn backward(
        &mut self,
        skinned: &Skinned,
        followed: &[Option<[u32; FOLLOWED]>],
        splats: &[render_host::adjoint::SplatGradient],
        sh_rest: &[f32],
    ) -> Vec<super::motion::NodeGradient> {
        let mut moved = vec![super::motion::SkinnedGradient::default(); self.len()];
        let this = &*self;
        let nodes = skinned.backward_all(&mut moved, |index, out, nodes| {
            let splat = &splats[index];
            if splat.position == [0.0; 3] && splat.rotation == [0.0; 4] {
                return;
            }
            let gradient =
                PosedGradient { position: Vec3::from_array(splat.position), rotation: splat.rotation };
            *out = skinned.backward(&this.rest(index, followed), &gradient, nodes);
        });
        let fill = |to: &mut Parameter, from: &mut dyn FnMut(usize, &mut [f32])| {
            let width = to.width().max(1);
            to.gradient_mut().chunks_exact_mut(width).enumerate().for_each(|(i, to)| from(i, to));
        };
        fill(&mut self.position, &mut |i, to| to.copy_from_slice(&moved[i].position.to_array()));
        fill(&mut self.rotation, &mut |i, to| to.copy_from_slice(&moved[i].rotation));
        fill(&mut self.skin, &mut |i, to| to.copy_from_slice(&moved[i].logits));
        fill(&mut self.log_scale, &mut |i, to| to.copy_from_slice(&splats[i].log_scale));
        fill(&mut self.opacity, &mut |i, to| to[0] = splats[i].opacity_logit);
        fill(&mut self.sh0, &mut |i, to| to.copy_from_slice(&splats[i].sh0));
        self.sh_rest.gradient_mut().copy_from_slice(sh_rest);
        nodes
    }

    /// Adds these to the gradients of positions before motion, by index.
    pub(super) fn add_position_gradients(&mut self, by_index: &[(usize, [f32; 3])]) {
        let gradient = self.position.gradient_mut();
        for (index, slope) in by_index {
            gradient[3 * index..].iter_mut().zip(slope).for_each(|(sum, v)| *sum += v);
        }
    }

    /// Adds the gradients of `opacity_weight · mean opacity + scale_weight · mean scale`, scales in units of
    /// `unit`, scene units: what is not needed fades and shrinks (Kheradmand et al. 2024, section 3.4).
    pub(super) fn regularise(&mut self, opacity_weight: f32, scale_weight: f32, unit: f32) {
        let count = self.len().max(1) as f32;
        if opacity_weight > 0.0 {
            let (values, gradient) = self.opacity.values_and_gradient();
            for (value, gradient) in values.iter().zip(gradient) {
                let opacity = sigmoid(*value);
                *gradient += opacity_weight / count * opacity * (1.0 - opacity);
            }
        }
        if scale_weight > 0.0 {
            let (values, gradient) = self.log_scale.values_and_gradient();
            for (value, gradient) in values.iter().zip(gradient) {
                *gradient += scale_weight / (3.0 * count) * (value.exp() / unit);
            }
        }
    }

    /// Takes a step of every attribute.
    pub(super) fn step(&mut self, rates: AttributeRates, step: AdamStep) {
        let at = |rate: f32| AdamStep { rate, ..step };
        self.position.step(at(rates.position));
        self.log_scale.step(at(rates.log_scale));
        self.rotation.step(at(rates.rotation));
        self.opacity.step(at(rates.opacity));
        self.sh0.step(at(rates.sh0));
        if rates.sh_rest > 0.0 {
            self.step_bands(at(rates.sh_rest));
        }
        self.skin.step(at(rates.skin));
    }

    /// Takes a step of the higher bands, each of which counts its own: as steps of the training, the first of
    /// a late band would be several times too long.
    fn step_bands(&mut self, step: AdamStep) {
        if self.begun == [0; 3] {
            return self.sh_rest.step(step);
        }
        let of_band = |(below, &begun): (usize, &u32)| {
            std::iter::repeat_n(step.number.saturating_sub(begun).max(1), 3 * (2 * below + 3))
        };
        let numbers = self.begun.iter().enumerate().flat_map(of_band).take(self.sh_rest.width());
        self.sh_rest.step_numbered(step, &numbers.collect::<Vec<u32>>());
    }

    /// Keeps the Gaussians of these indices; see [`Parameter::select`].
    pub(super) fn select(&mut self, indices: &[usize], fresh: usize) {
        for parameter in self.parameters_mut() {
            parameter.select(indices, fresh);
        }
    }

    /// Every attribute.
    pub(super) fn parameters(&self) -> [&Parameter; 7] {
        let Self { position, log_scale, rotation, opacity, sh0, sh_rest, skin, .. } = self;
        [position, log_scale, rotation, opacity, sh0, sh_rest, skin]
    }

    /// Every attribute, to be changed from outside a step.
    pub(super) fn parameters_mut(&mut self) -> [&mut Parameter; 7] {
        let Self { position, log_scale, rotation, opacity, sh0, sh_rest, skin, .. } = self;
        [position, log_scale, rotation, opacity, sh0, sh_rest, skin]
    }

    /// Whether what was read from a file can be used.
    pub(super) fn is_sound(&self) -> bool {
        let count = self.len();
        let Some(degree) = ShDegree::new(self.degree) else { return false };
        let widths = [3, 3, 4, 1, 3, degree.rest_len(), FOLLOWED];
        self.parameters().iter().zip(widths).all(|(part, width)| part.is_sound(width, count))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scene_of_another_size_is_shrunk_as_much() {
        let gradient = |unit: f32| {
            let gaussian = Gaussian { scale: [0.1, 0.2, 0.4].map(|scale| unit * scale), ..Gaussian::ABSENT };
            let instant = Instant { gaussians: vec![gaussian; 4], ..Instant::default() };
            let mut gaussians = TrainedGaussians::new(&instant, ShDegree::ZERO);
            gaussians.regularise(0.0, 0.3, unit);
            let gradient: [f32; 3] = std::array::from_fn(|axis| gaussians.log_scale.gradient_mut()[axis]);
            gradient
        };
        let of = |unit: f32, expected: f32, axis: usize| (gradient(unit)[axis] / expected - 1.0).abs() < 1e-4;
        for unit in [0.02, 1.0, 50.0] {
            // A twelfth of the weight, times the scale in extents.
            let expected = [0.0025, 0.005, 0.01];
            assert!((0..3).all(|axis| of(unit, expected[axis], axis)), "{unit}: {:?}", gradient(unit));
        }
    }
}
