//! Reads the files of a dataset: bytes, photographs, names.

use std::path::Path;

use render_host::{
    Camera, ImageError,
    adjoint::loss::photograph::Photograph,
    camera::MAX_SIDE,
    image_file::{Bounds, Rgba8},
};

use super::error::DatasetError;
use crate::train::pixel_mask::PixelMask;

/// All bytes of a file.
pub(super) fn read_bytes(path: &Path) -> Result<Vec<u8>, DatasetError> {
    std::fs::read(path).map_err(|source| DatasetError::File { path: path.to_owned(), source })
}

/// Bytes that a lossless WebP file of any length may take in memory: a mask of one colour, 4096 × 4096.
const FLAT_BYTES: u64 = 64 << 20;

/// The photograph in an image file; `true` where some of it is transparent.
pub(super) fn read_photograph(path: &Path) -> Result<(Photograph, bool), DatasetError> {
    let bytes = read_bytes(path)?;
    let failed = |source| DatasetError::Image { path: path.to_owned(), source };
    let most = 4 * u64::from(MAX_SIDE) * u64::from(MAX_SIDE);
    let bounds = Bounds { side: MAX_SIDE, bytes: most, flat_bytes: FLAT_BYTES };
    let image = Rgba8::decode(&bytes, bounds).map_err(|e| failed(ImageError::Codec(e.to_string())))?;
    drop(bytes);
    let (width, height) = image.size();
    let mut rgba = image.into_data();
    let mut has_alpha = false;
    for [r, g, b, a] in rgba.as_chunks_mut::<4>().0.iter_mut().filter(|pixel| pixel[3] < 255) {
        has_alpha = true;
        let by_alpha = |v: u8| ((u32::from(v) * u32::from(*a) + 127) / 255) as u8;
        [*r, *g, *b] = [*r, *g, *b].map(by_alpha);
    }
    Photograph::new(width, height, rgba).map(|p| (p, has_alpha)).map_err(failed)
}

/// The mask in an image file: yes where it is not black.
pub(super) fn read_mask(path: &Path) -> Result<PixelMask, DatasetError> {
    let (mask, _) = read_photograph(path)?;
    let values = mask.rgba().chunks_exact(4).map(|pixel| pixel[0].max(pixel[1]).max(pixel[2])).collect();
    PixelMask::new(mask.width(), mask.height(), values).ok_or_else(|| {
        let source = ImageError::Size { width: mask.width(), height: mask.height() };
        DatasetError::Image { path: path.to_owned(), source }
    })
}

/// The name of the last part of a path.
pub(super) fn name_of(path: &Path) -> String {
    let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// Whether an image of `width` × `height` is that of `camera`, or a larger or smaller copy whose sides were
/// rounded: one of them, of the other by the camera's ratio, is off by less than a pixel.
pub(super) fn is_copy(camera: &Camera, width: u32, height: u32) -> bool {
    let [of_width, of_height] = [camera.width(), camera.height()].map(u64::from);
    let off = (u64::from(width) * of_height).abs_diff(u64::from(height) * of_width);
    off < of_width.max(of_height)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cuts_are_no_copies() {
        let is_copy = |camera: (u32, u32), image: (u32, u32)| {
            let up = [0.0, -1.0, 0.0];
            let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], up, 0.7, camera.0, camera.1).unwrap();
            is_copy(&camera, image.0, image.1)
        };
        // Sides rounded to the nearest, down and up.
        for image in [(2690, 2016), (672, 504), (673, 504), (672, 503), (5380, 4032), (336, 252)] {
            assert!(is_copy((2690, 2016), image), "{image:?}");
        }
        assert!(is_copy((240, 320), (60, 80)) && is_copy((321, 241), (160, 120)));
        for image in [(320, 238), (320, 239), (318, 240), (240, 320), (160, 119), (640, 478)] {
            assert!(!is_copy((320, 240), image), "{image:?}");
        }
    }
}
