//! LDR-FLIP (Andersson et al. 2020): the difference a person sees when switching between two images.
//!
//! Colour: both images are filtered by the eye's contrast sensitivity in an opponent space, compared in
//! Hunt-adjusted CIELAB by the HyAB distance, and the result is redistributed to 0..=1. Features: edges
//! and points of the luminance are compared. The two join as `colour^(1 - feature)`, per pixel.
//!
//! Input is sRGB display values, clamped to 0..=1. Every filter is a sum of separable ones, so it runs
//! along rows, then along columns; edges repeat the border pixel. Equal images give exactly 0; a NaN of
//! either image makes its surroundings in the map, and the mean, NaN.
//! A test holds this file to the authors' own program.

use crate::{
    image::{Image, ImageError, same_size},
    parallel,
};

/// A 0.7 m wide 3840-pixel screen seen from 0.7 m. Source: the FLIP paper.
pub const PIXELS_PER_DEGREE: f64 = 67.020_645_5;

const COLOUR_EXPONENT: f32 = 0.7;
const FEATURE_EXPONENT: f32 = 0.5;
/// Share of the largest colour difference below which it is mapped to [`PT`] of the range.
const PC: f32 = 0.4;
const PT: f32 = 0.95;
/// Width of the feature detector, degrees.
const FEATURE_WIDTH: f64 = 0.082;

/// The result of a comparison.
#[derive(Clone, Debug, PartialEq)]
pub struct Flip {
    /// Mean over all pixels, 0..=1; NaN when either image holds one.
    pub mean: f64,
    /// Error per pixel, 0..=1, row by row; NaN where the filters reach one of either image.
    pub map: Vec<f32>,
}

/// Compares two images seen at `pixels_per_degree` (1 to 1000; [`PIXELS_PER_DEGREE`] is usual).
///
/// # Errors
/// Different sizes, or `pixels_per_degree` out of range.
pub fn flip(test: &Image, reference: &Image, pixels_per_degree: f64) -> Result<Flip, ImageError> {
    let (width, height) = same_size(test, reference)?;
    if !(1.0..=1000.0).contains(&pixels_per_degree) {
        let (field, found) = ("pixels_per_degree", pixels_per_degree.to_string());
        return Err(ImageError::Range { field, found, allowed: "1 to 1000" });
    }
    let seen = |image| Seen::new(image, width, height, pixels_per_degree);
    let (a, b) = (seen(test), seen(reference));
    let largest = hyab(hunt([0.0, 1.0, 0.0]), hunt([0.0, 0.0, 1.0])).powf(COLOUR_EXPONENT);
    let mut map = vec![0.0; width * height];
    parallel::for_each_chunk(true, &mut map, width, |y, row| {
        for (x, out) in row.iter_mut().enumerate() {
            let i = y * width + x;
            let colour = redistribute(hyab(a.colour[i], b.colour[i]).powf(COLOUR_EXPONENT), largest);
            let edge = (a.edge[i] - b.edge[i]).abs();
            let point = (a.point[i] - b.point[i]).abs();
            let feature = (edge.max(point) * std::f32::consts::FRAC_1_SQRT_2).powf(FEATURE_EXPONENT);
            // `max` and `min` pass NaN over; a sum does not.
            *out = if (colour + edge + point).is_nan() {
                f32::NAN
            } else if colour > 0.0 {
                colour.powf(1.0 - feature.min(1.0))
            } else {
                0.0
            };
        }
    });
    let rows = map.chunks_exact(width).map(|row| row.iter().map(|&v| f64::from(v)).sum::<f64>());
    let mean = rows.sum::<f64>() / map.len() as f64;
    Ok(Flip { mean, map })
}

/// An image behind FLIP's filters: colour after contrast sensitivity, edges and points.
struct Seen {
    /// Hunt-adjusted CIELAB after contrast sensitivity.
    colour: Vec<[f32; 3]>,
    /// Strength of luminance edges.
    edge: Vec<f32>,
    /// Strength of luminance points.
    point: Vec<f32>,
}

impl Seen {
    fn new(image: &Image, width: usize, height: usize, ppd: f64) -> Self {
        let (pixels, _) = image.rgb().as_chunks::<3>();
        let opponent = per_pixel([width, height], |i| opponent(xyz(pixels[i].map(linear))));
        let plane = |c: usize| Plane { width, height, values: opponent.iter().map(|p| p[c]).collect() };

        let planes: [Vec<f32>; 3] = std::array::from_fn(|c| sensitivity(&plane(c), c, ppd));
        let colour = per_pixel([width, height], |i| {
            let filtered = linear_rgb(from_opponent([planes[0][i], planes[1][i], planes[2][i]]));
            hunt(filtered.map(|v| v.clamp(0.0, 1.0)))
        });

        let mut grey = plane(0);
        grey.values.iter_mut().for_each(|v| *v = (*v + 16.0) / 116.0);
        let filters = FeatureFilters::new(ppd);
        let strength = |filter: &[f32]| -> Vec<f32> {
            let across = grey.filtered(filter, &filters.smooth);
            let down = grey.filtered(&filters.smooth, filter);
            across.iter().zip(&down).map(|(x, y)| x.hypot(*y)).collect()
        };
        Self { colour, edge: strength(&filters.edge), point: strength(&filters.point) }
    }
}

/// What `of` makes of each pixel of an image of `size` (width, height), row by row.
fn per_pixel(size: [usize; 2], of: impl Fn(usize) -> [f32; 3] + Sync) -> Vec<[f32; 3]> {
    let [width, height] = size;
    let mut out = vec![[0.0; 3]; width * height];
    parallel::for_each_chunk(true, &mut out, width, |y, row| {
        row.iter_mut().enumerate().for_each(|(x, out)| *out = of(y * width + x));
    });
    out
}

/// One channel.
struct Plane {
    width: usize,
    height: usize,
    values: Vec<f32>,
}

impl Plane {
    /// Filters along rows, then along columns; both filters have odd length, borders repeat.
    fn filtered(&self, along: &[f32], down: &[f32]) -> Vec<f32> {
        let (width, height) = (self.width, self.height);
        let mut wide = vec![0.0; width * height];
        parallel::for_each_chunk(true, &mut wide, width, |y, out| {
            let source = &self.values[y * width..][..width];
            let radius = along.len() / 2;
            let mut padded = vec![source[0]; width + 2 * radius];
            padded[radius..radius + width].copy_from_slice(source);
            padded[radius + width..].fill(source[width - 1]);
            for (k, weight) in along.iter().enumerate() {
                out.iter_mut().zip(&padded[k..]).for_each(|(sum, v)| *sum += weight * v);
            }
        });
        let mut out = vec![0.0; width * height];
        parallel::for_each_chunk(true, &mut out, width, |y, out| {
            for (k, weight) in down.iter().enumerate() {
                let row = (y + k).saturating_sub(down.len() / 2).min(height - 1);
                out.iter_mut().zip(&wide[row * width..]).for_each(|(sum, v)| *sum += weight * v);
            }
        });
        out
    }
}

/// Contrast sensitivity of the opponent channels (lightness, red–green, blue–yellow): a sum of Gaussians
/// `a √(π/b) exp(-π² r² / b)` with r in degrees.
const SENSITIVITY: [&[(f64, f64)]; 3] = [&[(1.0, 0.0047)], &[(1.0, 0.0053)], &[(34.1, 0.04), (13.5, 0.025)]];

fn sensitivity(plane: &Plane, channel: usize, ppd: f64) -> Vec<f32> {
    let pi2 = std::f64::consts::PI.powi(2);
    // All three share the radius of the widest Gaussian, b = 0.04.
    let radius = (3.0 * (0.04 / (2.0 * pi2)).sqrt() * ppd).ceil() as i64;
    let parts: Vec<(f64, Vec<f64>)> = SENSITIVITY[channel]
        .iter()
        .map(|&(a, b)| {
            let taps = (-radius..=radius).map(|x| (-pi2 * (x as f64 / ppd).powi(2) / b).exp()).collect();
            (a * (std::f64::consts::PI / b).sqrt(), taps)
        })
        .collect();
    let sum: f64 = parts.iter().map(|(weight, taps)| weight * taps.iter().sum::<f64>().powi(2)).sum();
    let mut out = vec![0.0; plane.values.len()];
    for (weight, taps) in parts {
        let down: Vec<f32> = taps.iter().map(|&t| t as f32).collect();
        let along: Vec<f32> = taps.iter().map(|&t| (t * weight / sum) as f32).collect();
        out.iter_mut().zip(plane.filtered(&along, &down)).for_each(|(sum, v)| *sum += v);
    }
    out
}

/// One-dimensional parts of the feature detectors.
struct FeatureFilters {
    /// First derivative of a Gaussian; positive and negative weights sum to 1 and -1.
    edge: Vec<f32>,
    /// Second derivative, likewise.
    point: Vec<f32>,
    /// The Gaussian across, summing to 1.
    smooth: Vec<f32>,
}

impl FeatureFilters {
    fn new(ppd: f64) -> Self {
        let deviation = 0.5 * FEATURE_WIDTH * ppd;
        let radius = (3.0 * deviation).ceil() as i64;
        let filter = |shape: &dyn Fn(f64, f64) -> f64| -> Vec<f32> {
            let taps: Vec<f64> = (-radius..=radius)
                .map(|x| {
                    let x = x as f64 / deviation;
                    shape(x, (-0.5 * x * x).exp())
                })
                .collect();
            let total = |sign: f64| taps.iter().map(|t| (sign * t).max(0.0)).sum::<f64>();
            let (up, down) = (total(1.0), total(-1.0));
            taps.iter().map(|&t| (t / if t > 0.0 { up } else { down.max(1e-300) }) as f32).collect()
        };
        Self {
            edge: filter(&|x, g| -x * g),
            point: filter(&|x, g| (x * x - 1.0) * g),
            smooth: filter(&|_, g| g),
        }
    }
}

fn redistribute(difference: f32, largest: f32) -> f32 {
    let knee = PC * largest;
    if difference < knee {
        difference * PT / knee
    } else {
        PT + (difference - knee) / (largest - knee) * (1.0 - PT)
    }
}

fn hyab(a: [f32; 3], b: [f32; 3]) -> f32 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}

/// Linear RGB to CIELAB with chroma scaled by lightness (the Hunt effect).
fn hunt(rgb: [f32; 3]) -> [f32; 3] {
    const DELTA: f32 = 6.0 / 29.0;
    let xyz = xyz(rgb);
    let f = |i: usize| {
        let t = xyz[i] / WHITE[i];
        if t > DELTA * DELTA * DELTA { t.cbrt() } else { t / (3.0 * DELTA * DELTA) + 4.0 / 29.0 }
    };
    let (x, y, z) = (f(0), f(1), f(2));
    let lightness = 116.0 * y - 16.0;
    [lightness, 0.01 * lightness * 500.0 * (x - y), 0.01 * lightness * 200.0 * (y - z)]
}

/// The D65 white point.
const WHITE: [f32; 3] = [0.950_428_55, 1.0, 1.088_900_4];

fn linear(srgb: f32) -> f32 {
    let v = srgb.clamp(0.0, 1.0);
    if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
}

fn times(m: &[[f64; 3]; 3], v: [f32; 3]) -> [f32; 3] {
    m.map(|row| row.iter().zip(v).map(|(&a, v)| a as f32 * v).sum())
}

fn xyz(rgb: [f32; 3]) -> [f32; 3] {
    const M: [[f64; 3]; 3] = [
        [10_135_552.0 / 24_577_794.0, 8_788_810.0 / 24_577_794.0, 4_435_075.0 / 24_577_794.0],
        [2_613_072.0 / 12_288_897.0, 8_788_810.0 / 12_288_897.0, 887_015.0 / 12_288_897.0],
        [1_425_312.0 / 73_733_382.0, 8_788_810.0 / 73_733_382.0, 70_074_185.0 / 73_733_382.0],
    ];
    times(&M, rgb)
}

fn linear_rgb(xyz: [f32; 3]) -> [f32; 3] {
    const M: [[f64; 3]; 3] = [
        [3.241_003_275, -1.537_398_934, -0.498_615_861],
        [-0.969_224_334, 1.875_930_071, 0.041_554_224],
        [0.055_639_423, -0.204_011_202, 1.057_148_933],
    ];
    times(&M, xyz)
}

/// XYZ to the opponent space YCxCz.
fn opponent(xyz: [f32; 3]) -> [f32; 3] {
    let [x, y, z]: [f32; 3] = std::array::from_fn(|i| xyz[i] / WHITE[i]);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

fn from_opponent([lightness, cx, cz]: [f32; 3]) -> [f32; 3] {
    let y = (lightness + 16.0) / 116.0;
    [(y + cx / 500.0) * WHITE[0], y, (y - cz / 200.0) * WHITE[2]]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An 8-bit image of blobs, edges and noise.
    fn picture(width: u32, height: u32, seed: u32) -> Image {
        let mut state = seed;
        let mut next = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        let value = |i: u32, noise: u8| {
            let (x, y, c) = ((i / 3) % width, i / 3 / width, i % 3);
            let base = if (x / 7 + y / 5 + seed) % 3 == c { 200 } else { 30 + (x + y) as u8 % 50 };
            f32::from(u8::saturating_add(base, noise / 8)) / 255.0
        };
        Image::new(width, height, (0..3 * width * height).map(|i| value(i, next())).collect()).unwrap()
    }

    #[test]
    fn it_agrees_with_the_authors_program() {
        for (w, h, a, b) in [(64, 48, 1, 2), (33, 71, 5, 5), (100, 20, 9, 4)] {
            let (test, reference) = (picture(w, h, a), {
                let mut image = picture(w, h, b);
                image.rgb_mut()[..300].fill(1.0);
                image
            });
            let ours = flip(&test, &reference, PIXELS_PER_DEGREE).unwrap();
            let peer = |i: &Image| nv_flip::FlipImageRgb8::with_data(w, h, &i.to_rgb8());
            let ppd = PIXELS_PER_DEGREE as f32;
            let map = nv_flip::flip(peer(&reference), peer(&test), ppd);
            let theirs = nv_flip::FlipPool::from_image(&map).mean();
            // Both are f32; theirs filters in two dimensions, so sums differ in their last digits.
            assert!((ours.mean - f64::from(theirs)).abs() < 1e-4, "{} {theirs}", ours.mean);
        }
    }

    #[test]
    fn equal_is_zero_and_one_pixel_is_not() {
        let a = picture(40, 30, 3);
        assert_eq!(flip(&a, &a, PIXELS_PER_DEGREE).unwrap().mean, 0.0);
        let mut b = a.clone();
        b.rgb_mut()[3 * (15 * 40 + 20) + 1] = 1.0;
        b.rgb_mut()[3 * (15 * 40 + 20)] = 1.0;
        let out = flip(&b, &a, PIXELS_PER_DEGREE).unwrap();
        assert!(out.mean > 1e-4, "{}", out.mean);
        assert!(out.map.iter().all(|v| (0.0..=1.0).contains(v)));
        let near = out.map[15 * 40 + 20];
        assert!(near > 10.0 * out.map[0], "{near}");
    }

    #[test]
    fn black_and_white_are_as_far_as_it_gets() {
        let black = Image::filled(16, 16, [0.0; 3]).unwrap();
        let white = Image::filled(16, 16, [1.0; 3]).unwrap();
        let mean = flip(&black, &white, PIXELS_PER_DEGREE).unwrap().mean;
        assert!(mean > 0.9 && mean <= 1.0, "{mean}");
    }

    #[test]
    fn a_picture_with_nan_is_not_perfect() {
        let good = picture(40, 30, 3);
        let mut bad = good.clone();
        bad.rgb_mut()[3 * (15 * 40 + 20)] = f32::NAN;
        for (test, reference) in [(&bad, &good), (&good, &bad), (&bad, &bad)] {
            let out = flip(test, reference, PIXELS_PER_DEGREE).unwrap();
            assert!(out.mean.is_nan() && out.map[15 * 40 + 20].is_nan());
        }
        let all = Image::filled(16, 16, [f32::NAN; 3]).unwrap();
        assert!(flip(&all, &all, PIXELS_PER_DEGREE).unwrap().mean.is_nan());
    }

    #[test]
    fn sizes_and_the_viewing_distance_are_checked() {
        let (a, b) = (picture(8, 4, 1), picture(4, 8, 1));
        let error = flip(&a, &b, PIXELS_PER_DEGREE).unwrap_err().to_string();
        assert!(error.contains("8 x 4") && error.contains("4 x 8"), "{error}");
        let error = flip(&a, &a, f64::NAN).unwrap_err().to_string();
        assert!(error.contains("pixels_per_degree is NaN"), "{error}");
    }
}
