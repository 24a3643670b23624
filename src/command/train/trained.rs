//! What a training led to: one model, or several that follow one another.

use std::{borrow::Cow, collections::BTreeMap, ops::Range};

use anyhow::{Context, Result};
use codec_core::Footprint;
use trainer_host::{
    Instant, Scene,
    encode::Decisions,
    train::{Dataset, DynamicScene, Model, PosedPhotograph, Pruning, TrainOptions, Trainer, Training, Views},
};

use crate::args::train::Train;

/// What a training led to.
pub(super) struct Trained {
    /// What is encoded.
    pub(super) scene: Scene,
    pub(super) steps: u32,
    /// Gaussians of all epochs, those of them that stand still, and nodes.
    pub(super) gaussians: usize,
    pub(super) standing: usize,
    pub(super) nodes: usize,
    pub(super) options: TrainOptions,
    /// As [`Trainer::reduced`].
    pub(super) reduced: u32,
    /// Choices of the encoder that the training has made its own.
    pub(super) decisions: Option<Decisions>,
    pub(super) prunings: Vec<Pruning>,
    /// By place of a camera (bits of its coordinates), factors of r g b and offsets that turn a picture of
    /// the scene into one that was taken there; none where none were learnt.
    pub(super) exposures: BTreeMap<[u64; 3], [[f32; 3]; 2]>,
    pub(super) estimated_bytes: Option<f64>,
    /// Per epoch, what the training went on with, that as a receiver has it, and what it began with.
    models: Vec<[Model; 3]>,
}

impl Trained {
    /// What `trainer` led to on `dataset`, in as many frames as `args` say.
    ///
    /// # Errors
    /// A Gaussian that is not finite, or another dataset than that of the training.
    pub(super) fn of(trainer: &Trainer, dataset: &Dataset, args: &Train) -> Result<Self> {
        let frames = args.frames.unwrap_or(dataset.frames);
        let views = dataset.train.photographs().iter().enumerate();
        let exposures =
            views.filter_map(|(index, view)| Some((place(view), trainer.exposure_of(index)?))).collect();
        let model = trainer.model().into_owned();
        let mut scene = model.scene(frames, trainer.frames_per_second())?;
        scene.up = dataset.up;
        Ok(Self {
            scene,
            steps: trainer.steps(),
            gaussians: model.gaussians(),
            standing: model.standing(),
            nodes: model.nodes(),
            options: trainer.options().clone(),
            reduced: trainer.reduced(),
            decisions: trainer.decisions()?,
            prunings: trainer.prunings().to_vec(),
            exposures,
            estimated_bytes: trainer.estimated_bytes(),
            models: vec![[model, trainer.shown(), Trainer::start(dataset, trainer.options())?]],
        })
    }

    /// The same, with `next` after it.
    ///
    /// # Errors
    /// A scene of another frame rate.
    pub(super) fn followed_by(self, next: Self) -> Result<Self> {
        let epochs = [self.scene.epochs(), next.scene.epochs()].concat();
        let mut scene = Scene::new(epochs, self.scene.frames_per_second()).context("epochs")?;
        (scene.up, scene.footprint) = (self.scene.up, self.scene.footprint);
        let decisions = match (self.decisions, next.decisions) {
            (Some(before), Some(after)) => before.followed_by(after),
            _ => None,
        };
        Ok(Self {
            scene,
            steps: self.steps + next.steps,
            gaussians: self.gaussians + next.gaussians,
            standing: self.standing + next.standing,
            nodes: self.nodes + next.nodes,
            options: self.options,
            reduced: self.reduced,
            decisions,
            prunings: [self.prunings, next.prunings].concat(),
            exposures: self.exposures.into_iter().chain(next.exposures).collect(),
            estimated_bytes: self.estimated_bytes.zip(next.estimated_bytes).map(|(a, b)| a + b),
            models: [self.models, next.models].concat(),
        })
    }

    /// `view` as a camera without an exposure of its own would have taken it: what the scene, which is the
    /// mean of all cameras, is to be compared with.
    pub(super) fn neutral<'v>(&self, view: &'v PosedPhotograph) -> Cow<'v, PosedPhotograph> {
        match self.exposures.get(&place(view)) {
            Some(exposure) => Cow::Owned(view.without_exposure(*exposure)),
            None => Cow::Borrowed(view),
        }
    }

    /// All of `views` so.
    ///
    /// # Errors
    /// Never for views that fit together.
    pub(super) fn neutral_views<'v>(&self, views: &'v Views<Training>) -> Result<Cow<'v, Views<Training>>> {
        if self.exposures.is_empty() {
            return Ok(Cow::Borrowed(views));
        }
        let neutral = views.photographs().iter().map(|view| self.neutral(view).into_owned());
        Ok(Cow::Owned(Views::new(neutral.collect())?))
    }

    /// The scene as the training went on with it.
    pub(super) fn exact(&self) -> impl DynamicScene {
        self.one_after_another(0)
    }

    /// The scene as a receiver has it, but for what is lost of its motion.
    pub(super) fn shown(&self) -> impl DynamicScene {
        self.one_after_another(1)
    }

    /// The scene before the first step.
    pub(super) fn begun(&self) -> impl DynamicScene {
        self.one_after_another(2)
    }

    /// The same at the times of the frames that are encoded alone, as a receiver has it but for what is lost
    /// of its motion.
    pub(super) fn shown_in_frames(&self) -> impl DynamicScene {
        InFrames { scene: self.one_after_another(1), frames: self.scene.frames() }
    }

    fn one_after_another(&self, form: usize) -> OneAfterAnother<'_> {
        let mut start = 0;
        let parts = self.scene.epochs().iter().zip(&self.models).map(|(epoch, models)| {
            start += epoch.frames();
            (start - epoch.frames()..start, &models[form])
        });
        OneAfterAnother(parts.collect())
    }
}

/// Where the photograph `view` was taken from.
fn place(view: &PosedPhotograph) -> [u64; 3] {
    view.camera.centre().map(f64::to_bits)
}

/// A scene of which so many frames are shown, evenly spread over the clip: of every time the nearest.
struct InFrames<S> {
    scene: S,
    frames: usize,
}

impl<S: DynamicScene> DynamicScene for InFrames<S> {
    fn pose(&self, time: f32, out: &mut Instant) {
        let last = self.frames.saturating_sub(1) as f64;
        let nearest = if last > 0.0 { (f64::from(time) * last).round() / last } else { 0.0 };
        self.scene.pose(nearest as f32, out);
    }

    fn footprint(&self) -> Footprint {
        self.scene.footprint()
    }
}

/// Models and the frames that each is shown in.
struct OneAfterAnother<'a>(Vec<(Range<usize>, &'a Model)>);

impl DynamicScene for OneAfterAnother<'_> {
    fn pose(&self, time: f32, out: &mut Instant) {
        if let [(_, model)] = self.0[..] {
            return model.pose(time, out);
        }
        let frames = self.0.last().map_or(0, |(frames, _)| frames.end);
        let at = f64::from(time) * frames.saturating_sub(1) as f64;
        // Between the last frame of one and the first of the next the nearer of both is shown.
        let Some((frames, model)) = self.0.iter().find(|(frames, _)| at < frames.end as f64 - 0.5) else {
            return;
        };
        let last = frames.len().saturating_sub(1).max(1) as f64;
        model.pose(((at - frames.start as f64) / last).clamp(0.0, 1.0) as f32, out);
    }

    fn footprint(&self) -> Footprint {
        self.0.first().map_or(Footprint::default(), |(_, model)| model.footprint())
    }
}

#[cfg(test)]
mod tests {
    use codec_core::Gaussian;

    use super::*;

    /// A scene that says which time it is shown at.
    struct ByTime;

    impl DynamicScene for ByTime {
        fn pose(&self, time: f32, out: &mut Instant) {
            out.gaussians = vec![Gaussian {
                position: [time; 3],
                scale: [1.0; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity: 0.5,
                sh0: [0.0; 3],
            }];
        }

        fn footprint(&self) -> Footprint {
            Footprint::default()
        }
    }

    #[test]
    fn of_every_time_the_nearest_frame_is_shown() {
        let at = |frames: usize, time: f32| {
            let mut instant = Instant::default();
            InFrames { scene: ByTime, frames }.pose(time, &mut instant);
            instant.gaussians[0].position[0]
        };
        assert_eq!([0.0, 0.2, 0.3, 0.7, 0.8, 1.0].map(|t| at(3, t)), [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]);
        assert_eq!([at(1, 0.2), at(1, 0.8), at(2, 0.8), at(101, 0.25)], [0.0, 0.0, 1.0, 0.25]);
    }
}
