//! Quantises a scene on uniform grids: what the order-0 and the adaptive peer code.
//!
//! Every attribute component is a plane of integers, frame by frame, or one frame if it does not change.
//! Gaussians stand in Morton order of their first frame. What is coded are residuals: of a key frame
//! against the Gaussian before, if that pays; of later frames against the frame before, or against the
//! line through the two frames before, whichever pays. All of it is undone exactly.

use anyhow::Result;
use codec_core::{
    Gaussian,
    internals::{
        gaussian::ShDegree,
        math::{mrp_from_quat, normalised, quat_from_mrp},
    },
};
use trainer_host::{Epoch, Instant, Scene, activation::sigmoid, encode::QuantiserSteps};

/// Attributes, the unit of a model; each of the harmonic bands above 0 is one.
pub const ATTRIBUTES: usize = 8;

/// One component of one attribute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plane {
    /// Place of its attribute: position, scale, rotation, opacity, band 0, bands 1 to 3.
    pub attribute: usize,
    /// Frames stored: 1, or all of the epoch.
    pub frames: usize,
    /// Grid indices, frame-major.
    pub values: Vec<i32>,
}

/// One epoch on its grids.
#[derive(Clone, Debug, PartialEq)]
pub struct Grids {
    /// Number of Gaussians.
    pub count: usize,
    frames: usize,
    degree: ShDegree,
    steps: [f32; ATTRIBUTES],
    origin: [f32; 3],
    /// In the order of [`Grids::components`].
    pub planes: Vec<Plane>,
}

/// Bytes that describe an epoch's grids: counts, steps, origin.
pub const HEADER_BYTES: usize = 4 + 4 + 1 + 4 * ATTRIBUTES + 12;

/// Bits of a plane's predictor, stored as one byte.
const NEIGHBOUR: u8 = 1;
const LINE: u8 = 2;

impl Grids {
    /// `epoch` on grids of `quality`.
    pub fn of(epoch: &Epoch, quality: &QuantiserSteps) -> Self {
        let (n, frames, a) = (epoch.count(), epoch.frames(), epoch.attributes());
        let mut sizes: Vec<f32> =
            a.log_scales.frame(0, n).iter().map(|s| s.iter().sum::<f32>() / 3.0).collect();
        sizes.sort_unstable_by(f32::total_cmp);
        let size = sizes.get(n / 2).map_or(1.0, |s| s.exp());
        let first = a.positions.frame(0, n);
        let origin = [0, 1, 2].map(|d| first.iter().fold(f32::INFINITY, |m, p| m.min(p[d])).min(1e30));
        let steps = [
            (quality.position * size).max(1e-9),
            quality.scale,
            quality.rotation,
            quality.opacity,
            quality.sh0,
            quality.sh_rest,
            quality.sh_rest,
            quality.sh_rest,
        ];
        let all: Vec<u32> = (0..n as u32).collect();
        let order = morton_order(&all, first);
        let mut grids = Self { count: n, frames, degree: a.sh_degree, steps, origin, planes: Vec::new() };
        let rest = a.sh_degree.rest_len();
        let constant = [
            a.positions.is_constant(),
            a.log_scales.is_constant(),
            a.rotations.is_constant(),
            a.opacity_logits.is_constant(),
            a.sh0.is_constant(),
        ];
        for (attribute, component) in grids.components() {
            let stored = if constant.get(attribute).copied().unwrap_or(true) { 1 } else { frames };
            let mut values = Vec::with_capacity(n * stored);
            for t in 0..stored {
                values.extend(order.iter().map(|&i| {
                    let i = i as usize;
                    let value = match attribute {
                        0 => a.positions.frame(t, n)[i][component] - origin[component],
                        1 => a.log_scales.frame(t, n)[i][component],
                        2 => mrp_from_quat(a.rotations.frame(t, n)[i])[component],
                        3 => sigmoid(a.opacity_logits.frame(t, n)[i]),
                        4 => a.sh0.frame(t, n)[i][component],
                        _ => a.sh_rest[i * rest + component],
                    };
                    (value / steps[attribute]).round() as i32
                }));
            }
            grids.planes.push(Plane { attribute, frames: stored, values });
        }
        grids
    }

    /// Attribute and component of every plane; components of the higher bands are places in `sh_rest`.
    fn components(&self) -> Vec<(usize, usize)> {
        let three = |attribute: usize| (0..3).map(move |d| (attribute, d));
        let band = |c: usize| {
            if c < 9 {
                5
            } else if c < 24 {
                6
            } else {
                7
            }
        };
        let rest = (0..self.degree.rest_len()).map(|c| (band(c), c));
        three(0).chain(three(1)).chain(three(2)).chain([(3, 0)]).chain(three(4)).chain(rest).collect()
    }

    /// Frame `t` of the epoch, reconstructed from the grids.
    pub fn instant(&self, t: usize) -> Instant {
        let n = self.count;
        let value = |plane: usize, i: usize| {
            let plane = &self.planes[plane];
            let t = if plane.frames == 1 { 0 } else { t };
            plane.values[t * n + i] as f32 * self.steps[plane.attribute]
        };
        let gaussians = (0..n)
            .map(|i| Gaussian {
                position: [0, 1, 2].map(|d| value(d, i) + self.origin[d]),
                scale: [0, 1, 2].map(|d| value(3 + d, i).exp()),
                rotation: normalised(quat_from_mrp([0, 1, 2].map(|d| value(6 + d, i)))),
                opacity: value(9, i).clamp(0.0, 1.0),
                sh0: [0, 1, 2].map(|d| value(10 + d, i)),
            })
            .collect();
        let rest = self.degree.rest_len();
        let sh_rest = (0..n * rest).map(|k| value(13 + k % rest, k / rest)).collect();
        Instant { gaussians, sh_rest, sh_degree: self.degree }
    }

    /// The same grids with nothing on them: what a decoder knows after the header.
    pub fn emptied(&self) -> Self {
        let planes =
            self.planes.iter().map(|p| Plane { values: vec![0; p.values.len()], ..p.clone() }).collect();
        Self { planes, ..self.clone() }
    }
}

impl Plane {
    /// Turns grid indices into residuals; returns how, as one byte.
    pub fn predict(&mut self, n: usize) -> u8 {
        let cost = |v: i32| (1.0 + 2.0 * f64::from(v.unsigned_abs())).log2();
        let v = &self.values;
        let total = |f: &dyn Fn(usize) -> i32, range: std::ops::Range<usize>| -> f64 {
            range.map(|i| cost(v[i].wrapping_sub(f(i)))).sum()
        };
        let before = |i: usize| if i == 0 { 0 } else { v[i - 1] };
        let mut how = 0;
        if total(&before, 0..n) < total(&|_| 0, 0..n) {
            how |= NEIGHBOUR;
        }
        let late = 2 * n..v.len();
        if total(&|i| line(v[i - n], v[i - 2 * n]), late.clone()) < total(&|i| v[i - n], late) {
            how |= LINE;
        }
        for i in (0..v.len()).rev() {
            self.values[i] = self.values[i].wrapping_sub(self.prediction(i, n, how));
        }
        how
    }

    /// Undoes [`Plane::predict`].
    pub fn restore(&mut self, n: usize, how: u8) {
        for i in 0..self.values.len() {
            self.values[i] = self.values[i].wrapping_add(self.prediction(i, n, how));
        }
    }

    fn prediction(&self, i: usize, n: usize, how: u8) -> i32 {
        match i / n {
            0 if how & NEIGHBOUR != 0 && i > 0 => self.values[i - 1],
            0 => 0,
            1 => self.values[i - n],
            _ if how & LINE != 0 => line(self.values[i - n], self.values[i - 2 * n]),
            _ => self.values[i - n],
        }
    }
}

fn line(last: i32, before: i32) -> i32 {
    last.wrapping_mul(2).wrapping_sub(before)
}

/// All epochs of `scene` on grids of `quality`.
pub fn grids(scene: &Scene, quality: &QuantiserSteps) -> Vec<Grids> {
    scene.epochs().iter().map(|e| Grids::of(e, quality)).collect()
}

/// Reconstructs every frame and drops it: what a decoder is timed for.
pub fn reconstruct_all(grids: &[Grids]) {
    for epoch in grids {
        (0..epoch.frames).for_each(|t| drop(std::hint::black_box(epoch.instant(t))));
    }
}

/// Reconstructs scene frames `shown` from the epochs' grids.
///
/// # Errors
/// A frame past the end.
pub fn instants(scene: &Scene, grids: &[Grids], shown: &[u32]) -> Result<Vec<Instant>> {
    let at = |&frame: &u32| {
        let (epoch, t) = scene.locate(frame as usize).ok_or_else(|| anyhow::anyhow!("no frame {frame}"))?;
        Ok(grids[epoch].instant(t))
    };
    shown.iter().map(at).collect()
}

/// `indices` along the Morton curve of their positions, ties by index: the order in which peers code.
pub fn morton_order(indices: &[u32], positions: &[[f32; 3]]) -> Vec<u32> {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for &i in indices {
        for d in 0..3 {
            low[d] = low[d].min(positions[i as usize][d]);
            high[d] = high[d].max(positions[i as usize][d]);
        }
    }
    let extent = (0..3).map(|d| high[d] - low[d]).fold(0.0f32, f32::max).max(1e-20);
    let code = |i: u32| {
        let mut code = 0u64;
        for d in 0..3 {
            let cell = ((positions[i as usize][d] - low[d]) / extent * 1_048_575.0) as u64;
            for bit in 0..20 {
                code |= (cell >> bit & 1) << (3 * bit + d as u64);
            }
        }
        code
    };
    let mut order = indices.to_vec();
    order.sort_by_cached_key(|&i| (code(i), i));
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::setup::synth;

    #[test]
    fn residuals_are_undone_and_smaller() {
        let scene = synth("figure", 1000, 6).unwrap();
        let grids = Grids::of(&scene.epochs()[0], &QuantiserSteps::default());
        let size = |p: &Plane| p.values.iter().map(|v| f64::from(v.unsigned_abs())).sum::<f64>();
        for plane in &grids.planes {
            let mut coded = plane.clone();
            let how = coded.predict(grids.count);
            assert!(size(&coded) <= size(plane) + 1.0, "attribute {}", plane.attribute);
            coded.restore(grids.count, how);
            assert_eq!(&coded, plane);
        }
    }

    #[test]
    fn grids_hold_every_value_to_half_a_step() {
        let scene = synth("balls", 1000, 5).unwrap();
        let epoch = &scene.epochs()[0];
        let grids = Grids::of(epoch, &QuantiserSteps::default());
        let order = morton_order(&(0..1000).collect::<Vec<_>>(), epoch.attributes().positions.frame(0, 1000));
        for t in [0, 4] {
            let (got, source) = (grids.instant(t), epoch.instant(t));
            for (g, &i) in got.gaussians.iter().zip(&order) {
                let s = &source.gaussians[i as usize];
                for d in 0..3 {
                    assert!((g.position[d] - s.position[d]).abs() <= 0.51 * grids.steps[0]);
                    assert!((g.sh0[d] - s.sh0[d]).abs() <= 0.51 * grids.steps[4]);
                }
                assert!((g.opacity - s.opacity).abs() <= 0.51 * grids.steps[3]);
                let dot: f32 = g.rotation.iter().zip(s.rotation).map(|(a, b)| a * b).sum();
                assert!(dot.abs() > 0.999);
            }
        }
    }
}
