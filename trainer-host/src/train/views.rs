//! Views hold what a scene is trained on and judged by: photographs with their cameras and times.

use std::{marker::PhantomData, ops::Range};

use codec_core::{Footprint, ShDegree};
use rayon::prelude::*;
use render_host::{Camera, adjoint::loss::photograph::Photograph};

use super::pixel_mask::PixelMask;
use crate::scene::{Instant, Up};

/// Multiples of it, whole numbers left out, are spread evenly however many they are.
const GOLDEN_RATIO: f64 = 1.618_033_988_749_895;

/// A photograph, from where and when it was taken.
#[derive(Clone, Debug)]
pub struct PosedPhotograph {
    /// Name of the image in its source.
    pub name: String,
    /// Camera, of the photograph's size.
    pub camera: Camera,
    /// Time in the clip, 0 to 1.
    pub time: f32,
    /// The photograph.
    pub photograph: Photograph,
    /// What of it moves or is meant, where a mask of its size says so; without, what is opaque.
    pub foreground: Option<PixelMask>,
    /// What of it is trained on and compared, where a mask of its size says so; without, all. In losses and
    /// metrics that look at a pixel's surroundings the others are equal to the photograph.
    pub counted: Option<PixelMask>,
}

/// Marks views that training may see.
#[derive(Clone, Copy, Debug)]
pub enum Training {}
/// Marks views that choices may be made on, and no gradients.
#[derive(Clone, Copy, Debug)]
pub enum Validation {}
/// Marks views that only reported figures come from.
#[derive(Clone, Copy, Debug)]
pub enum Test {}

/// Photographs of one split: a function that trains cannot be given those of another.
#[derive(Clone, Debug)]
pub struct Views<Split> {
    photographs: Vec<PosedPhotograph>,
    split: PhantomData<Split>,
}

/// Views that do not fit together.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ViewsError {
    /// A photograph of another size than its camera's.
    #[error(
        "{name}: image of {} x {} pixels, camera of {} x {}",
        image.0, image.1, camera.0, camera.1
    )]
    Size {
        /// Name of the image.
        name: String,
        /// Width and height of the image, pixels.
        image: (u32, u32),
        /// Width and height that the camera has, pixels.
        camera: (u32, u32),
    },
    /// A mask of another size than its photograph.
    #[error(
        "{name}: mask of {} x {} pixels, image of {} x {}",
        mask.0, mask.1, image.0, image.1
    )]
    Mask {
        /// Name of the image.
        name: String,
        /// Width and height of the mask, pixels.
        mask: (u32, u32),
        /// Width and height of the image, pixels.
        image: (u32, u32),
    },
    /// A time that is not in the clip.
    #[error("{name}: time is {found}; 0 to 1 is allowed")]
    Time {
        /// Name of the image.
        name: String,
        /// The time found.
        found: f32,
    },
}

impl<Split> Views<Split> {
    /// Checks `photographs`.
    ///
    /// # Errors
    /// A photograph of another size than its camera or its masks, or a time outside 0 to 1.
    pub fn new(photographs: Vec<PosedPhotograph>) -> Result<Self, ViewsError> {
        for PosedPhotograph { name, camera, time, photograph, foreground, counted } in &photographs {
            let (image, camera) =
                ((photograph.width(), photograph.height()), (camera.width(), camera.height()));
            if image != camera {
                return Err(ViewsError::Size { name: name.clone(), image, camera });
            }
            for mask in [foreground, counted].into_iter().flatten().map(PixelMask::size) {
                if mask != image {
                    return Err(ViewsError::Mask { name: name.clone(), mask, image });
                }
            }
            if !(0.0..=1.0).contains(time) {
                return Err(ViewsError::Time { name: name.clone(), found: *time });
            }
        }
        Ok(Self { photographs, split: PhantomData })
    }

    /// The photographs in the order of their source.
    pub fn photographs(&self) -> &[PosedPhotograph] {
        &self.photographs
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.photographs.is_empty()
    }

    /// At most `count` of them, evenly spread: over their order, or, where several photographs have the same
    /// time, over times and cameras.
    #[must_use]
    pub fn sample(&self, count: usize) -> Self {
        let (all, count) = (self.photographs.len(), count.min(self.photographs.len()));
        let chosen = if 2 * self.instants() <= all {
            self.over_times(count)
        } else {
            (0..count).map(|k| k * all / count).collect()
        };
        let photographs = chosen.into_iter().map(|at| self.photographs[at].clone()).collect();
        Self { photographs, split: PhantomData }
    }

    /// Indices of `count` of them, evenly spread over times and over cameras: the place of a photograph among
    /// those of its time tells cameras apart where each has one of every time. Each next camera is far from
    /// those before, also in every fifth of the sample: equal steps could meet one camera again and again.
    fn over_times(&self, count: usize) -> Vec<usize> {
        let mut order: Vec<usize> = (0..self.photographs.len()).collect();
        order.sort_by(|&a, &b| self.photographs[a].time.total_cmp(&self.photographs[b].time));
        let same = |&a: &usize, &b: &usize| self.photographs[a].time == self.photographs[b].time;
        let mut left: Vec<Vec<(usize, usize)>> =
            order.chunk_by(same).map(|views| views.iter().copied().enumerate().collect()).collect();
        let places = far_apart(left.iter().map(Vec::len).max().unwrap_or(0));
        let mut chosen = Vec::with_capacity(count);
        for k in 0..count {
            let first = k * left.len() / count;
            let time = (first..left.len()).chain(0..first).find(|&time| !left[time].is_empty());
            let Some(views) = time.map(|time| &mut left[time]) else { break };
            let wanted = places[k % places.len()];
            let at = views.iter().position(|&(place, _)| place >= wanted).unwrap_or(0);
            chosen.push(views.remove(at).1);
        }
        chosen.sort_unstable();
        chosen
    }

    /// Each changed; `change` must leave it the size of its camera, and its time.
    pub(super) fn map(self, change: impl Fn(PosedPhotograph) -> PosedPhotograph + Sync + Send) -> Self {
        Self { photographs: self.photographs.into_par_iter().map(change).collect(), split: PhantomData }
    }

    /// Those of some frames of a clip of `count`, as views of a clip of only these.
    pub(super) fn part(&self, count: usize, frames: &Range<usize>) -> Self {
        let frame =
            |view: &PosedPhotograph| (f64::from(view.time) * count.saturating_sub(1) as f64).round() as usize;
        let inside = self.photographs.iter().filter(|view| frames.contains(&frame(view)));
        let last = frames.len().saturating_sub(1).max(1) as f32;
        let moved = |view: &PosedPhotograph| PosedPhotograph {
            time: (frame(view) - frames.start) as f32 / last,
            ..view.clone()
        };
        Self { photographs: inside.map(moved).collect(), split: PhantomData }
    }

    /// Number of different times.
    pub fn instants(&self) -> usize {
        distinct(self.photographs.iter().map(|view| view.time))
    }
}

/// 0 to `count` − 1 in such an order that the first of them, however many, are spread over all: by multiples
/// of the golden ratio.
fn far_apart(count: usize) -> Vec<usize> {
    let share = |k: usize| (k as f64 * GOLDEN_RATIO).fract();
    let mut by_share: Vec<usize> = (0..count).collect();
    by_share.sort_by(|&a, &b| share(a).total_cmp(&share(b)));
    let mut places = vec![0; count];
    by_share.iter().enumerate().for_each(|(place, &k)| places[k] = place);
    places
}

/// How many different ones there are of `times`.
pub(super) fn distinct(times: impl Iterator<Item = f32>) -> usize {
    let mut times: Vec<f32> = times.collect();
    times.sort_by(f32::total_cmp);
    times.dedup();
    times.len()
}

/// A point of known colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColouredPoint {
    /// Scene units.
    pub position: [f32; 3],
    /// Red, green, blue, 0 to 1.
    pub colour: [f32; 3],
}

/// Space before cameras in which nothing is: what stood there would hide the scene from views between those
/// that are trained on, where no photograph tells that it is not there.
#[derive(Clone, Debug, Default)]
pub struct FreeSpace {
    cameras: Vec<Camera>,
    distance: f64,
    cosine: f64,
}

impl FreeSpace {
    /// What is nearer than `distance`, in scene units, to one of `cameras`, in directions whose angle to its
    /// optical axis has at least this `cosine`, -1 to 1.
    pub fn before(cameras: Vec<Camera>, distance: f64, cosine: f64) -> Self {
        Self { cameras, distance, cosine }
    }

    /// Whether `place` is in it.
    pub(crate) fn contains(&self, place: [f32; 3]) -> bool {
        self.cameras.iter().any(|camera| {
            let [x, y, z] = camera.to_camera(place);
            let distance = (x * x + y * y + z * z).sqrt();
            distance < self.distance && z > self.cosine * distance
        })
    }
}

/// What training begins with.
#[derive(Clone, Debug)]
pub enum Start {
    /// Points inside the outlines of the photographs, which have alpha, near the canonical instant.
    VisualHull,
    /// Points that a reconstruction found.
    Points(Vec<ColouredPoint>),
    /// Gaussians of the canonical instant.
    Gaussians(Instant, ShDegree),
}

/// A capture: its views by split, and what else its source knows.
#[derive(Clone, Debug)]
pub struct Dataset {
    /// What the source is called.
    pub name: String,
    /// Views to train on.
    pub train: Views<Training>,
    /// Views to choose by; may be empty.
    pub validation: Views<Validation>,
    /// Views to report; may be empty.
    pub test: Views<Test>,
    /// How many times as long the sides of test photographs are as they would be among those to train on, at
    /// least 1: so that figures can be of larger pictures, too.
    pub test_scale: u32,
    /// What training begins with.
    pub start: Start,
    /// Where nothing can be.
    pub free_space: FreeSpace,
    /// Whether photographs have an outline: what lies outside it is empty space, not background.
    pub has_alpha: bool,
    /// Frames that the clip has, one at least.
    pub frames: usize,
    /// Which way is up.
    pub up: Up,
    /// How Gaussians are best drawn: as what a pixel of a photograph averages over, or as the scene is whose
    /// renders the photographs are.
    pub footprint: Footprint,
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    /// Views of `cameras` at each of `frames` times, one time after the other, named by both.
    fn views(cameras: usize, frames: usize) -> Views<Training> {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.7, 1, 1).unwrap();
        let view = |frame: usize, place: usize| PosedPhotograph {
            name: format!("{place} {frame}"),
            camera: camera.clone(),
            time: frame as f32 / frames as f32,
            photograph: Photograph::new(1, 1, vec![0; 4]).unwrap(),
            foreground: None,
            counted: None,
        };
        let all = (0..frames).flat_map(|frame| (0..cameras).map(move |place| (frame, place)));
        Views::new(all.map(|(frame, place)| view(frame, place)).collect()).unwrap()
    }

    fn different<'a>(names: impl Iterator<Item = &'a str>) -> usize {
        names.collect::<BTreeSet<_>>().len()
    }

    #[test]
    fn a_sample_is_of_many_cameras_and_times() {
        for (count, frames) in [20, 24, 64].into_iter().flat_map(|count| (20..=128).map(move |f| (count, f)))
        {
            let sample = views(24, frames).sample(count);
            let names: Vec<(&str, &str)> =
                sample.photographs().iter().map(|view| view.name.split_once(' ').unwrap()).collect();
            assert_eq!(names.len(), count);
            let cameras = different(names.iter().map(|(place, _)| *place));
            let times = different(names.iter().map(|(_, frame)| *frame));
            assert_eq!((cameras, times), (count.min(24), count.min(frames)), "{count} of {frames} frames");
            // Every fifth of them is a sample itself.
            let fifth = different(names.iter().step_by(5).map(|(place, _)| *place));
            assert!(4 * fifth >= 3 * count.div_ceil(5), "{count} of {frames} frames: {fifth} cameras");
        }
    }

    /// Photographs of what stands still have one time, and lie in the order in which they were taken.
    #[test]
    fn a_sample_of_one_time_is_spread_over_all_of_it() {
        for (all, count, widest) in [(200, 20, 18), (100, 20, 9), (300, 4, 120)] {
            let sample = views(all, 1).sample(count);
            let mut places: Vec<usize> = sample
                .photographs()
                .iter()
                .map(|view| view.name[..view.name.len() - 2].parse().unwrap())
                .collect();
            places.extend([0, all]);
            places.sort_unstable();
            let gap = places.windows(2).map(|pair| pair[1] - pair[0]).max().unwrap();
            assert!(places.len() == count + 2 && gap <= widest, "{count} of {all}: {places:?}");
        }
    }

    /// Some times have few photographs, and cameras come one after the other: none comes twice.
    #[test]
    fn a_sample_of_a_rig_with_gaps_is_of_different_photographs() {
        let full = views(3, 6);
        let by_camera = (0..3).flat_map(|place| (0..6).map(move |frame| 3 * frame + place));
        let present = by_camera.filter(|at| ![4, 5, 8].contains(at));
        let gaps: Views<Training> =
            Views::new(present.map(|at| full.photographs()[at].clone()).collect()).unwrap();
        for count in 0..=15 {
            let sample = gaps.sample(count);
            let names = sample.photographs().iter().map(|view| view.name.as_str());
            assert_eq!(different(names), count);
        }
    }

    #[test]
    fn a_sample_of_one_camera_is_of_equal_steps() {
        let names = |count: usize| -> Vec<String> {
            views(1, 10).sample(count).photographs().iter().map(|view| view.name.clone()).collect()
        };
        assert_eq!(names(5), ["0 0", "0 2", "0 4", "0 6", "0 8"]);
        assert_eq!(names(99).len(), 10);
        assert_eq!(names(0).len(), 0);
    }
}
