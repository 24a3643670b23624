//! Reports progress to a function of the caller's, which may stop the work.

use std::{
    ops::ControlFlow,
    sync::atomic::{AtomicU64, Ordering},
};

use super::EncodeError;

/// Hears how far the encoder is, and says whether it goes on: what is at hand, a stage or an encoding of a
/// search for a target, and the share of the whole work that is done, 0..=1, which never falls. It is called
/// on the thread that encodes.
pub type Progress<'p> = &'p (dyn Fn(&'static str, f64) -> ControlFlow<()> + Sync);

/// For callers that want neither to hear nor to stop.
pub fn no_progress(_stage: &'static str, _share: f64) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Tells `progress` that `stage` has come to `share`.
///
/// # Errors
/// [`EncodeError::Stopped`] if that is where it ends.
pub(super) fn report(progress: Progress<'_>, stage: &'static str, share: f64) -> Result<(), EncodeError> {
    match progress(stage, share) {
        ControlFlow::Continue(()) => Ok(()),
        ControlFlow::Break(()) => Err(EncodeError::Stopped { stage }),
    }
}

/// `progress` for a part of the work: from share `from` of the whole to share `to`.
pub(super) fn part(
    progress: Progress<'_>,
    from: f64,
    to: f64,
) -> impl Fn(&'static str, f64) -> ControlFlow<()> + Sync {
    move |stage, share| progress(stage, from + (to - from) * share)
}

/// `progress` for a part of the work whose stages are all called `name`.
pub(super) fn named(
    progress: Progress<'_>,
    name: &'static str,
) -> impl Fn(&'static str, f64) -> ControlFlow<()> + Sync {
    move |_, share| progress(name, share)
}

/// `progress` that hears no share below one that it has heard: what is done over, as with blocks that did not
/// fit a packet, is not counted twice.
pub(super) fn rising(progress: Progress<'_>) -> impl Fn(&'static str, f64) -> ControlFlow<()> + Sync {
    // Numbers of at least 0 are ordered as their bits are.
    let most = AtomicU64::new(0);
    move |stage, share| {
        let share = share.clamp(0.0, 1.0).to_bits();
        let before = most.fetch_max(share, Ordering::Relaxed);
        progress(stage, f64::from_bits(before.max(share)))
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::{
        encode::{EncodeOptions, Encoded, Target, encode},
        import::{Limits, synth},
    };

    /// What is heard of encoding a small scene, and what comes of it.
    fn heard(options: &EncodeOptions) -> (Vec<(&'static str, f64)>, Encoded) {
        let scene = synth::SynthOptions { gaussians: 1000, frames: 2, ..synth::SynthOptions::default() };
        let scene = synth::make(&scene, &Limits::default()).unwrap();
        let heard = Mutex::new(Vec::new());
        let listen = |stage, share| {
            heard.lock().unwrap().push((stage, share));
            ControlFlow::Continue(())
        };
        let encoded = encode(&scene, options, &listen).unwrap();
        (heard.into_inner().unwrap(), encoded)
    }

    #[test]
    fn shares_rise_from_stage_to_stage_and_end_at_all_of_the_work() {
        let paper = EncodeOptions { pictures: 0, ..EncodeOptions::paper() };
        for options in [EncodeOptions::default(), paper] {
            let (heard, _) = heard(&options);
            assert!(heard.is_sorted_by(|a, b| a.1 <= b.1), "{heard:?}");
            assert_eq!((heard[0], heard[heard.len() - 1]), (("analyse", 0.0), ("done", 1.0)));
            let firsts: Vec<f64> = heard.chunk_by(|a, b| a.0 == b.0).map(|stage| stage[0].1).collect();
            assert!(
                firsts.len() > 4 && firsts.is_sorted_by(|a, b| a < b),
                "each begins further on: {heard:?}"
            );
        }
    }

    #[test]
    fn a_search_for_a_target_says_which_encoding_it_is_at() {
        let plain = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
        let half = heard(&plain).1.stream.wire_bytes() as u64 / 2;
        for target in [Target::Bytes(half), Target::PsnrDb(30.0)] {
            let (heard, encoded) = heard(&EncodeOptions { target: Some(target), ..plain.clone() });
            let encodes = encoded.report.reached.unwrap().encodes;
            assert!(heard.is_sorted_by(|a, b| a.1 <= b.1), "{heard:?}");
            assert_eq!(heard[heard.len() - 1], ("done", 1.0));
            let names: Vec<&str> = heard.chunk_by(|a, b| a.0 == b.0).map(|stage| stage[0].0).collect();
            let tries = (1..=encodes).map(|k| format!("encoding {k} of at most 8"));
            let expected = std::iter::once("analyse".to_owned()).chain(tries);
            assert_eq!(names, expected.chain(["done".to_owned()]).collect::<Vec<_>>(), "{encodes}");
            assert!(encodes > 1, "a search: {encodes}");
        }
    }

    #[test]
    fn what_is_done_over_is_not_counted_twice() {
        let heard = Mutex::new(Vec::new());
        let listen = |_: &'static str, share: f64| {
            heard.lock().unwrap().push(share);
            ControlFlow::Continue(())
        };
        {
            let rising = rising(&listen);
            let half = part(&rising, 0.5, 1.0);
            for share in [0.0, 0.5, 0.25, 1.0] {
                assert!(named(&half, "a")("b", share).is_continue());
            }
        }
        assert_eq!(heard.into_inner().unwrap(), [0.5, 0.75, 0.75, 1.0]);
    }

    #[test]
    fn work_ends_at_the_stage_at_which_it_is_stopped() {
        let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..synth::SynthOptions::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
        let stages = Mutex::new(Vec::new());
        let listen = |stage, _| {
            stages.lock().unwrap().push(stage);
            ControlFlow::Continue(())
        };
        encode(&scene, &options, &listen).unwrap();
        for wanted in stages.into_inner().unwrap() {
            let stop = |stage, _| {
                if stage == wanted { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
            };
            let error = encode(&scene, &options, &stop).unwrap_err();
            assert_eq!(error, EncodeError::Stopped { stage: wanted });
        }
    }
}
