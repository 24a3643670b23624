//! Trims photographs whose sides reductions do not divide.

use std::collections::BTreeMap;

use render_host::adjoint::loss::photograph::Photograph;

use super::{
    photographs::{MAX_REDUCED, exact_reduction},
    pixel_mask::PixelMask,
    schedule::MIN_SIDE,
    views::{Dataset, PosedPhotograph},
};

/// What was cut: the size of most photographs that were, before and after.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trimmed {
    /// Width and height before, pixels.
    pub before: (u32, u32),
    /// Width and height after, pixels.
    pub after: (u32, u32),
    /// Photographs of this size, of all splits.
    pub photographs: usize,
    /// Other sizes that were cut besides, of fewer photographs.
    pub other_sizes: usize,
}

impl Dataset {
    /// The same with photographs that can be reduced so that no side is longer than `max_side` pixels, and
    /// then by half again and again: what does not divide is cut off at the right and at the bottom, fewer
    /// pixels than a 64th of the shortest side, or than photographs are reduced by. Photographs that divide
    /// stay as they are.
    pub fn trimmed(mut self, max_side: u32) -> (Self, Option<Trimmed>) {
        let views = || {
            let splits = [self.train.photographs(), self.validation.photographs(), self.test.photographs()];
            splits.into_iter().flatten().map(|view| (view.photograph.width(), view.photograph.height()))
        };
        let by = divisor(&views().flat_map(|(width, height)| [width, height]).collect::<Vec<_>>(), max_side);
        let mut cut: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        for size in views().filter(|(width, height)| width % by != 0 || height % by != 0) {
            *cut.entry(size).or_default() += 1;
        }
        let Some((&before, &photographs)) = cut.iter().max_by_key(|(_, count)| **count) else {
            return (self, None);
        };
        let after = (before.0 / by * by, before.1 / by * by);
        let report = Trimmed { before, after, photographs, other_sizes: cut.len() - 1 };
        self.train = self.train.map(|view| trimmed(view, by));
        self.validation = self.validation.map(|view| trimmed(view, by));
        self.test = self.test.map(|view| trimmed(view, by));
        (self, Some(report))
    }
}

/// What every side is to be a multiple of: 1 where nothing has to be cut, or sides are too short for that.
fn divisor(sides: &[u32], max_side: u32) -> u32 {
    let (Some(&longest), Some(&shortest)) = (sides.iter().max(), sides.iter().min()) else { return 1 };
    if exact_reduction(sides.iter().copied(), max_side).is_some() {
        return 1;
    }
    let base = (1..=MAX_REDUCED).find(|by| longest / by <= max_side).unwrap_or(MAX_REDUCED);
    let halves = [8, 4, 2].into_iter().find(|by| shortest / base / by >= MIN_SIDE).unwrap_or(1);
    if shortest / base == 0 { 1 } else { base * halves }
}

/// `view` cut to multiples of `by`.
fn trimmed(view: PosedPhotograph, by: u32) -> PosedPhotograph {
    let (width, height) = (view.photograph.width() / by * by, view.photograph.height() / by * by);
    if (width, height) == (view.photograph.width(), view.photograph.height()) {
        return view;
    }
    let row = 4 * view.photograph.width() as usize;
    let rows = view.photograph.rgba().chunks_exact(row).take(height as usize);
    let rgba: Vec<u8> = rows.flat_map(|row| &row[..4 * width as usize]).copied().collect();
    match (Photograph::new(width, height, rgba), view.camera.cropped(0, 0, width, height)) {
        (Ok(photograph), Ok(camera)) => {
            let cut = |mask: &Option<PixelMask>| mask.as_ref().map(|mask| mask.cut(width, height));
            let (foreground, counted) = (cut(&view.foreground), cut(&view.counted));
            PosedPhotograph { photograph, camera, foreground, counted, ..view }
        }
        _ => view,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scene::Up,
        train::{FreeSpace, Start, Views},
    };
    use codec_core::Footprint;
    use render_host::Camera;

    fn dataset(sizes: &[(u32, u32)]) -> Dataset {
        let view = |&(width, height): &(u32, u32)| {
            let camera =
                Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, width, height).unwrap();
            let rgba = (0..4 * width * height).map(|at| (at / 4 % width) as u8).collect();
            let photograph = Photograph::new(width, height, rgba).unwrap();
            PosedPhotograph {
                name: "a".to_owned(),
                camera,
                time: 0.0,
                photograph,
                foreground: None,
                counted: None,
            }
        };
        Dataset {
            name: "odd".to_owned(),
            train: Views::new(sizes.iter().map(view).collect()).unwrap(),
            validation: Views::new(Vec::new()).unwrap(),
            test: Views::new(vec![view(&sizes[0])]).unwrap(),
            start: Start::Points(Vec::new()),
            free_space: FreeSpace::default(),
            has_alpha: false,
            frames: 1,
            up: Up::Y,
            footprint: Footprint::Pixel,
        }
    }

    #[test]
    fn odd_sides_are_cut_so_that_they_can_be_reduced_and_pixels_stay_in_place() {
        let (cut, report) = dataset(&[(641, 479), (641, 479)]).trimmed(100);
        let report = report.unwrap();
        assert_eq!((report.before, report.after, report.photographs), ((641, 479), (637, 476), 3));
        let view = &cut.train.photographs()[0];
        assert_eq!((view.camera.width(), view.photograph.width(), view.photograph.height()), (637, 637, 476));
        assert_eq!(view.photograph.rgba()[4 * (637 + 3)], 3, "column 3 of row 1");
        assert_eq!(cut.test.photographs()[0].photograph.width(), 637);
        let whole = dataset(&[(641, 479)]);
        let centre = |dataset: &Dataset| dataset.train.photographs()[0].camera.intrinsics().cx;
        assert_eq!(centre(&cut), centre(&whole));
    }

    #[test]
    fn what_divides_or_needs_no_reduction_is_left() {
        for sizes in [[(640, 360), (640, 360)], [(99, 71), (100, 70)]] {
            let (left, report) = dataset(&sizes).trimmed(320);
            assert_eq!(report, None);
            assert_eq!(left.train.photographs()[0].photograph.width(), sizes[0].0);
        }
    }
}
