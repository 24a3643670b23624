//! Times whole steps of a trainer, and the parts of them that can be taken by themselves.

use anyhow::{Context, Result};
use render_host::{Differentiator, Gradients, Settings, Splats, adjoint::loss::photograph::PhotographLoss};
use trainer_host::{
    Instant, Scene,
    train::{
        Dataset, Schedule, TrainOptions, Trainer,
        dataset::rendered::{RenderedOptions, rendered},
    },
};

use super::measure::{WEIGHTS, WHITE, ms};
use crate::figures::{Bench, Figure, median};

/// As the protocol of the bench says it.
pub(super) const PROTOCOL: &str = "step: a trainer with as many Gaussians and 512 nodes on renders of the \
    clip, at half of its training, every eighth step, which shows the whole photograph, on one thread; pose: \
    motion forward; picture: picture, loss, gradients and statistics of the same view; update: what is left \
    where nothing moves (gradients of attributes, Adam, checks); motion_backward: what is left of a moving \
    one beyond that";
/// How far the training is: with all nodes, and Gaussians still added.
const PROGRESS: f64 = 0.5;
/// One step of so many shows the whole photograph.
const WHOLE_EVERY: u32 = 8;
/// Cameras of the renders.
const CAMERAS: usize = 2;

/// Medians of the parts of a step, ms.
struct Parts {
    step: f64,
    pose: f64,
    picture: f64,
}

impl Parts {
    /// What the step takes besides.
    fn rest(&self) -> f64 {
        self.step - self.pose - self.picture
    }
}

/// A row per part of a step.
///
/// # Errors
/// What the trainer or the renderer refuses.
pub(super) fn stages(
    bench: &mut Bench,
    scene: &Scene,
    side: u32,
    gaussians: usize,
    runs: usize,
) -> Result<()> {
    let dataset = rendered(
        scene,
        "figure",
        &RenderedOptions { cameras: CAMERAS, test_cameras: 1, side, ..Default::default() },
    )?;
    let options = |nodes| TrainOptions {
        initial_gaussians: gaussians,
        max_gaussians: gaussians,
        nodes,
        max_side: side,
        background: WHITE,
        schedule: Schedule { sizes: [0.0; 3], ..Schedule::default() },
        ..TrainOptions::default()
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().context("a thread")?;
    let (moving, still) = pool.install(|| -> Result<(Parts, Parts)> {
        Ok((parts(&dataset, &options(512), runs)?, parts(&dataset, &options(0), runs)?))
    })?;
    for (key, value) in [
        ("step", moving.step),
        ("step.pose", moving.pose),
        ("step.picture", moving.picture),
        ("step.motion_backward", moving.rest() - still.rest()),
        ("step.update", still.rest()),
        ("step.nothing_moves", still.step),
    ] {
        bench.push(Figure::new(format!("{side}.{key}"), value, "ms").runs(runs));
    }
    Ok(())
}

/// The parts of steps on `dataset`, all on this thread.
fn parts(dataset: &Dataset, options: &TrainOptions, runs: usize) -> Result<Parts> {
    let mut trainer = Trainer::new(dataset, options)?;
    let [mut step, mut pose, mut picture] = [const { Vec::new() }; 3];
    let (mut instant, mut out, mut statistics) = (Instant::default(), Gradients::default(), Vec::new());
    let mut differentiator = Differentiator::default();
    while step.len() < runs {
        // The first steps spread nodes and make room.
        let is_timed = trainer.steps() > 0 && trainer.steps().is_multiple_of(WHOLE_EVERY);
        let mut view = 0;
        let mut taken = Vec::new();
        let model = is_timed.then(|| trainer.model().into_owned());
        ms(&mut taken, || {
            view = trainer.step(PROGRESS)?.view;
            Ok(())
        })?;
        let Some(model) = model else { continue };
        step.extend(taken);
        let view = dataset.train.photographs().get(view).context("no such view")?;
        ms(&mut pose, || {
            model.instant_into(view.time, &mut instant);
            Ok(())
        })?;
        let settings = Settings::over(WHITE).with_footprint(dataset.footprint);
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        ms(&mut picture, || {
            let loss = PhotographLoss::new(&view.photograph, WHITE, WEIGHTS);
            let counted = Some(&mut statistics);
            Ok(differentiator.differentiate(&splats, &view.camera, &settings, &loss, &mut out, counted)?)
        })?;
    }
    Ok(Parts { step: median(&step), pose: median(&pose), picture: median(&picture) })
}
