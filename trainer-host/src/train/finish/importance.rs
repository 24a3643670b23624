//! Measures what pictures lose without each Gaussian, and says which are needed most.
//!
//! A picture is linear in the opacity of each Gaussian, so leaving one out changes it by exactly
//! `-opacity · ∂I/∂opacity`. The squares of that, summed over pixels and channels, come from one backward
//! pass with random signs ([`Signs`]), averaged over training views. As in training, only pixels that count
//! are looked at, and where photographs have outlines their channels are over the background and over its
//! opposite: what has the colour of one is seen over the other.

use render_host::{Differentiator, Image, ImageError, Loss, Settings, Splats, adjoint::Gradients};

use super::super::{error::TrainError, model::Model, photographs::Pyramid, pixel_mask::PixelMask};
use crate::{encode::sensitivity::Signs, scene::Instant};

/// Most views that are rendered.
const MAX_VIEWS: usize = 160;
/// Opacities count as no more than this: above it alpha is clamped, and derivatives vanish.
const MAX_OPACITY: f32 = 0.98;

/// The pictures that a pruning looks at.
#[derive(Clone, Copy, Debug)]
pub(in crate::train) struct Pictures<'a> {
    /// The photographs, one picture for each of some of them.
    pub(in crate::train) photographs: &'a Pyramid<'a>,
    /// Which of its sizes they have.
    pub(in crate::train) size: usize,
    /// What they are over.
    pub(in crate::train) background: [f32; 3],
    /// Whether channels are over its opposite as well.
    pub(in crate::train) varies: bool,
}

/// What picture `k` is over: `background` and, where it `varies`, its opposite, so that of any two pictures
/// that follow each other each channel is over both.
fn background_of(k: usize, background: [f32; 3], varies: bool) -> [f32; 3] {
    let over = |channel: usize| {
        let value = background[channel];
        if varies && (k + channel) % 2 == 1 { 1.0 - value } else { value }
    };
    std::array::from_fn(over)
}

/// A random sign for each value of the pixels that count.
struct CountedSigns<'a> {
    signs: Signs,
    counted: Option<&'a PixelMask>,
}

impl CountedSigns<'_> {
    /// Whether each value counts.
    fn values_count(&self) -> Option<impl Iterator<Item = bool>> {
        let of_pixel = |&pixel: &u8| [pixel > 0; 3];
        self.counted.map(|mask| mask.values().iter().flat_map(of_pixel))
    }
}

impl Loss for CountedSigns<'_> {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let all = self.signs.differentiate(image, parallel, gradient)?;
        let Some(counts) = self.values_count() else { return Ok(all) };
        gradient.iter_mut().zip(counts).filter(|(_, counts)| !counts).for_each(|(sign, _)| *sign = 0.0);
        let products = gradient.iter().zip(image.rgb()).map(|(&sign, &value)| f64::from(sign * value));
        Ok(products.sum())
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        let Some(counts) = self.values_count() else { return self.signs.exact(rgb) };
        let counted = rgb.iter().zip(counts).map(|(&value, counts)| if counts { value } else { 0.0 });
        self.signs.exact(&counted.collect::<Vec<_>>())
    }
}

/// Per Gaussian, the squared error of a picture without it, summed over the picture's pixels that count and
/// channels: mean over pictures.
///
/// # Errors
/// A view that cannot be rendered.
pub(super) fn removal_errors(
    model: &Model,
    pictures: Pictures<'_>,
    differentiator: &mut Differentiator,
) -> Result<Vec<f64>, TrainError> {
    let Pictures { photographs, size, background, varies } = pictures;
    let views = photographs.originals();
    let all = views.len();
    let count = all.min(MAX_VIEWS);
    let mut errors = vec![0.0; model.gaussians()];
    let (mut instant, mut gradients) = (Instant::default(), Gradients::default());
    for k in 0..count {
        let index = k * all / count;
        let view = &views[index];
        let named = || view.name.clone();
        let (width, height) = photographs.size(index, size);
        let camera = view.camera.resized(width, height);
        let camera = camera.map_err(|source| TrainError::Camera { view: named(), source })?;
        model.instant_into(view.time, &mut instant);
        for gaussian in &mut instant.gaussians {
            gaussian.opacity = gaussian.opacity.min(MAX_OPACITY);
        }
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)
            .map_err(|source| TrainError::Splats { view: named(), source })?;
        let counted = photographs.counted(index, size);
        let signs = CountedSigns { signs: Signs { seed: k as u64 }, counted };
        let settings = Settings::over(background_of(k, background, varies)).with_footprint(model.footprint);
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
        train::{Start, TrainOptions, Trainer, Views, dataset::rendered},
    };

    /// The slow twin: each Gaussian left out in turn. The left quarter of every picture does not count.
    #[test]
    fn errors_are_those_of_pictures_without_each_gaussian() {
        let synthetic =
            synth::SynthOptions { kind: SynthKind::Figure, gaussians: 1000, frames: 1, ..Default::default() };
        let scene = synth::make(&synthetic, &Limits::default()).unwrap();
        let options =
            rendered::RenderedOptions { cameras: 40, test_cameras: 1, side: 32, ..Default::default() };
        let mut dataset = rendered::rendered(&scene, "figure", &options).unwrap();
        dataset.start = Start::VisualHull;
        let counts_of: Vec<u8> = (0..32 * 32).map(|at| u8::from(at % 32 >= 8)).collect();
        let mut photographs = dataset.train.photographs().to_vec();
        let mask = PixelMask::new(32, 32, counts_of.clone());
        photographs.iter_mut().for_each(|view| view.counted.clone_from(&mask));
        dataset.train = Views::new(photographs).unwrap();
        let few = TrainOptions { initial_gaussians: 60, max_gaussians: 60, ..TrainOptions::default() };
        let trainer = Trainer::new(&dataset, &few).unwrap();
        let model = trainer.model();
        let photographs = &Pyramid::new(dataset.train.photographs(), 32);
        let size = photographs.sizes() - 1;
        let pictures = Pictures { photographs, size, background: [1.0, 0.8, 0.0], varies: true };
        let found = removal_errors(&model, pictures, &mut Differentiator::default()).unwrap();
        assert_eq!(found.len(), model.gaussians());

        let error_without = |index: usize| -> f64 {
            let mut sum = 0.0;
            for (k, view) in dataset.train.photographs().iter().enumerate() {
                let mut instant = Instant::default();
                model.instant_into(view.time, &mut instant);
                let mut draw = |opacity: Option<f32>| {
                    instant.gaussians[index].opacity =
                        opacity.unwrap_or(instant.gaussians[index].opacity.min(MAX_OPACITY));
                    let splats =
                        Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
                    let settings = Settings::over(background_of(k, pictures.background, true));
                    Renderer::new().render(&splats, &view.camera, &settings).unwrap().image
                };
                let (with, without) = (draw(None), draw(Some(0.0)));
                let pixels = with.rgb().chunks_exact(3).zip(without.rgb().chunks_exact(3));
                let counted = pixels.zip(&counts_of).filter(|(_, counts)| **counts > 0);
                let square = |(a, b): (&f32, &f32)| f64::from(a - b).powi(2);
                sum += counted.map(|((a, b), _)| a.iter().zip(b).map(square).sum::<f64>()).sum::<f64>();
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

    /// What is as black as one background is seen over the other; where that does not show, nor does this.
    #[test]
    fn what_has_the_colour_of_the_background_is_needed_where_there_is_another() {
        let of = |varies| [0, 1].map(|k| background_of(k, [1.0; 3], varies));
        assert_eq!(of(true), [[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]);
        assert_eq!(of(false), [[1.0; 3]; 2]);
    }

    #[test]
    fn the_least_needed_go_and_one_stays() {
        assert_eq!(most_needed(&[3.0, 0.0, 2.0, 0.0, 5.0], 0.4), [0, 2, 4]);
        assert_eq!(most_needed(&[1.0, 1.0, 1.0], 0.34), [0, 1]);
        assert_eq!(most_needed(&[1.0, 2.0], 1.0), [1]);
        assert!(most_needed(&[1.0, 2.0], 0.0).len() == 2);
    }
}
