//! Makes five balls that bounce without loss and spin, each at its own height and pace, over a still floor.
//!
//! A ball is rigid: its discs never change against each other. It turns about one fixed axis at a
//! constant rate, falls freely, and bounces at the floor without deforming.

use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};

use super::{
    disc::{Disc, epoch_of, on_disc, on_sphere, shares, sigma_of},
    options::SynthOptions,
    paint,
};
use crate::scene::{Epoch, SceneError};

const FLOOR: f64 = -1.0;
const FLOOR_RADIUS: f64 = 1.9;
const BALLS: usize = 5;
/// Units per second squared: slow enough to watch at this size.
const GRAVITY: f64 = 4.0;

struct Ball {
    radius: f64,
    /// Where it touches the floor.
    foot: DVec3,
    /// Highest clearance under it.
    height: f64,
    /// Seconds into its bounce at frame 0.
    phase: f64,
    axis: DVec3,
    /// Radians per second.
    spin: f64,
}

impl Ball {
    /// Centre at `seconds`: a parabola, repeated.
    fn centre(&self, seconds: f64) -> DVec3 {
        let half = (2.0 * self.height / GRAVITY).sqrt();
        let t = (seconds + self.phase).rem_euclid(2.0 * half) - half;
        let clearance = self.height - 0.5 * GRAVITY * t * t;
        self.foot + DVec3::Y * (self.radius + clearance.max(0.0))
    }

    fn turn(&self, seconds: f64) -> DQuat {
        DQuat::from_axis_angle(self.axis, self.spin * seconds)
    }
}

pub(super) fn make(options: &SynthOptions) -> Result<Epoch, SceneError> {
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let start = rng.random::<f64>() * std::f64::consts::TAU;
    let balls: Vec<Ball> = (0..BALLS)
        .map(|b| {
            let angle = start + b as f64 / BALLS as f64 * std::f64::consts::TAU;
            Ball {
                radius: 0.24 + 0.16 * rng.random::<f64>(),
                foot: DVec3::new(angle.cos(), 0.0, angle.sin()) * 1.05 + DVec3::Y * FLOOR,
                height: 0.6 + 1.0 * rng.random::<f64>(),
                phase: 2.0 * rng.random::<f64>(),
                axis: on_sphere((rng.random::<f64>() * 97.0) as usize, 97),
                spin: 1.5 + 2.5 * rng.random::<f64>(),
            }
        })
        .collect();
    let sphere = |r: f64| 4.0 * std::f64::consts::PI * r * r;
    let floor_area = std::f64::consts::PI * FLOOR_RADIUS * FLOOR_RADIUS;
    // The floor is plain and still; it may be coarser than the balls.
    let mut areas: Vec<f64> = balls.iter().map(|b| 2.5 * sphere(b.radius)).collect();
    areas.push(floor_area);
    let parts = shares(options.gaussians, &areas);

    let mut discs = Vec::with_capacity(options.gaussians);
    let mut owner = Vec::with_capacity(options.gaussians);
    for (b, ball) in balls.iter().enumerate() {
        let n = parts[b];
        let (main, second) = (paint::PALETTE[b % 8], paint::PALETTE[(b + 3) % 8]);
        for i in 0..n {
            let normal = on_sphere(i, n);
            discs.push(Disc {
                position: normal * ball.radius,
                normal,
                sigma: sigma_of(sphere(ball.radius), n),
                colour: paint::lit(pattern(b, normal, main, second), normal),
            });
            owner.push(b);
        }
    }
    let n = parts[BALLS];
    for i in 0..n {
        let p = on_disc(i, n) * FLOOR_RADIUS;
        let colour = paint::tiles(p.x, p.z, 0.475);
        let sigma = sigma_of(floor_area, n);
        discs.push(Disc { position: p + DVec3::Y * FLOOR, normal: DVec3::Y, sigma, colour });
        owner.push(BALLS);
    }

    epoch_of(&discs, options.frames, |frame, i, disc| {
        let seconds = frame as f64 / options.frames_per_second;
        match balls.get(owner[i]) {
            None => (disc.position, disc.rotation()),
            Some(ball) => {
                let turn = ball.turn(seconds);
                (ball.centre(seconds) + turn * disc.position, turn * disc.rotation())
            }
        }
    })
}

/// Stripes, segments, spots or bands, so that spin shows.
fn pattern(ball: usize, n: DVec3, main: [f32; 3], second: [f32; 3]) -> [f32; 3] {
    let turn = n.z.atan2(n.x) / std::f64::consts::TAU + 0.5;
    let marked = match ball % 4 {
        0 => (turn * 8.0).floor() % 2.0 == 0.0,
        1 => (n.y * 4.0).floor().rem_euclid(2.0) == 0.0,
        2 => n.x.abs().max(n.y.abs()).max(n.z.abs()) > 0.9,
        _ => ((turn * 8.0).floor() + (n.y * 3.0).floor()).rem_euclid(2.0) == 0.0,
    };
    if marked { paint::mix(main, [0.98, 0.96, 0.92], 0.85) } else { paint::mix(main, second, 0.1) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::synth::SynthKind;

    #[test]
    fn balls_are_rigid_and_stay_above_the_floor() {
        let options =
            SynthOptions { kind: SynthKind::Balls, gaussians: 3_000, frames: 40, ..SynthOptions::default() };
        let epoch = make(&options).unwrap();
        let a = epoch.attributes();
        let n = epoch.count();
        let distance = |t: usize, i: usize, j: usize| {
            let p = a.positions.frame(t, n);
            (0..3).map(|k| (p[i][k] - p[j][k]).powi(2)).sum::<f32>().sqrt()
        };
        for t in 1..40 {
            assert!((distance(t, 0, 30) - distance(0, 0, 30)).abs() < 1e-5);
            assert!(a.positions.frame(t, n).iter().all(|p| p[1] >= -1.0 - 1e-5));
        }
        let moved = (0..n).filter(|&i| a.positions.frame(0, n)[i] != a.positions.frame(20, n)[i]).count();
        assert!(moved > 1000 && moved < n, "the floor is still: {moved}");
    }
}
