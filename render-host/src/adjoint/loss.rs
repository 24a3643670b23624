//! Losses about a picture and their gradients with respect to its values.
//!
//! Each has a twin in f64, written by the definition, for differences of the f64 reference.

mod definition;
mod mse;
pub mod photograph;
pub(crate) mod ssim;

use self::ssim::sweep::Parts;
use crate::{
    image::{Image, ImageError},
    metric::distortion::STRUCTURE_WEIGHT,
};
pub use definition::Loss;
pub use mse::Mse;
pub use ssim::Dissimilarity;

/// The distortion of the paper, `MSE + 0.20 (1 - SSIM)`, as [`crate::metric::distortion()`] measures it.
#[derive(Debug)]
pub struct Distortion {
    structure: Dissimilarity,
    weight: f64,
}

impl Distortion {
    /// The distance from `target`.
    pub fn new(target: Image) -> Self {
        Self::weighted(target, STRUCTURE_WEIGHT)
    }

    /// `MSE + weight (1 - SSIM)`.
    pub fn weighted(target: Image, weight: f64) -> Self {
        Self { structure: Dissimilarity::new(target), weight }
    }
}

impl Loss for Distortion {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let weight = Parts { mse: 1.0, structure: self.weight };
        let found = self.structure.sweep(image, parallel, weight, gradient)?;
        Ok(found.mse + self.weight * found.structure)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        mse::exact(self.structure.target(), rgb) + self.weight * self.structure.exact(rgb)
    }
}

/// How much of each part a loss has.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mix {
    /// Of mean squared error.
    pub mse: f64,
    /// Of `1 - SSIM`.
    pub structure: f64,
}

impl Mix {
    /// Mean squared error alone, as [`Mse`].
    pub const MSE: Self = Self { mse: 1.0, structure: 0.0 };
    /// `1 - SSIM` alone, as [`Dissimilarity`].
    pub const STRUCTURE: Self = Self { mse: 0.0, structure: 1.0 };
    /// As [`Distortion::new`].
    pub const DISTORTION: Self = Self::weighted(STRUCTURE_WEIGHT);

    /// As [`Distortion::weighted`].
    pub const fn weighted(structure: f64) -> Self {
        Self { mse: 1.0, structure }
    }
}

/// `Σ weight · value`: its gradient is the weights. A given pixel gradient as a loss.
#[derive(Clone, Debug)]
pub struct Linear(pub Image);

impl Loss for Linear {
    fn differentiate(&self, image: &Image, _: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        crate::image::same_size(image, &self.0)?;
        gradient.copy_from_slice(self.0.rgb());
        Ok(image.rgb().iter().zip(self.0.rgb()).map(|(&v, &w)| f64::from(v) * f64::from(w)).sum())
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        rgb.iter().zip(self.0.rgb()).map(|(v, &w)| v * f64::from(w)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric;

    fn noise(width: u32, height: u32, seed: u32) -> Image {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        Image::new(width, height, (0..3 * width * height).map(|_| next()).collect()).unwrap()
    }

    fn losses(target: &Image) -> [Box<dyn Loss>; 4] {
        [
            Box::new(Mse::new(target.clone())),
            Box::new(Dissimilarity::new(target.clone())),
            Box::new(Distortion::new(target.clone())),
            Box::new(Linear(target.clone())),
        ]
    }

    #[test]
    fn values_are_those_of_the_metrics() {
        for (w, h) in [(23, 17), (11, 11), (12, 5), (4, 30), (1, 1), (2, 11)] {
            let (image, target) = (noise(w, h, 1), noise(w, h, 2));
            let mut gradient = vec![0.0; image.rgb().len()];
            let [mse, structure, both, _] =
                losses(&target).map(|l| l.differentiate(&image, true, &mut gradient).unwrap());
            assert!((mse - metric::mse(&image, &target).unwrap()).abs() < 1e-14);
            assert!((structure - (1.0 - metric::ssim(&image, &target).unwrap())).abs() < 2e-7);
            assert!((both - metric::distortion(&image, &target).unwrap()).abs() < 5e-8);
            let other = noise(h + 1, w, 3);
            assert!(losses(&target).iter().all(|l| l.differentiate(&other, true, &mut gradient).is_err()));
        }
    }

    #[test]
    fn gradients_are_the_differences_of_the_exact_twins() {
        for (w, h) in [(23, 17), (11, 12), (12, 5), (4, 30), (1, 1)] {
            let (image, target) = (noise(w, h, 1), noise(w, h, 2));
            for (which, loss) in losses(&target).iter().enumerate() {
                let mut gradient = vec![f32::NAN; image.rgb().len()];
                let value = loss.differentiate(&image, false, &mut gradient).unwrap();
                let mut rgb: Vec<f64> = image.rgb().iter().map(|&v| f64::from(v)).collect();
                assert!((value - loss.exact(&rgb)).abs() < 2e-7, "{which}: {value} {}", loss.exact(&rgb));
                let largest = gradient.iter().fold(0.0f32, |a, g| a.max(g.abs()));
                for i in (0..rgb.len()).step_by(7) {
                    let mut at = |h: f64| {
                        let was = rgb[i];
                        rgb[i] += h;
                        let value = loss.exact(&rgb);
                        rgb[i] = was;
                        value
                    };
                    let expected = (at(1e-5) - at(-1e-5)) / 2e-5;
                    let error = (f64::from(gradient[i]) - expected).abs() / f64::from(largest);
                    assert!(error < 2e-6, "{w} x {h}, loss {which}, value {i}: {error}");
                }
            }
        }
    }

    #[test]
    fn equal_pictures_lose_nothing_and_threads_do_not_show() {
        let image = noise(70, 50, 4);
        let mut gradient = vec![f32::NAN; image.rgb().len()];
        let same = Distortion::new(image.clone());
        assert_eq!(same.differentiate(&image, true, &mut gradient).unwrap(), 0.0);
        assert!(gradient.iter().all(|g| g.abs() < 1e-12));
        let loss = Distortion::new(noise(70, 50, 5));
        let serial = loss.differentiate(&image, false, &mut gradient).unwrap();
        for threads in [1, 2, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let mut other = vec![f32::NAN; gradient.len()];
            let value = pool.install(|| loss.differentiate(&image, true, &mut other).unwrap());
            assert_eq!((value, other), (serial, gradient.clone()));
        }
    }
}
