//! Prices the canonical values of a block of Gaussians: bits, and their slopes by parameters.
//!
//! Per component of a block one Laplace distribution over cells of the quantiser, as a table per run of
//! symbols is: about 0 for rotations and higher bands, whose least values are zero, about the block's mean for
//! others. Where differences to the Gaussian before are sent, those of the base, and what refines it is spread
//! evenly. Positions and rotations have no slope: what they cost is where things are.

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
