//! Says how finely to quantise: steps per attribute class, and how levels nest.

use codec_core::internals::{
    quant::{Class, Quantiser},
    wire::manifest::Quant,
};

use super::{EncodeError, sensitivity};
use crate::scene::Epoch;

/// Fineness of the quantisers at the last level, per attribute.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct QuantiserSteps {
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

impl Default for QuantiserSteps {
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

impl QuantiserSteps {
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

    /// The step of each class of [`sensitivity`] times its factor; a factor above 1 leads up to
    /// [`LINEAR`] only.
    #[must_use]
    pub(super) fn times(mut self, factors: &Factors) -> Self {
        for ((step, factor), most) in self.steps().into_iter().zip(factors).zip(LINEAR) {
            *step = (*step * factor).min(step.max(most));
        }
        self
    }

    /// The step of `class`; of positions in units of the median size.
    const fn of(&self, class: Class) -> f32 {
        match class {
            Class::Position => self.position,
            Class::Scale => self.scale,
            Class::Rotation => self.rotation,
            Class::Opacity => self.opacity,
            Class::Sh0 => self.sh0,
            Class::Sh1 | Class::Sh2 | Class::Sh3 => self.sh_rest,
        }
    }

    /// The steps, by class of [`sensitivity`].
    pub(super) const fn steps(&mut self) -> [&mut f32; sensitivity::CLASSES] {
        let Self { position, scale, rotation, opacity, sh0, sh_rest, .. } = self;
        [position, scale, rotation, opacity, sh0, sh_rest]
    }
}

/// Steps beyond which the error of a picture does not follow those of the values: about a Gaussian's size,
/// half of it in scale, a radian, a third of opacity and a sixth of a display's range, by class of
/// [`sensitivity`].
const LINEAR: Factors = [1.0, 0.6, 0.25, 0.3, 0.6, 0.6];

/// Factors on steps, by class of [`sensitivity`].
pub(super) type Factors = [f32; sensitivity::CLASSES];

/// What positions of an epoch are counted in.
pub(super) struct Grid {
    /// Centre of the bounding box of all positions.
    pub origin: [f32; 3],
    /// Step at the usual quality: in proportion to the median Gaussian's size, on a coarse ladder.
    /// Invariant: at least `least`.
    usual: f32,
    /// Least step.
    least: f32,
    /// Least step at the base level.
    least_base: f32,
}

/// An axis counts as no shorter than the longest over 20, a difference of log-scales: flat Gaussians are
/// rarely seen from the edge, so what they lack in thickness does not make errors of position show.
const FLATTEST: f32 = 2.995_732_3;

/// Indices at the base level must fit i16 with room for differences.
const BASE_INDEX_SPAN: f32 = 30_000.0;

impl Grid {
    /// The grid of `epoch`, with steps coarse enough for i16 at a base step of `most_ratio` fine ones.
    pub fn of(epoch: &Epoch, most_ratio: f32) -> Self {
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
            return Self { origin: [0.0; 3], usual: 1.0, least: 1.0, least_base: 1.0 };
        }
        let mean = |s: &[f32; 3]| {
            let least = s[0].max(s[1]).max(s[2]) - FLATTEST;
            s.iter().map(|s| s.max(least)).sum::<f32>() / 3.0
        };
        let mut sizes: Vec<f32> = a.log_scales.frame(0, n).iter().map(mean).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        let size = sizes[n / 2].exp();
        let extent = (0..3).map(|d| high[d] - low[d]).fold(0.0f32, f32::max);
        let least_base = extent / BASE_INDEX_SPAN;
        let origin = [0, 1, 2].map(|d| low[d] + (high[d] - low[d]) * 0.5);
        let least = ladder((least_base / most_ratio).max(1e-7) * 1.2);
        Self {
            origin,
            usual: ladder(QuantiserSteps::default().position * size).max(least),
            least,
            least_base,
        }
    }

    /// Finest position step for `quality`, scene units.
    pub fn step(&self, quality: &QuantiserSteps) -> f32 {
        // The ladder is for what differs between epochs; the caller's coarseness moves all rungs alike,
        // so that rate control finds no stairs.
        (self.usual * (quality.position / QuantiserSteps::default().position)).max(self.least)
    }

    /// `usual`, or wider ratios where base indices of a last step of `step` would not fit: a few Gaussians
    /// far from all others make the base coarse, not the whole scene.
    fn ratios(&self, step: f32, usual: [u8; 3]) -> [u8; 3] {
        let needed = self.least_base / step;
        if usual.iter().map(|&ratio| f32::from(ratio)).product::<f32>() >= needed {
            return usual;
        }
        // The least odd number whose cube is enough.
        let each = 2 * (0.5 * (needed.cbrt() - 1.0)).ceil().clamp(1.0, 127.0) as u8 + 1;
        [each; 3]
    }
}

/// `step` on a coarse ladder, so that epochs of like size share a quantisation profile.
fn ladder(step: f32) -> f32 {
    ((step.log2() * 2.0).round() * 0.5).exp2()
}

/// Ratios of the refinements of `dgs1` for a last step `coarser` times the usual one, of at most `most`
/// refinements: thirds, so that cells nest about their centres, and as many as lead back to about the
/// usual base. More would leave the base less than neighbours tell of each other.
fn thirds(coarser: f32, most: u8) -> [u8; 3] {
    let count = (f32::from(most) - coarser.log(3.0)).round().clamp(0.0, f32::from(most)) as u8;
    let first = 3 - most;
    [0, 1, 2].map(|l| if (first..first + count).contains(&l) { 3 } else { 1 })
}

/// Most steps of a position of `dgs1` in one of its base: with indices of the base in i16, those of the last
/// level fit i32.
pub(super) const DGS1_MOST_RATIO: f32 = 60_000.0;

/// The `dgs1` quantisation profile for `quality` on `grid`. `frames` are those of the epoch; `predicted` says
/// per canonical class, then per moving class, whether differences are coded, `decorrelated` per canonical
/// class whether triples are coded as their mean and differences.
pub(super) fn dgs1(
    quality: &QuantiserSteps,
    grid: &Grid,
    frames: usize,
    predicted: &[bool; Class::COUNT + Class::MOVING],
    decorrelated: &[bool; Class::COUNT],
) -> Result<Quant, EncodeError> {
    let position_step = grid.step(quality);
    let step = |class: Class| if class == Class::Position { position_step } else { quality.of(class) };
    let usual = QuantiserSteps::default();
    let coarser = |class: Class| quality.of(class) / usual.of(class);
    let first = Quantiser::new(position_step, [3; 3], false)?;
    let mut quant = Quant { canonical: [first; Class::COUNT], motion: [first; Class::MOVING] };
    for (class, target) in Class::ALL.into_iter().zip(&mut quant.canonical) {
        let thirds = thirds(coarser(class), 3);
        let ratio = if class == Class::Position { grid.ratios(position_step, thirds) } else { thirds };
        let quantiser = Quantiser::new(step(class), ratio, predicted[class.index()])?;
        *target = quantiser.with_decorrelated(decorrelated[class.index()]);
    }
    // An error of a canonical value shows on every frame, one of an orthonormal coefficient is spread
    // over its window: at equal slope of rate against distortion their steps differ by the root of
    // the number of frames.
    let spread = ladder((frames as f32).sqrt());
    for (class, target) in Class::ALL.into_iter().zip(&mut quant.motion) {
        let ratio = thirds(coarser(class), 2);
        let predicted = predicted[Class::COUNT + class.index()];
        // Relative rotations are in half-angle units, twice the Rodrigues parameters.
        let unit = if class == Class::Rotation { 2.0 } else { 1.0 };
        *target = Quantiser::new(step(class) * unit * spread * quality.motion, ratio, predicted)?;
    }
    Ok(quant)
}

/// The `paper` quantisation profile: sixteenths from plane to plane, i16 everywhere.
pub(super) fn paper(quality: &QuantiserSteps, position_step: f32) -> Result<Quant, EncodeError> {
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

#[cfg(test)]
mod tests {
    use codec_core::internals::{gaussian::ShDegree, ids::Level};

    use super::*;
    use crate::{
        encode::{EncodeOptions, encode},
        scene::{Attributes, Scene, Track},
    };

    /// `n` Gaussians of size `size`, in turn at both ends of a scene that is 1000 wide.
    fn wide(n: usize, size: f32) -> Epoch {
        let side = |i: usize| if i.is_multiple_of(2) { -500.0 } else { 500.0 };
        let attributes = Attributes {
            positions: Track::Constant((0..n).map(|i| [side(i), 0.01 * i as f32, side(i / 2)]).collect()),
            rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; n]),
            log_scales: Track::Constant(vec![[size.ln(); 3]; n]),
            opacity_logits: Track::Constant(vec![2.0; n]),
            sh0: Track::Constant(vec![[0.5; 3]; n]),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        };
        Epoch::new(1, attributes).unwrap()
    }

    /// However small Gaussians are in a large scene, and at any coarseness: base indices and their
    /// differences fit, so that no position is clamped.
    #[test]
    fn positions_of_tiny_gaussians_in_wide_scenes_fit() {
        for size in [1e-8, 1e-3, 0.02, 1.0] {
            let epoch = wide(130, size);
            let grid = Grid::of(&epoch, DGS1_MOST_RATIO);
            for coarseness in [0.06, 0.3, 1.0, 1.7, 1.8, 5.1, 5.3, 15.0, 16.0, 64.0] {
                let quality = QuantiserSteps::default().scaled(coarseness);
                let none = [false; Class::COUNT + Class::MOVING];
                let quant = dgs1(&quality, &grid, 1, &none, &[false; Class::COUNT]).unwrap();
                let base = quant.canonical[Class::Position.index()].step(Level::BASE);
                assert!(1000.0 / base < 32_767.0, "size {size}, coarseness {coarseness}: {base}");
                let scene = Scene::new(vec![epoch.clone()], 30.0).unwrap();
                let options = EncodeOptions { quality, pictures: 2, ..EncodeOptions::default() };
                let stream = encode(&scene, &options, &crate::encode::no_progress).unwrap();
                assert_eq!(stream.report.ledger.saturated, 0, "size {size}, coarseness {coarseness}");
            }
        }
    }

    /// One Gaussian far away makes the base coarse, and no other position worse at the last level.
    #[test]
    fn a_few_far_gaussians_do_not_make_steps_coarse() {
        let with_one_at = |far: f32| {
            let place = |i: usize| [(i as f32).sin(), (i as f32).cos(), 0.0];
            let positions = (0..300).map(|i| if i == 7 { [far, 0.0, 0.0] } else { place(i) });
            let attributes = Attributes {
                positions: Track::Constant(positions.collect()),
                ..wide(300, 0.02).attributes().clone()
            };
            Epoch::new(1, attributes).unwrap()
        };
        let near = Grid::of(&with_one_at(1.0), DGS1_MOST_RATIO);
        let quality = QuantiserSteps::default();
        for far in [1e2, 1e3, 1e4] {
            let epoch = with_one_at(far);
            let grid = Grid::of(&epoch, DGS1_MOST_RATIO);
            assert_eq!(grid.step(&quality), near.step(&quality), "{far}");
            let scene = Scene::new(vec![epoch], 30.0).unwrap();
            let options = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
            let stream = encode(&scene, &options, &crate::encode::no_progress).unwrap();
            assert_eq!(stream.report.ledger.saturated, 0, "{far}");
        }
    }

    #[test]
    fn coarse_steps_have_fewer_refinements_and_about_the_usual_base() {
        assert_eq!([0.01, 1.0, 1.7].map(|coarser| thirds(coarser, 3)), [[3; 3]; 3]);
        assert_eq!([2.0, 4.0, 8.0, 99.0].map(|c| thirds(c, 3)), [[3, 3, 1], [3, 3, 1], [3, 1, 1], [1; 3]]);
        assert_eq!([1.0, 2.0, 9.0].map(|c| thirds(c, 2)), [[1, 3, 3], [1, 3, 1], [1; 3]]);
        for k in 0..60 {
            let coarser = 1.05f32.powi(k);
            let base = thirds(coarser, 3).into_iter().fold(coarser, |step, ratio| step * f32::from(ratio));
            let ratio = if coarser < 27.0 { 27.0 } else { coarser };
            assert!((ratio / 1.733..ratio * 1.733).contains(&base), "{coarser}: {base}");
        }
    }
}
