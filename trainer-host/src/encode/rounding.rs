//! Rounds the canonical values of one Gaussian at a time as the writer of a `dgs1` stream does, and back:
//! what a receiver of all levels sees of them.
//!
//! Left out: Gaussians with two equal scales, whose turn in their plane the writer chooses. Training makes
//! none.
//!
//! A value over its step is a *coordinate*; coordinates are rounded to whole numbers, and how they spread
//! within a block is what they cost.

use codec_core::internals::{
    ids::Level,
    math::{mrp_from_quat, quat_from_mrp, quat_mul},
    quant::{Class, Quantiser, decorrelate, recorrelate},
    wire::manifest::Quant,
};

use super::{
    EncodeError,
    decisions::{CanonicalRotation, Dgs1Decisions, EpochDecisions, Quantisers},
    dgs1::canonical_rotation::group,
};

/// Coordinates of a Gaussian before those of its higher bands: position 3, log-scale 3, Rodrigues parameters
/// 3, opacity 1, band 0 of colour 3.
pub(crate) const PLAIN: usize = 13;
/// Class of each of them.
pub(crate) const PLAIN_CLASSES: [Class; PLAIN] = {
    let (p, s, r, c) = (Class::Position, Class::Scale, Class::Rotation, Class::Sh0);
    [p, p, p, s, s, s, r, r, r, Class::Opacity, c, c, c]
};
/// Where the classes of plain values begin.
const FIRSTS: [(Class, usize); 5] =
    [(Class::Position, 0), (Class::Scale, 3), (Class::Rotation, 6), (Class::Opacity, 9), (Class::Sh0, 10)];
/// The classes of higher bands, in the order of a Gaussian's values of them.
const BANDS: [Class; 3] = [Class::Sh1, Class::Sh2, Class::Sh3];

/// A quaternion, wxyz.
type Quat = [f32; 4];

/// Canonical values of a Gaussian at the first frame of its epoch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CanonicalValues {
    /// Scene units.
    pub position: [f32; 3],
    /// Of length 1.
    pub rotation: Quat,
    /// Natural logarithms.
    pub log_scale: [f32; 3],
    /// 0 to 1.
    pub opacity: f32,
    /// Band 0.
    pub sh0: [f32; 3],
}

/// How the Gaussians of one epoch are rounded.
#[derive(Debug)]
pub(crate) struct Rounding {
    origin: [f32; 3],
    /// Turns from the right, of which the least total turn is sent; one if rotations are sent as they are.
    turns: Vec<(Quat, [usize; 3])>,
    quants: Vec<Quant>,
    /// Per Gaussian, its quantisers and harmonic degree; none if it is not sent.
    of: Vec<Option<(usize, u8)>>,
    /// Members of each cluster in the order in which they are sent.
    clusters: Vec<Vec<u32>>,
    block_len: usize,
}

impl Rounding {
    /// That of epoch `epoch` of `decisions`, of `gaussians` Gaussians.
    ///
    /// # Errors
    /// Quantisers out of range.
    pub fn of(
        decisions: &Dgs1Decisions,
        epoch: &EpochDecisions,
        gaussians: usize,
    ) -> Result<Self, EncodeError> {
        let quants: Result<Vec<Quant>, EncodeError> =
            epoch.quantisers.iter().map(Quantisers::quant).collect();
        let mut of = vec![None; gaussians];
        for cluster in &epoch.clusters {
            for &i in &cluster.gaussians {
                if let Some(of) = of.get_mut(i as usize) {
                    *of = Some((cluster.quantisers, cluster.harmonic_degree));
                }
            }
        }
        let mut turns: Vec<(Quat, [usize; 3])> =
            group().into_iter().map(|(q, axes)| (q.map(|v| v as f32), axes)).collect();
        if epoch.canonical_rotation == CanonicalRotation::AsGiven {
            turns.truncate(1);
        }
        let known = |members: &[u32]| -> Vec<u32> {
            members.iter().copied().filter(|&i| (i as usize) < gaussians).collect()
        };
        Ok(Self {
            origin: epoch.origin,
            turns,
            quants: quants?,
            of,
            clusters: epoch.clusters.iter().map(|cluster| known(&cluster.gaussians)).collect(),
            block_len: decisions.block_len.max(1),
        })
    }

    /// The Gaussians of every block, in order.
    pub fn blocks(&self) -> impl Iterator<Item = &[u32]> {
        self.clusters.iter().flat_map(|members| members.chunks(self.block_len))
    }

    /// Quantisers and harmonic degree of Gaussian `index`, if it is sent.
    pub fn quantisers(&self, index: usize) -> Option<(&Quant, u8)> {
        let (quant, degree) = (*self.of.get(index)?)?;
        Some((self.quants.get(quant)?, degree))
    }

    /// The turn from the right that a Gaussian of `rotation` is sent with, and which old axis each new one
    /// is.
    fn turn(&self, rotation: Quat) -> (Quat, [usize; 3]) {
        let mut best = (-1.0f32, ([1.0, 0.0, 0.0, 0.0], [0, 1, 2]));
        for &(turn, axes) in &self.turns {
            let [a, b] = [rotation, turn];
            let scalar = (a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]).abs();
            if scalar > best.0 + 1e-6 {
                best = (scalar, (turn, axes));
            }
        }
        best.1
    }

    /// Plain coordinates of `values` under `quant`, and which old axis each of scale is.
    pub fn coordinates(&self, quant: &Quant, values: &CanonicalValues) -> ([f32; PLAIN], [usize; 3]) {
        let (turn, axes) = self.turn(values.rotation);
        let mut out = self.plain(values, turn, axes);
        for (class, first) in FIRSTS {
            let quantiser = &quant.canonical[class.index()];
            let own = &mut out[first..first + class.components()];
            triples(quantiser, class, own, decorrelate);
            let step = quantiser.step(Level::ALL[3]);
            own.iter_mut().for_each(|v| *v /= step);
        }
        (out, axes)
    }

    fn plain(&self, values: &CanonicalValues, turn: Quat, axes: [usize; 3]) -> [f32; PLAIN] {
        let mut out = [0.0; PLAIN];
        let mrp = mrp_from_quat(quat_mul(values.rotation, turn));
        for d in 0..3 {
            out[d] = values.position[d] - self.origin[d];
            out[3 + d] = values.log_scale[axes[d]];
            out[6 + d] = mrp[d];
            out[10 + d] = values.sh0[d];
        }
        out[9] = values.opacity;
        out
    }

    /// `values` of a Gaussian under `quant` as they are received.
    pub fn rounded(&self, quant: &Quant, values: &CanonicalValues) -> CanonicalValues {
        let (turn, axes) = self.turn(values.rotation);
        let mut all = self.plain(values, turn, axes);
        for (class, first) in FIRSTS {
            round(&quant.canonical[class.index()], class, &mut all[first..first + class.components()]);
        }
        let [w, x, y, z] = turn;
        let mut out = CanonicalValues {
            position: [0, 1, 2].map(|d| all[d] + self.origin[d]),
            rotation: quat_mul(quat_from_mrp([all[6], all[7], all[8]]), [w, -x, -y, -z]),
            log_scale: [0.0; 3],
            opacity: all[9].clamp(0.0, 1.0),
            sh0: [all[10], all[11], all[12]],
        };
        axes.iter().zip(&all[3..6]).for_each(|(&axis, &v)| out.log_scale[axis] = v);
        out
    }

    /// Rounds the higher bands `rest` of a Gaussian under `quant`; those above `degree` are not sent.
    pub fn round_rest(&self, quant: &Quant, degree: u8, rest: &mut [f32]) {
        for (class, values) in bands(rest) {
            if class.sh_degree() > degree {
                values.fill(0.0);
            } else {
                round(&quant.canonical[class.index()], class, values);
            }
        }
    }

    /// Coordinates of the higher bands `rest` of a Gaussian under `quant`, in place.
    pub fn rest_coordinates(&self, quant: &Quant, rest: &mut [f32]) {
        for (class, values) in bands(rest) {
            let quantiser = &quant.canonical[class.index()];
            triples(quantiser, class, values, decorrelate);
            let step = quantiser.step(Level::ALL[3]);
            values.iter_mut().for_each(|v| *v /= step);
        }
    }
}

/// The bands that `rest` holds.
pub(crate) fn bands(rest: &mut [f32]) -> impl Iterator<Item = (Class, &mut [f32])> {
    let mut left = rest;
    BANDS.into_iter().map_while(move |class| {
        let (own, others) = std::mem::take(&mut left).split_at_mut_checked(class.components())?;
        left = others;
        Some((class, own))
    })
}

/// Turns triples of `values` by `form` where they are sent so. It keeps lengths, so slopes by coordinates go
/// back by [`recorrelate`].
pub(crate) fn triples(
    quantiser: &Quantiser,
    class: Class,
    values: &mut [f32],
    form: impl Fn([f32; 3]) -> [f32; 3],
) {
    if quantiser.decorrelated() && class.decorrelates() {
        values.as_chunks_mut::<3>().0.iter_mut().for_each(|triple| *triple = form(*triple));
    }
}

fn round(quantiser: &Quantiser, class: Class, values: &mut [f32]) {
    let step = quantiser.step(Level::ALL[3]);
    triples(quantiser, class, values, decorrelate);
    values.iter_mut().for_each(|v| *v = quantiser.index(*v) as f32 * step);
    triples(quantiser, class, values, recorrelate);
}

#[cfg(test)]
mod tests {
    use codec_core::ShDegree;

    use super::*;
    use crate::{
        activation::sigmoid,
        encode::{Decisions, EncodeOptions, QuantiserSteps, encode, factorise::rotation_matrix},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        scene::{Attributes, Epoch, Scene, Track},
        stream::Player,
    };

    /// A scene of one frame, which motion cannot change, with colours of degree 2.
    fn scene() -> Scene {
        let options =
            synth::SynthOptions { kind: SynthKind::Figure, gaussians: 1000, frames: 1, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let epoch = &scene.epochs()[0];
        let noise = |i: usize| ((i * 7919 + 13) % 1009) as f32 / 504.5 - 1.0;
        let sh_rest = (0..24 * epoch.count()).map(|i| 0.3 * noise(i) * noise(i / 24)).collect();
        let sh_degree = ShDegree::new(2).unwrap();
        // No two axes alike: see the page.
        let uneven = |(i, s): (usize, &[f32; 3])| [0, 1, 2].map(|d| s[d] + 0.2 * noise(3 * i + d));
        let log_scales = epoch.attributes().log_scales.frame(0, epoch.count()).iter().enumerate();
        let log_scales = Track::Constant(log_scales.map(uneven).collect());
        let attributes = Attributes { sh_rest, sh_degree, log_scales, ..epoch.attributes().clone() };
        Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap()
    }

    fn values(epoch: &Epoch, i: usize) -> CanonicalValues {
        let (n, a) = (epoch.count(), epoch.attributes());
        CanonicalValues {
            position: a.positions.frame(0, n)[i],
            rotation: a.rotations.frame(0, n)[i],
            log_scale: a.log_scales.frame(0, n)[i],
            opacity: sigmoid(a.opacity_logits.frame(0, n)[i]),
            sh0: a.sh0.frame(0, n)[i],
        }
    }

    /// Equal for equal Gaussians, however their axes are named.
    fn covariance(rotation: Quat, scales: [f32; 3]) -> nalgebra::Matrix3<f64> {
        let r = rotation_matrix(rotation.map(f64::from));
        let s = scales.map(|s| f64::from(s).powi(2));
        r * nalgebra::Matrix3::from_diagonal(&s.into()) * r.transpose()
    }

    /// Largest difference, over all Gaussians and values, of what `shown` makes of them from what is
    /// received, in parts of the value's size.
    fn farthest(coarseness: f32, is_rounded: bool) -> f64 {
        let scene = scene();
        let quality = QuantiserSteps::default().scaled(coarseness);
        let options = EncodeOptions { quality, pictures: 4, ..EncodeOptions::default() };
        let encoded = encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let Decisions::Dgs1(decisions) = &encoded.decisions else { unreachable!("profile dgs1") };
        let epoch = &scene.epochs()[0];
        let rounding = Rounding::of(decisions, &decisions.epochs[0], epoch.count()).unwrap();
        let received = encoded.stream.receive().unwrap();
        let content = received.content();
        let shown = Player::new(content.manifest).instant(&content, 0).unwrap();
        let mut worst = 0.0f64;
        for (k, (g, &i)) in shown.gaussians.iter().zip(&encoded.order[0]).enumerate() {
            let i = i as usize;
            let (quant, degree) = rounding.quantisers(i).unwrap();
            let plain = values(epoch, i);
            let found = if is_rounded { rounding.rounded(quant, &plain) } else { plain };
            let mut rest = epoch.attributes().sh_rest[24 * i..][..24].to_vec();
            if is_rounded {
                rounding.round_rest(quant, degree, &mut rest);
            }
            let scales = found.log_scale.map(f32::exp);
            let (a, b) = (covariance(found.rotation, scales), covariance(g.rotation, g.scale));
            worst = worst.max((a - b).norm() / b.norm()).max(f64::from((found.opacity - g.opacity).abs()));
            for d in 0..3 {
                let size = f64::from(g.scale[d].max(1e-3));
                worst = worst.max(f64::from((found.position[d] - g.position[d]).abs()) / size);
                worst = worst.max(f64::from((found.sh0[d] - g.sh0[d]).abs()));
            }
            for (a, b) in rest.iter().zip(&shown.sh_rest[24 * k..][..24]) {
                worst = worst.max(f64::from((a - b).abs()));
            }
        }
        worst
    }

    #[test]
    fn rounded_values_are_those_that_are_received() {
        for coarseness in [1.0, 4.0] {
            let worst = farthest(coarseness, true);
            assert!(worst < 1e-3, "coarseness {coarseness}: {worst}");
        }
        // The comparison tells rounded values from others.
        assert!(farthest(4.0, false) > 0.05);
    }

    #[test]
    fn coordinates_round_to_the_indices_that_are_sent() {
        let scene = scene();
        let encoded = encode(&scene, &EncodeOptions::default(), &crate::encode::no_progress).unwrap();
        let Decisions::Dgs1(decisions) = &encoded.decisions else { unreachable!("profile dgs1") };
        let epoch = &scene.epochs()[0];
        let rounding = Rounding::of(decisions, &decisions.epochs[0], epoch.count()).unwrap();
        assert_eq!(rounding.blocks().flatten().count(), encoded.order[0].len());
        for i in [0, 5, 333] {
            let (quant, _) = rounding.quantisers(i).unwrap();
            let plain = values(epoch, i);
            let (all, _) = rounding.coordinates(quant, &plain);
            let (again, _) = rounding.coordinates(quant, &rounding.rounded(quant, &plain));
            // What is rounded once stays: opacities apart, which are clamped.
            for k in (0..6).chain(10..13) {
                assert!((again[k] - all[k].round()).abs() < 0.02, "{i} {k}: {} {}", all[k], again[k]);
            }
        }
    }
}
