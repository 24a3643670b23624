//! A photograph keeps 4 bytes per pixel, and which squares of it show anything.

use std::ops::Range;

use crate::{
    camera::MAX_SIDE,
    image::{Image, ImageError},
};

/// Side of the squares in which a photograph knows whether it shows anything, pixels.
pub(super) const SQUARE: usize = 8;

/// What a camera saw: red, green, blue and alpha of 8 bits, premultiplied (no colour is above its alpha).
///
/// ```
/// use render_host::adjoint::loss::photograph::Photograph;
///
/// // One opaque red pixel and a transparent one.
/// let photograph = Photograph::new(2, 1, vec![255, 0, 0, 255, 0, 0, 0, 0])?;
/// assert_eq!(photograph.over([0.0, 0.5, 1.0]).rgb(), [1.0, 0.0, 0.0, 0.0, 0.5, 1.0]);
/// # Ok::<(), render_host::ImageError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Photograph {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Exactly `4 · width · height` bytes: r g b a per pixel, row by row.
    pub(super) rgba: Vec<u8>,
    /// Of each square, row by row: whether a pixel in it is not wholly transparent.
    shown: Vec<bool>,
}

impl Photograph {
    /// A photograph of r g b a per pixel, row by row, premultiplied.
    ///
    /// # Errors
    /// A side out of 1..=16384, another number of bytes than `4 · width · height`, or a colour above its
    /// alpha.
    pub fn new(width: u32, height: u32, rgba: Vec<u8>) -> Result<Self, ImageError> {
        let allowed = 1..=MAX_SIDE;
        if !allowed.contains(&width) || !allowed.contains(&height) {
            return Err(ImageError::Size { width, height });
        }
        let needed = 4 * width as usize * height as usize;
        if rgba.len() != needed {
            return Err(ImageError::Length { width, height, found: rgba.len(), needed });
        }
        let (pixels, _) = rgba.as_chunks::<4>();
        let above = |&[r, g, b, a]: &[u8; 4]| r.max(g).max(b) > a;
        if let Some(at) = pixels.iter().position(above) {
            let (x, y) = (at % width as usize, at / width as usize);
            let found = format!("{:?} in column {x} of row {y}", pixels[at]);
            let allowed = "premultiplied r g b a, no colour above its alpha,";
            return Err(ImageError::Range { field: "photograph", found, allowed });
        }
        let columns = (width as usize).div_ceil(SQUARE);
        let mut shown = vec![false; columns * (height as usize).div_ceil(SQUARE)];
        for (y, row) in pixels.chunks_exact(width as usize).enumerate() {
            let squares = &mut shown[y / SQUARE * columns..][..columns];
            for (square, pixels) in squares.iter_mut().zip(row.chunks(SQUARE)) {
                *square |= pixels.iter().any(|pixel| pixel[3] > 0);
            }
        }
        Ok(Self { width, height, rgba, shown })
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// r g b a per pixel, row by row, premultiplied.
    pub fn rgba(&self) -> &[u8] {
        &self.rgba
    }

    /// The photograph on fewer pixels: each is the mean of the whole pixels that it covers, rounded.
    ///
    /// # Errors
    /// A side that does not divide the photograph's.
    pub fn resized(&self, width: u32, height: u32) -> Result<Self, ImageError> {
        for (field, found, whole) in [("width", width, self.width), ("height", height, self.height)] {
            if found == 0 || whole % found != 0 {
                let found = format!("{found} for {whole} pixels");
                return Err(ImageError::Range { field, found, allowed: "a divisor" });
            }
        }
        let (across, down) = ((self.width / width) as usize, (self.height / height) as usize);
        let count = (across * down) as u64;
        let mut rgba = Vec::with_capacity(4 * width as usize * height as usize);
        let mut sums = vec![[0u64; 4]; width as usize];
        for rows in self.rgba.chunks_exact(4 * self.width as usize * down) {
            sums.fill([0; 4]);
            for row in rows.chunks_exact(4 * self.width as usize) {
                for (sum, pixels) in sums.iter_mut().zip(row.chunks_exact(4 * across)) {
                    for pixel in pixels.as_chunks::<4>().0 {
                        sum.iter_mut().zip(pixel).for_each(|(sum, &v)| *sum += u64::from(v));
                    }
                }
            }
            rgba.extend(sums.as_flattened().iter().map(|sum| ((sum + count / 2) / count) as u8));
        }
        Self::new(width, height, rgba)
    }

    /// The photograph over a background, r g b.
    pub fn over(&self, background: [f32; 3]) -> Image {
        let mut rgb = vec![0.0; self.rgba.len() / 4 * 3];
        put_over(&self.rgba, background, &mut rgb);
        // The sides were checked when the photograph was made.
        Image::new(self.width, self.height, rgb).unwrap_or_default()
    }

    /// Whether all pixels in columns `x` and rows `y`, of which there is at least one each, are wholly
    /// transparent. May say no where squares that they touch show something elsewhere.
    pub(super) fn is_empty(&self, x: Range<usize>, y: Range<usize>) -> bool {
        let columns = (self.width as usize).div_ceil(SQUARE);
        let across = x.start / SQUARE..x.end.div_ceil(SQUARE);
        (y.start / SQUARE..y.end.div_ceil(SQUARE))
            .all(|row| !self.shown[row * columns..][across.clone()].contains(&true))
    }
}

/// Puts pixels r g b a, premultiplied, over a background. A wholly transparent one gives the background's
/// very bits, as an empty tile of a picture has them.
#[inline(always)]
pub(super) fn put_over(rgba: &[u8], background: [f32; 3], rgb: &mut [f32]) {
    for (&[r, g, b, a], out) in rgba.as_chunks::<4>().0.iter().zip(rgb.as_chunks_mut::<3>().0) {
        let shows = 1.0 - f32::from(a) / 255.0;
        for ((out, colour), background) in out.iter_mut().zip([r, g, b]).zip(background) {
            *out = f32::from(colour) / 255.0 + shows * background;
        }
    }
}
