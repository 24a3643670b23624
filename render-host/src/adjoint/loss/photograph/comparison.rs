//! A photograph loss says how far a picture is from a photograph.

use std::{cell::RefCell, ops::Range};

use super::{
    areas::{areas, band_rows},
    source::{Photograph, put_over},
    sweep::{Compared, Memory, Sums, Sweep},
};
use crate::{
    adjoint::loss::{
        Loss,
        ssim::{self, rows::MIDDLE, sweep::FARTHEST},
    },
    image::{Image, ImageError},
    metric::ssim::Windows,
    parallel,
};

/// Half-width of the rounded tip of the absolute error (Charbonnier), in display values.
const TIP: f64 = 1e-3;

/// How much of each part a loss has; 0 leaves a part out and costs nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Of the mean absolute error, `√(e² + 0.001²) - 0.001` per value (Charbonnier).
    pub absolute: f32,
    /// Of the mean squared error.
    pub squared: f32,
    /// Of `1 - SSIM`.
    pub structure: f32,
}

/// The weighted distance of a picture from a photograph over a background.
///
/// Making one costs next to nothing, and comparing costs nothing where both show only the background. A
/// value further than 10⁶ from the photograph counts as that far.
///
/// ```
/// use render_host::{Image, Loss, adjoint::loss::photograph::{Photograph, PhotographLoss, Weights}};
///
/// let photograph = Photograph::new(2, 2, [128, 128, 128, 255].repeat(4))?;
/// let weights = Weights { absolute: 0.8, squared: 0.0, structure: 0.2 };
/// let loss = PhotographLoss::new(&photograph, [1.0; 3], weights);
/// let mut gradient = vec![0.0; 12];
/// let value = loss.differentiate(&Image::filled(2, 2, [0.7; 3])?, false, &mut gradient)?;
/// assert!(value > 0.1 && gradient[0] > 0.0);
/// # Ok::<(), render_host::ImageError>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct PhotographLoss<'a> {
    photograph: &'a Photograph,
    background: [f32; 3],
    weights: Weights,
    /// Left and top of the rectangle that is compared, inside the photograph.
    corner: [usize; 2],
    /// Its width and height, at least 1.
    size: [usize; 2],
    /// One per pixel of the photograph.
    pixel_weights: Option<&'a [u8]>,
}

thread_local! {
    /// Scratch memory of this thread; what it held does not matter.
    static MEMORY: RefCell<Memory> = RefCell::default();
}

impl<'a> PhotographLoss<'a> {
    /// The distance from `photograph` over `background`, r g b.
    pub fn new(photograph: &'a Photograph, background: [f32; 3], weights: Weights) -> Self {
        let size = [photograph.width as usize, photograph.height as usize];
        Self { photograph, background, weights, corner: [0; 2], size, pixel_weights: None }
    }

    /// The same over a rectangle of the photograph, for the picture of a camera that sees just that
    /// ([`crate::Camera::cropped`]): means and windows are those of the rectangle.
    ///
    /// # Errors
    /// A rectangle that is empty or not inside the photograph.
    pub fn cropped(self, left: u32, top: u32, width: u32, height: u32) -> Result<Self, ImageError> {
        let fits = |first: u32, side: u32, whole: u32| side > 0 && first <= whole && side <= whole - first;
        let whole = (self.photograph.width, self.photograph.height);
        if !fits(left, width, whole.0) || !fits(top, height, whole.1) {
            let found = format!("{width} x {height} from {left}, {top} of {} x {}", whole.0, whole.1);
            let allowed = "a rectangle inside the photograph";
            return Err(ImageError::Range { field: "crop", found, allowed });
        }
        let corner = [left as usize, top as usize];
        Ok(Self { corner, size: [width as usize, height as usize], ..self })
    }

    /// The same, where the pixels count by `weights` of 0..=255, one per pixel of the photograph, row by
    /// row: what is compared is the picture blended into the photograph by weight / 255. So at 0 a pixel
    /// counts as equal, in its neighbours' windows too.
    ///
    /// # Errors
    /// Not one weight per pixel.
    pub fn with_pixel_weights(self, weights: &'a [u8]) -> Result<Self, ImageError> {
        let Photograph { width, height, .. } = *self.photograph;
        let needed = width as usize * height as usize;
        if weights.len() != needed {
            return Err(ImageError::Length { width, height, found: weights.len(), needed });
        }
        Ok(Self { pixel_weights: Some(weights), ..self })
    }
}

impl Loss for PhotographLoss<'_> {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let [width, height] = self.size;
        if image.size() != (width as u32, height as u32) {
            return Err(ImageError::Mismatch { a: image.size(), b: (width as u32, height as u32) });
        }
        let windows = Windows::new(width, height);
        let by_distance = |weights: &[f64]| -> [f32; MIDDLE + 1] {
            std::array::from_fn(|k| weights.get(weights.len() / 2 + k).map_or(0.0, |&w| w as f32))
        };
        let (along, down) = (by_distance(&windows.along), by_distance(&windows.down));
        let centres =
            |weights: &[f64], count: usize| -> Range<usize> { weights.len() / 2..weights.len() / 2 + count };
        let (values, count) = ((3 * width * height) as f64, windows.count() as f64);
        let [absolute, squared, structure] =
            [self.weights.absolute, self.weights.squared, self.weights.structure].map(f64::from);
        let band = band_rows(height);
        let bands = areas(image.rgb(), self.size, self.photograph, self.corner, self.background, parallel);
        let mut bands: Vec<_> = bands
            .into_iter()
            .zip(gradient.chunks_mut(3 * width * band))
            .map(|(areas, gradient)| (areas, gradient, Sums::default()))
            .collect();
        let arch = pulp::Arch::new();
        parallel::for_each(parallel, &mut bands, |index, (areas, gradient, sums)| {
            gradient.fill(0.0);
            for area in areas.iter() {
                let first = area.rows.start - index * band;
                let gradient = &mut gradient[3 * width * first..];
                let compared = Compared {
                    picture: image.rgb(),
                    photograph: &self.photograph.rgba,
                    photograph_width: self.photograph.width as usize,
                    corner: self.corner,
                    pixel_weights: self.pixel_weights,
                    background: self.background,
                    size: self.size,
                    rows: area.rows.clone(),
                    columns: area.columns.clone(),
                    centres: [centres(&windows.along, windows.columns), centres(&windows.down, windows.rows)],
                    along: &along,
                    down: &down,
                    scale: [absolute / values, 2.0 * squared / values, structure / count].map(|v| v as f32),
                };
                MEMORY.with_borrow_mut(|memory| {
                    sums.add(&arch.dispatch(Sweep { compared, memory, gradient }));
                });
            }
        });
        let mut sums = Sums::default();
        bands.iter().for_each(|(_, _, band)| sums.add(band));
        Ok(absolute * sums.absolute / values
            + squared * sums.squared / values
            + structure * sums.structure / count)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        let [width, height] = self.size;
        let mut photograph = vec![0.0; 3 * width * height];
        let mut shares = vec![1.0; width * height];
        for (y, out) in photograph.chunks_exact_mut(3 * width).enumerate() {
            let first = (self.corner[1] + y) * self.photograph.width as usize + self.corner[0];
            put_over(&self.photograph.rgba[4 * first..4 * (first + width)], self.background, out);
            if let Some(weights) = self.pixel_weights {
                let shares = shares[y * width..].iter_mut();
                shares.zip(&weights[first..]).take(width).for_each(|(s, &w)| *s = f64::from(w) / 255.0);
            }
        }
        let photograph: Vec<f64> = photograph.iter().map(|&v| f64::from(v)).collect();
        let far = f64::from(FARTHEST);
        let errors: Vec<f64> =
            (0..rgb.len()).map(|i| shares[i / 3] * (rgb[i] - photograph[i]).clamp(-far, far)).collect();
        let blended: Vec<f64> = photograph.iter().zip(&errors).map(|(y, e)| y + e).collect();
        let mean = |of: &dyn Fn(f64) -> f64| errors.iter().map(|&e| of(e)).sum::<f64>() / errors.len() as f64;
        let windows = Windows::new(width, height);
        let [absolute, squared, structure] =
            [self.weights.absolute, self.weights.squared, self.weights.structure].map(f64::from);
        absolute * mean(&|e| (e * e + TIP * TIP).sqrt() - TIP)
            + squared * mean(&|e| e * e)
            + structure * ssim::exact(&windows, width, &blended, &photograph)
    }
}
