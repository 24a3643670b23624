//! A pyramid holds the photographs of a split at the sizes that training goes through.

use rayon::prelude::*;
use render_host::{
    ImageError,
    adjoint::loss::photograph::{Photograph, PhotographLoss},
};

use super::{pixel_mask::PixelMask, schedule::Sizes, views::PosedPhotograph};

/// Share of a photograph's width that is kept around its outline.
const MARGIN: f64 = 0.05;

/// Most times that photographs are reduced.
pub(super) const MAX_REDUCED: u32 = 64;

/// Photographs at several sizes, coarsest first.
#[derive(Debug)]
pub(super) struct Pyramid<'a> {
    originals: &'a [PosedPhotograph],
    /// How many times smaller the largest photographs of the training are than the originals.
    base: u32,
    sizes: Sizes,
    /// Of each view, the reduced photographs; without the last one where that is the original.
    reduced: Vec<Vec<Photograph>>,
    /// Of each view whose pixels do not all count, the mask at each size.
    counted: Vec<Vec<PixelMask>>,
    /// Of each view and size: left, top, width and height of what its outline needs, pixels.
    outlines: Vec<Vec<[u32; 4]>>,
}

impl<'a> Pyramid<'a> {
    /// Reduces photographs so that no side is longer than `max_side`, where a whole divisor does that.
    pub(super) fn new(originals: &'a [PosedPhotograph], max_side: u32) -> Self {
        let sides = || originals.iter().flat_map(|view| [view.photograph.width(), view.photograph.height()]);
        let common = sides().fold(0, greatest_common_divisor);
        let base = nearest_reduction(sides(), max_side);
        // Reductions that fit the greatest common divisor fit every side.
        let shortest = sides().min().unwrap_or(1);
        let sizes = Sizes::of(common / base, shortest / base);
        let pyramid = |view: &PosedPhotograph| {
            let divisors = sizes.divisors().iter().map(|by| by * base).filter(|&by| by > 1);
            let reduce = |by: u32| {
                let (width, height) = (view.photograph.width() / by, view.photograph.height() / by);
                view.photograph.resized(width, height).unwrap_or_else(|_| view.photograph.clone())
            };
            divisors.map(reduce).collect::<Vec<_>>()
        };
        let reduced: Vec<Vec<Photograph>> = originals.par_iter().map(pyramid).collect();
        let masks = |view: &PosedPhotograph| {
            let mask = view.counted.as_ref();
            let at_sizes = |mask: &PixelMask| {
                sizes.divisors().iter().map(|by| mask.reduced((by * base).max(1))).collect::<Vec<_>>()
            };
            mask.map(at_sizes).unwrap_or_default()
        };
        let counted = originals.par_iter().map(masks).collect();
        let mut out = Self { originals, base, sizes, reduced, counted, outlines: Vec::new() };
        let count = out.sizes();
        out.outlines = (0..originals.len())
            .into_par_iter()
            .map(|view| (0..count).map(|size| outline(out.photograph(view, size))).collect())
            .collect();
        out
    }

    pub(super) fn originals(&self) -> &'a [PosedPhotograph] {
        self.originals
    }

    pub(super) fn schedule(&self) -> &Sizes {
        &self.sizes
    }

    pub(super) fn sizes(&self) -> usize {
        self.sizes.divisors().len()
    }

    pub(super) fn smallest_divisor(&self) -> u32 {
        self.base
    }

    /// How many times smaller than the originals photographs of this size are.
    pub(super) fn divisor(&self, size: usize) -> u32 {
        self.base * self.sizes.divisors().get(size).copied().unwrap_or(1)
    }

    pub(super) fn photograph(&self, view: usize, size: usize) -> &Photograph {
        self.reduced[view].get(size).unwrap_or(&self.originals[view].photograph)
    }

    /// Which pixels of the photograph count, where not all do.
    pub(super) fn counted(&self, view: usize, size: usize) -> Option<&PixelMask> {
        self.counted[view].get(size)
    }

    /// `loss`, of pixels of the photograph that count.
    pub(super) fn where_counted<'b>(
        &'b self,
        view: usize,
        size: usize,
        loss: PhotographLoss<'b>,
    ) -> Result<PhotographLoss<'b>, ImageError> {
        match self.counted(view, size) {
            Some(mask) => loss.with_pixel_weights(mask.values()),
            None => Ok(loss),
        }
    }

    pub(super) fn size(&self, view: usize, size: usize) -> (u32, u32) {
        let photograph = self.photograph(view, size);
        (photograph.width(), photograph.height())
    }

    pub(super) fn outline(&self, view: usize, size: usize) -> [u32; 4] {
        self.outlines[view][size]
    }
}

/// The least whole number that divides every side and leaves none longer than `max_side`, if there is one.
pub(super) fn exact_reduction(sides: impl Iterator<Item = u32> + Clone, max_side: u32) -> Option<u32> {
    let common = sides.clone().fold(0, greatest_common_divisor);
    let longest = sides.max().unwrap_or(1);
    let divides = |by: &u32| common.is_multiple_of(*by);
    (1..=MAX_REDUCED).filter(divides).find(|by| longest / by <= max_side)
}

/// The same; where there is none, the greatest that divides every side, at most [`MAX_REDUCED`].
pub(super) fn nearest_reduction(sides: impl Iterator<Item = u32> + Clone, max_side: u32) -> u32 {
    exact_reduction(sides.clone(), max_side).unwrap_or_else(|| {
        let common = sides.fold(0, greatest_common_divisor);
        (1..=MAX_REDUCED).rev().find(|by| common.is_multiple_of(*by)).unwrap_or(1)
    })
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// The rectangle around pixels whose alpha is above 2 %, with a margin; all of an empty photograph.
fn outline(photograph: &Photograph) -> [u32; 4] {
    let (width, height) = (photograph.width(), photograph.height());
    let [mut left, mut top, mut right, mut bottom] = [width, height, 0, 0];
    for (index, pixel) in photograph.rgba().chunks_exact(4).enumerate() {
        if pixel[3] > 4 {
            let (x, y) = (index as u32 % width, index as u32 / width);
            (left, right) = (left.min(x), right.max(x + 1));
            (top, bottom) = (top.min(y), bottom.max(y + 1));
        }
    }
    if left >= right {
        return [0, 0, width, height];
    }
    let margin = (MARGIN * f64::from(width)).ceil() as u32;
    let (left, top) = (left.saturating_sub(margin), top.saturating_sub(margin));
    let (right, bottom) = ((right + margin).min(width), (bottom + margin).min(height));
    [left, top, right - left, bottom - top]
}

#[cfg(test)]
mod tests {
    use super::*;
    use render_host::Camera;

    fn view(width: u32, height: u32) -> PosedPhotograph {
        let camera =
            Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, width, height).unwrap();
        let mut rgba = vec![0; 4 * (width * height) as usize];
        let at = 4 * (height / 2 * width + width / 4) as usize;
        rgba[at..at + 4].fill(255);
        let photograph = Photograph::new(width, height, rgba).unwrap();
        PosedPhotograph {
            name: "a".to_owned(),
            camera,
            time: 0.0,
            photograph,
            foreground: None,
            counted: None,
        }
    }

    #[test]
    fn sizes_divide_both_sides_and_keep_the_longest_bound() {
        let views = [view(640, 320)];
        let pyramid = Pyramid::new(&views, 320);
        assert_eq!(pyramid.smallest_divisor(), 2);
        let sizes: Vec<_> = (0..pyramid.sizes()).map(|size| pyramid.size(0, size)).collect();
        assert_eq!(sizes, [(160, 80), (320, 160)]);
        let views = [view(641, 320)];
        let pyramid = Pyramid::new(&views, 1000);
        assert_eq!((pyramid.sizes(), pyramid.size(0, 0)), (1, (641, 320)));
    }

    #[test]
    fn outlines_hold_what_is_there_with_a_margin() {
        let views = [view(100, 60)];
        let [left, top, width, height] = Pyramid::new(&views, 100).outline(0, 0);
        assert_eq!([left, top, width, height], [20, 25, 11, 11]);
    }
}
