//! Mean squared error over channels.

use super::definition::Loss;
use crate::{
    image::{Image, ImageError, same_size},
    parallel,
};

/// Mean squared distance from a target, as [`crate::metric::mse`] measures it.
#[derive(Clone, Debug)]
pub struct Mse(Image);

impl Mse {
    /// The distance from `target`.
    pub fn new(target: Image) -> Self {
        Self(target)
    }
}

impl Loss for Mse {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let (width, height) = same_size(image, &self.0)?;
        let row = 3 * width;
        let scale = 2.0 / (row * height) as f64;
        let mut work: Vec<(f64, &mut [f32])> = gradient.chunks_mut(row).map(|g| (0.0, g)).collect();
        parallel::for_each(parallel, &mut work, |y, (sum, gradient)| {
            let (a, b) = (&image.rgb()[y * row..][..row], &self.0.rgb()[y * row..][..row]);
            for ((g, &a), &b) in gradient.iter_mut().zip(a).zip(b) {
                let d = f64::from(a) - f64::from(b);
                *g = (scale * d) as f32;
                *sum += d * d;
            }
        });
        Ok(work.iter().map(|(sum, _)| sum).sum::<f64>() / (row * height) as f64)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        exact(&self.0, rgb)
    }
}

/// Mean squared distance of `rgb` from `target`.
pub(super) fn exact(target: &Image, rgb: &[f64]) -> f64 {
    let square = |(a, &b): (&f64, &f32)| (a - f64::from(b)).powi(2);
    rgb.iter().zip(target.rgb()).map(square).sum::<f64>() / rgb.len() as f64
}
