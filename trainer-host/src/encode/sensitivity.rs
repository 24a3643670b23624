//! Measures how much an error in each attribute of each Gaussian shows in pictures.
//!
//! To first order an error `e` in a value changes a picture by `e · ∂I/∂value`, so its squared error
//! is `e² · Σ (∂I/∂value)²` over pixels and channels: the diagonal of the Gauss-Newton matrix. One
//! backward pass with a random sign at every pixel and channel gives each value's `Σ ± ∂I/∂value`,
//! whose square has that sum as its mean (source: Hutchinson 1990); pictures from all around are
//! averaged. Errors of different values are independent, so that what they cost adds up. What a scene stands
//! before is not known, and something is seen only where it differs from that: of each picture some channels
//! are over black and the others over white, by turns.

use codec_core::internals::gaussian::Gaussian;
use render_host::{
    Backend, Image, ImageError, Settings, Splats,
    adjoint::{Gradients, Loss},
};

use crate::{
    encode::{
        EncodeError, Progress,
        evaluator::{EvaluationError, instant_at, spread},
        progress::report,
    },
    scene::Scene,
    viewpoint::Framing,
};

/// Attribute classes with a weight each: position, log-scale, rotation (Rodrigues parameters), linear
/// opacity, band 0 and the higher bands of the harmonics.
pub const CLASSES: usize = 6;

/// Squared change of a picture, summed over pixels and channels, per squared unit of a class's
/// components: mean over pictures and components.
pub type Weights = [f64; CLASSES];

/// Most pictures of an epoch.
pub const MAX_PICTURES: usize = 1024;
/// Width and height of a picture, pixels.
const SIZE: (u32, u32) = (256, 256);
/// Opacities are seen within this range: beyond it a picture is cut off or clamped, and small errors
/// have no effect although larger ones do.
const OPACITIES: (f32, f32) = (0.002, 0.98);
/// Alphas below this are not drawn.
const CUTOFF: f32 = 1e-5;

/// The weights of every Gaussian of every epoch of `scene`, from `pictures` pictures an epoch, at
/// least one, spread over its frames and around the scene.
///
/// Deterministic on any number of threads, for each `backend`.
///
/// # Errors
/// What the renderer refuses; `progress`, which hears stage "analyse", stops the work.
pub fn measure(
    scene: &Scene,
    pictures: usize,
    backend: &Backend,
    progress: Progress<'_>,
) -> Result<Vec<Vec<Weights>>, EncodeError> {
    let pictures = pictures.max(1);
    let cameras = Framing::of(scene).around(pictures, SIZE).map_err(EvaluationError::from)?;
    let mut differentiator = backend.differentiator().map_err(EvaluationError::from)?;
    let mut gradients = Gradients::default();
    let (mut done, all) = (0, pictures * scene.epochs().len());
    let (mut out, mut first) = (Vec::new(), 0);
    for epoch in scene.epochs() {
        let frames = epoch.frames() as u32;
        let mut weights = vec![[0.0; CLASSES]; epoch.count()];
        let frames_seen = spread(first, frames, pictures as u32);
        for (k_frame, &frame) in frames_seen.iter().enumerate() {
            let mut instant = instant_at(scene, frame)?;
            for gaussian in &mut instant.gaussians {
                gaussian.opacity = gaussian.opacity.clamp(OPACITIES.0, OPACITIES.1);
            }
            let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree);
            let splats = splats.map_err(EvaluationError::from)?;
            let rest = instant.sh_degree.rest_len();
            for (k, camera) in cameras.iter().enumerate().skip(k_frame).step_by(frames_seen.len()) {
                let signs = Signs { seed: k as u64 };
                let settings = settings(k).with_footprint(scene.footprint);
                report(progress, "analyse", done as f64 / all as f64)?;
                done += 1;
                differentiator
                    .differentiate(&splats, camera, &settings, &signs, &mut gradients, None)
                    .map_err(EvaluationError::from)?;
                add(&mut weights, &instant.gaussians, &gradients, rest, pictures);
            }
        }
        first += frames;
        out.push(weights);
    }
    Ok(out)
}

/// How picture `k` is drawn, but for the scene's footprint.
fn settings(k: usize) -> Settings {
    let background = std::array::from_fn(|channel| ((k + channel) % 2) as f32);
    Settings { alpha_cutoff: CUTOFF, ..Settings::over(background) }
}

/// Adds one of `pictures` pictures' share to the weights of every Gaussian, which has `rest` values of
/// higher harmonics.
fn add(weights: &mut [Weights], gaussians: &[Gaussian], gradients: &Gradients, rest: usize, pictures: usize) {
    for (i, (weights, gaussian)) in weights.iter_mut().zip(gaussians).enumerate() {
        let Some(gradient) = gradients.splats.get(i) else { break };
        // A change of Rodrigues parameters moves the unit quaternion by 1 + w times as much,
        // where w ≥ 0 is its real part: the stereographic projection keeps angles.
        let turn = 1.0 + f64::from(gaussian.rotation[0].abs());
        let opacity = f64::from(gaussian.opacity);
        let per_opacity = 1.0 / (opacity * (1.0 - opacity));
        let bands = gradients.sh_rest.get(i * rest..(i + 1) * rest).unwrap_or(&[]);
        for (weight, found) in weights.iter_mut().zip([
            squares(&gradient.position) / 3.0,
            squares(&gradient.log_scale) / 3.0,
            squares(&gradient.rotation) / 3.0 * turn * turn,
            (f64::from(gradient.opacity_logit) * per_opacity).powi(2),
            squares(&gradient.sh0) / 3.0,
            squares(bands) / rest.max(1) as f64,
        ]) {
            *weight += found / pictures as f64;
        }
    }
}

fn squares(values: &[f32]) -> f64 {
    values.iter().map(|&v| f64::from(v).powi(2)).sum()
}

/// The sum of a picture's values, each with a random sign.
#[derive(Debug)]
pub(crate) struct Signs {
    pub(crate) seed: u64,
}

impl Signs {
    /// 1 or −1 for value `i`.
    fn sign(&self, i: usize) -> f32 {
        if hash(hash(self.seed) ^ i as u64) & 1 == 0 { 1.0 } else { -1.0 }
    }
}

/// SplitMix64 of `x` (source: Steele, Lea and Flood 2014).
const fn hash(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

impl Loss for Signs {
    fn differentiate(&self, image: &Image, _: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let mut sum = 0.0;
        for (i, (gradient, &value)) in gradient.iter_mut().zip(image.rgb()).enumerate() {
            *gradient = self.sign(i);
            sum += f64::from(*gradient) * f64::from(value);
        }
        Ok(sum)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        rgb.iter().enumerate().map(|(i, value)| f64::from(self.sign(i)) * value).sum()
    }
}

#[cfg(test)]
mod tests {
    use codec_core::ShDegree;
    use render_host::Renderer;

    use super::*;
    use crate::{
        encode::no_progress,
        scene::{
            Attributes, Epoch, Track,
            activation::{logit, sigmoid},
        },
    };

    /// A few Gaussians apart from each other, and one behind the others' backs that nobody sees much of.
    fn scene(change: impl Fn(&mut Attributes)) -> Scene {
        let n = 5;
        let mut attributes = Attributes {
            positions: Track::Constant(
                (0..n).map(|i| [0.8 * i as f32 - 1.6, 0.3 * (i % 2) as f32, 0.2 * i as f32]).collect(),
            ),
            rotations: Track::Constant(vec![[0.8, 0.6, 0.0, 0.0]; n]),
            log_scales: Track::Constant((0..n).map(|i| [-1.2, -1.6, -2.0 + 0.1 * i as f32]).collect()),
            opacity_logits: Track::Constant(vec![0.5, -0.2, 1.0, -6.0, 0.0]),
            sh0: Track::Constant((0..n).map(|i| [0.9, 0.2 * i as f32, 0.4]).collect()),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        };
        change(&mut attributes);
        Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap()
    }

    /// What a change of one value changes in the pictures that are measured, squared and summed over
    /// their values, per squared unit: mean over pictures.
    fn change(plain: &Scene, changed: &Scene, by: f64, pictures: usize) -> f64 {
        let cameras = Framing::of(plain).around(pictures, SIZE).unwrap();
        let mut sum = 0.0;
        for (k, camera) in cameras.iter().enumerate() {
            let draw = |scene: &Scene| {
                let instant = scene.instant(0).unwrap();
                let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
                Renderer::new().render(&splats, camera, &settings(k)).unwrap().image
            };
            let (a, b) = (draw(plain), draw(changed));
            let squares = a.rgb().iter().zip(b.rgb()).map(|(a, b)| f64::from(a - b).powi(2));
            sum += squares.sum::<f64>() / (by * by);
        }
        sum / pictures as f64
    }

    #[test]
    fn weights_are_what_small_changes_do_to_pictures() {
        let pictures = 64;
        let plain = scene(|_| {});
        let weights = &measure(&plain, pictures, &Backend::Cpu, &no_progress).unwrap()[0];
        let by = 0.004f32;
        for i in [0, 2] {
            // The mean over components, by differences.
            let mean = |change_one: &dyn Fn(&mut Attributes, usize)| -> f64 {
                (0..3).map(|d| change(&plain, &scene(|a| change_one(a, d)), by.into(), pictures) / 3.0).sum()
            };
            fn frame<T>(track: &mut Track<T>) -> &mut Vec<T> {
                match track {
                    Track::Constant(values) | Track::PerFrame(values) => values,
                }
            }
            let exact = [
                mean(&|a, d| frame(&mut a.positions)[i][d] += by),
                mean(&|a, d| frame(&mut a.log_scales)[i][d] += by),
                mean(&|a, d| {
                    let q = &mut frame(&mut a.rotations)[i];
                    let mut m = codec_core::internals::math::mrp_from_quat(*q);
                    m[d] += by;
                    *q = codec_core::internals::math::normalised(codec_core::internals::math::quat_from_mrp(
                        m,
                    ));
                }),
                change(
                    &plain,
                    &scene(|a| {
                        let value = &mut frame(&mut a.opacity_logits)[i];
                        *value = logit(sigmoid(*value) + by);
                    }),
                    by.into(),
                    pictures,
                ),
                mean(&|a, d| frame(&mut a.sh0)[i][d] += by),
            ];
            for (class, exact) in exact.into_iter().enumerate() {
                // One random sign per value: the square's deviation is √2 of its mean, over the pictures
                // and components.
                let ratio = weights[i][class] / exact;
                assert!((0.6..1.6).contains(&ratio), "Gaussian {i} class {class}: {ratio}");
            }
        }
        // The faint one.
        assert!(weights[3][4] < 1e-3 * weights[2][4] && weights[3][4] > 0.0);
        // Its opacity is not as unimportant as its colour.
        assert!(weights[3][3] > 0.02 * weights[2][3]);
        assert_eq!(weights[0][5], 0.0);
    }

    /// Black over black and white over white are not seen, and are over the other.
    #[test]
    fn no_colour_hides_what_an_error_shows() {
        let of = |colour: f32| {
            let coloured = scene(|a| {
                let Track::Constant(colours) = &mut a.sh0 else { panic!("one frame") };
                colours.fill([(colour - 0.5) / 0.282_094_8; 3]);
            });
            measure(&coloured, 96, &Backend::Cpu, &no_progress).unwrap()[0][0]
        };
        let [black, grey, white] = [0.0, 0.5, 1.0].map(of);
        // Position and opacity: grey differs from both by a half, black from one by all and from the other by
        // nothing, which is twice as much once squared.
        for class in [0, 3] {
            for colour in [black, white] {
                let ratio = colour[class] / grey[class];
                assert!((1.2..3.2).contains(&ratio), "class {class}: {ratio}");
            }
        }
    }

    #[test]
    fn the_loss_is_the_signed_sum() {
        let signs = Signs { seed: 3 };
        let image = Image::new(4, 2, (0..24).map(|i| i as f32 / 8.0).collect()).unwrap();
        let mut gradient = vec![0.0; 24];
        let found = signs.differentiate(&image, false, &mut gradient).unwrap();
        let wide: Vec<f64> = image.rgb().iter().map(|&v| v.into()).collect();
        assert!((found - signs.exact(&wide)).abs() < 1e-9);
        assert!(gradient.iter().all(|v| v.abs() == 1.0));
        assert!((0..10_000).map(|i| signs.sign(i)).sum::<f32>().abs() < 300.0);
        assert_ne!(gradient, (0..24).map(|i| Signs { seed: 4 }.sign(i)).collect::<Vec<_>>());
    }
}
