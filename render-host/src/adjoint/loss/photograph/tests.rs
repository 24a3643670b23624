use super::{
    areas::{Area, areas},
    *,
};
use crate::{
    Image,
    adjoint::{Loss, loss::Dissimilarity},
    metric,
};

const PARTS: [Weights; 4] = [
    Weights { absolute: 1.0, squared: 0.0, structure: 0.0 },
    Weights { absolute: 0.0, squared: 1.0, structure: 0.0 },
    Weights { absolute: 0.0, squared: 0.0, structure: 1.0 },
    Weights { absolute: 0.8, squared: 0.3, structure: 0.2 },
];

struct TestRng(u32);

impl TestRng {
    fn below(&mut self, past: u32) -> u32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) % past
    }
}

fn noise(width: u32, height: u32, seed: u32) -> Image {
    let mut numbers = TestRng(seed);
    let mut next = || numbers.below(1 << 20) as f32 / (1u32 << 20) as f32;
    Image::new(width, height, (0..3 * width * height).map(|_| next()).collect()).unwrap()
}

/// A photograph that shows something in the box of `shown` (columns and rows, half-open).
fn photograph(width: u32, height: u32, shown: [u32; 4], seed: u32) -> Photograph {
    let mut numbers = TestRng(seed);
    let [left, right, top, bottom] = shown;
    let pixels = (0..width * height).flat_map(|at| {
        let (x, y) = (at % width, at / width);
        let alpha = 1 + numbers.below(255);
        let [r, g, b] = [0; 3].map(|_| numbers.below(alpha + 1) as u8);
        let inside = (left..right).contains(&x) && (top..bottom).contains(&y);
        if inside { [r, g, b, alpha as u8] } else { [0; 4] }
    });
    Photograph::new(width, height, pixels.collect()).unwrap()
}

/// The background, with noise in a box.
fn picture(width: u32, height: u32, shown: [u32; 4], background: [f32; 3]) -> Image {
    let mut image = noise(width, height, 77);
    let [left, right, top, bottom] = shown;
    for (at, pixel) in image.rgb_mut().chunks_exact_mut(3).enumerate() {
        let (x, y) = (at as u32 % width, at as u32 / width);
        if !((left..right).contains(&x) && (top..bottom).contains(&y)) {
            pixel.copy_from_slice(&background);
        }
    }
    image
}

/// Largest difference of the gradient from differences of the exact twin, by the largest gradient.
fn worst(loss: &PhotographLoss, image: &Image, step: usize) -> f64 {
    let mut gradient = vec![f32::NAN; image.rgb().len()];
    let value = loss.differentiate(image, false, &mut gradient).unwrap();
    let mut rgb: Vec<f64> = image.rgb().iter().map(|&v| f64::from(v)).collect();
    let exact = loss.exact(&rgb);
    assert!((value - exact).abs() < 2e-6 * exact.max(0.1), "{value} {exact}");
    let largest = gradient.iter().fold(0.0f32, |a, g| a.max(g.abs()));
    let mut worst = 0.0f64;
    for i in (0..rgb.len()).step_by(step) {
        let mut at = |h: f64| {
            let was = rgb[i];
            rgb[i] += h;
            let value = loss.exact(&rgb);
            rgb[i] = was;
            value
        };
        let slope = |at: &mut dyn FnMut(f64) -> f64, h: f64| (at(h) - at(-h)) / (2.0 * h);
        let expected = (4.0 * slope(&mut at, 1e-5) - slope(&mut at, 2e-5)) / 3.0;
        worst = worst.max((f64::from(gradient[i]) - expected).abs() / f64::from(largest));
    }
    worst
}

#[test]
fn gradients_are_the_differences_of_the_exact_twin() {
    for (w, h) in [(23, 17), (11, 12), (12, 5), (4, 30), (1, 1)] {
        let (image, photograph) = (noise(w, h, 1), photograph(w, h, [0, w, 0, h], 2));
        for weights in PARTS {
            let loss = PhotographLoss::new(&photograph, [1.0, 0.5, 0.0], weights);
            let worst = worst(&loss, &image, 7);
            assert!(worst < 1e-5, "{w} x {h}, {weights:?}: {worst}");
        }
    }
}

/// In an even patch on white, where the photograph's moments lose the most to rounding.
#[test]
fn even_patches_on_white_are_as_exact() {
    let shown = [20, 60, 10, 40];
    let photograph = photograph(70, 50, shown, 3);
    let mut image = picture(70, 50, shown, [1.0; 3]);
    image.rgb_mut().iter_mut().for_each(|v| *v = 0.7 + 0.3 * *v);
    for weights in PARTS {
        let worst = worst(&PhotographLoss::new(&photograph, [1.0; 3], weights), &image, 61);
        assert!(worst < 2e-5, "{weights:?}: {worst}");
    }
}

#[test]
fn values_are_those_of_the_metrics() {
    let (image, photograph) = (noise(70, 50, 1), photograph(70, 50, [5, 40, 9, 33], 2));
    let background = [0.9, 0.8, 0.7];
    let over = photograph.over(background);
    let mut gradient = vec![0.0; image.rgb().len()];
    let mut value = |weights| {
        PhotographLoss::new(&photograph, background, weights)
            .differentiate(&image, true, &mut gradient)
            .unwrap()
    };
    assert!((value(PARTS[1]) - metric::mse(&image, &over).unwrap()).abs() < 1e-7);
    assert!((value(PARTS[2]) - 1.0 + metric::ssim(&image, &over).unwrap()).abs() < 1e-6);
    let absolute = image.rgb().iter().zip(over.rgb()).map(|(a, b)| f64::from((a - b).abs())).sum::<f64>();
    assert!((value(PARTS[0]) - absolute / image.rgb().len() as f64).abs() < 1e-3);
}

/// What is left out has value and gradient 0: the same picture with everything compared, one sweep each.
#[test]
fn what_is_left_out_has_no_gradient() {
    let (width, height) = (200, 150);
    let background = [1.0, 0.25, 0.0];
    for (seen, shown) in [
        ([70, 90, 60, 70], [80, 121, 33, 77]),
        ([0, 0, 0, 0], [30, 31, 100, 101]),
        ([190, 200, 140, 150], [0, 0, 0, 0]),
        ([31, 49, 15, 33], [140, 200, 130, 150]),
    ] {
        let photograph = photograph(width, height, shown, 4);
        let image = picture(width, height, seen, background);
        let size = [width as usize, height as usize];
        let some = areas(image.rgb(), size, &photograph, [0; 2], background, false);
        let pixels = |area: &Area| area.columns.len() * area.rows.len();
        let compared: usize = some.iter().flatten().map(pixels).sum();
        assert!(compared > 0 && compared < 15_000, "{some:?}");
        let structure = Dissimilarity::new(photograph.over(background));
        let (mut sparse, mut whole) = (vec![f32::NAN; image.rgb().len()], vec![0.0; image.rgb().len()]);
        let loss = PhotographLoss::new(&photograph, background, PARTS[2]);
        let value = loss.differentiate(&image, false, &mut sparse).unwrap();
        let expected = structure.differentiate(&image, false, &mut whole).unwrap();
        assert!((value - expected).abs() < 1e-5 * expected, "{value} {expected}");
        let largest = whole.iter().fold(0.0f32, |a, g| a.max(g.abs()));
        for (i, (a, b)) in sparse.iter().zip(&whole).enumerate() {
            assert!((a - b).abs() < 1e-5 * largest, "{i}: {a} {b}");
            assert!(*b != 0.0 || *a == 0.0, "{i}");
        }
    }
}

/// A background that is not the picture's own: nothing can be left out, and nothing is.
#[test]
fn another_background_is_an_error_everywhere() {
    let photograph = photograph(100, 80, [0; 4], 4);
    let image = picture(100, 80, [0; 4], [0.5; 3]);
    let mut gradient = vec![0.0; image.rgb().len()];
    let loss = PhotographLoss::new(&photograph, [0.25; 3], PARTS[1]);
    let value = loss.differentiate(&image, false, &mut gradient).unwrap();
    assert!((value - 0.0625).abs() < 1e-9 && gradient.iter().all(|&g| g > 0.0), "{value}");
}

#[test]
fn a_crop_is_the_loss_of_a_smaller_photograph() {
    let whole = photograph(90, 70, [10, 80, 5, 60], 8);
    let (left, top, width, height) = (13u32, 7u32, 41u32, 37u32);
    let row = |y: u32| &whole.rgba()[4 * ((top + y) * 90 + left) as usize..][..4 * width as usize];
    let part = Photograph::new(width, height, (0..height).flat_map(row).copied().collect()).unwrap();
    let image = noise(width, height, 3);
    let mut gradients = [vec![0.0; image.rgb().len()], vec![0.0; image.rgb().len()]];
    let [a, b] = &mut gradients;
    let cropped = PhotographLoss::new(&whole, [1.0; 3], PARTS[3]).cropped(left, top, width, height).unwrap();
    let small = PhotographLoss::new(&part, [1.0; 3], PARTS[3]);
    let values = (cropped.differentiate(&image, false, a), small.differentiate(&image, false, b));
    assert_eq!(values.0, values.1);
    assert_eq!(gradients[0], gradients[1]);
    let moved =
        PhotographLoss::new(&whole, [1.0; 3], PARTS[3]).cropped(left + 1, top, width, height).unwrap();
    let mut other = vec![0.0; image.rgb().len()];
    assert_ne!(moved.differentiate(&image, false, &mut other), values.0);
    for (left, top, width, height) in [(50, 0, 41, 1), (0, 71, 1, 1), (0, 0, 0, 1), (u32::MAX, 0, 2, 1)] {
        let error = PhotographLoss::new(&whole, [0.0; 3], PARTS[3]).cropped(left, top, width, height);
        assert!(error.unwrap_err().to_string().contains("of 90 x 70"));
    }
}

#[test]
fn pixel_weights_blend_the_picture_into_the_photograph() {
    let photograph = photograph(40, 30, [3, 37, 2, 29], 5);
    let image = noise(40, 30, 6);
    let mut numbers = TestRng(9);
    let weights: Vec<u8> =
        (0..1200).map(|i| if i % 40 < 13 { 0 } else { numbers.below(256) as u8 }).collect();
    for parts in PARTS {
        let plain = PhotographLoss::new(&photograph, [1.0; 3], parts);
        let loss = plain.with_pixel_weights(&weights).unwrap();
        let worst = worst(&loss, &image, 37);
        assert!(worst < 1e-5, "{parts:?}: {worst}");
        let mut gradient = vec![f32::NAN; image.rgb().len()];
        let value = loss.differentiate(&image, false, &mut gradient).unwrap();
        assert!(gradient.chunks(120).all(|row| row[..39].iter().all(|&g| g == 0.0)));
        let full = plain.with_pixel_weights(&[255; 1200]).unwrap();
        let whole = full.differentiate(&image, false, &mut gradient).unwrap();
        assert_eq!(whole, plain.differentiate(&image, false, &mut gradient).unwrap());
        assert!(value < whole);
    }
    let plain = PhotographLoss::new(&photograph, [1.0; 3], PARTS[0]);
    assert!(plain.with_pixel_weights(&weights[1..]).unwrap_err().to_string().contains("found 1199"));
}

#[test]
fn threads_do_not_show() {
    let photograph = photograph(210, 230, [50, 180, 30, 200], 4);
    let image = picture(210, 230, [30, 170, 40, 210], [1.0; 3]);
    let loss = PhotographLoss::new(&photograph, [1.0; 3], PARTS[3]);
    let mut gradient = vec![f32::NAN; image.rgb().len()];
    let serial = loss.differentiate(&image, false, &mut gradient).unwrap();
    for threads in [1, 2, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let mut other = vec![f32::NAN; gradient.len()];
        let value = pool.install(|| loss.differentiate(&image, true, &mut other).unwrap());
        assert_eq!((value, &other), (serial, &gradient));
    }
}

/// As with the other losses: what is not a number shows in the loss and in the gradient around it.
#[test]
fn a_value_that_is_not_a_number_shows() {
    let photograph = photograph(64, 64, [0; 4], 4);
    let mut image = picture(64, 64, [0; 4], [1.0; 3]);
    image.rgb_mut()[3 * (20 * 64 + 30)] = f32::NAN;
    for weights in PARTS {
        let mut gradient = vec![0.0; image.rgb().len()];
        let loss = PhotographLoss::new(&photograph, [1.0; 3], weights);
        assert!(loss.differentiate(&image, false, &mut gradient).unwrap().is_nan());
        assert!(gradient[3 * (20 * 64 + 30)].is_nan() && gradient.iter().any(|g| g.is_finite()));
    }
}

#[test]
fn equal_pictures_lose_nothing() {
    let photograph = photograph(64, 50, [3, 60, 4, 40], 4);
    let image = photograph.over([0.3, 0.6, 0.9]);
    let mut gradient = vec![f32::NAN; image.rgb().len()];
    for weights in PARTS {
        let loss = PhotographLoss::new(&photograph, [0.3, 0.6, 0.9], weights);
        assert_eq!(loss.differentiate(&image, true, &mut gradient).unwrap(), 0.0);
        assert!(gradient.iter().all(|&g| g == 0.0));
        assert!(loss.differentiate(&noise(50, 64, 1), true, &mut gradient).is_err());
    }
}

#[test]
fn what_is_not_a_photograph_is_refused() {
    let error = |w, h, rgba| Photograph::new(w, h, rgba).unwrap_err().to_string();
    assert!(error(0, 1, vec![]).contains("0 x 1"));
    assert!(error(2, 1, vec![0; 7]).contains("found 7 values, need 8"));
    let found = error(2, 1, vec![0, 0, 0, 0, 0, 9, 0, 8]);
    assert!(found.contains("[0, 9, 0, 8] in column 1 of row 0"), "{found}");
}

#[test]
fn a_smaller_photograph_holds_means() {
    let whole = photograph(24, 18, [1, 20, 2, 15], 6);
    let small = whole.resized(8, 9).unwrap();
    for (at, pixel) in small.rgba().chunks(4).enumerate() {
        for (c, &value) in pixel.iter().enumerate() {
            let (x, y) = (at % 8, at / 8);
            let of = |i: usize| f64::from(whole.rgba()[4 * ((2 * y + i / 3) * 24 + 3 * x + i % 3) + c]);
            let mean = (0..6).map(of).sum::<f64>() / 6.0;
            assert!((f64::from(value) - mean).abs() <= 0.5, "{value} {mean}");
        }
    }
    assert_eq!(whole.resized(24, 18).unwrap(), whole);
    assert!(whole.resized(24, 7).unwrap_err().to_string().contains("height is 7 for 18 pixels"));
    assert!(whole.resized(0, 9).is_err() && whole.resized(48, 18).is_err());
}
