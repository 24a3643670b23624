//! Searches by trial how attributes share the bits: the steps that suit a scene's own pictures.
//!
//! The steps of [`QuantiserSteps`] weigh attributes against each other as typical scenes do. Here one step
//! at a time is made coarser or finer, the scene is encoded and rendered from validation cameras,
//! and what gives the same PSNR for fewer bits is kept: a coordinate search, factors shrinking from
//! round to round, bounded by a number of encodings.

use super::{
    Analysis, EncodeError, EncodeOptions, Encoded, Progress, QuantiserSteps, Report, SearchReport, Target,
    evaluator::{Evaluator, PSNR_CAP_DB, spread},
    profile::decide_and_write,
    progress::{part, report},
    target,
};
use crate::scene::{Epoch, Scene};

/// Factors on a step, tried both ways, round by round.
const FACTORS: [f32; 4] = [1.6, 1.3, 1.15, 1.07];
/// Factors on all steps whose streams tell what a dB costs.
const AROUND: (f32, f32) = (0.75, 1.3);
/// Share of the bits that a change must save: less is the noise of one set of pictures.
const MIN_GAIN: f64 = 0.005;
/// Frames rendered.
const FRAMES: u32 = 4;

/// A stream as good as `start`, the encoding of the scene of `analysis` with `options`, for fewer bits; or,
/// at a target size, better.
pub(super) fn encode(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
    mut start: Encoded,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let scene = analysis.scene;
    let frames = spread(0, scene.frames() as u32, FRAMES);
    let evaluator = Evaluator::validation_on(scene, frames, &options.backend()?)?;
    let psnr = evaluator.whole(&start.stream)?;
    let before = start.report.ledger.wire();
    let nothing = SearchReport { encodes: 0, is_better: false, bits: 1.0, psnr_db: 0.0 };
    start.report.searched = Some(nothing);
    if psnr >= PSNR_CAP_DB {
        return Ok(start);
    }
    let quality = start.report.quality;
    let searched = options.search as f64 / (options.search + target::MOST) as f64;
    let (quality, encodes) = on_a_part(analysis, options, quality, &part(progress, 0.0, searched))?;
    // Sizes were asked for, or the PSNR that there was is to be kept.
    let wanted = options.target.unwrap_or(Target::PsnrDb(psnr));
    let again = EncodeOptions { quality, target: None, ..options.clone() };
    start.report.searched = Some(SearchReport { encodes, ..nothing });
    let mut found = match target::encode(analysis, &again, wanted, &part(progress, searched, 1.0)) {
        Ok(found) => found,
        Err(EncodeError::Unreachable { .. }) => return Ok(start),
        Err(error) => return Err(error),
    };
    let gain = evaluator.whole(&found.stream)? - psnr;
    let is_better = match wanted {
        Target::PsnrDb(_) => found.report.ledger.wire() < before,
        _ => gain > 0.0,
    };
    let encodes = encodes + found.report.reached.map_or(0, |r| r.encodes);
    if !is_better {
        start.report.searched = Some(SearchReport { encodes, ..nothing });
        return Ok(start);
    }
    let bits = found.report.ledger.wire() / before;
    let reached = options.target.and(found.report.reached);
    let searched = Some(SearchReport { encodes, is_better, bits, psnr_db: gain });
    found.report = Report { reached, searched, ..found.report };
    Ok(found)
}

/// Searches on the middle epoch of the scene, which stands for the others.
fn on_a_part(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
    quality: QuantiserSteps,
    progress: Progress<'_>,
) -> Result<(QuantiserSteps, usize), EncodeError> {
    let scene = analysis.scene;
    let middle = scene.epochs().len() / 2;
    let part = if scene.epochs().len() > 1 { epoch_alone(scene, middle) } else { None };
    let of_part = part.as_ref().map(|part| analysis.of_epoch(part, middle));
    let analysis = of_part.as_ref().unwrap_or(analysis);
    let part = analysis.scene;
    let frames = spread(0, part.frames() as u32, FRAMES);
    let evaluator = Evaluator::validation_on(part, frames, &options.backend()?)?;
    let mut tries = 0;
    descend(quality, &Axis::of(part), options.search, |quality| {
        report(progress, "search", tries as f64 / options.search as f64)?;
        tries += 1;
        let encoded = decide_and_write(
            analysis,
            &EncodeOptions { quality, ..options.clone() },
            &crate::encode::no_progress,
        )?;
        Ok(RateAndPsnr { bits: encoded.report.ledger.wire(), psnr: evaluator.whole(&encoded.stream)? })
    })
}

/// Epoch `index` of `scene` as a scene of its own, drawn and seen from around as the whole is; nothing where
/// there is no such epoch.
fn epoch_alone(scene: &Scene, index: usize) -> Option<Scene> {
    let epoch = scene.epochs().get(index)?;
    let mut alone = Scene::new(vec![epoch.clone()], scene.frames_per_second()).ok()?;
    (alone.footprint, alone.up) = (scene.footprint, scene.up);
    Some(alone)
}

/// A step of [`QuantiserSteps`].
#[derive(Clone, Copy, Debug, PartialEq)]
enum Axis {
    Position,
    Scale,
    Rotation,
    Opacity,
    Sh0,
    ShRest,
    Motion,
}

impl Axis {
    /// The steps that matter to `scene`.
    fn of(scene: &Scene) -> Vec<Self> {
        let any = |has: fn(&Epoch) -> bool| scene.epochs().iter().any(has);
        let mut all = vec![Self::Position, Self::Scale, Self::Rotation, Self::Opacity, Self::Sh0];
        if any(|epoch| epoch.attributes().sh_degree.get() > 0) {
            all.push(Self::ShRest);
        }
        if any(|epoch| epoch.frames() > 1) {
            all.push(Self::Motion);
        }
        all
    }

    /// `quality` with this step times `factor`.
    fn scaled(self, mut quality: QuantiserSteps, factor: f32) -> QuantiserSteps {
        let step = match self {
            Self::Position => &mut quality.position,
            Self::Scale => &mut quality.scale,
            Self::Rotation => &mut quality.rotation,
            Self::Opacity => &mut quality.opacity,
            Self::Sh0 => &mut quality.sh0,
            Self::ShRest => &mut quality.sh_rest,
            Self::Motion => &mut quality.motion,
        };
        *step *= factor;
        quality
    }
}

/// What an encoding came to.
#[derive(Clone, Copy, Debug)]
struct RateAndPsnr {
    /// Bits or bytes, any unit.
    bits: f64,
    /// dB.
    psnr: f64,
}

/// The best steps found from `start` along `axes` with at most `most` measurements, and how many it took.
fn descend<E>(
    start: QuantiserSteps,
    axes: &[Axis],
    most: usize,
    mut measure: impl FnMut(QuantiserSteps) -> Result<RateAndPsnr, E>,
) -> Result<(QuantiserSteps, usize), E> {
    if most < 4 {
        return Ok((start, 0));
    }
    let mut quality = start;
    let mut marks = measure(quality)?;
    let (fine, coarse) = (measure(quality.scaled(AROUND.0))?, measure(quality.scaled(AROUND.1))?);
    let mut tries = 3;
    // dB for which bits grow e-fold.
    let db_per_log_bits = (fine.psnr - coarse.psnr) / (fine.bits / coarse.bits).ln();
    if !(db_per_log_bits > 0.0 && db_per_log_bits.is_finite()) {
        return Ok((start, tries));
    }
    for factor in FACTORS {
        for axis in axes {
            // On in the direction that helps, else in the other.
            for factor in [factor, 1.0 / factor] {
                let before = quality;
                loop {
                    if tries == most {
                        return Ok((quality, tries));
                    }
                    let other = axis.scaled(quality, factor);
                    let found = measure(other)?;
                    tries += 1;
                    let saved = (found.psnr - marks.psnr) / db_per_log_bits - (found.bits / marks.bits).ln();
                    if saved <= MIN_GAIN {
                        break;
                    }
                    (quality, marks) = (other, found);
                }
                if quality != before {
                    break;
                }
            }
        }
    }
    Ok((quality, tries))
}

#[cfg(test)]
mod tests {
    use codec_core::Footprint;

    use super::*;
    use crate::{
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        scene::Up,
        viewpoint::{Framing, Ring},
    };

    /// Attributes with `values` values each whose squared errors weigh `weights`: log rate, PSNR of the sum.
    fn model(values: [f64; 5], weights: [f64; 5]) -> impl Fn(QuantiserSteps) -> RateAndPsnr {
        move |q| {
            let steps = [q.position, q.scale, q.rotation, q.opacity, q.sh0].map(f64::from);
            let bits: f64 = steps.iter().zip(values).map(|(s, n)| n * (6.0 - s.log2())).sum();
            let error: f64 = steps.iter().zip(weights).map(|(s, w)| w * s * s).sum();
            RateAndPsnr { bits, psnr: -10.0 * error.log10() }
        }
    }

    const AXES: [Axis; 5] = [Axis::Position, Axis::Scale, Axis::Rotation, Axis::Opacity, Axis::Sh0];

    #[test]
    fn steps_come_to_weigh_errors_by_the_number_of_values() {
        let values = [3.0, 3.0, 3.0, 1.0, 3.0];
        let start = QuantiserSteps {
            position: 1.0,
            scale: 1.0,
            rotation: 1.0,
            opacity: 1.0,
            sh0: 1.0,
            ..QuantiserSteps::default()
        };
        let weights = [12.0, 3.0, 1.0, 1.0, 0.3];
        let marks = model(values, weights);
        let (found, tries) = descend(start, &AXES, 60, |q| Ok::<_, ()>(marks(q))).unwrap();
        assert!(tries <= 60, "{tries}");
        // At the optimum weight · step² is the same per value.
        let each = [found.position, found.scale, found.rotation, found.opacity, found.sh0];
        let shares: Vec<f64> =
            each.iter().zip(weights).zip(values).map(|((s, w), n)| w * f64::from(s * s) / n).collect();
        let spread =
            shares.iter().fold(0.0f64, |m, s| m.max(*s)) / shares.iter().fold(f64::MAX, |m, s| m.min(*s));
        assert!(spread < 4.0, "{shares:?}: it was 40 at the start");
        let (old, new) = (marks(start), marks(found));
        // One bit of each of the 13 values is 6.02 dB.
        let dearer = (new.bits - old.bits) / 13.0 * 6.02;
        assert!(new.psnr - old.psnr > dearer + 0.5, "{old:?} {new:?}");
    }

    #[test]
    fn few_tries_change_nothing_and_balance_stays() {
        let values = [3.0, 3.0, 3.0, 1.0, 3.0];
        let marks = model(values, values);
        let start = QuantiserSteps {
            position: 1.0,
            scale: 1.0,
            rotation: 1.0,
            opacity: 1.0,
            sh0: 1.0,
            ..QuantiserSteps::default()
        };
        assert_eq!(descend(start, &AXES, 3, |q| Ok::<_, ()>(marks(q))), Ok((start, 0)));
        assert_eq!(descend(start, &AXES, 500, |q| Ok::<_, ()>(marks(q))), Ok((start, 43)));
    }

    /// The steps are searched for from cameras that stand as those that measure the whole clip do.
    #[test]
    fn an_epoch_alone_is_drawn_and_seen_as_the_whole_scene() {
        let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..Default::default() };
        let one = synth::make(&options, &Limits::default()).unwrap();
        let mut scene = Scene::new([one.epochs(), one.epochs(), one.epochs()].concat(), 24.0).unwrap();
        (scene.up, scene.footprint) = (Up::Z, Footprint::Pixel);
        let alone = epoch_alone(&scene, 1).unwrap();
        assert_eq!((alone.up, alone.footprint), (Up::Z, Footprint::Pixel));
        assert_eq!((alone.epochs(), alone.frames_per_second()), (&scene.epochs()[1..2], 24.0));
        let eye = |scene: &Scene| {
            let ring = Framing::of(scene).ring(Ring::Validation, 1, (8, 8)).unwrap();
            ring[0].translation()
        };
        assert_eq!(eye(&alone), eye(&scene), "each epoch is as large as all of them");
        assert!(epoch_alone(&scene, 3).is_none());
    }

    #[test]
    fn a_searched_stream_is_smaller_and_as_good_or_the_first_one() {
        let options =
            synth::SynthOptions { gaussians: 1000, frames: 4, kind: SynthKind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let evaluator = Evaluator::validation(&scene, spread(0, 4, FRAMES)).unwrap();
        // Far from balance: positions much too fine.
        let quality = QuantiserSteps { position: 0.002, ..QuantiserSteps::default() };
        let plain = EncodeOptions { quality, pictures: 0, ..EncodeOptions::default() };
        let first = super::super::encode(&scene, &plain, &crate::encode::no_progress).unwrap();
        let found = super::super::encode(
            &scene,
            &EncodeOptions { search: 16, ..plain.clone() },
            &crate::encode::no_progress,
        )
        .unwrap();
        let searched = found.report.searched.unwrap();
        assert!(searched.is_better && searched.bits < 0.97, "{searched:?}");
        assert_eq!(searched.bits, found.report.ledger.wire() / first.report.ledger.wire());
        assert!(evaluator.whole(&found.stream).unwrap() >= evaluator.whole(&first.stream).unwrap());
        assert!(found.report.quality.position > 0.0024 && found.report.reached.is_none());
        // A size that was asked for is kept.
        let target = Some(Target::Bytes(first.report.ledger.wire() as u64));
        let sized = EncodeOptions { search: 16, target, ..plain };
        let found = super::super::encode(&scene, &sized, &crate::encode::no_progress).unwrap();
        assert!(found.report.ledger.wire() <= first.report.ledger.wire() && found.report.reached.is_some());
        assert!(found.report.searched.unwrap().psnr_db > 0.0);
    }
}
