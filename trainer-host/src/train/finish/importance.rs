//! Measures what pictures lose without each Gaussian, and says which are needed most.
//!
//! A picture is linear in the opacity of each Gaussian, so leaving one out changes it by exactly
//! `-opacity · ∂I/∂opacity`. The squares of that, summed over pixels and channels, come from one backward
//! pass with random signs ([`Signs`]), averaged over training views.

use render_host::{Differentiator, Settings, Splats, adjoint::Gradients};

use super::super::{
    error::TrainError,
    model::Model,
    views::{Training, Views},
};
use crate::{encode::sensitivity::Signs, scene::Instant};

/// Most views that are rendered.
const MAX_VIEWS: usize = 160;
/// Opacities count as no more than this: above it alpha is clamped, and derivatives vanish.
const MAX_OPACITY: f32 = 0.98;

/// Per Gaussian, the squared error of a view without it, summed over the view's pixels and channels: mean
/// over views. `size_of` says how large a view is rendered, pixels.
///
/// # Errors
/// A view that cannot be rendered.
pub(super) fn removal_errors(
    model: &Model,
    views: &Views<Training>,
    size_of: impl Fn(usize) -> (u32, u32),
    differentiator: &mut Differentiator,
) -> Result<Vec<f64>, TrainError> {
    let all = views.photographs().len();
    let count = all.min(MAX_VIEWS);
    let mut errors = vec![0.0; model.gaussians()];
    let settings = Settings::default().with_footprint(model.footprint);
    let (mut instant, mut gradients) = (Instant::default(), Gradients::default());
    for k in 0..count {
        let index = k * all / count;
        let view = &views.photographs()[index];
        let named = || view.name.clone();
        let (width, height) = size_of(index);
        let camera = view.camera.resized(width, height);
        let camera = camera.map_err(|source| TrainError::Camera { view: named(), source })?;
        model.instant_into(view.time, &mut instant);
        for gaussian in &mut instant.gaussians {
            gaussian.opacity = gaussian.opacity.min(MAX_OPACITY);
        }
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)
            .map_err(|source| TrainError::Splats { view: named(), source })?;
        let signs = Signs { seed: k as u64 };
        differentiator
            .differentiate(&splats, &camera, &settings, &signs, &mut gradients, None)
            .map_err(|source| TrainError::View { view: named(), source })?;
        for ((error, gaussian), splat) in errors.iter_mut().zip(&instant.gaussians).zip(&gradients.splats) {
            // Of the logit, ∂I is opacity · (1 - opacity) times that of the opacity.
            let change = f64::from(splat.opacity_logit) / f64::from(1.0 - gaussian.opacity);
            *error += change * change / count as f64;
        }
    }
    Ok(errors)
}

/// Indices, ascending, of all but a `share` of the Gaussians: those whose removal costs least go. Of equal
/// ones the first stay; one stays always.
pub(super) fn most_needed(errors: &[f64], share: f64) -> Vec<usize> {
    let mut order: Vec<usize> = (0..errors.len()).collect();
    order.sort_by(|&a, &b| errors[b].total_cmp(&errors[a]).then(a.cmp(&b)));
    let removed = (share * errors.len() as f64) as usize;
    order.truncate((errors.len() - removed.min(errors.len())).max(1));
    order.sort_unstable();
    order
}

#[cfg(test)]
mod tests {
    use render_host::Renderer;

    use super::*;
    use crate::{
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        train::{Start, TrainOptions, Trainer, dataset::rendered},
    };

    /// The slow twin: each Gaussian left out in turn.
    #[test]
    fn errors_are_those_of_pictures_without_each_gaussian() {
        let synthetic =
            synth::SynthOptions { kind: SynthKind::Figure, gaussians: 1000, frames: 1, ..Default::default() };
        let scene = synth::make(&synthetic, &Limits::default()).unwrap();
        let options = rendered::RenderedOptions { cameras: 40, test_cameras: 1, side: 32 };
        let mut dataset = rendered::rendered(&scene, "figure", &options).unwrap();
        dataset.start = Start::VisualHull;
        let few = TrainOptions { initial_gaussians: 60, max_gaussians: 60, ..TrainOptions::default() };
        let trainer = Trainer::new(&dataset, &few).unwrap();
        let model = trainer.model();
        let found =
            removal_errors(&model, &dataset.train, |_| (32, 32), &mut Differentiator::default()).unwrap();
        assert_eq!(found.len(), model.gaussians());

        let error_without = |index: usize| -> f64 {
            let mut sum = 0.0;
            for view in dataset.train.photographs() {
                let mut instant = Instant::default();
                model.instant_into(view.time, &mut instant);
                let mut draw = |opacity: Option<f32>| {
                    instant.gaussians[index].opacity =
                        opacity.unwrap_or(instant.gaussians[index].opacity.min(MAX_OPACITY));
                    let splats =
                        Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
                    Renderer::new().render(&splats, &view.camera, &Settings::default()).unwrap().image
                };
                let (with, without) = (draw(None), draw(Some(0.0)));
                let squares = with.rgb().iter().zip(without.rgb()).map(|(a, b)| f64::from(a - b).powi(2));
                sum += squares.sum::<f64>();
            }
            sum / dataset.train.photographs().len() as f64
        };
        // Signs are random: single errors vary, their sum and their order hardly.
        let exact: Vec<f64> = (0..found.len()).map(error_without).collect();
        let ratio = found.iter().sum::<f64>() / exact.iter().sum::<f64>();
        assert!((0.75..1.3).contains(&ratio), "{ratio}");
        let (needed, best) = (most_needed(&found, 0.5), most_needed(&exact, 0.5));
        let agreed = needed.iter().filter(|index| best.contains(index)).count();
        assert!(agreed * 10 > 8 * best.len(), "{agreed} of {}", best.len());
    }

    #[test]
    fn the_least_needed_go_and_one_stays() {
        assert_eq!(most_needed(&[3.0, 0.0, 2.0, 0.0, 5.0], 0.4), [0, 2, 4]);
        assert_eq!(most_needed(&[1.0, 1.0, 1.0], 0.34), [0, 1]);
        assert_eq!(most_needed(&[1.0, 2.0], 1.0), [1]);
        assert!(most_needed(&[1.0, 2.0], 0.0).len() == 2);
    }
}
