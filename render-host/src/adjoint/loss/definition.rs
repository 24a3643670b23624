//! A loss is a number about a picture, with its gradient.

use crate::image::{Image, ImageError};

/// A number about a picture, smaller for a better one.
///
/// ```
/// use render_host::{Image, Loss, adjoint::loss::Mse};
///
/// let loss = Mse::new(Image::filled(2, 1, [0.5; 3])?);
/// let mut gradient = [0.0; 6];
/// let value = loss.differentiate(&Image::filled(2, 1, [0.75; 3])?, false, &mut gradient)?;
/// assert!((value - 0.0625).abs() < 1e-6 && gradient.iter().all(|&slope| slope > 0.0));
/// # Ok::<(), render_host::ImageError>(())
/// ```
pub trait Loss: Sync {
    /// The value; its gradient with respect to every value of `image` goes to `gradient` (r g b per
    /// pixel, row by row, as long as the image).
    ///
    /// # Errors
    /// The loss is made for another size of picture.
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError>;

    /// The value alone, of a picture in f64 with as many values as the loss is made for.
    fn exact(&self, rgb: &[f64]) -> f64;
}
