//! Finds the space in which something moves, where fixed cameras show the same place again and again.
//!
//! In a capture by many fixed cameras most of the scene is walls and floor. What moves passes through places
//! whose pixels change in nearly every picture that shows them; a place that changes in one picture and not
//! in others only lies behind or before it. Control nodes are spread where something moves, and all else
//! stands still from the beginning.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;
use render_host::{Camera, adjoint::loss::photograph::Photograph};

use super::views::PosedPhotograph;

/// Fixed cameras that must agree.
const MIN_CAMERAS: usize = 4;
/// Instants that each of them must have seen.
const MIN_INSTANTS: usize = 4;
/// Range over time of a channel's mean over a cell of pixels from which on the cell changes.
const CHANGE: f32 = 0.06;
/// Cells along the longer side of a picture.
const CELLS: usize = 80;
/// Share of the cameras that see a place in which it must change.
const AGREEMENT: f32 = 0.75;

/// The space in which something moves.
#[derive(Clone, Debug)]
pub(super) struct MovingRegion(Vec<Seen>);

/// What one fixed camera saw change.
#[derive(Clone, Debug)]
struct Seen {
    camera: Camera,
    across: usize,
    down: usize,
    /// Of each cell, row by row: whether it changes, or one beside it does.
    changes: Vec<bool>,
}

impl MovingRegion {
    /// What `views` show of it; nothing where cameras move, or are few.
    pub(super) fn of(views: &[PosedPhotograph]) -> Option<Self> {
        let mut fixed: BTreeMap<Vec<u64>, Vec<&PosedPhotograph>> = BTreeMap::new();
        for view in views {
            fixed.entry(key(&view.camera)).or_default().push(view);
        }
        let instants = |views: &[&PosedPhotograph]| -> usize {
            views.iter().map(|view| view.time.to_bits()).collect::<BTreeSet<_>>().len()
        };
        fixed.retain(|_, views| instants(views) >= MIN_INSTANTS);
        if fixed.len() < MIN_CAMERAS {
            return None;
        }
        let fixed: Vec<Vec<&PosedPhotograph>> = fixed.into_values().collect();
        let seen: Vec<Seen> = fixed.par_iter().filter_map(|views| Seen::of(views)).collect();
        seen.iter().any(|seen| seen.changes.contains(&true)).then_some(Self(seen))
    }

    /// Whether something moves at `place`, as far as the cameras can tell.
    pub(super) fn contains(&self, place: [f32; 3]) -> bool {
        let (mut seen, mut changing) = (0.0f32, 0.0f32);
        for camera in &self.0 {
            if let Some(changes) = camera.changes_at(place) {
                seen += 1.0;
                changing += f32::from(u8::from(changes));
            }
        }
        seen >= 2.0 && changing >= AGREEMENT * seen
    }
}

/// What tells a camera from others.
fn key(camera: &Camera) -> Vec<u64> {
    let lens = camera.intrinsics();
    let numbers = camera.rotation().into_iter().flatten().chain(camera.translation());
    let size = [lens.width, lens.height].map(f64::from);
    numbers.chain([lens.fx, lens.fy, lens.cx, lens.cy]).chain(size).map(f64::to_bits).collect()
}

impl Seen {
    /// What the photographs of one camera show.
    fn of(views: &[&PosedPhotograph]) -> Option<Self> {
        let camera = views.first()?.camera.clone();
        let (width, height) = (camera.width() as usize, camera.height() as usize);
        let side = width.max(height).div_ceil(CELLS);
        let (across, down) = (width.div_ceil(side), height.div_ceil(side));
        let mut range = vec![[f32::INFINITY, f32::NEG_INFINITY]; 3 * across * down];
        for view in views {
            for (mean, [low, high]) in means(&view.photograph, side, across, down).into_iter().zip(&mut range)
            {
                (*low, *high) = (low.min(mean), high.max(mean));
            }
        }
        let mut cells: Vec<bool> =
            range.chunks_exact(3).map(|cell| cell.iter().any(|[low, high]| high - low > CHANGE)).collect();
        // What is never foreground does not move: its pixels change by noise and shadows.
        if views.iter().all(|view| view.foreground.is_some()) {
            let mut moves = vec![false; cells.len()];
            for mask in views.iter().filter_map(|view| view.foreground.as_ref()) {
                for (at, _) in mask.values().iter().enumerate().filter(|(_, value)| **value > 0) {
                    moves[at / width / side * across + at % width / side] = true;
                }
            }
            cells.iter_mut().zip(moves).for_each(|(cell, moves)| *cell &= moves);
        }
        let near = |index: usize| {
            let (x, y) = (index % across, index / across);
            (y.saturating_sub(1)..(y + 2).min(down))
                .any(|y| (x.saturating_sub(1)..(x + 2).min(across)).any(|x| cells[y * across + x]))
        };
        let changes = (0..cells.len()).map(near).collect();
        Some(Self { camera, across, down, changes })
    }

    /// Whether a place changes in the picture, if it is in it.
    fn changes_at(&self, place: [f32; 3]) -> Option<bool> {
        let [x, y, z] = self.camera.to_camera(place);
        if z <= self.camera.near() {
            return None;
        }
        let lens = self.camera.intrinsics();
        let column = (lens.fx * x / z + lens.cx) / f64::from(lens.width) * self.across as f64;
        let row = (lens.fy * y / z + lens.cy) / f64::from(lens.height) * self.down as f64;
        let inside = column >= 0.0 && row >= 0.0 && column < self.across as f64 && row < self.down as f64;
        inside.then(|| self.changes[row as usize * self.across + column as usize])
    }
}

/// Mean of each channel over each cell of `side` x `side` pixels, 0 to 1.
fn means(photograph: &Photograph, side: usize, across: usize, down: usize) -> Vec<f32> {
    let mut sums = vec![0.0f32; 3 * across * down];
    let mut counts = vec![0.0f32; across * down];
    let width = photograph.width() as usize;
    for (index, pixel) in photograph.rgba().chunks_exact(4).enumerate() {
        let cell = index / width / side * across + index % width / side;
        counts[cell] += 255.0;
        (0..3).for_each(|c| sums[3 * cell + c] += f32::from(pixel[c]));
    }
    sums.iter().enumerate().map(|(index, sum)| sum / counts[index / 3].max(1.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::pixel_mask::PixelMask;
    use render_host::Intrinsics;

    /// Six cameras around a ball of grey that is in one of two places, before a wall of dots.
    fn views(moves: bool) -> Vec<PosedPhotograph> {
        let mut out = Vec::new();
        for camera in 0..6 {
            let turn = f64::from(camera);
            let eye = [4.0 * turn.cos(), -1.0, 4.0 * turn.sin()];
            let camera = Camera::look_at(eye, [0.0; 3], [0.0, -1.0, 0.0], 0.9, 96, 64).unwrap();
            for instant in 0..4 {
                let place = if moves && instant >= 2 { [0.8f32, 0.0, 0.0] } else { [-0.8, 0.0, 0.0] };
                let [x, y, z] = camera.to_camera(place);
                let lens = camera.intrinsics();
                let (column, row) = (lens.fx * x / z + lens.cx, lens.fy * y / z + lens.cy);
                let pixel = |at: u32| {
                    let (dx, dy) = (f64::from(at % 96) - column, f64::from(at / 96) - row);
                    if dx.hypot(dy) < 5.0 { 200 } else { 40 }
                };
                let rgba = (0..96 * 64).flat_map(|at| [pixel(at), pixel(at), pixel(at), 255]).collect();
                let photograph = Photograph::new(96, 64, rgba).unwrap();
                let (name, time) = (String::new(), instant as f32 / 3.0);
                out.push(PosedPhotograph {
                    name,
                    camera: camera.clone(),
                    time,
                    photograph,
                    foreground: None,
                    counted: None,
                });
            }
        }
        out
    }

    #[test]
    fn what_a_mask_calls_background_does_not_move() {
        let mut views = views(true);
        let moved = [0.8, 0.0, 0.0];
        assert!(MovingRegion::of(&views).unwrap().contains(moved));
        let all = |value: u8| PixelMask::new(96, 64, vec![value; 96 * 64]);
        views.iter_mut().for_each(|view| view.foreground = all(1));
        assert!(MovingRegion::of(&views).unwrap().contains(moved));
        views.iter_mut().for_each(|view| view.foreground = all(0));
        assert!(MovingRegion::of(&views).is_none());
    }

    #[test]
    fn places_that_something_passes_change_and_others_do_not() {
        let changing = MovingRegion::of(&views(true)).unwrap();
        assert!(changing.contains([0.8, 0.0, 0.0]) && changing.contains([-0.8, 0.0, 0.0]));
        assert!(!changing.contains([0.0, 1.0, 0.0]) && !changing.contains([0.0, 0.0, 1.4]));
    }

    #[test]
    fn cameras_that_move_or_see_nothing_move_tell_nothing() {
        assert!(MovingRegion::of(&views(false)).is_none());
        let mut moving = views(true);
        moving.truncate(3);
        assert!(MovingRegion::of(&moving).is_none());
        let mut other_size = views(true);
        let (width, height) = (112, 96);
        let lens = Intrinsics { width, height, ..other_size[0].camera.intrinsics() };
        let camera = &other_size[0].camera;
        let camera = Camera::new(lens, camera.rotation(), camera.translation()).unwrap();
        let photograph = Photograph::new(width, height, vec![0; 4 * 112 * 96]).unwrap();
        other_size.push(PosedPhotograph { camera, photograph, ..other_size[0].clone() });
        assert!(MovingRegion::of(&other_size).unwrap().contains([0.8, 0.0, 0.0]), "a camera of its own");
        let one_each: Vec<_> = views(true).into_iter().step_by(4).collect();
        assert!(MovingRegion::of(&one_each).is_none());
    }
}
