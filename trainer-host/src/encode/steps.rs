//! How finely to quantise: steps per attribute class, and how levels nest.

use codec_core::{
    quant::{Class, Quantiser},
    wire::manifest::Quant,
};

use super::EncodeError;
use crate::scene::Epoch;

/// Fineness of the quantisers at the last level, per attribute.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Quality {
    /// Position step, in units of the median Gaussian's size, the geometric mean of its axes.
    pub position: f32,
    /// Log-scale step.
    pub scale: f32,
    /// Rotation step, modified Rodrigues parameters (a quarter of the angle in radians).
    pub rotation: f32,
    /// Opacity step, linear.
    pub opacity: f32,
    /// Band-0 colour step (0.0139 is one 8-bit display step).
    pub sh0: f32,
    /// Step of the higher bands.
    pub sh_rest: f32,
    /// Steps of motion coefficients relative to those at which an error in them weighs as much as one
    /// in the canonical values.
    pub motion: f32,
}

impl Default for Quality {
    /// Visually lossless: about one 8-bit step of colour, a twentieth of a standard deviation.
    fn default() -> Self {
        Self {
            position: 0.05,
            scale: 0.03,
            rotation: 0.0115,
            opacity: 0.006,
            sh0: 0.014,
            sh_rest: 0.02,
            motion: 2.0,
        }
    }
}

impl Quality {
    /// All steps times `factor`.
    #[must_use]
    pub fn scaled(self, factor: f32) -> Self {
        Self {
            position: self.position * factor,
            scale: self.scale * factor,
            rotation: self.rotation * factor,
            opacity: self.opacity * factor,
            sh0: self.sh0 * factor,
            sh_rest: self.sh_rest * factor,
            motion: self.motion,
        }
    }
}

/// Position step and origin of an epoch.
pub(super) struct Grid {
    /// Centre of the bounding box of all positions.
    pub origin: [f32; 3],
    /// Finest position step, scene units.
    pub step: f32,
}

/// An axis counts as no shorter than the longest over 20, a difference of log-scales: flat Gaussians are
/// rarely seen from the edge, so what they lack in thickness does not make errors of position show.
const FLATTEST: f32 = 2.995_732_3;

/// Indices at the base level must fit i16 with room for differences.
const BASE_INDEX_SPAN: f32 = 30_000.0;

impl Grid {
    /// The grid of `epoch`: fine enough for `quality`, coarse enough for i16 at a base step of
    /// `base_ratio` fine ones.
    pub fn of(epoch: &Epoch, quality: &Quality, base_ratio: f32) -> Self {
        let n = epoch.count();
        let a = epoch.attributes();
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for p in a.positions.frame(0, n) {
            for d in 0..3 {
                low[d] = low[d].min(p[d]);
                high[d] = high[d].max(p[d]);
            }
        }
        if n == 0 {
            return Self { origin: [0.0; 3], step: 1.0 };
        }
        let mean = |s: &[f32; 3]| {
            let least = s[0].max(s[1]).max(s[2]) - FLATTEST;
            s.iter().map(|s| s.max(least)).sum::<f32>() / 3.0
        };
        let mut sizes: Vec<f32> = a.log_scales.frame(0, n).iter().map(mean).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        let size = sizes[n / 2].exp();
        let extent = (0..3).map(|d| high[d] - low[d]).fold(0.0f32, f32::max);
        let least = (extent / (BASE_INDEX_SPAN * base_ratio)).max(1e-7);
        let origin = [0, 1, 2].map(|d| low[d] + (high[d] - low[d]) * 0.5);
        // The ladder is for what differs between epochs; the caller's coarseness moves all rungs alike,
        // so that rate control finds no stairs.
        let usual = Quality::default().position;
        let step = ladder(usual * size) * (quality.position / usual);
        Self { origin, step: step.max(ladder(least * 1.2)) }
    }
}

/// `step` on a coarse ladder, so that epochs of like size share a quantisation profile.
fn ladder(step: f32) -> f32 {
    ((step.log2() * 2.0).round() * 0.5).exp2()
}

/// Ratios of the three refinements of `dgs1`: thirds, so that cells nest about their centres.
const THIRDS: [u8; 3] = [3, 3, 3];

/// Base position step over finest.
pub(super) const DGS1_BASE_RATIO: f32 = 27.0;

/// The `dgs1` quantisation profile for `quality` on a grid of `position_step`.
/// `frames` are those of the epoch; `predicted` says per canonical class, then per moving class, whether differences are coded,
/// `mixed` per canonical class whether triples are mixed.
pub(super) fn dgs1(
    quality: &Quality,
    position_step: f32,
    frames: usize,
    predicted: &[bool; Class::COUNT + Class::MOVING],
    mixed: &[bool; Class::COUNT],
) -> Result<Quant, EncodeError> {
    let step = |class: Class| match class {
        Class::Position => position_step,
        Class::Scale => quality.scale,
        Class::Rotation => quality.rotation,
        Class::Opacity => quality.opacity,
        Class::Sh0 => quality.sh0,
        Class::Sh1 | Class::Sh2 | Class::Sh3 => quality.sh_rest,
    };
    let first = Quantiser::new(position_step, THIRDS, false)?;
    let mut quant = Quant { canonical: [first; Class::COUNT], motion: [first; Class::MOVING] };
    for (class, target) in Class::ALL.into_iter().zip(&mut quant.canonical) {
        let quantiser = Quantiser::new(step(class), THIRDS, predicted[class.index()])?;
        *target = quantiser.with_mixed(mixed[class.index()]);
    }
    // An error of a canonical value shows on every frame, one of an orthonormal coefficient is spread
    // over its window: at equal slope of rate against distortion their steps differ by the root of
    // the number of frames.
    let spread = ladder((frames as f32).sqrt());
    for (class, target) in Class::ALL.into_iter().zip(&mut quant.motion) {
        let ratio = [1, THIRDS[1], THIRDS[2]];
        let predicted = predicted[Class::COUNT + class.index()];
        // Relative rotations are in half-angle units, twice the Rodrigues parameters.
        let unit = if class == Class::Rotation { 2.0 } else { 1.0 };
        *target = Quantiser::new(step(class) * unit * spread * quality.motion, ratio, predicted)?;
    }
    Ok(quant)
}

/// The `paper` quantisation profile: sixteenths from plane to plane, i16 everywhere.
pub(super) fn paper(quality: &Quality, position_step: f32) -> Result<Quant, EncodeError> {
    let planes = [8, 4, 4];
    let flat = [1, 1, 1];
    let rest = Quantiser::new(quality.sh_rest, flat, false)?;
    let mut quant = Quant { canonical: [rest; Class::COUNT], motion: [rest; Class::MOVING] };
    quant.canonical[Class::Position.index()] = Quantiser::new(position_step, flat, false)?;
    for (class, step) in [
        (Class::Scale, quality.scale),
        (Class::Rotation, quality.rotation * 2.0),
        (Class::Opacity, quality.opacity),
        (Class::Sh0, quality.sh0),
    ] {
        quant.canonical[class.index()] = Quantiser::new(step, planes, false)?;
    }
    // q at level 1, δ2 and δ3 at levels 2 and 3.
    quant.motion[Class::Position.index()] = Quantiser::new(position_step, [1, 2, 8], false)?;
    Ok(quant)
}
