//! Controls the rate: finds the coarseness at which a stream has a given size or quality.
//!
//! Coarser steps give fewer bytes and a lower PSNR, nearly linearly in logarithms, so a bracketed
//! secant on the logarithm of the coarseness needs few encodings. What is returned has been
//! encoded and measured, so a stream that is not quite monotone costs closeness, never the promise. Steps
//! below a sixteenth of the usual ones are tried only where those do not lead to the target.
//!
//! A PSNR is a mean over pictures, each weighed by the share of it that the scene covers.

use render_host::Settings;

use super::{
    Analysis, Decisions, EncodeError, EncodeOptions, Encoded, Progress, Target, TargetReport, TargetViews,
    evaluator::{Evaluator, spread},
    profile::{decide_and_write, reencode},
    progress::{named, part, report},
};
use crate::scene::Scene;

/// Finest and coarsest factor on the steps that is tried.
pub const COARSENESS: (f32, f32) = (0.001, 1024.0);
/// Finest factor on the steps that is tried where it suffices: finer ones are beyond what pictures show.
const USUAL_FINEST: f32 = 1.0 / 16.0;
/// Shortest and longest factor on the steps of motion alone that is tried.
const MOTION_STEPS: (f64, f64) = (1.0 / 16.0, 16.0);
/// Most encodings of a search.
pub(super) const MOST: usize = 8;
/// What progress calls them.
const TRIES: [&str; MOST] = [
    "encoding 1 of at most 8",
    "encoding 2 of at most 8",
    "encoding 3 of at most 8",
    "encoding 4 of at most 8",
    "encoding 5 of at most 8",
    "encoding 6 of at most 8",
    "encoding 7 of at most 8",
    "encoding 8 of at most 8",
];
/// Frames a PSNR is measured on.
const FRAMES: u32 = 4;
/// Sizes within this share below the target are close enough.
const CLOSE: f64 = 0.02;
/// As is a PSNR within this many dB above it.
const CLOSE_DB: f64 = 0.3;

/// Excess where nothing can be written that is right: above that of any stream, in dB or as a logarithm.
const NOT_WRITTEN: f64 = 100.0;

/// Encodes the scene of `analysis` at the coarseness that comes closest to `target` without missing it.
pub(super) fn encode(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
    target: Target,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let scene = analysis.scene;
    let evaluator = match target {
        Target::PsnrDb(_) => {
            let frames = spread(0, scene.frames() as u32, FRAMES);
            let backend = options.backend()?;
            Some(match &options.target_views {
                None => Evaluator::validation_on(scene, frames, &backend)?,
                Some(TargetViews { cameras, background }) => {
                    let settings = Settings { background: *background, ..Settings::default() };
                    Evaluator::new(scene, cameras.clone(), frames, &settings, &backend)?
                }
            })
        }
        _ => None,
    };
    // Towards the allowed side is coarser for sizes and finer for PSNR.
    let sign = if evaluator.is_some() { -1.0 } else { 1.0 };
    let [finest, usual, coarsest] = [COARSENESS.0, USUAL_FINEST, COARSENESS.1].map(|c| f64::from(c).ln());
    let search = if sign > 0.0 {
        Search { lowest: finest, low: usual, high: coarsest, highest: coarsest, slope: 0.25, close: CLOSE }
    } else {
        let (low, high, highest) = (-coarsest, -usual, -finest);
        Search { lowest: low, low, high, highest, slope: 6.0, close: CLOSE_DB }
    };
    let found = search.run(|number, at| {
        let coarseness = ((sign * at).exp() as f32).clamp(COARSENESS.0, COARSENESS.1);
        let again = EncodeOptions { quality: options.quality.scaled(coarseness), ..options.clone() };
        let progress = part(progress, share_before(number), share_before(number + 1));
        let encoded = match decide_and_write(analysis, &again, &named(&progress, TRIES[number])) {
            // As fine as this, what one Gaussian needs does not fit a packet, or the format has no such step.
            Err(error @ (EncodeError::BlockTooLarge { .. } | EncodeError::Format(_)))
                if coarseness < USUAL_FINEST =>
            {
                return Ok((NOT_WRITTEN, Err(error)));
            }
            encoded => encoded?,
        };
        let value = match (target, &evaluator) {
            (Target::PsnrDb(_), Some(evaluator)) => evaluator.whole(&encoded.stream)?,
            _ => size(target, &encoded),
        };
        // Values that the format's numbers do not reach are cut off: such a stream is worse, not finer.
        let is_cut = coarseness < USUAL_FINEST && encoded.report.ledger.saturated > 0;
        let excess = if is_cut { NOT_WRITTEN } else { excess(target, value) };
        Ok::<_, EncodeError>((excess, Ok((encoded, coarseness, value))))
    })?;
    let (mut encoded, coarseness, value) = found.what?;
    if found.excess > 0.0 {
        return Err(EncodeError::Unreachable {
            option: target.name(),
            wanted: target.value(),
            reached: value,
            coarseness,
        });
    }
    let views = evaluator.map(|evaluator| evaluator.measured());
    encoded.report.reached = Some(TargetReport { target, coarseness, encodes: found.tries, value, views });
    Ok(encoded)
}

/// Excess where there is no stream: that of one 20 times too large.
const NO_STREAM: f64 = 3.0;

/// As [`reencode`], with steps of motion such that the stream comes close to the size that `options` name, if
/// they do.
///
/// # Errors
/// As [`reencode`], or a size that steps of motion do not lead to.
pub fn reencode_to_size(
    scene: &Scene,
    decisions: &Decisions,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let target = match options.target {
        Some(target @ (Target::Bytes(_) | Target::BitsPerGaussian(_))) => target,
        None | Some(Target::PsnrDb(_)) => return reencode(scene, decisions, 1.0, options, progress),
    };
    target.check()?;
    let (finest, coarsest) = MOTION_STEPS;
    let (low, high) = (finest.ln(), coarsest.ln());
    let search = Search { lowest: low, low, high, highest: high, slope: 0.2, close: CLOSE };
    let found = search.run(|number, at| {
        let motion = at.exp() as f32;
        let progress = part(progress, share_before(number), share_before(number + 1));
        match reencode(scene, decisions, motion, options, &named(&progress, TRIES[number])) {
            // Motion as fine as this does not fit its packets: that, too, is more than there may be.
            Err(error @ EncodeError::BlockTooLarge { .. }) => Ok((NO_STREAM, Err(error))),
            encoded => {
                let encoded = encoded?;
                let value = size(target, &encoded);
                Ok::<_, EncodeError>((excess(target, value), Ok((encoded, motion, value))))
            }
        }
    })?;
    let (mut encoded, motion, value) = found.what?;
    if found.excess > 0.0 {
        return Err(EncodeError::UnreachableByMotion {
            option: target.name(),
            wanted: target.value(),
            reached: value,
            motion,
        });
    }
    let coarseness = motion;
    encoded.report.reached =
        Some(TargetReport { target, coarseness, encodes: found.tries, value, views: None });
    report(progress, "done", 1.0)?;
    Ok(encoded)
}

/// Share of a search that is done before its encoding `number`, from 0.
fn share_before(number: usize) -> f64 {
    number as f64 / MOST as f64
}

/// What `target`, a size, is compared with.
fn size(target: Target, encoded: &Encoded) -> f64 {
    match target {
        Target::BitsPerGaussian(_) => encoded.report.ledger.bits_per_gaussian(),
        _ => encoded.report.ledger.wire(),
    }
}

/// Excess of `value` over what `target` allows: logarithm of a size's ratio, or dB that lack.
fn excess(target: Target, value: f64) -> f64 {
    match target {
        Target::PsnrDb(wanted) => wanted - value,
        _ => (value / target.value()).ln(),
    }
}

/// A search for the least place whose excess, which falls from left to right, is at most zero.
struct Search {
    /// The least place there is: it is gone to only where even `low` fits, and is not close.
    lowest: f64,
    /// The least place that is usual.
    low: f64,
    /// The greatest place that is usual.
    high: f64,
    /// The greatest place there is: it is gone to only where `high` does not fit.
    highest: f64,
    /// Guess of how fast the excess falls.
    slope: f64,
    /// An excess of no less than minus this ends the search.
    close: f64,
}

/// The best place measured.
struct BestPlace<T> {
    at: f64,
    excess: f64,
    what: T,
    tries: usize,
}

impl Search {
    /// Starts at 0; if nothing fits, the answer is the place that exceeds least. Of places that fit alike it
    /// is the least. `measure` is given how many measurements there were, below [`MOST`], and a place.
    fn run<T, E>(
        &self,
        mut measure: impl FnMut(usize, f64) -> Result<(f64, T), E>,
    ) -> Result<BestPlace<T>, E> {
        let mut at = 0f64.clamp(self.low, self.high);
        let (excess, what) = measure(0, at)?;
        let mut best = BestPlace { at, excess, what, tries: 1 };
        let (mut fits, mut exceeds, mut not_written) = (None, None, None);
        let (mut last, mut slope) = ((at, excess), self.slope);
        loop {
            if last.1 >= NOT_WRITTEN && fits.is_none() && exceeds.is_some() {
                // What fits lies before it, if anything does.
                not_written = Some(last.0);
            } else {
                *(if last.1 <= 0.0 { &mut fits } else { &mut exceeds }) = Some(last);
            }
            let close = best.excess <= 0.0 && best.excess >= -self.close;
            let next = match (exceeds, fits, not_written) {
                (Some((from, _)), None, Some(end)) => (end - from > 0.02).then_some(0.5 * (from + end)),
                _ => self.next(fits, exceeds, slope, MOST - best.tries),
            };
            let Some(next) = next.filter(|_| !close && best.tries < MOST) else { return Ok(best) };
            at = next;
            let (excess, what) = measure(best.tries, at)?;
            let tries = best.tries + 1;
            let closer = match (excess <= 0.0, best.excess <= 0.0) {
                (true, true) if excess == best.excess => at < best.at,
                (true, true) => excess > best.excess,
                (fits, best_fits) => fits || !best_fits && excess < best.excess,
            };
            best = if closer { BestPlace { at, excess, what, tries } } else { BestPlace { tries, ..best } };
            let found = (last.1 - excess) / (at - last.0);
            slope = if found.is_finite() { found.clamp(self.slope / 8.0, self.slope * 4.0) } else { slope };
            last = (at, excess);
        }
    }

    /// Where to measure next with `left` tries left, if anywhere.
    fn next(
        &self,
        fits: Option<(f64, f64)>,
        exceeds: Option<(f64, f64)>,
        slope: f64,
        left: usize,
    ) -> Option<f64> {
        let wanted = -0.4 * self.close;
        let along = |(at, excess): (f64, f64)| at + ((excess - wanted) / slope).clamp(-2.0, 2.0);
        match (exceeds, fits) {
            (Some(a), Some(b)) => {
                let width = b.0 - a.0;
                let share = ((a.1 - wanted) / (a.1 - b.1)).clamp(0.08, 0.92);
                // Where the line misleads, halves.
                let share = if left <= 2 { 0.5 * (share + 0.5) } else { share };
                (width > 1e-4).then_some(a.0 + share * width)
            }
            (Some(a), None) => {
                let end = if a.0 < self.high { self.high } else { self.highest };
                // The last try but two goes to the end, where it is decided whether anything fits.
                let next = if left <= 3 { end } else { along(a).max(a.0 + 0.02).min(end) };
                (a.0 < end).then_some(next)
            }
            (None, Some(b)) => {
                let end = if b.0 > self.low { self.low } else { self.lowest };
                (b.0 > end).then_some(along(b).min(b.0 - 0.02).max(end))
            }
            (None, None) => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::{
        Limits,
        synth::{self, SynthKind},
    };
    use crate::scene::Scene;

    fn scene() -> Scene {
        let options =
            synth::SynthOptions { gaussians: 1000, frames: 4, kind: SynthKind::Figure, ..Default::default() };
        synth::make(&options, &Limits::default()).unwrap()
    }

    fn encoded(target: Target) -> Result<Encoded, EncodeError> {
        let options = EncodeOptions { target: Some(target), ..EncodeOptions::default() };
        super::super::encode(&scene(), &options, &crate::encode::no_progress)
    }

    #[test]
    fn sizes_are_met_closely_and_never_exceeded() {
        for factor in [0.5, 1.7] {
            let free = super::super::encode(&scene(), &EncodeOptions::default(), &crate::encode::no_progress)
                .unwrap();
            let wanted = (free.report.ledger.wire() * factor) as u64;
            let stream = encoded(Target::Bytes(wanted)).unwrap();
            let sent = stream.stream.wire_bytes();
            assert_eq!(stream.report.ledger.wire(), sent as f64);
            assert!(sent as u64 <= wanted && sent as f64 > 0.96 * wanted as f64, "{sent} of {wanted}");
            let reached = stream.report.reached.unwrap();
            assert!(reached.encodes <= MOST && (reached.coarseness > 1.0) == (factor < 1.0), "{reached:?}");
        }
        let bits = encoded(Target::BitsPerGaussian(80.0)).unwrap().report.ledger.bits_per_gaussian();
        assert!((76.0..=80.0).contains(&bits), "{bits}");
    }

    #[test]
    fn a_psnr_is_reached_and_not_much_more() {
        let stream = encoded(Target::PsnrDb(46.0)).unwrap();
        let evaluator = Evaluator::validation(&scene(), spread(0, 4, FRAMES)).unwrap();
        let found = evaluator.whole(&stream.stream).unwrap();
        assert_eq!(Some(found), stream.report.reached.map(|r| r.value));
        assert!((46.0..46.6).contains(&found), "{found}");
        let views = stream.report.reached.and_then(|reached| reached.views).unwrap();
        assert_eq!((views.cameras, views.frames, views.width, views.height), (3, 4, 256, 256));
        assert!((0.05..0.95).contains(&views.covered), "{views:?}");
    }

    #[test]
    fn a_psnr_from_other_views_is_reached_there() {
        let scene = scene();
        let near = crate::viewpoint::Framing { radius: 0.5, ..crate::viewpoint::Framing::of(&scene) };
        let cameras = near.turntable(2, (96, 64), 45.0).unwrap();
        let views = TargetViews { cameras: cameras.clone(), background: [1.0; 3] };
        let options = EncodeOptions {
            target: Some(Target::PsnrDb(44.0)),
            target_views: Some(views),
            ..EncodeOptions::default()
        };
        let encoded = super::super::encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let reached = encoded.report.reached.unwrap();
        let settings = Settings { background: [1.0; 3], ..Settings::default() };
        let evaluator =
            Evaluator::new(&scene, cameras, spread(0, 4, FRAMES), &settings, &render_host::Backend::Cpu)
                .unwrap();
        assert_eq!(evaluator.whole(&encoded.stream).unwrap(), reached.value);
        let around = Evaluator::validation(&scene, spread(0, 4, FRAMES)).unwrap();
        assert_ne!(around.whole(&encoded.stream).unwrap(), reached.value);
        assert_eq!(reached.views.map(|v| (v.cameras, v.width)), Some((2, 96)));
    }

    #[test]
    fn what_cannot_be_met_says_what_can() {
        let error = encoded(Target::Bytes(100)).unwrap_err();
        let EncodeError::Unreachable { option, wanted, reached, coarseness } = error else {
            panic!("{error}");
        };
        assert_eq!((option, wanted, coarseness), ("target_bytes", 100.0, COARSENESS.1));
        assert!(reached > 100.0);
        for target in [Target::Bytes(0), Target::PsnrDb(f64::NAN), Target::PsnrDb(120.0)] {
            assert!(matches!(encoded(target), Err(EncodeError::Target { .. })));
        }
    }

    /// A stair and a bent line: the answer fits, and no step of the stair that fits lies above it.
    #[test]
    fn the_search_keeps_its_promise_on_stairs() {
        let search = Search { lowest: -2.7, low: -2.7, high: 4.1, highest: 4.1, slope: 0.25, close: 0.02 };
        for wanted in [-0.5, -0.3, 0.0, 0.4] {
            let stair = |u: f64| -0.02 * (10.0 * u).floor() + 0.01 * u * u - wanted;
            let found = search.run(|_, u| Ok::<_, ()>((stair(u), u))).unwrap();
            assert!(found.excess <= 0.0 && found.tries <= MOST, "{wanted} {}", found.excess);
            assert!(found.excess > -0.045 || found.what == -2.7, "{wanted} {}", found.excess);
        }
        let never = search.run(|_, u| Ok::<_, ()>((9.0 - u, u))).unwrap();
        assert_eq!((never.what, never.excess > 0.0), (4.1, true));
    }

    /// What the usual places decide is decided as if there were no others; where they do not, the others do.
    #[test]
    fn unusual_places_are_gone_to_only_where_usual_ones_do_not_suffice() {
        // By size finer is to the left, by PSNR to the right. Each has one end beyond the usual one.
        let by_size =
            |lowest: f64| Search { lowest, low: -2.7, high: 6.9, highest: 6.9, slope: 0.25, close: 0.02 };
        let by_psnr =
            |highest: f64| Search { lowest: -6.9, low: -6.9, high: 2.7, highest, slope: 6.0, close: 0.3 };
        let run = |search: Search, excess: &dyn Fn(f64) -> f64| {
            let mut places = Vec::new();
            let found = search.run(|_, at| {
                places.push(at);
                Ok::<_, ()>((excess(at), at))
            });
            (places, found.unwrap())
        };
        for zero in [-2.5, -1.3, 0.4, 2.1, 3.9] {
            let excess = |at: f64| -0.3 * (at - zero);
            assert_eq!(run(by_size(-6.9), &excess).0, run(by_size(-2.7), &excess).0, "{zero}");
            let excess = |at: f64| -5.0 * (at + zero);
            assert_eq!(run(by_psnr(6.9), &excess).0, run(by_psnr(2.7), &excess).0, "{zero}");
        }
        for zero in [-3.5, -5.0, -6.6] {
            let (places, found) = run(by_size(-6.9), &|at: f64| -0.3 * (at - zero));
            assert!(found.excess <= 0.0 && found.excess > -0.05 && places.len() <= MOST, "{places:?}");
            let (places, found) = run(by_psnr(6.9), &|at: f64| -5.0 * (at + zero));
            assert!(found.excess <= 0.0 && found.excess > -0.6 && places.len() <= MOST, "{places:?}");
        }
        // What is too small or too good at every place ends at the last one.
        assert_eq!(run(by_size(-6.9), &|at: f64| -0.3 * (at + 20.0)).1.at, -6.9);
        let (places, found) = run(by_psnr(6.9), &|at: f64| -5.0 * (at - 20.0));
        assert!(found.excess > 0.0 && places.contains(&6.9), "{places:?}");
    }

    /// From some place on nothing can be written that is right: what fits before it is found.
    #[test]
    fn the_search_turns_back_where_nothing_can_be_written() {
        let search = Search { lowest: -6.9, low: -6.9, high: 2.7, highest: 6.9, slope: 6.0, close: 0.3 };
        for zero in [3.0, 3.4] {
            let excess = |at: f64| if at < 4.0 { -5.0 * (at - zero) } else { NOT_WRITTEN };
            let found = search.run(|_, at| Ok::<_, ()>((excess(at), at))).unwrap();
            assert!(
                found.excess <= 0.0 && found.what >= zero && found.tries <= MOST,
                "{zero}: {}",
                found.what
            );
        }
        let search = Search { lowest: -6.9, low: -2.7, high: 6.9, highest: 6.9, slope: 0.25, close: 0.02 };
        let excess = |at: f64| if at > -4.0 { -0.3 * (at + 5.0) } else { NOT_WRITTEN };
        let found = search.run(|_, at| Ok::<_, ()>((excess(at), at))).unwrap();
        assert!(found.excess <= 0.0 && found.what < -2.7, "{}", found.what);
    }

    /// On a plateau many coarsenesses give one PSNR: the coarsest of those tried takes fewest bytes.
    #[test]
    fn of_places_that_fit_alike_the_least_is_taken() {
        let search = Search { lowest: -6.9, low: -6.9, high: 2.7, highest: 6.9, slope: 6.0, close: 0.3 };
        let excess = |at: f64| if at < 1.0 { 5.0 } else { -2.0 };
        let mut fitting = Vec::new();
        let found = search.run(|_, at| {
            fitting.extend((at >= 1.0).then_some(at));
            Ok::<_, ()>((excess(at), at))
        });
        let least = fitting.iter().copied().fold(f64::INFINITY, f64::min);
        assert!(fitting.len() > 1 && fitting[0] > least, "{fitting:?}");
        assert_eq!(found.unwrap().what, least);
    }

    #[test]
    fn targets_beyond_the_usual_coarseness_are_met() {
        let reached = encoded(Target::PsnrDb(90.0)).unwrap().report.reached.unwrap();
        assert!(reached.value >= 90.0 && reached.encodes <= MOST, "{reached:?}");
        assert!((COARSENESS.0..USUAL_FINEST).contains(&reached.coarseness), "{reached:?}");
        // No coarseness makes that many bytes, and none of those tried may spoil the scene.
        let fine = encoded(Target::Bytes(100_000_000)).unwrap();
        let reached = fine.report.reached.unwrap();
        assert!(reached.coarseness < USUAL_FINEST && fine.report.ledger.saturated == 0, "{reached:?}");
        let evaluator = Evaluator::validation(&scene(), spread(0, 4, FRAMES)).unwrap();
        assert!(evaluator.whole(&fine.stream).unwrap() > 75.0);
    }

    #[test]
    fn steps_of_motion_lead_to_a_size_and_leave_canonical_values_alone() {
        let options = synth::SynthOptions {
            gaussians: 1500,
            frames: 12,
            kind: SynthKind::Figure,
            ..Default::default()
        };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
        let first = crate::encode::encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let bytes = first.report.ledger.wire();
        for share in [0.95, 1.05] {
            let target = Some(Target::Bytes((share * bytes) as u64));
            let to_size = EncodeOptions { target, ..options.clone() };
            let found =
                reencode_to_size(&scene, &first.decisions, &to_size, &crate::encode::no_progress).unwrap();
            let ratio = found.report.ledger.wire() / (share * bytes);
            assert!((1.0 - CLOSE..=1.0).contains(&ratio), "{share}: {ratio}");
            assert_eq!(found.order, first.order);
            let canonical = |encoded: &Encoded| {
                let shares = encoded.report.ledger.shares.iter();
                shares.filter(|s| !s.attribute.contains("motion") && s.attribute != "track").count()
            };
            assert_eq!(canonical(&found), canonical(&first));
        }
        let few = EncodeOptions { target: Some(Target::Bytes(1000)), ..options.clone() };
        let error =
            reencode_to_size(&scene, &first.decisions, &few, &crate::encode::no_progress).unwrap_err();
        assert!(matches!(error, EncodeError::UnreachableByMotion { .. }), "{error}");
        // Without a size nothing is sought.
        let again =
            reencode_to_size(&scene, &first.decisions, &options, &crate::encode::no_progress).unwrap();
        assert_eq!(again.report.reached, None);
    }
}
