//! Shows a scene under training as the encoder rounds it, and prices its values.
//!
//! Rounding is passed straight through: pictures are of rounded values, and their gradients go to the values
//! themselves (Bengio et al. 2013). What values cost is [`price`](super::price)'s.

use codec_core::internals::math::quat_mul;
use glam::Vec3;
use rayon::prelude::*;

use super::{
    super::{
        gaussians::TrainedGaussians,
        model::Model,
        parameter::Parameter,
        rotation::{Quaternion, conjugate, dot, matrix},
    },
    price::{self, Bits, Slopes},
};
use crate::{
    encode::{
        Decisions, EncodeError,
        rounding::{CanonicalValues, Rounding},
    },
    scene::activation::logit,
};

/// Gaussians that one task rounds.
const CHUNK: usize = 1024;
/// Rounded opacities stay within this, so that their logits are finite.
const OPACITIES: (f32, f32) = (1e-4, 1.0 - 1e-4);

/// A scene's rounding.
#[derive(Debug)]
pub(super) struct Coding {
    rounding: Rounding,
}

/// A Gaussian at the first frame, whose values are sent.
struct Start {
    values: CanonicalValues,
    /// How its nodes have turned it since the canonical instant.
    turn: Quaternion,
    /// Length of its quaternion.
    length: f32,
}

impl Coding {
    /// Of a scene of `gaussians` Gaussians encoded by `decisions`; none in a profile without nested
    /// quantisers.
    ///
    /// # Errors
    /// Quantisers out of range.
    pub(super) fn of(decisions: &Decisions, gaussians: usize) -> Result<Option<Self>, EncodeError> {
        let Decisions::Dgs1(decisions) = decisions else { return Ok(None) };
        let Some(epoch) = decisions.epochs.first() else { return Ok(None) };
        Ok(Some(Self { rounding: Rounding::of(decisions, epoch, gaussians)? }))
    }

    /// The Gaussians of `model` at the first frame.
    fn starts(model: &Model) -> Vec<Start> {
        let poses = model.nodes.poses(0.0);
        let skinned = model.nodes.skin(&poses);
        let g = &model.gaussians;
        let start = |index: usize| {
            let posed = skinned.pose(&g.rest(index, &model.followed));
            let rest = g.rotations()[index];
            let length = dot(rest, rest).sqrt().max(1e-12);
            let rotation = unit(posed.rotation);
            let (scale, sh0) = (g.log_scale.item(index), g.sh0.item(index));
            let values = CanonicalValues {
                position: posed.position.to_array(),
                rotation,
                log_scale: [scale[0], scale[1], scale[2]],
                opacity: g.opacity(index),
                sh0: [sh0[0], sh0[1], sh0[2]],
            };
            Start { values, turn: quat_mul(rotation, conjugate(rest.map(|v| v / length))), length }
        };
        (0..g.len()).into_par_iter().with_min_len(CHUNK).map(start).collect()
    }

    /// Writes the Gaussians of `model` to `out` as a receiver has them, back at the canonical instant.
    pub(super) fn round(&self, model: &Model, out: &mut TrainedGaussians) {
        let (g, width) = (&model.gaussians, model.gaussians.sh_rest.width());
        if out.len() != g.len() || out.degree != g.degree {
            out.clone_from(g);
        }
        out.skin.values_mut().copy_from_slice(g.skin.values());
        out.sh_rest.values_mut().copy_from_slice(g.sh_rest.values());
        if width > 0 {
            let rest = out.sh_rest.values_mut().par_chunks_mut(width).with_min_len(CHUNK).enumerate();
            rest.for_each(|(index, rest)| {
                if let Some((quant, degree)) = self.rounding.quantisers(index) {
                    self.rounding.round_rest(quant, degree, rest);
                }
            });
        }
        let rounded = |(index, Start { values, turn, length }): (usize, Start)| {
            let rounded = match self.rounding.quantisers(index) {
                Some((quant, _)) => self.rounding.rounded(quant, &values),
                None => values,
            };
            let moved = Vec3::from_array(rounded.position) - Vec3::from_array(values.position);
            let position = Vec3::from_slice(g.position.item(index)) + matrix(turn).transpose() * moved;
            let rotation = quat_mul(conjugate(turn), unit(rounded.rotation)).map(|v| length * v);
            let opacity = rounded.opacity.clamp(OPACITIES.0, OPACITIES.1);
            (CanonicalValues { position: position.to_array(), rotation, ..rounded }, logit(opacity))
        };
        let starts = Self::starts(model).into_par_iter().with_min_len(CHUNK).enumerate();
        let all: Vec<(CanonicalValues, f32)> = starts.map(rounded).collect();
        for (index, (rounded, logit)) in all.iter().enumerate() {
            out.position.item_mut(index).copy_from_slice(&rounded.position);
            out.rotation.item_mut(index).copy_from_slice(&rounded.rotation);
            out.log_scale.item_mut(index).copy_from_slice(&rounded.log_scale);
            out.opacity.item_mut(index)[0] = *logit;
            out.sh0.item_mut(index).copy_from_slice(&rounded.sh0);
        }
    }

    /// Bits of the canonical values of `model`, by class of attributes.
    pub(super) fn bits(&self, model: &Model) -> Bits {
        self.price(model).1
    }

    /// As [`Coding::bits`]; adds `weight` times their slopes to the gradients of the Gaussians.
    pub(super) fn add_slopes(&self, model: &mut Model, weight: f32) {
        let (priced, _) = self.price(model);
        for (block, slopes) in self.rounding.blocks().zip(priced) {
            for (&i, slopes) in block.iter().zip(slopes) {
                add(&mut model.gaussians, i as usize, &slopes, weight);
            }
        }
    }

    /// Slopes of each Gaussian of each block, and bits in all.
    fn price(&self, model: &Model) -> (Vec<Vec<Slopes>>, Bits) {
        let starts = Self::starts(model);
        let rest = &model.gaussians.sh_rest;
        let blocks: Vec<&[u32]> = self.rounding.blocks().collect();
        let of_block = |block: &&[u32]| {
            let Some((quant, degree)) = block.first().and_then(|&i| self.rounding.quantisers(i as usize))
            else {
                return (Vec::new(), Bits::default());
            };
            let values = block.iter().map(|&i| &starts[i as usize].values);
            let bands = block.iter().map(|&i| rest.item(i as usize));
            price::block(&self.rounding, quant, degree, values, bands)
        };
        let priced: Vec<(Vec<Slopes>, Bits)> = blocks.par_iter().map(of_block).collect();
        let mut bits = Bits::default();
        for (_, block) in &priced {
            bits.iter_mut().zip(block).for_each(|(sum, v)| *sum += v);
        }
        (priced.into_iter().map(|(slopes, _)| slopes).collect(), bits)
    }
}

/// Adds `weight` times `slopes` to the gradient of Gaussian `index`.
fn add(g: &mut TrainedGaussians, index: usize, slopes: &Slopes, weight: f32) {
    let one = |to: &mut Parameter, from: &[f32]| {
        let width = to.width();
        let gradient = &mut to.gradient_mut()[index * width..][..width];
        gradient.iter_mut().zip(from).for_each(|(sum, slope)| *sum += weight * slope);
    };
    one(&mut g.log_scale, &slopes.log_scale);
    one(&mut g.opacity, &[slopes.opacity]);
    one(&mut g.sh0, &slopes.sh0);
    one(&mut g.sh_rest, &slopes.rest);
}

fn unit(q: Quaternion) -> Quaternion {
    let length = dot(q, q).sqrt().max(1e-12);
    q.map(|v| v / length)
}
