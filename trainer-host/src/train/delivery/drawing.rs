//! Draws states and differentiates their pictures, on the processor or on a graphics device.

use rayon::prelude::*;
use render_host::{
    Backend, Camera, Differentiator, FrameRenderer, Gradients, Image, Loss, Renderer, Settings, Splats,
};

use super::error::DeliveryError;

/// States that are at work at once on the processor, on any number of threads.
const AT_ONCE: usize = 4;
/// The same on a graphics device: it has one to draw while the processor evaluates the loss of the other.
const IN_FLIGHT: usize = 2;

/// Which device draws the states of a fine-tuning.
#[derive(Debug)]
pub(super) enum Drawing {
    /// The processor. Buffers of a state go when it is done.
    Cpu,
    /// A graphics device, with renderers whose buffers stay.
    Gpu(Vec<StateRenderer>),
}

/// Draws a state or differentiates its picture, with buffers of its own. What it gives does not depend on
/// what it drew before.
#[derive(Debug, Default)]
pub(super) struct StateRenderer {
    differentiator: Differentiator,
    /// `None` on the processor, where a picture is drawn with buffers that go.
    frames: Option<FrameRenderer>,
}

impl Drawing {
    /// Drawing by `backend`.
    ///
    /// # Errors
    /// The graphics device has no memory.
    pub(super) fn on(backend: &Backend) -> Result<Self, DeliveryError> {
        if matches!(backend, Backend::Cpu) {
            return Ok(Self::Cpu);
        }
        let renderer = |_: usize| -> Result<StateRenderer, DeliveryError> {
            let (differentiator, frames) = (backend.differentiator()?, backend.frames()?);
            Ok(StateRenderer { differentiator, frames: Some(frames) })
        };
        (0..IN_FLIGHT).map(renderer).collect::<Result<Vec<_>, _>>().map(Self::Gpu)
    }

    /// Calls `make` with a renderer and each of the numbers `states`, several at once, and `take` with what
    /// came of each, in their order. No more results are in memory than states are at work.
    ///
    /// # Errors
    /// What `make` refuses.
    pub(super) fn for_each<T: Send>(
        &mut self,
        states: &[usize],
        make: impl Fn(&mut StateRenderer, usize) -> Result<T, DeliveryError> + Sync,
        mut take: impl FnMut(usize, T),
    ) -> Result<(), DeliveryError> {
        let at_once = if let Self::Gpu(renderers) = self { renderers.len() } else { AT_ONCE };
        for states in states.chunks(at_once.max(1)) {
            let found: Result<Vec<T>, DeliveryError> = match self {
                Self::Cpu => {
                    states.par_iter().map(|&state| make(&mut StateRenderer::default(), state)).collect()
                }
                Self::Gpu(renderers) => {
                    let pairs = states.par_iter().zip(renderers.par_iter_mut());
                    pairs.map(|(&state, renderer)| make(renderer, state)).collect()
                }
            };
            states.iter().zip(found?).for_each(|(&state, found)| take(state, found));
        }
        Ok(())
    }
}

impl StateRenderer {
    /// The picture of `splats` as `camera` sees them.
    ///
    /// # Errors
    /// A setting out of range or one that the graphics device does not have, or no memory on it.
    pub(super) fn picture(
        &mut self,
        splats: &Splats<'_>,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Image, DeliveryError> {
        match &mut self.frames {
            Some(frames) => Ok(frames.render(splats, camera, settings)?.image.clone()),
            None => Ok(Renderer::new().render(splats, camera, settings)?.image),
        }
    }

    /// The same picture with its `loss`, and the gradient of that by everything it was made from.
    ///
    /// # Errors
    /// As [`StateRenderer::picture`]; a loss made for another size of picture.
    pub(super) fn gradients(
        &mut self,
        splats: &Splats<'_>,
        camera: &Camera,
        settings: &Settings,
        loss: &dyn Loss,
    ) -> Result<Gradients, DeliveryError> {
        let mut found = Gradients::default();
        self.differentiator.differentiate(splats, camera, settings, loss, &mut found, None)?;
        Ok(found)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use render_host::DeviceChoice;

    use super::*;

    /// The graphics device; `None`, with a notice, where there is none. A build server must have one.
    pub(in crate::train::delivery) fn gpu() -> Option<Backend> {
        match Backend::open(DeviceChoice::Gpu) {
            Ok(backend) => Some(backend),
            Err(error) => {
                let excused = !Backend::HAS_GPU || std::env::var("CI").as_deref() != Ok("true");
                assert!(excused, "{error}");
                eprintln!("SKIPPED: {error}");
                None
            }
        }
    }

    #[test]
    fn results_come_in_the_order_of_states_and_a_refusal_ends_them() {
        let drawings = [Some(Drawing::Cpu), gpu().map(|gpu| Drawing::on(&gpu).unwrap())];
        for mut drawing in drawings.into_iter().flatten() {
            let states: Vec<usize> = (0..11).rev().collect();
            let mut seen = Vec::new();
            drawing.for_each(&states, |_, s| Ok(10 * s), |s, found| seen.push((s, found))).unwrap();
            assert!(seen.iter().copied().eq(states.iter().map(|&s| (s, 10 * s))), "{seen:?}");

            let mut taken = 0;
            let refused = |s: usize| DeliveryError::Diverged { update: s, found: 0.0 };
            let make = |_: &mut StateRenderer, s: usize| if s == 4 { Err(refused(s)) } else { Ok(()) };
            let error = drawing.for_each(&states, make, |_, ()| taken += 1).unwrap_err();
            assert!(error.to_string().contains("update 4") && taken < 7, "{error}, {taken}");
        }
        assert!(matches!(Drawing::on(&Backend::Cpu), Ok(Drawing::Cpu)));
    }
}
