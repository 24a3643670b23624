//! An exposure is how one camera's photographs differ in brightness and tint from those of all cameras.
//!
//! Cameras of a rig are not matched, and one camera measures anew for each photograph. What the scene cannot
//! explain otherwise becomes fog before the cameras, which hides it from those between them. So the picture
//! of a view is compared as that view's camera would have taken it: per channel a factor and an offset, which
//! learn beside the scene (Luiten et al., "Dynamic 3D Gaussians", 2024; Kerbl et al., "A Hierarchical 3D
//! Gaussian Representation", 2024, section 5.1). The mean of all exposures stays that of the scene.

use std::{collections::BTreeMap, sync::Mutex};

use rayon::prelude::*;
use render_host::{Image, ImageError, Loss, adjoint::loss::photograph::Photograph};
use serde::{Deserialize, Serialize};

use super::{
    parameter::{AdamStep, Parameter},
    views::{Dataset, PosedPhotograph},
};

/// Numbers of an exposure: logarithms of the factors of r g b, and what is added to each, display values.
pub(super) const NUMBERS: usize = 6;
/// Values whose sums one task makes: fixed, so that the result does not depend on the number of threads.
const CHUNK: usize = 3 * 4096;

/// The exposures of a training: one for all photographs that were taken from the same place, for a camera
/// that stands still keeps its own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Exposures {
    exposures: Vec<Exposure>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Exposure {
    numbers: Parameter,
    /// Steps taken.
    steps: u32,
}

/// Which exposure each training view has, by the place that it was taken from. None at a `rate` of 0; of one
/// place, whose exposure is the mean; of photographs with outlines, which are drawn and not taken; and of a
/// photograph that is alone at its place, which would explain by its exposure what it shows.
pub(super) fn of_views(dataset: &Dataset, rate: f32) -> Vec<Option<usize>> {
    let photographs = dataset.train.photographs();
    let place = |view: &PosedPhotograph| view.camera.centre().map(f64::to_bits);
    let mut taken: BTreeMap<[u64; 3], usize> = BTreeMap::new();
    photographs.iter().for_each(|view| *taken.entry(place(view)).or_default() += 1);
    let mut places = BTreeMap::new();
    let of_view = |view: &PosedPhotograph| {
        let next = places.len();
        (taken[&place(view)] > 1).then(|| *places.entry(place(view)).or_insert(next))
    };
    let exposures: Vec<Option<usize>> = photographs.iter().map(of_view).collect();
    let learns = rate != 0.0 && !dataset.has_alpha && places.len() > 1;
    if learns { exposures } else { vec![None; photographs.len()] }
}

/// How many different ones there are of `exposures`.
pub(super) fn count(exposures: &[Option<usize>]) -> usize {
    exposures.iter().flatten().max().map_or(0, |last| last + 1)
}

impl Exposures {
    /// `count` that change nothing.
    pub(super) fn neutral(count: usize) -> Self {
        let exposure = Exposure { numbers: Parameter::new(NUMBERS, vec![0.0; NUMBERS]), steps: 0 };
        Self { exposures: vec![exposure; count] }
    }

    /// Factors and offsets of exposure `index`, r g b each.
    pub(super) fn get(&self, index: usize) -> [[f32; 3]; 2] {
        let numbers = self.exposures[index].numbers.values();
        [std::array::from_fn(|c| numbers[c].exp()), std::array::from_fn(|c| numbers[3 + c])]
    }

    /// Takes a step of `rate` against `slopes`, those of the loss by the numbers of exposure `index`, and
    /// shifts all so that their mean stays neutral.
    pub(super) fn step(&mut self, index: usize, slopes: [f64; NUMBERS], rate: f32) {
        let Exposure { numbers, steps } = &mut self.exposures[index];
        *steps += 1;
        let gradient = numbers.gradient_mut().iter_mut();
        let finite = |slope: f64| if slope.is_finite() { slope as f32 } else { 0.0 };
        gradient.zip(slopes).for_each(|(gradient, slope)| *gradient = finite(slope));
        numbers.step(AdamStep { rate, first_decay: 0.9, second_decay: 0.999, number: *steps });
        let count = self.exposures.len() as f32;
        for k in 0..NUMBERS {
            let mean =
                self.exposures.iter().map(|exposure| exposure.numbers.values()[k]).sum::<f32>() / count;
            self.exposures.iter_mut().for_each(|exposure| exposure.numbers.values_mut()[k] -= mean);
        }
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.exposures.len()
    }

    /// Whether all numbers are finite: what was read from a file may not be so.
    pub(super) fn is_sound(&self) -> bool {
        self.exposures.iter().all(|exposure| exposure.numbers.is_sound(NUMBERS, 1))
    }
}

impl PosedPhotograph {
    /// The photograph that a camera would have taken which has no exposure of its own, where this one has
    /// these factors of r g b and these offsets in display values; what that makes darker than black or
    /// brighter than white is cut off.
    #[must_use]
    pub fn without_exposure(&self, [factors, offsets]: [[f32; 3]; 2]) -> Self {
        let (width, height) = (self.photograph.width(), self.photograph.height());
        let mut rgba = self.photograph.rgba().to_vec();
        for pixel in rgba.chunks_exact_mut(4) {
            for ((value, factor), offset) in pixel.iter_mut().zip(factors).zip(offsets) {
                let neutral = (f32::from(*value) / 255.0 - offset) / factor;
                *value = (neutral.clamp(0.0, 1.0) * 255.0).round() as u8;
            }
            // Colours are premultiplied by their alpha.
            let alpha = pixel[3];
            pixel[..3].iter_mut().for_each(|value| *value = (*value).min(alpha));
        }
        let photograph = Photograph::new(width, height, rgba);
        Self { photograph: photograph.unwrap_or_else(|_| self.photograph.clone()), ..self.clone() }
    }
}

/// A loss of the picture as a camera of some exposure would have taken it.
pub(super) struct Exposed<'a> {
    loss: &'a dyn Loss,
    factors: [f32; 3],
    offsets: [f32; 3],
    slopes: Mutex<[f64; NUMBERS]>,
}

impl<'a> Exposed<'a> {
    /// `loss`, after `factors` and `offsets`.
    pub(super) fn new(loss: &'a dyn Loss, [factors, offsets]: [[f32; 3]; 2]) -> Self {
        Self { loss, factors, offsets, slopes: Mutex::default() }
    }

    /// How the loss that was last differentiated changes with the numbers of the exposure.
    pub(super) fn slopes(self) -> [f64; NUMBERS] {
        self.slopes.into_inner().unwrap_or_default()
    }
}

impl Loss for Exposed<'_> {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let mut taken = image.clone();
        let of_pixel =
            |pixel: &mut [f32]| (0..3).for_each(|c| pixel[c] = self.factors[c] * pixel[c] + self.offsets[c]);
        taken.rgb_mut().par_chunks_mut(3).with_min_len(CHUNK / 3).for_each(of_pixel);
        let value = self.loss.differentiate(&taken, parallel, gradient)?;
        let chunks = gradient.par_chunks_mut(CHUNK).zip(image.rgb().par_chunks(CHUNK));
        let sums: Vec<[f64; NUMBERS]> =
            chunks.map(|(gradient, picture)| self.backward(gradient, picture)).collect();
        let mut slopes = [0.0; NUMBERS];
        sums.iter().for_each(|sum| slopes.iter_mut().zip(sum).for_each(|(slope, sum)| *slope += sum));
        if let Ok(mut last) = self.slopes.lock() {
            *last = slopes;
        }
        Ok(value)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        let taken =
            |(i, v): (usize, &f64)| f64::from(self.factors[i % 3]) * v + f64::from(self.offsets[i % 3]);
        let taken: Vec<f64> = rgb.iter().enumerate().map(taken).collect();
        self.loss.exact(&taken)
    }
}

impl Exposed<'_> {
    /// Makes the slope by each value of what was taken that by the `picture`'s; returns those by the numbers.
    fn backward(&self, gradient: &mut [f32], picture: &[f32]) -> [f64; NUMBERS] {
        let mut sums = [0.0; NUMBERS];
        for (gradient, pixel) in gradient.chunks_exact_mut(3).zip(picture.chunks_exact(3)) {
            for c in 0..3 {
                let slope = f64::from(gradient[c]);
                gradient[c] *= self.factors[c];
                sums[c] += f64::from(gradient[c]) * f64::from(pixel[c]);
                sums[3 + c] += slope;
            }
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use render_host::{Camera, adjoint::loss::Mse};

    use super::*;

    fn picture(shift: f32) -> Image {
        let values = (0..3 * 40 * 30).map(|i| 0.5 + 0.3 * ((i as f32) * 0.37 + shift).sin()).collect();
        Image::new(40, 30, values).unwrap()
    }

    #[test]
    fn slopes_are_those_of_differences() {
        let (image, mse) = (picture(0.0), Mse::new(picture(1.0)));
        let mut exposures = Exposures::neutral(1);
        exposures.exposures[0].numbers.values_mut().copy_from_slice(&[0.1, -0.2, 0.05, 0.02, -0.03, 0.01]);
        let exposed = Exposed::new(&mse, exposures.get(0));
        let mut gradient = vec![0.0; image.rgb().len()];
        let value = exposed.differentiate(&image, true, &mut gradient).unwrap();
        let rgb: Vec<f64> = image.rgb().iter().map(|&v| f64::from(v)).collect();
        assert!((value - exposed.exact(&rgb)).abs() < 1e-7);
        for i in [0, 1, 2, 1799] {
            let (mut more, mut less) = (rgb.clone(), rgb.clone());
            (more[i], less[i]) = (rgb[i] + 1e-4, rgb[i] - 1e-4);
            let slope = (exposed.exact(&more) - exposed.exact(&less)) / 2e-4;
            assert!((slope - f64::from(gradient[i])).abs() < 1e-3 * slope.abs() + 1e-9, "{i}: {slope}");
        }
        let slopes = exposed.slopes();
        for (k, found) in slopes.into_iter().enumerate() {
            let value = |by: f32| {
                let mut changed = exposures.clone();
                changed.exposures[0].numbers.values_mut()[k] += by;
                Exposed::new(&mse, changed.get(0)).exact(&rgb)
            };
            let slope = (value(1e-2) - value(-1e-2)) / 2e-2;
            assert!((slope - found).abs() < 2e-3 * slope.abs() + 1e-6, "{k}: {slope} {found}");
        }
    }

    #[test]
    fn a_photograph_without_its_exposure_is_that_of_a_neutral_camera() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, 16, 16).unwrap();
        let of = |rgba: Vec<u8>| PosedPhotograph {
            name: "a".to_owned(),
            camera: camera.clone(),
            time: 0.5,
            photograph: Photograph::new(16, 16, rgba).unwrap(),
            foreground: None,
            counted: None,
        };
        let scene: Vec<u8> = (0..16 * 16).flat_map(|k: u32| [(k % 200) as u8, 40, 120, 255]).collect();
        let exposure = [[0.7, 1.2, 1.0], [0.1, -0.05, 0.0]];
        let as_taken = |(at, &value): (usize, &u8)| match at % 4 {
            3 => value,
            c => ((f32::from(value) / 255.0 * exposure[0][c] + exposure[1][c]) * 255.0).round() as u8,
        };
        let taken = of(scene.iter().enumerate().map(as_taken).collect());
        let neutral = taken.without_exposure(exposure);
        let apart = neutral.photograph.rgba().iter().zip(&scene).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(apart <= Some(1), "{apart:?}");
        // What it makes darker than black is black.
        assert_eq!(taken.without_exposure([[1.0; 3], [1.0; 3]]).photograph.rgba()[..4], [0, 0, 0, 255]);
        assert_eq!(neutral.time, 0.5);
    }

    #[test]
    fn exposures_of_cameras_are_found_and_their_mean_stays_neutral() {
        let scene = picture(0.0);
        let truth = [[1.2, 0.05], [1.0 / 1.2, -0.05]];
        let seen = truth.map(|[factor, offset]| {
            let values = scene.rgb().iter().map(|v| factor * v + offset).collect();
            Mse::new(Image::new(40, 30, values).unwrap())
        });
        let mut exposures = Exposures::neutral(2);
        let mut gradient = vec![0.0; scene.rgb().len()];
        for step in 0..2000 {
            let exposed = Exposed::new(&seen[step % 2], exposures.get(step % 2));
            exposed.differentiate(&scene, true, &mut gradient).unwrap();
            exposures.step(step % 2, exposed.slopes(), 4e-3 * 0.998f32.powi(step as i32));
        }
        for (index, [factor, offset]) in truth.iter().enumerate() {
            let [factors, offsets] = exposures.get(index);
            assert!(factors.iter().all(|f| (f - factor).abs() < 0.03), "{factors:?}");
            assert!(offsets.iter().all(|o| (o - offset).abs() < 0.02), "{offsets:?}");
        }
        let product: f32 = (0..2).map(|index| exposures.get(index)[0][0]).product();
        assert!((product - 1.0).abs() < 1e-5 && exposures.len() == 2 && exposures.is_sound());
    }
}
