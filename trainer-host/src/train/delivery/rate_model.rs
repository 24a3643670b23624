//! Estimates the bits of a scene's canonical values under the encoder's quantisers, and their slope by
//! parameters.
//!
//! Per cluster and component one distribution (see `rate`): what entropy tables come to when each cluster may
//! choose among them. Motion keeps its bits, since it is not trained; what prediction and mixing of
//! components save is not counted, so this is a bound of its shape and not the size of the stream.

use codec_core::internals::{math::mrp_from_quat, quant::Class};
use glam::Quat;

use super::{
    parameters::{COMPONENTS, Parameters, Values},
    rate::Laplace,
};
use crate::{
    encode::{
        Decisions,
        decisions::{QuantiserDecision, Quantisers},
    },
    scene::{Epoch, Scene, activation::sigmoid},
};

/// Quantised values of a Gaussian: position 3, log-scale 3, Rodrigues parameters 3, opacity 1, band 0 of
/// colour 3.
type Quantised = [f64; COMPONENTS];

/// Classes that the values belong to, and how many of each.
const CLASSES: [(Class, usize); 5] =
    [(Class::Position, 3), (Class::Scale, 3), (Class::Rotation, 3), (Class::Opacity, 1), (Class::Sh0, 3)];

/// Step of the differences by which slopes of values by parameters are measured.
const DIFFERENCE: f32 = 1e-3;

/// Distributions of the values of one cluster.
struct ClusterModel {
    epoch: usize,
    members: Vec<u32>,
    models: [Laplace; COMPONENTS],
}

/// Distributions of a scene's values.
pub(super) struct RateModel {
    clusters: Vec<ClusterModel>,
    gaussians: f64,
}

impl RateModel {
    /// The distributions of `source` with `parameters`, in the clusters and steps of `decisions`.
    pub(super) fn of(source: &Scene, parameters: &Parameters, decisions: &Decisions) -> Self {
        let mut clusters = Vec::new();
        for (e, epoch) in source.epochs().iter().enumerate() {
            for (members, quantisers) in clusters_of(decisions, e) {
                let own = parameters.epoch(e);
                let all: Vec<Quantised> =
                    members.iter().map(|&i| quantised(epoch, i as usize, &own[i as usize])).collect();
                let steps = steps(quantisers);
                let models = std::array::from_fn(|c| Laplace::of(all.iter().map(|v| v[c]), steps[c]));
                clusters.push(ClusterModel { epoch: e, members: members.to_vec(), models });
            }
        }
        let gaussians = clusters.iter().map(|c| c.members.len()).sum::<usize>().max(1) as f64;
        Self { clusters, gaussians }
    }

    /// Kilobits per Gaussian; `weight` times the gradient goes to `gradient`, one entry per source Gaussian.
    pub(super) fn differentiate(
        &self,
        source: &Scene,
        parameters: &Parameters,
        weight: f64,
        gradient: &mut [[f64; COMPONENTS]],
    ) -> f64 {
        let unit = 1.0 / (1000.0 * self.gaussians);
        let mut total = 0.0;
        for cluster in &self.clusters {
            let (first, own) = (parameters.first_of(cluster.epoch), parameters.epoch(cluster.epoch));
            let Some(epoch) = source.epochs().get(cluster.epoch) else { continue };
            for &i in &cluster.members {
                let (i, values) = (i as usize, &own[i as usize]);
                let here = quantised(epoch, i, values);
                let mut slopes = [0.0; COMPONENTS];
                for ((model, value), slope) in cluster.models.iter().zip(here).zip(&mut slopes) {
                    let (bits, by) = model.bits(value);
                    total += unit * bits;
                    *slope = unit * by;
                }
                for (c, sum) in gradient[first + i].iter_mut().enumerate() {
                    let at = |h: f32| {
                        let mut moved = *values;
                        moved[c] += h;
                        quantised(epoch, i, &moved)
                    };
                    let (up, down) = (at(DIFFERENCE), at(-DIFFERENCE));
                    let by: f64 = (0..COMPONENTS).map(|k| slopes[k] * (up[k] - down[k])).sum();
                    *sum += weight * by / f64::from(2.0 * DIFFERENCE);
                }
            }
        }
        total
    }
}

/// The clusters of epoch `epoch` and their quantisers.
fn clusters_of(decisions: &Decisions, epoch: usize) -> Vec<(&[u32], &Quantisers)> {
    match decisions {
        Decisions::Dgs1(all) => all.epochs.get(epoch).map_or(Vec::new(), |epoch| {
            let of = |c: &'_ crate::encode::decisions::ClusterDecisions| c.quantisers;
            epoch.clusters.iter().map(|c| (c.gaussians.as_slice(), &epoch.quantisers[of(c)])).collect()
        }),
        Decisions::Paper(all) => all.epochs.get(epoch).map_or(Vec::new(), |epoch| {
            epoch.clusters.iter().map(|c| (c.as_slice(), &epoch.quantisers)).collect()
        }),
    }
}

/// Finest step of each component.
fn steps(quantisers: &Quantisers) -> [f64; COMPONENTS] {
    let mut classes = CLASSES.iter().flat_map(|&(class, count)| std::iter::repeat_n(class, count));
    std::array::from_fn(|_| {
        let class = classes.next().unwrap_or(Class::Sh0);
        let QuantiserDecision { step, .. } = quantisers.canonical[class.index()];
        f64::from(step)
    })
}

/// What is quantised of Gaussian `i` with parameters `values`: frame 0, as the scene would hold it.
fn quantised(epoch: &Epoch, i: usize, values: &Values) -> Quantised {
    let (n, a) = (epoch.count(), epoch.attributes());
    let (scale, q) = (a.log_scales.frame(0, n)[i], a.rotations.frame(0, n)[i]);
    let rotation = Quat::from_xyzw(q[1], q[2], q[3], q[0]);
    let size = (scale.iter().sum::<f32>() / 3.0).exp();
    let offset = rotation * (size * glam::Vec3::new(values[0], values[1], values[2]));
    let turned = rotation * Quat::from_scaled_axis(glam::Vec3::new(values[6], values[7], values[8]));
    let mrp = mrp_from_quat([turned.w, turned.x, turned.y, turned.z]);
    let (p, c) = (a.positions.frame(0, n)[i], a.sh0.frame(0, n)[i]);
    let opacity = sigmoid(a.opacity_logits.frame(0, n)[i] + values[9]);
    let parts = [
        [p[0] + offset.x, p[1] + offset.y, p[2] + offset.z],
        [0, 1, 2].map(|d| scale[d] + values[3 + d]),
        mrp,
    ];
    let mut out = [0.0; COMPONENTS];
    out.iter_mut().zip(parts.as_flattened()).for_each(|(out, &v)| *out = f64::from(v));
    out[9] = f64::from(opacity);
    (0..3).for_each(|d| out[10 + d] = f64::from(c[d] + values[10 + d]));
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode,
        train::delivery::{coded::no_change, view::tests::study},
    };

    #[test]
    fn finer_steps_cost_more_and_the_gradient_is_a_difference() {
        let (scene, _) = study(2, 1);
        let decided = |quality: encode::QuantiserSteps| {
            let options = encode::EncodeOptions { pictures: 0, quality, ..Default::default() };
            encode::encode(&scene, &options, &crate::encode::no_progress).unwrap()
        };
        let (fine, coarse) = (
            decided(encode::QuantiserSteps::default()),
            decided(encode::QuantiserSteps::default().scaled(4.0)),
        );
        let mut parameters = no_change(&scene);
        parameters.all_mut().enumerate().for_each(|(i, values)| {
            *values = std::array::from_fn(|c| 0.05 * (((i * 31 + c * 17) % 19) as f32 / 9.0 - 1.0));
        });
        let count = parameters.count();
        let value = |encoded: &encode::Encoded| {
            let model = RateModel::of(&scene, &parameters, &encoded.decisions);
            model.differentiate(&scene, &parameters, 1.0, &mut vec![[0.0; COMPONENTS]; count])
        };
        let (bits, fewer) = (value(&fine), value(&coarse));
        assert!(bits > fewer + 0.01, "{bits} {fewer}");
        // Two bits for each of 13 values at four times the step, less where cells hold almost everything.
        assert!(bits - fewer < 0.026 + 1e-6, "{bits} {fewer}");

        let model = RateModel::of(&scene, &parameters, &fine.decisions);
        let mut gradient = vec![[0.0; COMPONENTS]; count];
        model.differentiate(&scene, &parameters, 1.0, &mut gradient);
        let at = |h: f32| {
            let mut moved = parameters.clone();
            moved.all_mut().enumerate().for_each(|(i, values)| values[i % COMPONENTS] += h);
            model.differentiate(&scene, &moved, 0.0, &mut vec![[0.0; COMPONENTS]; count])
        };
        let numeric = (at(2e-3) - at(-2e-3)) / 4e-3;
        let found: f64 = gradient.iter().enumerate().map(|(i, g)| g[i % COMPONENTS]).sum();
        assert!((found - numeric).abs() < 0.05 * numeric.abs(), "{found} {numeric}");
    }
}
