//! Adds up squared differences from the reference, tile by tile, in one fixed order.

use super::{
    culling::{ACROSS, BLOCKS, SIDE},
    lanes::Wanted,
};
use crate::{
    image::Image,
    parallel,
    stage::{TILE, blend::Lanes},
};

/// r, g, b of the 16 rows of a tile; what lies outside the image is 0.
pub(super) type Planes = [[Lanes; 3]; TILE];

/// An image cut into tiles, row by row of tiles.
pub(super) fn cut(image: &Image, parallel: bool) -> Vec<Planes> {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let columns = width.div_ceil(TILE);
    let mut out = vec![[[[0.0; TILE]; 3]; TILE]; columns * height.div_ceil(TILE)];
    parallel::for_each_chunk(parallel, &mut out, columns, |row, tiles| {
        let rows = image.rgb()[3 * width * TILE * row..].chunks_exact(3 * width).take(TILE);
        for (y, row) in rows.enumerate() {
            for (planes, pixels) in tiles.iter_mut().zip(row.chunks(3 * TILE)) {
                for (x, pixel) in pixels.chunks_exact(3).enumerate() {
                    (0..3).for_each(|c| planes[y][c][x] = pixel[c]);
                }
            }
        }
    });
    out
}

/// Squares of one tile: a sum per pixel of a block, over all blocks.
pub(super) type Squares = [f64; TILE];

/// Squared differences on the pixels of a block, 0 outside the image.
#[inline(always)]
pub(super) fn squares(got: &[Lanes; 3], wanted: &Wanted) -> Squares {
    let mut out = [0.0; TILE];
    for (got, reference) in got.iter().zip(&wanted.rgb) {
        for (i, out) in out.iter_mut().enumerate() {
            let d = f64::from(got[i]) - f64::from(reference[i]);
            *out += d * d * f64::from(wanted.inside[i]);
        }
    }
    out
}

/// Adds the squares of one block.
#[inline(always)]
pub(super) fn add(sum: &mut Squares, squares: &Squares) {
    (0..TILE).for_each(|i| sum[i] += squares[i]);
}

/// Sum of squares between two images of one size, tile by tile.
pub(super) fn between(image: &Image, reference: &[Planes]) -> f64 {
    let (width, height) = (image.width() as usize, image.height() as usize);
    let columns = width.div_ceil(TILE);
    let tile = |(index, (got, reference)): (usize, (&Planes, &Planes))| {
        let size = inside([index % columns * TILE, index / columns * TILE], [width, height]);
        let mut sum = [0.0; TILE];
        for block in (0..BLOCKS).filter(|&b| within(b, size)) {
            let got = wanted(got, block, size).rgb;
            add(&mut sum, &squares(&got, &wanted(reference, block, size)));
        }
        sum.iter().sum::<f64>()
    };
    cut(image, false).iter().zip(reference).enumerate().map(tile).sum()
}

/// Width and height of the part of a tile that lies inside the image.
pub(super) fn inside(corner: [usize; 2], size: [usize; 2]) -> (usize, usize) {
    ((size[0] - corner[0]).min(TILE), (size[1] - corner[1]).min(TILE))
}

/// Whether a block has a pixel inside the image, where a tile has `size` of them.
pub(super) fn within(block: usize, size: (usize, usize)) -> bool {
    block % ACROSS * SIDE < size.0 && block / ACROSS * SIDE < size.1
}

/// The reference on the pixels of a block.
#[inline(always)]
pub(super) fn wanted(reference: &Planes, block: usize, size: (usize, usize)) -> Wanted {
    let (left, top) = (block % ACROSS * SIDE, block / ACROSS * SIDE);
    let mut out = Wanted { rgb: [[0.0; TILE]; 3], inside: [0.0; TILE] };
    for row in 0..SIDE {
        for (to, from) in out.rgb.iter_mut().zip(&reference[top + row]) {
            to[SIDE * row..][..SIDE].copy_from_slice(&from[left..left + SIDE]);
        }
        for column in 0..SIDE {
            let is_inside = left + column < size.0 && top + row < size.1;
            out.inside[SIDE * row + column] = f32::from(u8::from(is_inside));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_mean_squared_error_times_the_number_of_values() {
        let image = |k: usize| {
            let rgb = (0..3 * 37 * 19).map(|i| ((i * k) % 101) as f32 / 101.0).collect();
            Image::new(37, 19, rgb).unwrap()
        };
        let (a, b) = (image(7), image(11));
        let expected = crate::metric::mse(&a, &b).unwrap() * (3 * 37 * 19) as f64;
        assert!((between(&a, &cut(&b, true)) / expected - 1.0).abs() < 1e-12);
        assert_eq!(between(&a, &cut(&a, false)), 0.0);
    }
}
