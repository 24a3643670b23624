//! Pictures whose pixels may be transparent, for what is laid over something else.

use crate::{
    image::{Image, ImageError},
    image_file::{png_of_rgba8, webp_of_rgba8},
};

impl Image {
    /// What looks as this image over black and as `over_white` over white: 8 bits per channel, r g b a per
    /// pixel, row by row, colours not multiplied by alpha.
    ///
    /// ```
    /// use render_host::Image;
    ///
    /// // Half of red.
    /// let black = Image::filled(1, 1, [0.5, 0.0, 0.0])?;
    /// let white = Image::filled(1, 1, [1.0, 0.5, 0.5])?;
    /// assert_eq!(black.to_rgba8(&white)?, [255, 0, 0, 128]);
    /// # Ok::<(), render_host::ImageError>(())
    /// ```
    ///
    /// # Errors
    /// Images of two sizes.
    pub fn to_rgba8(&self, over_white: &Self) -> Result<Vec<u8>, ImageError> {
        if self.size() != over_white.size() {
            return Err(ImageError::Mismatch { a: self.size(), b: over_white.size() });
        }
        let (black, white) = (self.rgb().as_chunks::<3>().0, over_white.rgb().as_chunks::<3>().0);
        Ok(black.iter().zip(white).flat_map(|(black, white)| pixel(*black, *white)).collect())
    }

    /// [`Image::to_rgba8`] as a PNG file's bytes.
    ///
    /// # Errors
    /// Images of two sizes, or empty ones.
    pub fn to_transparent_png(&self, over_white: &Self) -> Result<Vec<u8>, ImageError> {
        let file = png_of_rgba8(self.width(), self.height(), &self.to_rgba8(over_white)?);
        file.map_err(|e| ImageError::Codec(e.to_string()))
    }

    /// [`Image::to_rgba8`] as a lossless WebP file's bytes.
    ///
    /// # Errors
    /// Images of two sizes, or empty ones.
    pub fn to_transparent_webp(&self, over_white: &Self) -> Result<Vec<u8>, ImageError> {
        let file = webp_of_rgba8(self.width(), self.height(), &self.to_rgba8(over_white)?);
        file.map_err(|e| ImageError::Codec(e.to_string()))
    }
}

/// One pixel: the background shows through by as much as it changes the picture.
fn pixel(black: [f32; 3], white: [f32; 3]) -> [u8; 4] {
    let through = (0..3).map(|channel| white[channel] - black[channel]).sum::<f32>() / 3.0;
    let alpha = (1.0 - through).clamp(0.0, 1.0);
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let [r, g, b] = black.map(|channel| if alpha > 0.0 { byte(channel / alpha) } else { 0 });
    [r, g, b, byte(alpha)]
}
