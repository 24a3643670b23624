//! Areas are the parts of a picture that must be compared with a photograph.

use std::ops::Range;

use super::source::{Photograph, SQUARE};
use crate::parallel;

/// Squares from one that shows something to the last one that its windows and gradients reach, in 10 pixels.
const REACH: usize = 2;
/// Squares without interest between two areas up to which they become one: around each area
/// 10 pixels on either side are read.
const GAP: usize = 2;
/// Bands that a picture is split into, about, and least and most pixel rows in one.
const BANDS: usize = 7;
const BAND_ROWS: [usize; 2] = [64, 128];

/// Pixel rows that are compared together in a picture of `height` rows; part of the order of sums.
pub(super) fn band_rows(height: usize) -> usize {
    height.div_ceil(BANDS).clamp(BAND_ROWS[0], BAND_ROWS[1]).next_multiple_of(SQUARE)
}

/// Columns and rows of pixels that are compared together.
#[derive(Clone, Debug)]
pub(super) struct Area {
    pub(super) columns: Range<usize>,
    pub(super) rows: Range<usize>,
}

/// Areas to be compared in each band of rows, from the top: all that are within two squares of one in which
/// the picture (r g b, of `size`) or the part of the photograph from `corner` on shows anything but
/// `background`. Elsewhere value and gradient of every part of the loss are exactly 0, since a window
/// and the pixels that its gradient reaches end within 10 pixels.
pub(super) fn areas(
    picture: &[f32],
    size: [usize; 2],
    photograph: &Photograph,
    corner: [usize; 2],
    background: [f32; 3],
    parallel: bool,
) -> Vec<Vec<Area>> {
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
    let near = |index: usize, past: usize| index.saturating_sub(REACH)..(index + REACH + 1).min(past);
    let of_interest = |column: usize, row: usize| {
        let mut rows = near(row, rows).map(|row| &shown[row * columns..][near(column, columns)]);
        rows.any(|squares| squares.contains(&true))
    };
    let squares = band_rows(height) / SQUARE;
    let band = |first: usize| {
        let past = (first + squares).min(rows);
        let mut found: Vec<Area> = Vec::new();
        for column in 0..columns {
            let mut inside = (first..past).filter(|&row| of_interest(column, row));
            let Some(top) = inside.next() else { continue };
            let bottom = inside.next_back().unwrap_or(top) + 1;
            match found.last_mut() {
                Some(last) if column <= last.columns.end + GAP => {
                    last.columns.end = column + 1;
                    last.rows = last.rows.start.min(top)..last.rows.end.max(bottom);
                }
                _ => found.push(Area { columns: column..column + 1, rows: top..bottom }),
            }
        }
        let pixels =
            |squares: &Range<usize>, side: usize| squares.start * SQUARE..(squares.end * SQUARE).min(side);
        let in_pixels =
            |area: &Area| Area { columns: pixels(&area.columns, width), rows: pixels(&area.rows, height) };
        found.iter().map(in_pixels).collect()
    };
    (0..rows).step_by(squares).map(band).collect()
}

/// Whether a value of `row` is not that of `pattern`.
fn differs(row: &[f32], pattern: &[f32; 3 * SQUARE]) -> bool {
    match <&[f32; 3 * SQUARE]>::try_from(row) {
        // Without a way out on the way, so that it becomes vectors.
        Ok(row) => row.iter().zip(pattern).fold(false, |found, (a, b)| found | (a != b)),
        Err(_) => row.iter().zip(pattern).any(|(a, b)| a != b),
    }
}
