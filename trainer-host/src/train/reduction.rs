//! Says how photographs are reduced, and trims those whose sides that does not divide.

use std::collections::BTreeMap;

use render_host::adjoint::loss::photograph::Photograph;

use super::{
    photographs::{MAX_REDUCED, exact_reduction},
    pixel_mask::PixelMask,
    schedule::MIN_SIDE,
    views::PosedPhotograph,
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

/// How photographs become small enough to train on, known before they are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reduction {
    /// Sides are first cut to multiples of this.
    multiple: u32,
    /// What divides the sides then.
    by: u32,
}

impl Reduction {
    /// Photographs as they are.
    pub(super) const NONE: Self = Self { multiple: 1, by: 1 };

    /// Of photographs of `sizes` (width and height, pixels): no side is longer than `max_side` pixels
    /// afterwards, and all can be halved again and again. What does not divide is cut off at the right and at
    /// the bottom, fewer pixels than a 64th of the shortest side, or than photographs are reduced by;
    /// photographs that divide are not cut. With it what is cut, if anything is.
    pub(super) fn of(sizes: &[(u32, u32)], max_side: u32) -> (Self, Option<Trimmed>) {
        let sides: Vec<u32> = sizes.iter().flat_map(|&(width, height)| [width, height]).collect();
        let multiple = divisor(&sides, max_side);
        let by = exact_reduction(sides.iter().map(|side| side / multiple * multiple), max_side).unwrap_or(1);
        let mut cut: BTreeMap<(u32, u32), usize> = BTreeMap::new();
        for &size in sizes.iter().filter(|(width, height)| width % multiple != 0 || height % multiple != 0) {
            *cut.entry(size).or_default() += 1;
        }
        let most = cut.iter().max_by_key(|(_, count)| **count);
        let trimmed = most.map(|(&before, &photographs)| {
            let after = (before.0 / multiple * multiple, before.1 / multiple * multiple);
            Trimmed { before, after, photographs, other_sizes: cut.len() - 1 }
        });
        (Self { multiple, by }, trimmed)
    }

    /// The same with sides twice as long, where that is a reduction by a whole number; and how many times as
    /// long they are, 1 or 2.
    pub(super) const fn doubled(self) -> (Self, u32) {
        if self.by.is_multiple_of(2) { (Self { by: self.by / 2, ..self }, 2) } else { (self, 1) }
    }

    /// `view`, reduced; one of another size than its camera stays as it is.
    pub(super) fn of_view(self, view: PosedPhotograph) -> PosedPhotograph {
        let size = (view.photograph.width(), view.photograph.height());
        if size != (view.camera.width(), view.camera.height()) {
            return view;
        }
        let view = trimmed(view, self.multiple);
        let (width, height) = (view.photograph.width() / self.by, view.photograph.height() / self.by);
        if self.by == 1 {
            return view;
        }
        match (view.photograph.resized(width, height), view.camera.resized(width, height)) {
            (Ok(photograph), Ok(camera)) => {
                let foreground = view.foreground.as_ref().map(|mask| mask.mostly(self.by));
                let counted = view.counted.as_ref().map(|mask| mask.reduced(self.by));
                PosedPhotograph { photograph, camera, foreground, counted, ..view }
            }
            _ => view,
        }
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
    use render_host::Camera;

    fn view(width: u32, height: u32) -> PosedPhotograph {
        let camera =
            Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, width, height).unwrap();
        let rgba = (0..4 * width * height).map(|at| (at / 4 % width) as u8).collect();
        let photograph = Photograph::new(width, height, rgba).unwrap();
        let mask = |from: u32| {
            let value = |at: u32| u8::from(at % width >= from);
            PixelMask::new(width, height, (0..width * height).map(value).collect())
        };
        PosedPhotograph {
            name: "a".to_owned(),
            camera,
            time: 0.0,
            photograph,
            foreground: mask(9),
            counted: mask(9),
        }
    }

    #[test]
    fn odd_sides_are_cut_so_that_they_can_be_reduced_and_pixels_stay_in_place() {
        let (reduction, report) = Reduction::of(&[(641, 479), (641, 479), (640, 479)], 100);
        let report = report.unwrap();
        assert_eq!((report.before, report.after, report.photographs), ((641, 479), (637, 476), 2));
        assert_eq!((report.other_sizes, reduction), (1, Reduction { multiple: 7, by: 7 }));
        let whole = view(641, 479);
        let reduced = reduction.of_view(whole.clone());
        assert_eq!(
            (reduced.camera.width(), reduced.photograph.width(), reduced.photograph.height()),
            (91, 91, 68)
        );
        assert_eq!(reduced.photograph.rgba()[4 * (91 + 3)], 24, "the mean of columns 21 to 27");
        let lens = [&whole, &reduced].map(|view| view.camera.intrinsics());
        assert!((7.0 * lens[1].cx - lens[0].cx).abs() < 1e-9 && (7.0 * lens[1].fx - lens[0].fx).abs() < 1e-9);
        // Columns 7 to 13 are one: five of them are in the masks.
        let columns = |mask: &Option<PixelMask>| [0, 1, 2].map(|x| mask.as_ref().unwrap().at(x, 5));
        assert_eq!(columns(&reduced.foreground), [false, true, true], "at least half of the pixels");
        assert_eq!(columns(&reduced.counted), [false, false, true], "all pixels");
    }

    #[test]
    fn what_divides_or_needs_no_reduction_is_not_cut() {
        let of = |sizes: &[(u32, u32)]| Reduction::of(sizes, 320);
        assert_eq!(of(&[(640, 360); 2]), (Reduction { multiple: 1, by: 2 }, None));
        assert_eq!(of(&[(99, 71), (100, 70)]), (Reduction::NONE, None));
        assert_eq!(of(&[]), (Reduction::NONE, None));
        assert_eq!(of(&[(640, 360)]).0.doubled(), (Reduction::NONE, 2));
        assert_eq!(Reduction { multiple: 7, by: 7 }.doubled(), (Reduction { multiple: 7, by: 7 }, 1));
    }
}
