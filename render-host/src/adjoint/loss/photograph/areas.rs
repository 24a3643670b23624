//! Areas are the parts of a picture that must be compared with a photograph.

use std::ops::Range;

use super::source::{Photograph, SQUARE};
use crate::parallel;

/// Rows of squares that are compared together; part of the order of sums.
const BAND_SQUARES: usize = 4;
/// Pixel rows in a band.
pub(super) const BAND: usize = BAND_SQUARES * SQUARE;
/// Squares without interest between two areas up to which they become one: around each area
/// 10 pixels on either side are read.
const GAP: usize = 1;

/// Columns of pixels to be compared in each band of rows, from the top: all that are within a square of one
/// in which the picture (r g b, of `size`) or the part of the photograph from `corner` on shows anything but
/// `background`. Elsewhere value and gradient of every part of the loss are exactly 0, since a window
/// and the pixels that its gradient reaches end within 10 pixels.
pub(super) fn areas(
    picture: &[f32],
    size: [usize; 2],
    photograph: &Photograph,
    corner: [usize; 2],
    background: [f32; 3],
    parallel: bool,
) -> Vec<Vec<Range<usize>>> {
    let [width, height] = size;
    let [columns, rows] = size.map(|side| side.div_ceil(SQUARE));
    let mut shown = vec![false; columns * rows];
    let pattern: [f32; 3 * SQUARE] = std::array::from_fn(|i| background[i % 3]);
    parallel::for_each_chunk(parallel, &mut shown, columns, |row, squares| {
        let y = row * SQUARE..((row + 1) * SQUARE).min(height);
        for (column, square) in squares.iter_mut().enumerate() {
            let x = column * SQUARE..((column + 1) * SQUARE).min(width);
            let there = [x.clone(), y.clone()];
            let [across, down] = [0, 1].map(|k| there[k].start + corner[k]..there[k].end + corner[k]);
            *square = !photograph.is_empty(across, down)
                || y.clone()
                    .any(|y| differs(&picture[3 * (y * width + x.start)..3 * (y * width + x.end)], &pattern));
        }
    });
    let near = |index: usize, past: usize| index.saturating_sub(1)..(index + 2).min(past);
    let band = |first: usize| {
        let of_interest = |column: usize| {
            let from = first.saturating_sub(1)..(first + BAND_SQUARES + 1).min(rows);
            let mut rows = from.map(|row| &shown[row * columns..][near(column, columns)]);
            rows.any(|squares| squares.contains(&true))
        };
        let mut found: Vec<Range<usize>> = Vec::new();
        for column in (0..columns).filter(|&column| of_interest(column)) {
            match found.last_mut() {
                Some(last) if column <= last.end + GAP => last.end = column + 1,
                _ => found.push(column..column + 1),
            }
        }
        found.iter().map(|at| at.start * SQUARE..(at.end * SQUARE).min(width)).collect()
    };
    (0..rows).step_by(BAND_SQUARES).map(band).collect()
}

/// Whether a value of `row` is not that of `pattern`.
fn differs(row: &[f32], pattern: &[f32; 3 * SQUARE]) -> bool {
    match <&[f32; 3 * SQUARE]>::try_from(row) {
        // Without a way out on the way, so that it becomes vectors.
        Ok(row) => row.iter().zip(pattern).fold(false, |found, (a, b)| found | (a != b)),
        Err(_) => row.iter().zip(pattern).any(|(a, b)| a != b),
    }
}
