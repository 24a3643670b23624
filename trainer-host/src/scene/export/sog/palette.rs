//! Fits books of values and palettes of rows to data, the same for any number of threads.

/// Rounds of refinement of a book.
const ROUNDS: usize = 32;

/// 256 values, in order, near to all of `values`: equal shares of the sorted values to begin with, then
/// moved to the means of what is nearest to them.
pub(super) fn book(values: impl Iterator<Item = f32>) -> [f32; 256] {
    let mut sorted: Vec<f32> = values.collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let Some((&first, &last)) = sorted.first().zip(sorted.last()) else { return [0.0; 256] };
    // Half of the places follow the values, half the range: tails are few values, and far off.
    let even = |k: usize| first + (last - first) * k as f32 / 127.0;
    let share = |k: usize| sorted[(2 * k + 1) * sorted.len() / 256];
    let mut book: [f32; 256] = std::array::from_fn(|k| if k < 128 { even(k) } else { share(k - 128) });
    book.sort_unstable_by(f32::total_cmp);
    for _ in 0..ROUNDS {
        let mut next = 0;
        for k in 0..256 {
            let end = match book.get(k + 1) {
                None => sorted.len(),
                Some(above) => next + sorted[next..].partition_point(|v| *v <= 0.5 * (book[k] + above)),
            };
            if end > next {
                let sum: f64 = sorted[next..end].iter().map(|&v| f64::from(v)).sum();
                book[k] = (sum / (end - next) as f64) as f32;
            }
            next = end;
        }
    }
    book.sort_unstable_by(f32::total_cmp);
    book
}

/// The place in `book`, which is in order, nearest to `value`.
pub(super) fn nearest(book: &[f32; 256], value: f32) -> u8 {
    let above = book.partition_point(|v| *v < value).min(255);
    let below = above.saturating_sub(1);
    (if (value - book[below]).abs() <= (book[above] - value).abs() { below } else { above }) as u8
}

/// Rows that are represented by one.
struct Cell {
    rows: Vec<u32>,
    mean: Vec<f32>,
    /// The column that varies most, and the sum of squared differences from its mean.
    widest: (usize, f64),
}

impl Cell {
    fn new(values: &[f32], columns: usize, rows: Vec<u32>) -> Self {
        let (mut sums, mut squares) = (vec![0.0f64; columns], vec![0.0f64; columns]);
        for &row in &rows {
            for (column, &v) in values[row as usize * columns..][..columns].iter().enumerate() {
                sums[column] += f64::from(v);
                squares[column] += f64::from(v) * f64::from(v);
            }
        }
        let count = rows.len().max(1) as f64;
        let spread = |column: usize| (squares[column] - sums[column] * sums[column] / count).max(0.0);
        let widest = (0..columns).max_by(|&a, &b| spread(a).total_cmp(&spread(b)).then(b.cmp(&a)));
        let widest = widest.map_or((0, 0.0), |column| (column, spread(column)));
        Self { mean: sums.iter().map(|sum| (sum / count) as f32).collect(), rows, widest }
    }
}

/// Up to `most` rows of `columns` that stand for those of `values`, and the place among them for each row:
/// the cell whose widest column varies most is split at that column's mean until there are enough.
pub(super) fn palette(values: &[f32], columns: usize, most: usize) -> (Vec<f32>, Vec<u32>) {
    let count = values.len() / columns;
    let mut cells = vec![Cell::new(values, columns, (0..count as u32).collect())];
    let key = |cell: &Cell, place: usize| (cell.widest.1.to_bits(), std::cmp::Reverse(place));
    // Variances are not negative, so their bits are in the order of their values.
    let mut queue = std::collections::BinaryHeap::from([key(&cells[0], 0)]);
    while cells.len() < most.max(1) {
        let Some((spread, std::cmp::Reverse(place))) = queue.pop().filter(|top| top.0 > 0) else { break };
        let (column, mean) = (cells[place].widest.0, cells[place].mean[cells[place].widest.0]);
        let above = |row: &u32| values[*row as usize * columns + column] > mean;
        let (high, low): (Vec<u32>, Vec<u32>) =
            std::mem::take(&mut cells[place].rows).into_iter().partition(|row| above(row));
        if high.is_empty() || low.is_empty() {
            // Rounding: as good as equal.
            let rows = if high.is_empty() { low } else { high };
            let widest = (column, 0.0);
            cells[place] = Cell { rows, widest, mean: std::mem::take(&mut cells[place].mean) };
            let _ = spread;
            continue;
        }
        let (low, high) = (Cell::new(values, columns, low), Cell::new(values, columns, high));
        queue.push(key(&low, place));
        queue.push(key(&high, cells.len()));
        cells[place] = low;
        cells.push(high);
    }
    let mut labels = vec![0; count];
    for (label, cell) in cells.iter().enumerate() {
        cell.rows.iter().for_each(|&row| labels[row as usize] = label as u32);
    }
    (cells.into_iter().flat_map(|cell| cell.mean).collect(), labels)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_book_of_few_values_is_exact() {
        let values = [3.0, -1.0, 3.0, 7.5, 0.0];
        let book = book(values.into_iter());
        for value in values {
            assert_eq!(book[usize::from(nearest(&book, value))], value);
        }
        assert!(book.is_sorted());
        assert_eq!(super::book(std::iter::empty()), [0.0; 256]);
    }

    #[test]
    fn a_book_is_nearer_than_equal_steps() {
        let values: Vec<f32> = (0..5000).map(|i| (i as f32 / 700.0).exp()).collect();
        let book = book(values.iter().copied());
        let error =
            |near: &dyn Fn(f32) -> f32| -> f32 { values.iter().map(|&v| (near(v) - v).powi(2)).sum() };
        let (low, step) = (values[0], (values[4999] - values[0]) / 255.0);
        let even = error(&|v| low + step * ((v - low) / step).round());
        let fitted = error(&|v| book[usize::from(nearest(&book, v))]);
        assert!(fitted < 0.8 * even, "{fitted} {even}");
    }

    #[test]
    fn a_palette_finds_the_groups_that_there_are() {
        let rows: Vec<f32> = (0..400).flat_map(|i| [(i % 4) as f32 * 10.0, (i % 2) as f32, 0.5]).collect();
        let (entries, labels) = palette(&rows, 3, 16);
        assert_eq!(entries.len(), 4 * 3, "no more entries than different rows");
        for i in 0..400 {
            assert_eq!(entries[3 * labels[i] as usize..][..3], rows[3 * i..][..3]);
        }
        let (few, labels) = palette(&rows, 3, 2);
        assert_eq!((few.len(), labels.iter().max()), (6, Some(&1)));
        let (none, labels) = palette(&[], 3, 2);
        assert_eq!((none, labels), (vec![0.0; 3], vec![]));
    }
}
