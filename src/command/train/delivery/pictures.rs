//! Finds the photographs that a fine-tuning is towards, and those that its candidates are compared on.

use std::borrow::Cow;

use anyhow::{Context, Result, bail};
use trainer_host::{
    Scene,
    train::{
        Dataset, PosedPhotograph, Views,
        delivery::{DeliveryOptions, Reference},
    },
};

use super::super::trained::Trained;
use crate::args::train::Train;

/// Sides of pictures are reduced to about this many pixels.
const SIDE: u32 = 400;

/// The pictures that a fine-tuning is towards.
#[derive(Clone, Copy)]
pub(in super::super) struct Pictures<'a> {
    pub(in super::super) dataset: &'a Dataset,
    pub(in super::super) background: [f32; 3],
    /// Longest side, pixels.
    pub(in super::super) max_side: u32,
    /// What was trained on them, where something was: it knows the exposures of their cameras.
    pub(in super::super) trained: Option<&'a Trained>,
}

/// Pictures for updates, and those for validation alone; where there are none of these, some of the former
/// are.
pub(super) struct References {
    pub(super) training: Vec<Reference>,
    pub(super) validation: Vec<Reference>,
}

/// Photographs of `views` that show a frame of a clip of so many `frames`; the dataset has photographs of
/// so many `instants`. Where a clip has fewer frames than there are instants, photographs from between two
/// frames show what no frame does.
fn of_frames<Split>(views: &Views<Split>, frames: usize, instants: usize) -> Result<Cow<'_, Views<Split>>>
where
    Views<Split>: Clone,
{
    let shows = |view: &&PosedPhotograph| shows_a_frame(view.time, frames, instants);
    let all = views.photographs();
    if all.iter().all(|view| shows(&view)) {
        return Ok(Cow::Borrowed(views));
    }
    Ok(Cow::Owned(Views::new(all.iter().filter(shows).cloned().collect())?))
}

/// Whether `time` is that of a frame of a clip of so many `frames`, to half the distance between two of so
/// many `instants`, evenly spread, that there are photographs of.
fn shows_a_frame(time: f32, frames: usize, instants: usize) -> bool {
    let (time, last) = (f64::from(time), frames.saturating_sub(1) as f64);
    let frame = if last > 0.0 { (time * last).round() / last } else { 0.0 };
    (time - frame).abs() * instants.saturating_sub(1) as f64 <= 0.5 + 1e-6
}

/// Refuses pictures that are too few for `options`, and says how many were left out.
pub(super) fn check(
    args: &Train,
    dataset: &Dataset,
    options: &DeliveryOptions,
    frames: usize,
) -> Result<Option<String>> {
    let shows = |view: &&PosedPhotograph| shows_a_frame(view.time, frames, dataset.frames);
    let all = dataset.train.photographs();
    let shown = all.iter().filter(shows).count();
    let has_own = dataset.validation.photographs().iter().any(|view| shows(&view));
    let is_validated = options.validation.candidates > 0 || args.choose_rank;
    let needed = if is_validated && !has_own { options.validation.every } else { 1 };
    let found = shown.min(args.references);
    if found < needed {
        let of = if shown < all.len() { format!(" at times of the {frames} frames") } else { String::new() };
        bail!("{found} training views{of}; at least {needed}, one of them for validation, are needed");
    }
    Ok((shown < all.len()).then(|| {
        format!(
            "--delivery: compares with {shown} of {} training photographs, as the others are from between \
             two of the {frames} frames",
            all.len()
        )
    }))
}

impl Pictures<'_> {
    /// Up to `count` training views as pictures of frames of `scene`, evenly spread, and for validation one
    /// in `every` as many validation views, where there are any.
    pub(super) fn references(&self, scene: &Scene, count: usize, every: usize) -> Result<References> {
        let (frames, dataset) = (scene.frames(), self.dataset);
        let training = of_frames(&dataset.train, frames, dataset.frames)?.sample(count);
        let validation =
            of_frames(&dataset.validation, frames, dataset.frames)?.sample(count.div_ceil(every.max(1)));
        let of = |view: &PosedPhotograph| match self.trained {
            Some(trained) => self.reference(&trained.neutral(view), scene),
            None => self.reference(view, scene),
        };
        Ok(References {
            training: training.photographs().iter().map(of).collect::<Result<_>>()?,
            validation: validation.photographs().iter().map(of).collect::<Result<_>>()?,
        })
    }

    /// A view that nothing was trained on, the middle one; of the training split where there is no other.
    pub(super) fn unseen(&self, scene: &Scene) -> Result<Reference> {
        let views = [self.dataset.test.photographs(), self.dataset.train.photographs()];
        let views = views.into_iter().find(|views| !views.is_empty()).unwrap_or_default();
        let view = views.get(views.len() / 2).context("there are no views")?;
        self.reference(view, scene)
    }

    /// `view` as a picture of a frame of `scene`.
    fn reference(&self, view: &PosedPhotograph, scene: &Scene) -> Result<Reference> {
        let (width, height) = (view.camera.width(), view.camera.height());
        let (shortest, longest) = (width.min(height), width.max(height));
        // By a whole number, as photographs are reduced; one that leaves something of the shorter side.
        let by = (shortest / SIDE).max(longest.div_ceil(self.max_side)).clamp(1, shortest);
        Reference::of_photograph(view, scene, by, self.background).context("--references")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_from_between_two_frames_show_none() {
        let shown = |frames: usize, instants: usize| -> Vec<usize> {
            let last = instants.saturating_sub(1).max(1) as f32;
            (0..instants).filter(|&at| shows_a_frame(at as f32 / last, frames, instants)).collect()
        };
        assert_eq!(shown(10, 10).len(), 10);
        assert_eq!(shown(30, 10).len(), 10, "each is near to one of more frames");
        assert_eq!(shown(4, 10), [0, 3, 6, 9]);
        assert_eq!(shown(3, 10), [0, 4, 5, 9], "4.5 is as far from both");
        assert_eq!(shown(1, 10), [0]);
        assert_eq!(shown(1, 1), [0]);
    }
}
