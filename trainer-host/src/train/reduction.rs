//! Says how photographs are reduced, and trims those whose sides that does not divide.

use std::collections::BTreeMap;

use render_host::adjoint::loss::photograph::Photograph;

use super::{
    photographs::{MAX_REDUCED, exact_reduction, nearest_reduction},
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

/// What a person should know of how photographs become small enough to train on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ReductionReport {
    /// What was cut, if anything was.
    pub trimmed: Option<Trimmed>,
    /// Of photographs that are reduced with larger ones to less than half of what is allowed, the smallest:
    /// width and height before and after, pixels.
    pub much_reduced: Option<[(u32, u32); 2]>,
    /// The longest side that photographs are trained on with, pixels, where that is more than is allowed.
    pub too_long: Option<u32>,
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
    /// photographs that divide by at most twice what is needed are not cut. With it what a person should
    /// know.
    pub(super) fn of(sizes: &[(u32, u32)], max_side: u32) -> (Self, ReductionReport) {
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
        let reduction = Self { multiple, by };
        let trained = reduction.trained_sizes(sizes, max_side);
        let longest = |(width, height): (u32, u32)| width.max(height);
        let both = || sizes.iter().copied().zip(trained.iter().copied());
        let much = both().filter(|&(before, after)| {
            longest(after) < longest(before) && u64::from(longest(after)) * 2 < u64::from(max_side)
        });
        let much_reduced =
            much.min_by_key(|&(_, after)| longest(after)).map(|(before, after)| [before, after]);
        let too_long = trained.iter().copied().map(longest).max().filter(|&side| side > max_side);
        (reduction, ReductionReport { trimmed, much_reduced, too_long })
    }

    /// Widths and heights that photographs of `sizes` are trained on with: where sides are still too long,
    /// a training reduces them once more.
    fn trained_sizes(self, sizes: &[(u32, u32)], max_side: u32) -> Vec<(u32, u32)> {
        let reduced = |side: u32| side / self.multiple * self.multiple / self.by;
        let sizes = sizes.iter().map(|&(width, height)| (reduced(width), reduced(height)));
        let once_more =
            nearest_reduction(sizes.clone().flat_map(|(width, height)| [width, height]), max_side);
        sizes.map(|(width, height)| (width / once_more, height / once_more)).collect()
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
    let base = (1..=MAX_REDUCED).find(|by| longest / by <= max_side).unwrap_or(MAX_REDUCED);
    // Pixels are cut off rather than photographs made more than twice as small as they have to be.
    if exact_reduction(sides.iter().copied(), max_side).is_some_and(|by| by <= 2 * base) {
        return 1;
    }
    let halves = [8, 4, 2].into_iter().find(|by| shortest / base / by >= MIN_SIDE).unwrap_or(1);
    if shortest / base == 0 { 1 } else { base * halves }
}

/// `view` cut to multiples of `by`.
pub(crate) fn trimmed(view: PosedPhotograph, by: u32) -> PosedPhotograph {
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
        let report = report.trimmed.unwrap();
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
        let nothing = ReductionReport::default();
        assert_eq!(of(&[(640, 360); 2]), (Reduction { multiple: 1, by: 2 }, nothing));
        assert_eq!(of(&[(99, 71), (100, 70)]), (Reduction::NONE, nothing));
        assert_eq!(of(&[]), (Reduction::NONE, nothing));
        assert_eq!(of(&[(640, 360)]).0.doubled(), (Reduction::NONE, 2));
        assert_eq!(Reduction { multiple: 7, by: 7 }.doubled(), (Reduction { multiple: 7, by: 7 }, 1));
    }

    #[test]
    fn what_becomes_much_smaller_or_stays_too_long_is_reported() {
        let of = |sizes: &[(u32, u32)], max_side: u32| {
            let report = Reduction::of(sizes, max_side).1;
            (report.much_reduced, report.too_long)
        };
        // Small ones are reduced with large ones.
        assert_eq!(of(&[(640, 480), (48, 64)], 64), (Some([(48, 64), (3, 4)]), None));
        assert_eq!(of(&[(640, 480), (320, 640)], 64), (None, None));
        // Small ones beside others that need no reduction are as they were.
        assert_eq!(of(&[(64, 48), (8, 8)], 64), (None, None));
        // The only divisor is a large one: a few pixels are cut off and a small one is taken.
        let (reduction, report) = Reduction::of(&[(707, 707), (707, 707)], 700);
        assert_eq!((report.much_reduced, report.too_long), (None, None));
        assert_eq!(report.trimmed.map(|trimmed| trimmed.after), Some((704, 704)));
        assert_eq!(reduction, Reduction { multiple: 8, by: 2 });
        // Thin ones are only reduced by what divides them, and no photograph more than 64 times.
        assert_eq!(of(&[(2000, 10)], 64), (None, Some(200)));
        assert_eq!(of(&[(8192, 8192)], 16), (None, Some(128)));
        assert_eq!(of(&[(8192, 4096), (64, 64)], 16), (Some([(64, 64), (1, 1)]), Some(128)));
    }
}
