//! Prices the canonical values of a block of Gaussians: bits, and their slopes by parameters.
//!
//! Per component of a block one Laplace distribution over cells of the quantiser, as a table per run of
//! symbols is: about 0 for rotations and higher bands, whose least values are zero, about the block's mean
//! for others. Where differences to the Gaussian before are sent, those of the base, and what refines it is
//! spread evenly. Positions and rotations have no slope: what they cost is where things are.

use codec_core::internals::{
    ids::Level,
    quant::{Class, Quantiser, recorrelate},
    wire::manifest::Quant,
};

use super::super::delivery::rate::Laplace;
use crate::encode::rounding::{CanonicalValues, PLAIN, PLAIN_CLASSES, Rounding, bands, triples};

/// Bits by class of attributes.
pub(super) type Bits = [f64; Class::COUNT];

/// Bits of the code word that names the table of a run of symbols.
const RUN_BITS: f64 = 1.5;

/// Slopes of a Gaussian's bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Slopes {
    pub(super) log_scale: [f32; 3],
    /// By the logit.
    pub(super) opacity: f32,
    pub(super) sh0: [f32; 3],
    pub(super) rest: Vec<f32>,
}

/// Slopes and bits of a block of Gaussians of `values` and higher bands `rests`, sent under `quant` up to
/// harmonic `degree`.
pub(super) fn block<'a>(
    rounding: &Rounding,
    quant: &Quant,
    degree: u8,
    values: impl Iterator<Item = &'a CanonicalValues>,
    rests: impl Iterator<Item = &'a [f32]>,
) -> (Vec<Slopes>, Bits) {
    let mut bits = Bits::default();
    let values: Vec<&CanonicalValues> = values.collect();
    let coordinates: Vec<([f32; PLAIN], [usize; 3])> =
        values.iter().map(|values| rounding.coordinates(quant, values)).collect();
    let mut plain = vec![[0f32; PLAIN]; values.len()];
    for (k, class) in PLAIN_CLASSES.into_iter().enumerate() {
        let column: Vec<f64> = coordinates.iter().map(|(all, _)| f64::from(all[k])).collect();
        let slopes = plain.iter_mut().map(|slopes| &mut slopes[k]);
        bits[class.index()] += run(&column, &quant.canonical[class.index()], class, slopes);
    }
    let mut rest: Vec<Vec<f32>> = rests.map(<[f32]>::to_vec).collect();
    rest.iter_mut().for_each(|rest| rounding.rest_coordinates(quant, rest));
    let width = rest.first().map_or(0, Vec::len);
    let mut of_rest = vec![vec![0f32; width]; rest.len()];
    let classes = [Class::Sh1, Class::Sh2, Class::Sh3].into_iter().take(degree.into());
    let components = classes.flat_map(|class| std::iter::repeat_n(class, class.components()));
    for (k, class) in components.take(width).enumerate() {
        let column: Vec<f64> = rest.iter().map(|all| f64::from(all[k])).collect();
        let slopes = of_rest.iter_mut().map(|slopes| &mut slopes[k]);
        bits[class.index()] += run(&column, &quant.canonical[class.index()], class, slopes);
    }
    let all = plain.into_iter().zip(of_rest).zip(values.iter().zip(&coordinates));
    let slopes =
        all.map(|((plain, rest), (values, (_, axes)))| by_parameters(quant, plain, rest, values, axes));
    (slopes.collect(), bits)
}

/// Bits of one component of a block, whose coordinates are `column`; their slopes by those go to `slopes`.
fn run<'a>(
    column: &[f64],
    quantiser: &Quantiser,
    class: Class,
    slopes: impl Iterator<Item = &'a mut f32>,
) -> f64 {
    let first = class.first_level();
    let levels = Level::ALL.into_iter().filter(|&level| quantiser.has_symbol(level, first)).count();
    let mut bits = RUN_BITS * levels as f64;
    if quantiser.predicted() {
        let ratio = f64::from(quantiser.step(first) / quantiser.step(Level::ALL[3]));
        let base = |value: &f64| (value / ratio).round();
        let differences: Vec<f64> = column.windows(2).map(|pair| base(&pair[1]) - base(&pair[0])).collect();
        let model = Laplace::of_cells(differences.iter().copied());
        bits += column.len() as f64 * ratio.log2();
        bits += differences.iter().map(|&difference| model.bits(difference).0).sum::<f64>();
        let model = Laplace::of(column.iter().copied(), 1.0);
        slopes.zip(column).for_each(|(slope, &value)| *slope = model.bits(value).1 as f32);
        return bits;
    }
    let is_about_zero = class == Class::Rotation || class.sh_degree() > 0;
    let model = if is_about_zero {
        Laplace::of_cells(column.iter().map(|value| value.round()))
    } else {
        Laplace::of(column.iter().copied(), 1.0)
    };
    for (slope, &value) in slopes.zip(column) {
        bits += model.bits(value.round()).0;
        *slope = model.bits(value).1 as f32;
    }
    bits
}

/// Slopes by parameters from those by coordinates, `plain` ones and those of higher bands.
fn by_parameters(
    quant: &Quant,
    mut plain: [f32; PLAIN],
    mut rest: Vec<f32>,
    values: &CanonicalValues,
    axes: &[usize; 3],
) -> Slopes {
    let back = |class: Class, slopes: &mut [f32]| {
        let quantiser = &quant.canonical[class.index()];
        let step = quantiser.step(Level::ALL[3]);
        slopes.iter_mut().for_each(|slope| *slope /= step);
        triples(quantiser, class, slopes, recorrelate);
    };
    back(Class::Scale, &mut plain[3..6]);
    back(Class::Opacity, &mut plain[9..10]);
    back(Class::Sh0, &mut plain[10..13]);
    bands(&mut rest).for_each(|(class, slopes)| back(class, slopes));
    let mut log_scale = [0.0; 3];
    axes.iter().zip(&plain[3..6]).for_each(|(&axis, &slope)| log_scale[axis] = slope);
    Slopes {
        log_scale,
        opacity: plain[9] * values.opacity * (1.0 - values.opacity),
        sh0: [plain[10], plain[11], plain[12]],
        rest,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        activation::sigmoid,
        encode::{Decisions, EncodeOptions, encode},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    const REST: usize = 9;

    /// The rounding of a scene whose colours and scales go in triples.
    fn rounding() -> (Rounding, Quant) {
        let options =
            synth::SynthOptions { kind: SynthKind::Figure, gaussians: 1000, frames: 1, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let encoded = encode(&scene, &EncodeOptions::default(), &crate::encode::no_progress).unwrap();
        let Decisions::Dgs1(decisions) = encoded.decisions else { unreachable!("profile dgs1") };
        let rounding = Rounding::of(&decisions, &decisions.epochs[0], 1000).unwrap();
        let mut quant = *rounding.quantisers(0).unwrap().0;
        for class in [Class::Scale, Class::Sh0, Class::Sh1] {
            let quantiser = &mut quant.canonical[class.index()];
            *quantiser = quantiser.with_decorrelated(true);
        }
        (rounding, quant)
    }

    /// Log-scales, logit, band 0 and band 1 as one list.
    fn values(all: &[f32]) -> (CanonicalValues, Vec<f32>) {
        let values = CanonicalValues {
            position: [0.1, 0.2, 0.3],
            rotation: [0.5, 0.5, -0.5, 0.5],
            log_scale: [all[0], all[1], all[2]],
            opacity: sigmoid(all[3]),
            sh0: [all[4], all[5], all[6]],
        };
        (values, all[7..].to_vec())
    }

    #[test]
    fn slopes_by_parameters_are_differences_of_coordinates() {
        let (rounding, quant) = rounding();
        let all: Vec<f32> = (0..7 + REST).map(|i| 0.3 * (1.7 * i as f32).sin()).collect();
        let weight = |k: usize| 0.5 + (0.9 * k as f32).cos();
        let coordinates = |all: &[f32]| -> f64 {
            let (values, mut rest) = values(all);
            rounding.rest_coordinates(&quant, &mut rest);
            let (mut plain, _) = rounding.coordinates(&quant, &values);
            // Positions and rotations have no slope.
            (0..3).chain(6..9).for_each(|k| plain[k] = 0.0);
            plain.iter().chain(&rest).enumerate().map(|(k, v)| f64::from(weight(k) * v)).sum()
        };
        let (here, _) = values(&all);
        let (_, axes) = rounding.coordinates(&quant, &here);
        let plain = std::array::from_fn(weight);
        let rest = (0..REST).map(|k| weight(PLAIN + k)).collect();
        let slopes = by_parameters(&quant, plain, rest, &here, &axes);
        let found: Vec<f32> = [&slopes.log_scale[..], &[slopes.opacity], &slopes.sh0, &slopes.rest].concat();
        for (i, found) in found.into_iter().enumerate() {
            let at = |by: f32| {
                let mut moved = all.clone();
                moved[i] += by;
                coordinates(&moved)
            };
            let expected = (at(5e-3) - at(-5e-3)) / 1e-2;
            assert!(
                (f64::from(found) - expected).abs() < 0.02 * expected.abs() + 0.05,
                "{i}: {found} {expected}"
            );
        }
    }

    #[test]
    fn what_is_spread_costs_more_and_is_drawn_together() {
        let (_, quant) = rounding();
        let quantiser = &quant.canonical[Class::Sh1.index()];
        let spread = |by: f64| {
            let column: Vec<f64> = (0..64).map(|i| by * (f64::from(i * 37 % 64) - 31.5) / 32.0).collect();
            let mut slopes = vec![0.0; 64];
            let bits = run(&column, quantiser, Class::Sh1, slopes.iter_mut());
            (bits, column, slopes)
        };
        let (wide, column, slopes) = spread(20.0);
        assert!(wide > spread(5.0).0 + 64.0 && spread(0.1).0 < 10.0, "{wide}");
        assert!(slopes.iter().zip(column).all(|(slope, value)| f64::from(*slope) * value >= 0.0));
    }
}
