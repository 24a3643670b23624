//! Pictures with alpha, for what is laid over something else.

use crate::{
    image::{Image, ImageError},
    image_file::{png_of_rgba8, webp_of_rgba8},
};

impl Image {
    /// This image, which was rendered over black, with alpha: 8 bits per channel, r g b a per pixel, row by
    /// row, straight (not premultiplied). `transmittance` is the share of the background that shows, 0 to 1
    /// per pixel, row by row: that of [`Rendered`](crate::Rendered).
    ///
    /// ```
    /// use render_host::Image;
    ///
    /// // Half of red.
    /// let image = Image::filled(1, 1, [0.5, 0.0, 0.0])?;
    /// assert_eq!(image.to_rgba8(&[0.5])?, [255, 0, 0, 128]);
    /// # Ok::<(), render_host::ImageError>(())
    /// ```
    ///
    /// # Errors
    /// Another number of values than pixels.
    pub fn to_rgba8(&self, transmittance: &[f32]) -> Result<Vec<u8>, ImageError> {
        let pixels = self.rgb().as_chunks::<3>().0;
        if pixels.len() != transmittance.len() {
            let found = format!("{} values for {} pixels", transmittance.len(), pixels.len());
            return Err(ImageError::Range { field: "transmittance", found, allowed: "one per pixel" });
        }
        Ok(pixels.iter().zip(transmittance).flat_map(|(rgb, &through)| pixel(*rgb, through)).collect())
    }

    /// [`Image::to_rgba8`] as a PNG file's bytes.
    ///
    /// # Errors
    /// As [`Image::to_rgba8`], or an empty image.
    pub fn to_transparent_png(&self, transmittance: &[f32]) -> Result<Vec<u8>, ImageError> {
        let file = png_of_rgba8(self.width(), self.height(), &self.to_rgba8(transmittance)?);
        file.map_err(|e| ImageError::Codec(e.to_string()))
    }

    /// [`Image::to_rgba8`] as a lossless WebP file's bytes.
    ///
    /// # Errors
    /// As [`Image::to_rgba8`], or an empty image.
    pub fn to_transparent_webp(&self, transmittance: &[f32]) -> Result<Vec<u8>, ImageError> {
        let file = webp_of_rgba8(self.width(), self.height(), &self.to_rgba8(transmittance)?);
        file.map_err(|e| ImageError::Codec(e.to_string()))
    }
}

/// One pixel of a picture over black.
fn pixel(rgb: [f32; 3], transmittance: f32) -> [u8; 4] {
    let alpha = (1.0 - transmittance).clamp(0.0, 1.0);
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let [r, g, b] = rgb.map(|channel| if alpha > 0.0 { byte(channel / alpha) } else { 0 });
    [r, g, b, byte(alpha)]
}
