//! Error as a picture: a value per pixel through the magma colour map.
//!
//! Magma's lightness rises evenly from black to a pale yellow, so it reads the same in grey and for
//! colour-blind eyes. The scale is the caller's to state: `full` is the error that gets the last colour,
//! and everything above it.

use crate::image::{Image, ImageError, same_size};

/// Magma at 0, 0.1, … 1 (sRGB, 8 bits); between them, linear. Source: matplotlib.
const MAGMA: [[u8; 3]; 11] = [
    [0x00, 0x00, 0x04],
    [0x14, 0x0e, 0x36],
    [0x3b, 0x0f, 0x70],
    [0x64, 0x1a, 0x80],
    [0x8c, 0x29, 0x81],
    [0xb7, 0x37, 0x79],
    [0xde, 0x49, 0x68],
    [0xf7, 0x70, 0x5c],
    [0xfe, 0x9f, 0x6d],
    [0xfe, 0xcf, 0x92],
    [0xfc, 0xfd, 0xbf],
];

/// The mean absolute error of each pixel's three channels, coloured: 0 black, `full` and above pale
/// yellow, NaN green.
///
/// # Errors
/// Different sizes, or `full` not a positive finite number.
pub fn heat(test: &Image, reference: &Image, full: f32) -> Result<Image, ImageError> {
    same_size(test, reference)?;
    let pixels = test.rgb().chunks_exact(3).zip(reference.rgb().chunks_exact(3));
    let errors: Vec<f32> =
        pixels.map(|(a, b)| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f32>() / 3.0).collect();
    map(test.width(), test.height(), &errors, full)
}

/// Colours `values`, one per pixel, as [`heat`] does.
///
/// # Errors
/// Another number of values than pixels, a side out of range, or `full` not a positive finite number.
pub fn map(width: u32, height: u32, values: &[f32], full: f32) -> Result<Image, ImageError> {
    if !(full.is_finite() && full > 0.0) {
        let allowed = "a positive finite number";
        return Err(ImageError::Range { field: "full", found: full.to_string(), allowed });
    }
    Image::new(width, height, values.iter().flat_map(|v| colour(v / full)).collect())
}

/// The colour of `level`: 0 to 1, clamped.
pub fn colour(level: f32) -> [f32; 3] {
    if level.is_nan() {
        return [0.0, 1.0, 0.0];
    }
    let last = MAGMA.len() - 1;
    let position = level.clamp(0.0, 1.0) * last as f32;
    let i = (position as usize).min(last - 1);
    let f = position - i as f32;
    std::array::from_fn(|c| ((1.0 - f) * f32::from(MAGMA[i][c]) + f * f32::from(MAGMA[i + 1][c])) / 255.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lightness_rises_all_the_way() {
        let light = |v: f32| {
            let [r, g, b] = colour(v).map(|c| c.powf(2.2));
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        for i in 0..200 {
            assert!(light(i as f32 / 200.0) < light((i + 1) as f32 / 200.0), "{i}");
        }
    }

    #[test]
    fn the_changed_pixel_lights_up_and_no_other() {
        let a = Image::filled(5, 4, [0.5; 3]).unwrap();
        let mut b = a.clone();
        b.rgb_mut()[3 * 7..3 * 8].fill(0.75);
        let out = heat(&b, &a, 0.25).unwrap();
        assert_eq!(out.pixel(2, 1), Some(colour(1.0)));
        assert_eq!(out.pixel(3, 1), Some(colour(0.0)));
        b.rgb_mut()[0] = f32::NAN;
        assert_eq!(heat(&b, &a, 0.25).unwrap().pixel(0, 0), Some([0.0, 1.0, 0.0]));
        assert!(heat(&a, &b, 0.0).unwrap_err().to_string().contains("full is 0"));
        assert!(heat(&a, &Image::filled(4, 5, [0.0; 3]).unwrap(), 1.0).is_err());
    }
}
