//! Trims photographs whose sides reductions do not divide.

use render_host::adjoint::loss::photograph::Photograph;

use super::{
    schedule::LEAST_SIDE,
    views::{Dataset, PosedPhotograph, Views},
};

/// What was trimmed: a size before and after, and how many photographs had it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Trimmed {
    /// Width and height before, pixels.
    pub before: (u32, u32),
    /// Width and height after, pixels.
    pub after: (u32, u32),
    /// Photographs of the first such size.
    pub photographs: usize,
}

impl Dataset {
    /// The same with photographs that can be reduced so that no side is longer than `max_side`, and then by
    /// half again and again: what does not divide is cut off at the right and at the bottom, 15 of 1,000
    /// pixels at most. Photographs that divide are left as they are.
    pub fn trimmed(mut self, max_side: u32) -> (Self, Option<Trimmed>) {
        let sides = |views: &[PosedPhotograph]| -> Vec<u32> {
            views.iter().flat_map(|view| [view.photograph.width(), view.photograph.height()]).collect()
        };
        let all: Vec<u32> =
            [self.train.photographs(), self.validation.photographs(), self.test.photographs()]
                .into_iter()
                .flat_map(sides)
                .collect();
        let by = divisor(&all, max_side.max(1));
        let cut =
            |view: &PosedPhotograph| (view.photograph.width() % by, view.photograph.height() % by) != (0, 0);
        let first = self.train.photographs().iter().find(|view| cut(view));
        let report = first.map(|view| {
            let before = (view.photograph.width(), view.photograph.height());
            let same =
                |other: &&PosedPhotograph| (other.photograph.width(), other.photograph.height()) == before;
            Trimmed {
                before,
                after: (before.0 / by * by, before.1 / by * by),
                photographs: self.train.photographs().iter().filter(same).count(),
            }
        });
        self.train = trimmed(&self.train, by);
        self.validation = trimmed(&self.validation, by);
        self.test = trimmed(&self.test, by);
        (self, report)
    }
}

/// What every side is to be a multiple of: 1 where sides are too short for that.
fn divisor(sides: &[u32], max_side: u32) -> u32 {
    let (Some(&longest), Some(&shortest)) = (sides.iter().max(), sides.iter().min()) else { return 1 };
    let common = sides.iter().fold(0, |a, &b| greatest_common_divisor(a, b));
    let reduces = |by: &u32| longest / by <= max_side;
    if (1..=64).filter(|by| common.is_multiple_of(*by)).any(|by| reduces(&by)) {
        return 1;
    }
    let base = (1..=64).find(reduces).unwrap_or(64);
    let halves = [8, 4, 2].into_iter().find(|by| shortest / base / by >= LEAST_SIDE).unwrap_or(1);
    if shortest / base == 0 { 1 } else { base * halves }
}

fn greatest_common_divisor(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { greatest_common_divisor(b, a % b) }
}

/// `views` cut to multiples of `by`.
fn trimmed<Split>(views: &Views<Split>, by: u32) -> Views<Split> {
    views.map(|view| {
        let (width, height) = (view.photograph.width() / by * by, view.photograph.height() / by * by);
        let is_whole = (width, height) == (view.photograph.width(), view.photograph.height());
        if is_whole {
            return view.clone();
        }
        let row = 4 * view.photograph.width() as usize;
        let rows = view.photograph.rgba().chunks_exact(row).take(height as usize);
        let rgba: Vec<u8> = rows.flat_map(|row| &row[..4 * width as usize]).copied().collect();
        match (Photograph::new(width, height, rgba), view.camera.cropped(0, 0, width, height)) {
            (Ok(photograph), Ok(camera)) => PosedPhotograph { photograph, camera, ..view.clone() },
            _ => view.clone(),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        scene::Up,
        train::{FreeSpace, Start},
    };
    use codec_core::Footprint;
    use render_host::Camera;

    fn dataset(sizes: &[(u32, u32)]) -> Dataset {
        let view = |&(width, height): &(u32, u32)| {
            let camera =
                Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, width, height).unwrap();
            let rgba = (0..4 * width * height).map(|at| (at / 4 % width) as u8).collect();
            let photograph = Photograph::new(width, height, rgba).unwrap();
            PosedPhotograph { name: "a".to_owned(), camera, time: 0.0, photograph }
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
        assert_eq!((report.before, report.after, report.photographs), ((641, 479), (637, 476), 2));
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
