//! A reference picture prepared for many comparisons: its share of every window's moments is filtered once.
//!
//! A test picture that differs from another one in a few pixels needs only the windows that hold one of
//! them. Each window's similarity is bit for bit the one that [`super::ssim`] adds up: the filters run in
//! the same order, along rows and then down columns, in f64.

use std::ops::Range;

use super::{Windows, similarity};
use crate::image::Image;

/// Moments of a test picture that a window needs: x, x², xy.
const MOMENTS: usize = 3;

/// Three planes of values, row by row.
pub(crate) type Planes = [Vec<f32>; 3];

/// The reference picture, plane by plane, and its moments in every window.
#[derive(Clone, Debug)]
pub(crate) struct Target {
    width: usize,
    windows: Windows,
    values: [Vec<f64>; 3],
    /// Of each window: mean of y.
    means: [Vec<f64>; 3],
    /// Of each window: mean of y².
    squares: [Vec<f64>; 3],
}

/// Windows, named by column and row of their first pixel.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Rectangle {
    pub(crate) columns: Range<usize>,
    pub(crate) rows: Range<usize>,
}

impl Rectangle {
    /// Number of windows.
    pub(crate) fn len(&self) -> usize {
        self.columns.len() * self.rows.len()
    }
}

/// Scratch memory of [`Target::similarities`].
#[derive(Clone, Debug, Default)]
pub(crate) struct Scratch {
    along: Vec<f64>,
    down: Vec<f64>,
    row: Vec<f64>,
}

impl Target {
    /// Filters `reference`, of sides of at least 1 pixel.
    pub(crate) fn new(reference: &Image) -> Self {
        let (width, height) = (reference.width() as usize, reference.height() as usize);
        let windows = Windows::new(width.max(1), height.max(1));
        let plane = |c: usize| reference.rgb()[c..].iter().step_by(3).map(|&v| f64::from(v)).collect();
        let values: [Vec<f64>; 3] = std::array::from_fn(plane);
        let filter = |c: usize, power: i32| -> Vec<f64> {
            let mut wide = vec![0.0; windows.columns * height];
            for (row, out) in wide.chunks_exact_mut(windows.columns).enumerate() {
                let values = &values[c][row * width..][..width];
                for (k, weight) in windows.along.iter().enumerate() {
                    for (sum, &y) in out.iter_mut().zip(&values[k..]) {
                        *sum += weight * if power == 1 { y } else { y * y };
                    }
                }
            }
            let mut out = vec![0.0; windows.columns * windows.rows];
            for (row, out) in out.chunks_exact_mut(windows.columns).enumerate() {
                for (k, weight) in windows.down.iter().enumerate() {
                    let wide = &wide[(row + k) * windows.columns..];
                    out.iter_mut().zip(wide).for_each(|(sum, v)| *sum += weight * v);
                }
            }
            out
        };
        let means = std::array::from_fn(|c| filter(c, 1));
        let squares = std::array::from_fn(|c| filter(c, 2));
        Self { width, windows, values, means, squares }
    }

    /// The windows of the picture.
    pub(crate) fn windows(&self) -> &Windows {
        &self.windows
    }

    /// All windows.
    pub(crate) fn all(&self) -> Rectangle {
        Rectangle { columns: 0..self.windows.columns, rows: 0..self.windows.rows }
    }

    /// Windows of rows `rows` that hold a pixel of `columns`; `columns` are of the picture, not empty.
    pub(crate) fn columns_with(&self, columns: &Range<usize>) -> Range<usize> {
        let reach = self.windows.along.len() - 1;
        columns.start.saturating_sub(reach)..columns.end.min(self.windows.columns)
    }

    /// As [`Target::columns_with`], of rows.
    pub(crate) fn rows_with(&self, rows: &Range<usize>) -> Range<usize> {
        let reach = self.windows.down.len() - 1;
        rows.start.saturating_sub(reach)..rows.end.min(self.windows.rows)
    }

    /// Similarity of each window of `at`, added over the three channels, row by row to the front of `out`.
    pub(crate) fn similarities(&self, test: &Planes, at: &Rectangle, scratch: &mut Scratch, out: &mut [f64]) {
        pulp::Arch::new().dispatch(Compare { target: self, test, at, scratch, out });
    }
}

/// The windows of one rectangle, as a value, so that they can be compiled once per vector width.
struct Compare<'a> {
    target: &'a Target,
    test: &'a Planes,
    at: &'a Rectangle,
    scratch: &'a mut Scratch,
    out: &'a mut [f64],
}

impl pulp::NullaryFnOnce for Compare<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { target, test, at, scratch, out } = self;
        let Target { width, windows, values, means, squares } = target;
        let columns = at.columns.len();
        let out = &mut out[..at.len()];
        out.fill(0.0);
        let pixel_rows = at.rows.len() + windows.down.len() - 1;
        let pixel_columns = columns + windows.along.len() - 1;
        let Scratch { along, down, row } = scratch;
        along.resize(MOMENTS * columns * pixel_rows, 0.0);
        down.resize(MOMENTS * columns, 0.0);
        row.resize(MOMENTS * pixel_columns, 0.0);
        for c in 0..3 {
            for (index, sums) in along.chunks_exact_mut((MOMENTS * columns).max(1)).enumerate() {
                let first = (at.rows.start + index) * width + at.columns.start;
                products(&test[c][first..][..pixel_columns], &values[c][first..][..pixel_columns], row);
                for moment in 0..MOMENTS {
                    let products = &row[moment * pixel_columns..][..pixel_columns];
                    weigh(products, &windows.along, &mut sums[moment * columns..][..columns]);
                }
            }
            for (index, out) in out.chunks_exact_mut(columns.max(1)).enumerate() {
                down.fill(0.0);
                for (k, &weight) in windows.down.iter().enumerate() {
                    let source = &along[(index + k) * MOMENTS * columns..][..MOMENTS * columns];
                    down.iter_mut().zip(source).for_each(|(sum, v)| *sum += weight * v);
                }
                let first = (at.rows.start + index) * windows.columns + at.columns.start;
                let (means, squares) = (&means[c][first..][..columns], &squares[c][first..][..columns]);
                let (x, rest) = down.split_at(columns);
                let (xx, xy) = rest.split_at(columns);
                for i in 0..columns {
                    out[i] += similarity([x[i], means[i], xx[i], squares[i], xy[i]]);
                }
            }
        }
    }
}

/// x, x² and xy of a row of pixels, one after the other.
#[inline(always)]
fn products(test: &[f32], reference: &[f64], out: &mut [f64]) {
    let n = test.len();
    let (x, rest) = out.split_at_mut(n);
    let (xx, xy) = rest.split_at_mut(n);
    for i in 0..n {
        let value = f64::from(test[i]);
        x[i] = value;
        xx[i] = value * value;
        xy[i] = value * reference[i];
    }
}

/// Weighted sum of the values from each place on.
#[inline(always)]
fn weigh(values: &[f64], weights: &[f64], out: &mut [f64]) {
    out.fill(0.0);
    let n = out.len();
    for (k, &weight) in weights.iter().enumerate() {
        let values = &values[k..k + n];
        for i in 0..n {
            out[i] += weight * values[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::ssim;

    fn noise(width: u32, height: u32, seed: u32) -> Image {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        Image::new(width, height, (0..3 * width * height).map(|_| next()).collect()).unwrap()
    }

    fn planes(image: &Image) -> Planes {
        std::array::from_fn(|c| image.rgb()[c..].iter().step_by(3).copied().collect())
    }

    #[test]
    fn the_mean_over_all_windows_is_the_metric() {
        for (w, h) in [(23, 17), (11, 11), (12, 5), (4, 30), (1, 1), (2, 11)] {
            let (a, b) = (noise(w, h, 1), noise(w, h, 2));
            let target = Target::new(&b);
            let all = target.all();
            let mut out = vec![f64::NAN; all.len()];
            target.similarities(&planes(&a), &all, &mut Scratch::default(), &mut out);
            let mean = out.iter().sum::<f64>() / target.windows().count() as f64;
            let expected = ssim(&a, &b).unwrap();
            assert!((mean - expected).abs() < 1e-14, "{w} x {h}: {mean} {expected}");
        }
    }

    #[test]
    fn a_rectangle_is_a_part_of_all_windows_and_a_changed_pixel_stays_within_its_reach() {
        let (w, h) = (40usize, 33usize);
        let (a, b) = (noise(40, 33, 3), noise(40, 33, 4));
        let target = Target::new(&b);
        let (all, mut scratch) = (target.all(), Scratch::default());
        let mut whole = vec![0.0; all.len()];
        let mut test = planes(&a);
        target.similarities(&test, &all, &mut scratch, &mut whole);
        let pixel = (17..18, 9..10);
        let at = Rectangle { columns: target.columns_with(&pixel.0), rows: target.rows_with(&pixel.1) };
        let mut some = vec![0.0; at.len()];
        target.similarities(&test, &at, &mut scratch, &mut some);
        let columns = w - 10;
        let matches = |some: &[f64], whole: &[f64]| {
            let row = |y: usize| &whole[y * columns + at.columns.start..][..at.columns.len()];
            at.rows.clone().zip(some.chunks(at.columns.len())).all(|(y, some)| some == row(y))
        };
        assert!(matches(&some, &whole));
        test[1][9 * w + 17] += 0.01;
        let mut changed = vec![0.0; all.len()];
        target.similarities(&test, &all, &mut scratch, &mut changed);
        assert!(!matches(&some, &changed), "a pixel that differs shows");
        for (i, (before, after)) in whole.iter().zip(&changed).enumerate() {
            let (x, y) = (i % columns, i / columns);
            let within = at.columns.contains(&x) && at.rows.contains(&y);
            assert_eq!(before != after, within, "window {x}, {y} of {columns} x {}", h - 10);
        }
    }
}
