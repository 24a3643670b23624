//! Weighs drawing tiles of a photograph at random: the noise that it adds to a step against the time it
//! saves.

use anyhow::Result;
use render_host::{
    Camera, Gradients, Image, Loss, Renderer, Settings, Splats, Workspace,
    adjoint::{
        loss::photograph::{Photograph, PhotographLoss},
        render_and_gradients_into,
    },
    image::ImageError,
};
use trainer_host::{
    Instant, Scene,
    train::{
        Dataset, TrainOptions, Trainer,
        dataset::rendered::{RenderedOptions, rendered},
    },
};

use super::measure::{WEIGHTS, WHITE, ms};
use crate::figures::{Bench, Figure, median};

/// As the protocol of the bench says it.
pub(super) const PROTOCOL: &str = "tiles: half of the squares of 32 pixels that show something drawn at \
    random, their gradients divided by their chances (which are even, by the sum of absolute differences \
    with a tenth of its mean as a floor, or by the length of the square's own gradient, which nobody knows \
    before): variance of the gradient of positions, of that between photographs, a scene trained at this \
    side; time: of a photograph drawn whole, if half of the backward pass is saved and nothing else; worth: \
    (1 + variance) times time, below 1 where drawing pays";
/// Side of a square, pixels.
const SQUARE: u32 = 32;
/// Of the mean error of squares, what is added to each: none has no chance.
const FLOOR: f64 = 0.1;
/// Progress that the training reaches, 0 to 1 of its schedule: with all nodes, and Gaussians still added.
const PROGRESS: f64 = 0.5;
/// How often times are taken.
const RUNS: usize = 5;

/// Pixels `[left, top, right, bottom]`, right and bottom left out.
type Square = [u32; 4];

/// A loss whose gradient is left out outside of a square.
struct Within<'a> {
    loss: &'a PhotographLoss<'a>,
    square: Square,
}

impl Loss for Within<'_> {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let value = self.loss.differentiate(image, parallel, gradient)?;
        let [left, top, right, bottom] = self.square;
        for (row, values) in gradient.chunks_exact_mut(3 * image.width() as usize).enumerate() {
            let is_in = (top..bottom).contains(&(row as u32));
            let (left, right) = if is_in { (left, right) } else { (0, 0) };
            values[..3 * left as usize].fill(0.0);
            values[3 * right as usize..].fill(0.0);
        }
        Ok(value)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        self.loss.exact(rgb)
    }
}

/// What squares of one photograph give.
struct Parts {
    /// Gradient of positions of the whole photograph.
    whole: Vec<f64>,
    squares: Vec<Part>,
}

/// What one square gives.
#[derive(Clone, Copy)]
struct Part {
    /// Square of the length of its gradient of positions.
    power: f64,
    /// Sum of absolute differences between picture and photograph.
    error: f64,
}

/// The weight of a square among others, whose mean error is given: its chance follows it.
type Weight = fn(Part, f64) -> f64;

/// Rows of a scene of `steps` steps on its own renders.
///
/// # Errors
/// What the trainer or the renderer refuses.
pub(super) fn variance(bench: &mut Bench, scene: &Scene, side: u32, steps: u32) -> Result<()> {
    let dataset = rendered(
        scene,
        "figure",
        &RenderedOptions { cameras: 2, test_cameras: 1, side, ..Default::default() },
    )?;
    let options = TrainOptions { max_side: side, background: WHITE, ..TrainOptions::default() };
    let mut trainer = Trainer::new(&dataset, &options)?;
    for step in 0..steps {
        trainer.step(PROGRESS * f64::from(step) / f64::from(steps))?;
    }
    let (parts, time) = photographs(&dataset, &trainer)?;
    let between = between(&parts);
    for (name, weight) in [
        ("even", (|_, _| 1.0) as Weight),
        ("by_error", |part, mean| part.error + FLOOR * mean),
        ("by_gradient", |part, _| part.power.sqrt()),
    ] {
        let added = parts.iter().map(|parts| added(&parts.squares, weight)).sum::<f64>() / parts.len() as f64;
        let variance = added / between;
        bench.push(Figure::new(format!("{side}.tiles.{name}.variance"), variance, "of photographs'"));
        bench.push(Figure::new(format!("{side}.tiles.{name}.worth"), (1.0 + variance) * time, "of whole"));
    }
    bench.push(Figure::new(format!("{side}.tiles.time"), time, "of whole").runs(RUNS));
    Ok(())
}

/// Parts of every training photograph, and the share of a step's picture that is left where half of the
/// backward pass is saved.
fn photographs(dataset: &Dataset, trainer: &Trainer) -> Result<(Vec<Parts>, f64)> {
    let model = trainer.model();
    let (mut instant, mut parts) = (Instant::default(), Vec::new());
    let [mut forward, mut whole] = [const { Vec::new() }; 2];
    let settings = Settings { parallel: false, ..Settings::over(WHITE).with_footprint(dataset.footprint) };
    for view in dataset.train.photographs() {
        model.instant_into(view.time, &mut instant);
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        parts.push(of_photograph(&splats, &view.camera, &view.photograph, &settings)?);
        if whole.len() >= RUNS {
            continue;
        }
        let loss = PhotographLoss::new(&view.photograph, WHITE, WEIGHTS);
        let (mut renderer, mut picture) = (Renderer::new(), Default::default());
        let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
        renderer.render_into(&splats, &view.camera, &settings, &mut picture)?;
        let mut gradient = vec![0.0; picture.image.rgb().len()];
        ms(&mut forward, || {
            renderer.render_into(&splats, &view.camera, &settings, &mut picture)?;
            loss.differentiate(&picture.image, false, &mut gradient)?;
            Ok(())
        })?;
        let camera = &view.camera;
        let mut both =
            || Ok(render_and_gradients_into(&mut workspace, &splats, camera, &settings, &loss, &mut out)?);
        both()?;
        ms(&mut whole, both)?;
    }
    let (forward, whole) = (median(&forward), median(&whole));
    Ok((parts, 0.5 * (forward + whole) / whole))
}

/// The gradient of one photograph, and of each of its squares alone.
fn of_photograph(
    splats: &Splats,
    camera: &Camera,
    photograph: &Photograph,
    settings: &Settings,
) -> Result<Parts> {
    let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
    let loss = PhotographLoss::new(photograph, WHITE, WEIGHTS);
    let target = photograph.over(WHITE);
    render_and_gradients_into(&mut workspace, splats, camera, settings, &loss, &mut out)?;
    let (whole, picture) = (positions(&out), out.rendered.image.clone());
    let (width, height) = (camera.width(), camera.height());
    let mut squares = Vec::new();
    for top in (0..height).step_by(SQUARE as usize) {
        for left in (0..width).step_by(SQUARE as usize) {
            let square = [left, top, (left + SQUARE).min(width), (top + SQUARE).min(height)];
            let within = Within { loss: &loss, square };
            render_and_gradients_into(&mut workspace, splats, camera, settings, &within, &mut out)?;
            let power = squared(&positions(&out));
            if power > 0.0 {
                squares.push(Part { power, error: error(&picture, &target, square) });
            }
        }
    }
    Ok(Parts { whole, squares })
}

fn positions(gradients: &Gradients) -> Vec<f64> {
    gradients.splats.iter().flat_map(|splat| splat.position).map(f64::from).collect()
}

fn squared(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum()
}

/// Sum of absolute differences in a square.
fn error(picture: &Image, target: &Image, [left, top, right, bottom]: Square) -> f64 {
    let mut sum = 0.0;
    for row in top..bottom {
        let at = |column: u32| 3 * (row * picture.width() + column) as usize;
        let values = at(left)..at(right);
        let pairs = picture.rgb()[values.clone()].iter().zip(&target.rgb()[values]);
        sum += pairs.map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
    }
    sum
}

/// Variance of the gradient between photographs: the mean square of its distance from their mean.
fn between(parts: &[Parts]) -> f64 {
    let count = parts.len() as f64;
    let mut mean = vec![0.0; parts.first().map_or(0, |parts| parts.whole.len())];
    for parts in parts {
        mean.iter_mut().zip(&parts.whole).for_each(|(sum, v)| *sum += v / count);
    }
    parts.iter().map(|parts| squared(&parts.whole)).sum::<f64>() / count - squared(&mean)
}

/// Variance that drawing half of the squares adds, `Σ (1/p - 1) |g|²`: each is drawn by itself with a
/// chance `p` that follows its weight.
fn added(squares: &[Part], weight: Weight) -> f64 {
    let mean = squares.iter().map(|part| part.error).sum::<f64>() / squares.len().max(1) as f64;
    let weights: Vec<f64> = squares.iter().map(|&part| weight(part, mean)).collect();
    let chances = chances(&weights, 0.5 * squares.len() as f64);
    squares.iter().zip(chances).map(|(part, chance)| (1.0 / chance - 1.0) * part.power).sum()
}

/// Chances of at most 1 that follow `weights` and add up to `expected`.
fn chances(weights: &[f64], expected: f64) -> Vec<f64> {
    let at = |factor: f64| weights.iter().map(move |weight| (factor * weight).min(1.0));
    let (mut low, mut high) = (0.0, weights.len() as f64 / weights.iter().copied().fold(f64::MAX, f64::min));
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        *(if at(middle).sum::<f64>() < expected { &mut low } else { &mut high }) = middle;
    }
    at(high).collect()
}

#[cfg(test)]
mod tests {
    use anyhow::Context;

    use super::*;

    #[test]
    fn chances_follow_weights_and_add_up() {
        let found = chances(&[1.0, 1.0, 2.0, 100.0], 2.0);
        assert!((found.iter().sum::<f64>() - 2.0).abs() < 1e-9);
        assert!(
            found[3] == 1.0 && (found[0] - 0.25).abs() < 1e-9 && (found[2] - 0.5).abs() < 1e-9,
            "{found:?}"
        );
        // With even chances of a half every square's own length is added.
        let parts = |parts: &[(f64, f64)]| -> Vec<Part> {
            parts.iter().map(|&(power, error)| Part { power, error }).collect()
        };
        assert!((added(&parts(&[(3.0, 0.1), (5.0, 7.0)]), |_, _| 1.0) - 8.0).abs() < 1e-6);
        // Chances that follow the length add least.
        let squares = parts(&[(1.0, 9.0), (4.0, 1.0), (0.25, 5.0), (0.5, 5.0)]);
        let (even, best) = (added(&squares, |_, _| 1.0), added(&squares, |part, _| part.power.sqrt()));
        assert!(best < 0.8 * even, "{best} {even}");
    }

    #[test]
    fn gradients_of_squares_add_up_to_that_of_the_photograph() -> Result<()> {
        let scene = crate::setup::synth("figure", 1000, 2)?;
        let dataset = rendered(
            &scene,
            "figure",
            &RenderedOptions { cameras: 1, test_cameras: 1, side: 80, ..Default::default() },
        )?;
        let view = dataset.train.photographs().first().context("no photograph")?;
        let instant = scene.instant(1).context("no frame 1")?;
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        let loss = PhotographLoss::new(&view.photograph, WHITE, WEIGHTS);
        let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
        let settings = Settings::over(WHITE);
        let mut gradient = |loss: &dyn Loss| -> Result<Vec<f64>> {
            render_and_gradients_into(&mut workspace, &splats, &view.camera, &settings, loss, &mut out)?;
            Ok(positions(&out))
        };
        let whole = gradient(&loss)?;
        let mut sum = vec![0.0; whole.len()];
        for square in [[0, 0, 40, 80], [40, 0, 80, 30], [40, 30, 80, 80]] {
            let part = gradient(&Within { loss: &loss, square })?;
            sum.iter_mut().zip(part).for_each(|(sum, v)| *sum += v);
        }
        let off: Vec<f64> = sum.iter().zip(&whole).map(|(a, b)| a - b).collect();
        assert!(squared(&off) < 1e-8 * squared(&whole) && squared(&whole) > 0.0);
        Ok(())
    }
}
