//! Measures what damaged states look like: FLIP, LPIPS and flicker of each state and of the complete one.

use anyhow::{Context, Result};
use rayon::prelude::*;
use render_host::{
    Image,
    metric::{self, Lpips},
};
use trainer_host::train::delivery::{DeliveredScene, FineTuned, Masks, Reference};

use super::super::delivery::Study;
use crate::setup::Setup;

/// One measure of the complete state and of each damaged one.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) complete: f64,
    pub(super) states: Vec<f64>,
}

impl Measured {
    /// Mean over states.
    pub(super) fn mean(&self) -> f64 {
        crate::figures::mean(&self.states)
    }
}

/// What states look like, each a mean over test pictures; less is better.
#[derive(Clone, Debug)]
pub(super) struct Appearance {
    /// Of the first states only.
    pub(super) flip: Measured,
    /// Of as many; nothing without weights.
    pub(super) lpips: Option<Measured>,
    /// Where a test picture has a next one, times 1000.
    pub(super) flicker: Measured,
}

/// Perceptual measures, which take longest.
pub(super) struct Perceptual {
    /// Weights of LPIPS, if there are any.
    pub(super) network: Option<Lpips>,
    /// How many states, the first ones.
    pub(super) states: usize,
}

/// Most states that `--quick` measures so.
const QUICK_STATES: usize = 4;

impl Perceptual {
    /// With the weights that `setup` names or that lie in the data folder.
    ///
    /// # Errors
    /// A file that holds none.
    pub(super) fn of(setup: &Setup) -> Result<Self> {
        let read = |path: std::path::PathBuf| {
            let failed = || format!("weights of LPIPS: {}", path.display());
            Lpips::from_safetensors(&std::fs::read(&path).with_context(failed)?).with_context(failed)
        };
        let most = if setup.quick { QUICK_STATES } else { usize::MAX };
        let network = setup.lpips_weights().map(read).transpose()?;
        Ok(Self { network, states: setup.perceptual_states.min(most) })
    }
}

/// Sums of one picture after another: the complete state first, then the others.
#[derive(Debug, Default)]
struct Sums(Vec<f64>);

impl Sums {
    fn add(&mut self, values: &[f64]) {
        self.0.resize(values.len(), 0.0);
        self.0.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
    }

    fn means(&self, count: usize) -> Measured {
        let mut means = self.0.iter().map(|sum| sum / count.max(1) as f64);
        Measured { complete: means.next().unwrap_or(f64::NAN), states: means.collect() }
    }
}

impl Appearance {
    /// What the states of `masks` look like of a trained scene.
    ///
    /// # Errors
    /// States of another stream.
    pub(super) fn of(
        study: &Study,
        tuned: &FineTuned,
        masks: &Masks,
        perceptual: &Perceptual,
    ) -> Result<Self> {
        let scene = DeliveredScene::new(&tuned.scene, &tuned.decisions)?;
        let mut states = scene.complete();
        states.states.extend(masks.states.iter().cloned());
        let [mut flip, mut lpips, mut flicker] = [const { Sums(Vec::new()) }; 3];
        let mut pairs = 0;
        for (reference, following) in study.test.iter().zip(&study.following) {
            let Reference { frame, camera, background, picture } = reference;
            let images = scene.pictures(&states, *frame, camera, *background)?;
            let first = &images[..images.len().min(perceptual.states + 1)];
            flip.add(&each(first, |image| {
                Ok(metric::flip(image, picture, metric::flip::PIXELS_PER_DEGREE)?.mean)
            })?);
            if let Some(network) = &perceptual.network {
                lpips.add(&each(first, |image| Ok(network.distance(image, picture)?))?);
            }
            if let Some(following) = following {
                let next = scene.pictures(&states, frame + 1, camera, *background)?;
                flicker.add(&flickers(&images, &next, [picture, following])?);
                pairs += 1;
            }
        }
        let pictures = study.test.len();
        let lpips = perceptual.network.as_ref().map(|_| lpips.means(pictures));
        Ok(Self { flip: flip.means(pictures), lpips, flicker: flicker.means(pairs) })
    }
}

/// `measure` of each of `images`.
fn each(images: &[Image], measure: impl Fn(&Image) -> Result<f64> + Send + Sync) -> Result<Vec<f64>> {
    images.par_iter().map(measure).collect()
}

/// Flicker of each state from its picture to its next, times 1000, beside that of two `references`.
fn flickers(images: &[Image], next: &[Image], references: [&Image; 2]) -> Result<Vec<f64>> {
    let references = references.map(Image::clone);
    let of = |(image, next): (&Image, &Image)| {
        Ok(1000.0 * metric::flicker(&[image.clone(), next.clone()], &references)?)
    };
    images.par_iter().zip(next).map(of).collect()
}

#[cfg(test)]
mod tests {
    use trainer_host::train::delivery::{DeliveryOptions, LossModel, Variant};

    use super::*;
    use crate::{experiment::delivery::Size, setup::Setup};

    /// States that lost more look worse by every measure, and one that lost nothing like the complete one.
    #[test]
    fn damage_shows_in_every_measure() {
        let setup = Setup::new(None, true, dgs::pipeline::Quiet(true));
        let size = Size { updates: 1, worlds: 2, states: 6, frames: 3, ..Size::of(&setup) };
        let study = Study::make(size).unwrap();
        let options = DeliveryOptions { updates: 1, ..study.options(Variant::Reconstruction) };
        let tuned = study.train(&options).unwrap();
        let look = |probability, states| {
            let masks = study.masks(LossModel::Iid { probability }).unwrap();
            Appearance::of(&study, &tuned, &masks, &Perceptual { network: None, states }).unwrap()
        };
        let (none, some, many) = (look(0.0, 6), look(0.1, 6), look(0.5, 6));
        let few = look(0.5, 2);
        assert_eq!((&few.flip.states[..], few.flicker), (&many.flip.states[..2], many.flicker.clone()));
        let measures: [fn(&Appearance) -> Measured; 2] = [|a| a.flip.clone(), |a| a.flicker.clone()];
        for of in measures {
            let (none, some, many) = (of(&none), of(&some), of(&many));
            assert_eq!(none.states, [none.complete; 6]);
            assert_eq!((some.states.len(), some.complete), (6, none.complete));
            assert!(some.mean() > none.complete && many.mean() > some.mean(), "{none:?} {some:?} {many:?}");
        }
        assert!(none.lpips.is_none());
    }
}
