//! An image holds f32 r g b per pixel; it is read from and written to files, resized and put together.
//!
//! Values are display values, 0..=1 for what a screen shows, as the splats' colours are; nothing here
//! converts to or from linear light. Files have 8 bits: a value is clamped, multiplied by 255 and rounded.

use std::path::Path;

use crate::{
    camera::MAX_SIDE,
    image_file::{Bounds, Rgba8, jpeg_of_rgb8, png_of_rgb8, webp_of_rgb8},
};

/// The most that a decoded file may take, bytes.
const MAX_DECODED_BYTES: u64 = 512 << 20;

/// An image; row 0 is at the top.
///
/// ```
/// use render_host::Image;
///
/// let image = Image::filled(4, 2, [0.5, 0.25, 1.0])?;
/// assert_eq!(image.pixel(3, 1), Some([0.5, 0.25, 1.0]));
/// let again = Image::decode(&image.to_png()?, [0.0; 3])?;
/// assert_eq!(again.to_rgb8(), image.to_rgb8());
/// # Ok::<(), render_host::ImageError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    width: u32,
    height: u32,
    /// Exactly `3 · width · height` values.
    rgb: Vec<f32>,
}

/// An image that cannot be made, read, written or compared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ImageError {
    /// A side is 0 or above 16384.
    #[error("image of {width} x {height}; sides of 1 to 16384 are allowed")]
    Size {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
    },
    /// The values do not fill the image.
    #[error("image of {width} x {height}: found {found} values, need {needed}")]
    Length {
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Values found.
        found: usize,
        /// Values needed.
        needed: usize,
    },
    /// Two images that must have the same size do not.
    #[error("images differ in size: {} x {} and {} x {}", a.0, a.1, b.0, b.1)]
    Mismatch {
        /// Width and height of the first.
        a: (u32, u32),
        /// Width and height of the second.
        b: (u32, u32),
    },
    /// Two sequences that must have the same length do not.
    #[error("sequences differ in length: {a} and {b} images")]
    Lengths {
        /// Images in the first.
        a: usize,
        /// Images in the second.
        b: usize,
    },
    /// A list that must hold something is empty, or a number of columns is 0.
    #[error("{0} is empty")]
    Empty(&'static str),
    /// A number is out of range.
    #[error("{field} is {found}; {allowed} is allowed")]
    Range {
        /// Which number.
        field: &'static str,
        /// Its value.
        found: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// The bytes are not a PNG, JPEG or WebP image, or cannot be written.
    #[error("image codec: {0}")]
    Codec(String),
    /// The file cannot be read or written.
    #[error("{path}: {message}")]
    File {
        /// Path as given.
        path: String,
        /// What the system said.
        message: String,
    },
}

impl Image {
    /// An image of `rgb` values: r g b per pixel, row by row.
    ///
    /// # Errors
    /// A side out of 1..=16384, or another number of values than `3 · width · height`.
    pub fn new(width: u32, height: u32, rgb: Vec<f32>) -> Result<Self, ImageError> {
        let needed = values(width, height)?;
        if rgb.len() != needed {
            return Err(ImageError::Length { width, height, found: rgb.len(), needed });
        }
        Ok(Self { width, height, rgb })
    }

    /// An image of one colour.
    ///
    /// # Errors
    /// A side out of 1..=16384.
    pub fn filled(width: u32, height: u32, colour: [f32; 3]) -> Result<Self, ImageError> {
        let n = values(width, height)? / 3;
        Ok(Self { width, height, rgb: colour.repeat(n) })
    }

    /// Takes another size; values are unspecified. Memory is kept.
    pub(crate) fn reset(&mut self, width: u32, height: u32) -> Result<(), ImageError> {
        let n = values(width, height)?;
        (self.width, self.height) = (width, height);
        self.rgb.resize(n, 0.0);
        Ok(())
    }

    /// Width, pixels. 0 only for the default image, which is empty.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels. 0 only for the default image, which is empty.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// r g b per pixel, row by row.
    pub fn rgb(&self) -> &[f32] {
        &self.rgb
    }

    /// r g b per pixel, row by row, to be changed in place.
    pub fn rgb_mut(&mut self) -> &mut [f32] {
        &mut self.rgb
    }

    /// Colour of the pixel in column `x` and row `y`, if there is one.
    pub fn pixel(&self, x: u32, y: u32) -> Option<[f32; 3]> {
        if x >= self.width || y >= self.height {
            return None;
        }
        let at = 3 * (y as usize * self.width as usize + x as usize);
        Some([self.rgb[at], self.rgb[at + 1], self.rgb[at + 2]])
    }

    /// 8-bit values, r g b per pixel: clamped to 0..=1, times 255, rounded. NaN becomes 0.
    pub fn to_rgb8(&self) -> Vec<u8> {
        self.rgb.iter().map(|v| (v.clamp(0.0, 1.0) * 255.0).round() as u8).collect()
    }

    /// The image as a PNG file's bytes, 8 bits per channel.
    ///
    /// # Errors
    /// An empty image.
    pub fn to_png(&self) -> Result<Vec<u8>, ImageError> {
        if self.rgb.is_empty() {
            return Err(ImageError::Empty("the image"));
        }
        png_of_rgb8(self.width, self.height, &self.to_rgb8()).map_err(|e| ImageError::Codec(e.to_string()))
    }

    /// The image as a JPEG file's bytes, at `quality` 1 to 100, colour at full resolution. Lossy.
    ///
    /// # Errors
    /// An empty image.
    pub fn to_jpeg(&self, quality: u8) -> Result<Vec<u8>, ImageError> {
        let file = jpeg_of_rgb8(self.width, self.height, &self.to_rgb8(), quality);
        file.map_err(|e| ImageError::Codec(e.to_string()))
    }

    /// The image as a lossless WebP file's bytes, 8 bits per channel.
    ///
    /// # Errors
    /// An empty image.
    pub fn to_webp(&self) -> Result<Vec<u8>, ImageError> {
        let file = webp_of_rgb8(self.width, self.height, &self.to_rgb8());
        file.map_err(|e| ImageError::Codec(e.to_string()))
    }

    /// Reads PNG, JPEG or WebP bytes. Transparent pixels are laid over `background`.
    ///
    /// # Errors
    /// Bytes that are no such image, or one with a side above 16384.
    pub fn decode(bytes: &[u8], background: [f32; 3]) -> Result<Self, ImageError> {
        let bounds = Bounds { side: MAX_SIDE, bytes: MAX_DECODED_BYTES, flat_bytes: MAX_DECODED_BYTES };
        let rgba = Rgba8::decode(bytes, bounds).map_err(|e| ImageError::Codec(e.to_string()))?;
        let (width, height) = rgba.size();
        let over = |&[r, g, b, a]: &[u8; 4]| {
            let (alpha, colour) = (f32::from(a) / 255.0, [r, g, b].map(|v| f32::from(v) / 255.0));
            std::array::from_fn::<f32, 3, _>(|c| alpha * colour[c] + (1.0 - alpha) * background[c])
        };
        Self::new(width, height, rgba.data().as_chunks().0.iter().flat_map(over).collect())
    }

    /// Reads a PNG, JPEG or WebP file. Transparent pixels are laid over `background`.
    ///
    /// # Errors
    /// As [`Image::decode`], or what the system says about the path.
    pub fn read(path: &Path, background: [f32; 3]) -> Result<Self, ImageError> {
        let bytes = std::fs::read(path).map_err(|e| file_error(path, &e))?;
        Self::decode(&bytes, background).map_err(|e| match e {
            ImageError::Codec(message) => ImageError::File { path: path.display().to_string(), message },
            other => other,
        })
    }

    /// Lays images side by side, in rows of `columns`, on black, `gap` pixels apart. Cells are as large as
    /// the largest image; smaller ones sit at the top left.
    ///
    /// # Errors
    /// No images, no columns, or a result with a side above 16384.
    pub fn strip(images: &[&Self], columns: usize, gap: u32) -> Result<Self, ImageError> {
        if images.is_empty() || columns == 0 {
            return Err(ImageError::Empty(if columns == 0 { "a row of 0 columns" } else { "a strip" }));
        }
        let cell_width = images.iter().map(|i| i.width).max().unwrap_or(0);
        let cell_height = images.iter().map(|i| i.height).max().unwrap_or(0);
        let (columns, rows) = (columns.min(images.len()), images.len().div_ceil(columns));
        let side = |n: usize, cell: u32| {
            let total = n as u64 * u64::from(cell) + (n as u64 - 1) * u64::from(gap);
            u32::try_from(total).unwrap_or(u32::MAX)
        };
        let mut out = Self::filled(side(columns, cell_width), side(rows, cell_height), [0.0; 3])?;
        for (i, image) in images.iter().enumerate() {
            let x = (i % columns) * (cell_width + gap) as usize;
            let y = (i / columns) * (cell_height + gap) as usize;
            let width = 3 * image.width as usize;
            for (row, source) in image.rgb.chunks_exact(width.max(1)).enumerate() {
                let at = 3 * ((y + row) * out.width as usize + x);
                out.rgb[at..at + width].copy_from_slice(source);
            }
        }
        Ok(out)
    }

    /// A copy of `width` × `height` in which every pixel is the mean of the source area it covers
    /// (box filter; when enlarging, the nearest pixel with blended seams).
    ///
    /// # Errors
    /// A side out of range, or an empty image.
    pub fn resized_box(&self, width: u32, height: u32) -> Result<Self, ImageError> {
        self.resized(width, height, |from, to| {
            let ratio = f64::from(from) / f64::from(to);
            let taps = |i: u32| {
                let (start, end) = (f64::from(i) * ratio, (f64::from(i) + 1.0) * ratio);
                let last = (end.ceil() as u32).min(from);
                let weight = move |k: u32| {
                    let (a, b) = (start.max(f64::from(k)), end.min(f64::from(k) + 1.0));
                    (k, ((b - a).max(0.0) / ratio) as f32)
                };
                (start as u32..last).map(weight).collect()
            };
            (0..to).map(taps).collect()
        })
    }

    /// Columns, then rows, each a weighted sum of the source's: `taps(from, to)` lists source and weight.
    fn resized(
        &self,
        width: u32,
        height: u32,
        taps: impl Fn(u32, u32) -> Vec<Vec<(u32, f32)>>,
    ) -> Result<Self, ImageError> {
        if self.rgb.is_empty() {
            return Err(ImageError::Empty("the image"));
        }
        let mut out = Self::filled(width, height, [0.0; 3])?;
        let (columns, rows) = (taps(self.width, width), taps(self.height, height));
        let stride = 3 * width as usize;
        let mut wide = vec![0.0; stride * self.height as usize];
        for (source, row) in self.rgb.chunks_exact(3 * self.width as usize).zip(wide.chunks_exact_mut(stride))
        {
            for (pixel, taps) in row.chunks_exact_mut(3).zip(&columns) {
                for &(x, weight) in taps {
                    (0..3).for_each(|c| pixel[c] += weight * source[3 * x as usize + c]);
                }
            }
        }
        for (row, taps) in out.rgb.chunks_exact_mut(stride).zip(&rows) {
            for &(y, weight) in taps {
                let source = &wide[y as usize * stride..][..stride];
                row.iter_mut().zip(source).for_each(|(sum, v)| *sum += weight * v);
            }
        }
        Ok(out)
    }
}

/// Both images' common width and height in pixels.
///
/// # Errors
/// Different sizes, or empty images.
pub(crate) fn same_size(a: &Image, b: &Image) -> Result<(usize, usize), ImageError> {
    if a.size() != b.size() {
        return Err(ImageError::Mismatch { a: a.size(), b: b.size() });
    }
    if a.rgb.is_empty() {
        return Err(ImageError::Empty("the image"));
    }
    Ok((a.width as usize, a.height as usize))
}

fn values(width: u32, height: u32) -> Result<usize, ImageError> {
    let allowed = 1..=MAX_SIDE;
    if !allowed.contains(&width) || !allowed.contains(&height) {
        return Err(ImageError::Size { width, height });
    }
    Ok(3 * width as usize * height as usize)
}

fn file_error(path: &Path, error: &std::io::Error) -> ImageError {
    ImageError::File { path: path.display().to_string(), message: error.to_string() }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn ramp(width: u32, height: u32) -> Image {
        let n = 3 * width * height;
        Image::new(width, height, (0..n).map(|i| (i % 256) as f32 / 255.0).collect()).unwrap()
    }

    #[test]
    fn the_constructor_refuses_what_does_not_fit() {
        let error = Image::new(3, 2, vec![0.0; 17]).unwrap_err().to_string();
        assert!(
            error.contains("3 x 2") && error.contains("found 17") && error.contains("need 18"),
            "{error}"
        );
        assert!(matches!(Image::filled(0, 4, [0.0; 3]), Err(ImageError::Size { .. })));
        assert!(matches!(Image::filled(4, 20_000, [0.0; 3]), Err(ImageError::Size { .. })));
    }

    #[test]
    fn png_keeps_8_bit_values_and_clamps_the_rest() {
        let image = ramp(7, 5);
        assert_eq!(Image::decode(&image.to_png().unwrap(), [0.0; 3]).unwrap(), image);
        let odd = Image::new(1, 1, vec![-1.0, 7.0, f32::NAN]).unwrap();
        assert_eq!(odd.to_rgb8(), [0, 255, 0]);
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        std::fs::write(&path, image.to_png().unwrap()).unwrap();
        assert_eq!(Image::read(&path, [0.0; 3]).unwrap(), image);
        let missing = Image::read(&folder.path().join("b.png"), [0.0; 3]).unwrap_err().to_string();
        assert!(missing.contains("b.png"), "{missing}");
        assert!(Image::decode(b"not an image", [0.0; 3]).is_err());
        assert_eq!(Image::default().to_png(), Err(ImageError::Empty("the image")));
    }

    #[test]
    fn transparency_goes_over_the_background() {
        let mut png = Cursor::new(Vec::new());
        let data = [255, 0, 0, 255, 255, 0, 0, 0];
        let (colour, format) = (image::ExtendedColorType::Rgba8, image::ImageFormat::Png);
        image::write_buffer_with_format(&mut png, &data, 2, 1, colour, format).unwrap();
        let image = Image::decode(&png.into_inner(), [0.0, 0.5, 1.0]).unwrap();
        assert_eq!(image.rgb(), [1.0, 0.0, 0.0, 0.0, 0.5, 1.0]);
    }

    #[test]
    fn jpeg_is_read() {
        let grey = Image::filled(16, 8, [0.5; 3]).unwrap();
        let mut jpeg = Cursor::new(Vec::new());
        let (colour, format) = (image::ExtendedColorType::Rgb8, image::ImageFormat::Jpeg);
        image::write_buffer_with_format(&mut jpeg, &grey.to_rgb8(), 16, 8, colour, format).unwrap();
        let back = Image::decode(&jpeg.into_inner(), [0.0; 3]).unwrap();
        assert!(back.size() == (16, 8) && back.rgb().iter().all(|v| (v - 0.5).abs() < 0.02));
    }

    #[test]
    fn a_strip_has_its_images_where_they_belong() {
        let (a, b) = (Image::filled(2, 3, [1.0; 3]).unwrap(), Image::filled(4, 1, [0.5; 3]).unwrap());
        let strip = Image::strip(&[&a, &b, &a], 2, 1).unwrap();
        assert_eq!(strip.size(), (9, 7));
        let at = |x, y| strip.pixel(x, y).unwrap()[0];
        assert_eq!(
            [at(1, 2), at(2, 2), at(5, 0), at(5, 1), at(0, 3), at(1, 6)],
            [1.0, 0.0, 0.5, 0.0, 0.0, 1.0]
        );
        assert!(strip.pixel(9, 0).is_none());
        assert!(Image::strip(&[], 2, 0).is_err() && Image::strip(&[&a], 0, 0).is_err());
        assert!(Image::strip(&[&a, &a], 2, u32::MAX).is_err());
    }

    #[test]
    fn the_box_filter_keeps_the_mean() {
        let image = ramp(12, 9);
        let mean = |i: &Image| i.rgb().iter().sum::<f32>() / i.rgb().len() as f32;
        for (w, h) in [(4, 3), (5, 4), (1, 1), (12, 9), (24, 18)] {
            let small = image.resized_box(w, h).unwrap();
            assert_eq!(small.size(), (w, h));
            assert!((mean(&small) - mean(&image)).abs() < 1e-5, "{w} {h}");
        }
        assert_eq!(image.resized_box(12, 9).unwrap(), image);
        assert!(Image::default().resized_box(1, 1).is_err());
    }
}
