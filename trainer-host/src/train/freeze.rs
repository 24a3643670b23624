//! Finds Gaussians that hardly move over the clip and stands them still.
//!
//! Nodes can carry anything a little way, and each instant has few views: what stands still would wander
//! within a pixel to please them, and would no longer be where other views see it. What does not move at all
//! is agreed on by the views of every instant, and costs no motion.

use glam::Vec3;
use rayon::prelude::*;
use render_host::metric;

use super::{
    error::TrainError,
    evaluation::{self, EQUAL_DB, EvaluationError},
    model::Model,
    motion::{Posed, Skinned},
    rotation::{Quaternion, dot},
    views::{Training, Views},
};

/// Instants that motion is looked at, evenly spread over the clip, at least.
const MIN_INSTANTS: usize = 64;

/// How many training views decide whether what hardly moves may stand still.
const VIEWS: usize = 16;
/// What their mean PSNR may fall by at once, dB. What only wandered costs less, or nothing.
const MAX_LOSS_DB: f64 = 0.1;
/// Times that the allowed motion is halved where pictures do not bear it.
const HALVINGS: u32 = 3;

/// Training views that a scene is tried on.
pub(super) struct Trial<'a> {
    pub(super) views: &'a Views<Training>,
    /// The exposure of a view by its index, where it has one.
    pub(super) exposure_of: &'a dyn Fn(usize) -> Option<[[f32; 3]; 2]>,
    /// How many times smaller than the photographs pictures are.
    pub(super) reduced: u32,
    pub(super) background: [f32; 3],
}

impl Trial<'_> {
    /// Mean PSNR of views that are spread evenly over all, dB; those of which no pixel counts are left out.
    fn psnr_db(&self, model: &Model) -> Result<f64, EvaluationError> {
        let all = self.views.photographs().len();
        let count = all.min(VIEWS);
        let (mut sum, mut counted) = (0.0, 0);
        for k in 0..count {
            let index = k * all / count;
            let view = &self.views.photographs()[index];
            let neutral = (self.exposure_of)(index).map(|exposure| view.without_exposure(exposure));
            let view = neutral.as_ref().unwrap_or(view);
            let compared = evaluation::compare_view(model, view, self.reduced, self.background)?;
            if compared.counts() {
                sum += metric::psnr(&*compared.where_counted()?, &compared.photograph)?.min(EQUAL_DB);
                counted += 1;
            }
        }
        Ok(sum / f64::from(counted.max(1)))
    }
}

/// Stands Gaussians of `model` still that hardly move: `most` scene units, or half of that and so on if
/// pictures of training views lose too much. Returns how many.
///
/// # Errors
/// A view that cannot be rendered.
pub(super) fn freeze_still(model: &mut Model, most: f32, trial: &Trial) -> Result<usize, TrainError> {
    let mut before = None;
    for halving in 0..=HALVINGS {
        let mut tried = model.clone();
        let count = tried.freeze_still(most * 0.5f32.powi(halving as i32));
        if count == 0 {
            break;
        }
        let now = match before {
            Some(db) => db,
            None => *before.insert(trial.psnr_db(model)?),
        };
        let then = trial.psnr_db(&tried)?;
        if then >= now - MAX_LOSS_DB {
            *model = tried;
            return Ok(count);
        }
    }
    Ok(0)
}

impl Model {
    /// Stands Gaussians still, in the middle of where they have been, whose centre never is farther than
    /// `most` scene units from there, and whose turning never moves a standard deviation of theirs farther.
    /// Returns how many.
    pub(super) fn freeze_still(&mut self, most: f32) -> usize {
        if self.nodes.is_empty() {
            return 0;
        }
        // No piece of a spline is passed over.
        let instants = MIN_INSTANTS.max(2 * self.nodes.finest());
        let times = (0..instants).map(|instant| instant as f32 / (instants - 1) as f32);
        let poses: Vec<_> = times.map(|time| self.nodes.poses(time)).collect();
        let skinned: Vec<Skinned> = poses.iter().map(|poses| self.nodes.skin(poses)).collect();
        let (gaussians, followed) = (&self.gaussians, &self.followed);
        let stand = |index: usize| -> Option<(usize, Posed)> {
            followed[index].as_ref()?;
            let rest = gaussians.rest(index, followed);
            let path: Vec<Posed> = skinned.iter().map(|skinned| skinned.pose(&rest)).collect();
            let scales = gaussians.log_scale.item(index).iter().copied();
            let (middle, reach) = middle(&path, scales.fold(f32::MIN, f32::max).exp());
            (reach <= most).then_some((index, middle))
        };
        let standing: Vec<_> =
            (0..self.gaussians.len()).into_par_iter().with_min_len(256).filter_map(stand).collect();
        for (index, middle) in &standing {
            self.gaussians.position.item_mut(*index).copy_from_slice(&middle.position.to_array());
            self.gaussians.rotation.item_mut(*index).copy_from_slice(&middle.rotation);
            self.followed[*index] = None;
        }
        standing.len()
    }

    /// Gaussians that stand still.
    pub fn standing(&self) -> usize {
        self.followed.iter().filter(|followed| followed.is_none()).count()
    }
}

/// The mean of a path, and the farthest that anything on it is from there: its centre, or a point `arm` away
/// that turns with it.
fn middle(path: &[Posed], arm: f32) -> (Posed, f32) {
    let count = path.len().max(1) as f32;
    let position = path.iter().map(|posed| posed.position).sum::<Vec3>() / count;
    let units = |posed: &Posed| scaled(posed.rotation, 1.0 / length(posed.rotation).max(1e-12));
    let first = path.first().map_or([1.0, 0.0, 0.0, 0.0], units);
    let mut sum = [0.0; 4];
    for posed in path {
        let unit = units(posed);
        let sign = if dot(unit, first) < 0.0 { -1.0 } else { 1.0 };
        sum.iter_mut().zip(unit).for_each(|(sum, v)| *sum += sign * v);
    }
    let rotation = scaled(sum, 1.0 / length(sum).max(1e-12));
    let reach = |posed: &Posed| {
        // The sine of half the angle between the two.
        let turned = (1.0 - dot(units(posed), rotation).powi(2)).max(0.0).sqrt();
        posed.position.distance(position).max(2.0 * arm * turned)
    };
    let farthest = path.iter().map(reach).fold(0.0, f32::max);
    // What a quaternion is as long as decides how fast it learns.
    let long = path.iter().map(|posed| length(posed.rotation)).sum::<f32>() / count;
    (Posed { position, rotation: scaled(rotation, long) }, farthest)
}

fn length(q: Quaternion) -> f32 {
    dot(q, q).sqrt()
}

fn scaled(q: Quaternion, factor: f32) -> Quaternion {
    q.map(|v| factor * v)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn posed(x: f32, half_turn: f32) -> Posed {
        let (sin, cos) = half_turn.sin_cos();
        Posed { position: Vec3::new(x, 0.0, 0.0), rotation: [2.0 * cos, 0.0, 0.0, 2.0 * sin] }
    }

    #[test]
    fn the_middle_of_a_path_is_its_mean_and_its_reach_the_farthest_from_there() {
        let (middle, reach) = middle(&[posed(1.0, 0.0), posed(2.0, 0.0), posed(4.5, 0.0)], 1.0);
        assert_eq!((middle.position.x, reach), (2.5, 2.0));
        assert_eq!(middle.rotation, [2.0, 0.0, 0.0, 0.0]);
    }

    #[test]
    fn what_turns_reaches_as_far_as_it_is_long() {
        // A quaternion and its negative are one rotation.
        let there = posed(0.0, 0.2);
        let negative = Posed { rotation: there.rotation.map(|v| -v), ..there };
        let (middle, reach) = middle(&[posed(0.0, -0.2), negative], 3.0);
        assert!((middle.rotation[0] - 2.0).abs() < 1e-6 && middle.rotation[3].abs() < 1e-6, "{middle:?}");
        // Turned by 0.4 radians, a point three away is 6 sin 0.2 from where it was.
        assert!((reach - 6.0 * 0.2f32.sin()).abs() < 1e-5, "{reach}");
    }
}
