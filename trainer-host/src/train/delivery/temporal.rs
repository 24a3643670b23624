//! Measures how a picture changes from a frame to the next: squared error of the change.
//!
//! `F = mean((I(t+1) − I(t)) − C)²` over pixels and channels, with `C` the change that should be seen. By
//! either picture it is a mean squared error against a target made of the other one. Source: paper section 4,
//! F.

use render_host::{
    Image, ImageError,
    adjoint::{
        Loss,
        loss::{Distortion, Mse},
    },
};

/// `picture + change`: what the next picture should be.
pub(super) fn after(picture: &Image, change: &Image) -> Result<Image, ImageError> {
    combine(picture, change, |p, c| p + c)
}

/// `picture − change`: what the picture before should be, or the change from one picture to another.
pub(super) fn before(picture: &Image, change: &Image) -> Result<Image, ImageError> {
    combine(picture, change, |p, c| p - c)
}

fn combine(a: &Image, b: &Image, join: impl Fn(f32, f32) -> f32) -> Result<Image, ImageError> {
    let rgb = a.rgb().iter().zip(b.rgb()).map(|(&a, &b)| join(a, b)).collect();
    Image::new(a.width(), a.height(), rgb)
}

/// A weighted distortion plus a weighted squared error of change: what one world's picture costs.
pub(super) struct WorldLoss<'a> {
    pub distortion: Option<(f64, &'a Distortion)>,
    pub change: Option<(f64, Mse)>,
}

impl Loss for WorldLoss<'_> {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        gradient.fill(0.0);
        let mut part = vec![0.0; gradient.len()];
        let mut total = 0.0;
        let distortion = self.distortion.as_ref().map(|(weight, loss)| (*weight, *loss as &dyn Loss));
        let change = self.change.as_ref().map(|(weight, loss)| (*weight, loss as &dyn Loss));
        for (weight, loss) in [distortion, change].into_iter().flatten() {
            total += weight * loss.differentiate(image, parallel, &mut part)?;
            gradient.iter_mut().zip(&part).for_each(|(sum, part)| *sum += weight as f32 * part);
        }
        Ok(total)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        let distortion = self.distortion.as_ref().map_or(0.0, |(weight, loss)| weight * loss.exact(rgb));
        distortion + self.change.as_ref().map_or(0.0, |(weight, loss)| weight * loss.exact(rgb))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(seed: u32) -> Image {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        Image::new(12, 11, (0..3 * 12 * 11).map(|_| next()).collect()).unwrap()
    }

    #[test]
    fn a_constant_error_does_not_count_and_both_targets_give_one_value() {
        let (first, second) = (noise(1), noise(2));
        let change = before(&second, &first).unwrap();
        let shifted = |image: &Image| {
            let rgb = image.rgb().iter().map(|v| v + 0.125).collect();
            Image::new(image.width(), image.height(), rgb).unwrap()
        };
        let mut gradient = vec![0.0; first.rgb().len()];
        let mut value =
            |target: Image, image: &Image| Mse::new(target).differentiate(image, false, &mut gradient);
        let still = value(after(&shifted(&first), &change).unwrap(), &shifted(&second)).unwrap();
        assert!(still < 1e-12, "{still}");
        let (bad_first, bad_second) = (noise(3), noise(4));
        let by_next = value(after(&bad_first, &change).unwrap(), &bad_second).unwrap();
        let by_this = value(before(&bad_second, &change).unwrap(), &bad_first).unwrap();
        assert!(by_next > 0.01 && (by_next - by_this).abs() < 1e-7, "{by_next} {by_this}");
    }

    #[test]
    fn the_sum_of_losses_has_the_sum_of_gradients_and_each_part_shows() {
        let (image, target) = (noise(5), noise(6));
        let distortion = Distortion::new(target.clone());
        let both =
            WorldLoss { distortion: Some((0.7, &distortion)), change: Some((0.3, Mse::new(noise(7)))) };
        let mut gradient = vec![f32::NAN; image.rgb().len()];
        let value = both.differentiate(&image, false, &mut gradient).unwrap();
        let mut rgb: Vec<f64> = image.rgb().iter().map(|&v| f64::from(v)).collect();
        assert!((value - both.exact(&rgb)).abs() < 1e-6);
        let without = WorldLoss { distortion: both.distortion, change: None };
        assert!((without.exact(&rgb) - value).abs() > 1e-3, "a dropped part shows");
        for i in (0..rgb.len()).step_by(29) {
            let mut at = |h: f64| {
                let was = rgb[i];
                rgb[i] += h;
                let value = both.exact(&rgb);
                rgb[i] = was;
                value
            };
            let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
            assert!((f64::from(gradient[i]) - numeric).abs() < 1e-6, "{i}: {} {numeric}", gradient[i]);
        }
    }
}
