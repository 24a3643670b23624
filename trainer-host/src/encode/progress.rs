//! Reports progress to a function of the caller's, which may stop the work.

use std::ops::ControlFlow;

use super::EncodeError;

/// Hears how far the encoder is, stage name and share done, 0..=1, and says whether it goes on. It is called
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

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;
    use crate::{
        encode::{EncodeOptions, encode},
        import::{Limits, synth},
    };

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
