//! Holds what is trained of each Gaussian, and moves scenes, decoded Gaussians and gradients by it.
//!
//! A Gaussian has 13 parameters, all 0 for the source scene: its centre in units of its own size and its
//! turn, both in its own axes so that they follow its motion; its three log-scales; its opacity logit; its
//! colour. Higher harmonic bands and motion stay as they are. A block's proxy, which stands in for it until
//! its base arrives, has eight parameters more.

use codec_core::Gaussian;
use glam::{Quat, Vec3};
use render_host::adjoint::SplatGradient;

use crate::{
    encode::decisions::ProxyChange,
    scene::{
        Attributes, Epoch, Scene, SceneError, Track,
        activation::{logit, sigmoid},
    },
};

/// Parameters of a Gaussian: centre 3, log-scale 3, turn 3 (radians), opacity logit, band 0 of colour 3.
pub(super) const COMPONENTS: usize = 13;
pub(super) const SCALE: usize = 3;
pub(super) const TURN: usize = 6;
pub(super) const OPACITY: usize = 9;
pub(super) const COLOUR: usize = 10;

/// The 13 parameters of one Gaussian.
pub(super) type Values = [f32; COMPONENTS];

/// Parameters of all Gaussians of a scene, and of the proxies of its blocks where they are trained.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) struct Parameters {
    /// Gaussians, epoch by epoch; then proxies in the same way.
    epochs: Vec<Vec<Values>>,
    /// Per epoch and block, the size of its proxy as it was first sent, scene units; empty if none is
    /// trained.
    proxy_sizes: Vec<Vec<f32>>,
}

impl Parameters {
    /// Those of the source scene, whose epochs have `counts` Gaussians.
    pub(super) fn zeros(counts: &[usize]) -> Self {
        let epochs = counts.iter().map(|&n| vec![[0.0; COMPONENTS]; n]).collect();
        Self { epochs, proxy_sizes: Vec::new() }
    }

    /// With proxies of `sizes`, scene units, epoch by epoch, unchanged.
    #[must_use]
    pub(super) fn with_proxies(mut self, sizes: Vec<Vec<f32>>) -> Self {
        self.epochs.extend(sizes.iter().map(|sizes| vec![[0.0; COMPONENTS]; sizes.len()]));
        self.proxy_sizes = sizes;
        self
    }

    /// Sizes of the proxies of epoch `epoch`, scene units; none if none is trained.
    pub(super) fn proxy_sizes(&self, epoch: usize) -> &[f32] {
        self.proxy_sizes.get(epoch).map_or(&[], Vec::as_slice)
    }

    /// Where the proxies of epoch `epoch` are, as an epoch.
    pub(super) fn proxies_of(&self, epoch: usize) -> usize {
        self.epochs.len() - self.proxy_sizes.len() + epoch
    }

    /// What is added to the proxies of epoch `epoch`; none if none is trained.
    pub(super) fn proxy_changes(&self, epoch: usize) -> Vec<ProxyChange> {
        let sizes = self.proxy_sizes(epoch);
        let change = |(values, &size): (&Values, &f32)| proxy_change(values, size);
        self.epoch(self.proxies_of(epoch)).iter().zip(sizes).map(change).collect()
    }

    /// Those of epoch `epoch`; none if there is no such epoch.
    pub(super) fn epoch(&self, epoch: usize) -> &[Values] {
        self.epochs.get(epoch).map_or(&[], Vec::as_slice)
    }

    /// All, epoch after epoch.
    pub(super) fn all_mut(&mut self) -> impl Iterator<Item = &mut Values> {
        self.epochs.iter_mut().flatten()
    }

    /// Number of Gaussians in the epochs before `epoch`.
    pub(super) fn first_of(&self, epoch: usize) -> usize {
        self.epochs.iter().take(epoch).map(Vec::len).sum()
    }

    /// Number of Gaussians in all epochs.
    pub(super) fn count(&self) -> usize {
        self.epochs.iter().map(Vec::len).sum()
    }

    /// Whether they are parameters of what `other` are parameters of, and numbers.
    pub(super) fn is_like(&self, other: &Self) -> bool {
        let same_counts = self.epochs.iter().map(Vec::len).eq(other.epochs.iter().map(Vec::len));
        let finite = self.epochs.iter().flatten().flatten().all(|value| value.is_finite());
        same_counts && finite && self.proxy_sizes == other.proxy_sizes
    }

    /// `source` with these parameters.
    ///
    /// # Errors
    /// A parameter that is not finite.
    pub(super) fn applied(&self, source: &Scene) -> Result<Scene, SceneError> {
        // What is behind the epochs' Gaussians are proxies.
        let epochs = source.epochs().iter().zip(&self.epochs);
        let epochs: Result<Vec<Epoch>, SceneError> =
            epochs.map(|(epoch, values)| moved_epoch(epoch, values)).collect();
        let mut scene = Scene::new(epochs?, source.frames_per_second())?;
        (scene.up, scene.footprint) = (source.up, source.footprint);
        scene.cameras.clone_from(&source.cameras);
        scene.notes.clone_from(&source.notes);
        Ok(scene)
    }
}

fn moved_epoch(epoch: &Epoch, values: &[Values]) -> Result<Epoch, SceneError> {
    let (n, a) = (epoch.count(), epoch.attributes());
    let frames = 0..epoch.frames();
    let positions = match &a.positions {
        // Where Gaussians turn in place, an offset in their own axes moves them too.
        Track::Constant(_) if a.rotations.is_constant() => Track::Constant(positions_at(epoch, values, 0)),
        _ => Track::PerFrame(frames.flat_map(|t| positions_at(epoch, values, t)).collect()),
    };
    let each = |i: usize| &values[i % n.max(1)];
    let attributes = Attributes {
        positions,
        rotations: mapped(&a.rotations, |i, q| {
            let turned = quat(q) * turn(each(i));
            [turned.w, turned.x, turned.y, turned.z]
        }),
        log_scales: mapped(&a.log_scales, |i, s| [0, 1, 2].map(|d| s[d] + each(i)[SCALE + d])),
        opacity_logits: mapped(&a.opacity_logits, |i, o| o + each(i)[OPACITY]),
        sh0: mapped(&a.sh0, |i, c| [0, 1, 2].map(|d| c[d] + each(i)[COLOUR + d])),
        sh_rest: a.sh_rest.clone(),
        sh_degree: a.sh_degree,
    };
    Epoch::new(epoch.frames(), attributes)
}

fn positions_at(epoch: &Epoch, values: &[Values], t: usize) -> Vec<[f32; 3]> {
    let n = epoch.count();
    let positions = epoch.attributes().positions.frame(t, n);
    let place = |(i, p): (usize, &[f32; 3])| {
        let anchor = Anchor::of(epoch, i, t);
        (Vec3::from_array(*p) + anchor.offset(&values[i])).to_array()
    };
    positions.iter().enumerate().map(place).collect()
}

fn mapped<T: Copy>(track: &Track<T>, change: impl Fn(usize, T) -> T) -> Track<T> {
    let change = |values: &[T]| values.iter().enumerate().map(|(i, &v)| change(i, v)).collect();
    match track {
        Track::Constant(values) => Track::Constant(change(values)),
        Track::PerFrame(values) => Track::PerFrame(change(values)),
    }
}

fn quat([w, x, y, z]: [f32; 4]) -> Quat {
    Quat::from_xyzw(x, y, z, w)
}

fn turn(values: &Values) -> Quat {
    Quat::from_scaled_axis(Vec3::from_slice(&values[TURN..TURN + 3]))
}

/// A proxy has fewer parameters: its centre along the world's axes in units of its size, one log-scale for
/// all axes, its linear opacity, its colour.
fn proxy_change(values: &Values, size: f32) -> ProxyChange {
    ProxyChange {
        offset: [0, 1, 2].map(|d| size * values[d]),
        log_scale: values[SCALE],
        opacity: values[OPACITY],
        sh0: [0, 1, 2].map(|d| values[COLOUR + d]),
    }
}

/// What decoded Gaussians follow: parameters of their own, or those of a block's proxy.
#[derive(Clone, Copy, Debug)]
pub(super) enum Follows {
    /// How its source stands, and which source axis each of its axes is.
    Source(Anchor, [u8; 3]),
    /// A proxy of this size as it was first sent, scene units.
    Proxy(f32),
}

impl Follows {
    /// `decoded` moved by a `change` of its parameters.
    pub(super) fn moved(&self, decoded: &Gaussian, change: &Values) -> Gaussian {
        match *self {
            Self::Source(anchor, axes) => anchor.moved(decoded, axes, change),
            Self::Proxy(size) => {
                let change = proxy_change(change, size);
                let mut out = *decoded;
                (0..3).for_each(|d| out.position[d] += change.offset[d]);
                out.scale = out.scale.map(|s| s * change.log_scale.exp());
                out.opacity = (out.opacity + change.opacity).clamp(0.0, 1.0);
                (0..3).for_each(|d| out.sh0[d] += change.sh0[d]);
                out
            }
        }
    }

    /// The gradient of its parameters that the gradient `by` of `decoded` is.
    pub(super) fn pulled(&self, by: &SplatGradient, decoded: &Gaussian) -> Values {
        match *self {
            Self::Source(anchor, axes) => anchor.pulled(by, decoded, axes),
            Self::Proxy(size) => {
                let mut out = [0.0; COMPONENTS];
                (0..3).for_each(|d| out[d] = size * by.position[d]);
                out[SCALE] = by.log_scale.iter().sum();
                let opacity = decoded.opacity;
                if opacity > 0.0 && opacity < 1.0 {
                    out[OPACITY] = by.opacity_logit / (opacity * (1.0 - opacity));
                }
                out[COLOUR..].copy_from_slice(&by.sh0);
                out
            }
        }
    }
}

/// How a source Gaussian stands at a frame: what carries its parameters to the world.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anchor {
    /// Its rotation at the frame.
    rotation: Quat,
    /// Its size at frame 0, the geometric mean of its axes, scene units.
    size: f32,
}

impl Anchor {
    /// Gaussian `i` of `epoch` at frame `t`.
    pub(super) fn of(epoch: &Epoch, i: usize, t: usize) -> Self {
        let (n, a) = (epoch.count(), epoch.attributes());
        let size = (a.log_scales.frame(0, n)[i].iter().sum::<f32>() / 3.0).exp();
        Self { rotation: quat(a.rotations.frame(t, n)[i]), size }
    }

    /// What `values` add to its centre, scene units.
    fn offset(&self, values: &Values) -> Vec3 {
        self.rotation * (self.size * Vec3::from_slice(&values[..3]))
    }

    /// `decoded` moved by a `change` of its parameters; its axis `k` is axis `axes[k]` of the source.
    pub(super) fn moved(&self, decoded: &Gaussian, axes: [u8; 3], change: &Values) -> Gaussian {
        if change.iter().all(|&v| v == 0.0) {
            return *decoded;
        }
        let mut out = *decoded;
        out.position = (Vec3::from_array(decoded.position) + self.offset(change)).to_array();
        for (scale, axis) in out.scale.iter_mut().zip(axes) {
            *scale *= change[SCALE + usize::from(axis)].exp();
        }
        let about = Quat::from_scaled_axis(self.rotation * Vec3::from_slice(&change[TURN..TURN + 3]));
        let turned = about * quat(decoded.rotation);
        out.rotation = [turned.w, turned.x, turned.y, turned.z];
        let opacity = decoded.opacity.clamp(1e-6, 1.0 - 1e-6);
        out.opacity = sigmoid(logit(opacity) + change[OPACITY]);
        (0..3).for_each(|d| out.sh0[d] += change[COLOUR + d]);
        out
    }

    /// The gradient of its parameters that the gradient `by` of `decoded` is.
    fn pulled(&self, by: &SplatGradient, decoded: &Gaussian, axes: [u8; 3]) -> Values {
        let mut out = [0.0; COMPONENTS];
        let centre = self.size * (self.rotation.conjugate() * Vec3::from_array(by.position));
        out[..3].copy_from_slice(&centre.to_array());
        for (slope, axis) in by.log_scale.iter().zip(axes) {
            out[SCALE + usize::from(axis)] += slope;
        }
        // A turn by ω in the world changes a quaternion q by ω ⊗ q / 2.
        let q = quat(decoded.rotation);
        let world = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| {
            let change = Quat::from_xyzw(axis.x, axis.y, axis.z, 0.0) * q;
            let [w, x, y, z] = by.rotation;
            0.5 * (w * change.w + x * change.x + y * change.y + z * change.z)
        });
        let own = self.rotation.conjugate() * Vec3::from_array(world);
        out[TURN..TURN + 3].copy_from_slice(&own.to_array());
        out[OPACITY] = by.opacity_logit;
        out[COLOUR..].copy_from_slice(&by.sh0);
        out
    }

    /// What `decoded` is off by from `intended`, whose axis `axes[k]` is axis `k` of `decoded`: the
    /// parameters that would make the one of the other, to first order. A turn that is no small one counts as
    /// none.
    pub(super) fn error(&self, intended: &Gaussian, decoded: &Gaussian, axes: [u8; 3]) -> Values {
        let mut out = [0.0; COMPONENTS];
        let (from, to) = (quat(intended.rotation), quat(decoded.rotation));
        let off = Vec3::from_array(decoded.position) - Vec3::from_array(intended.position);
        out[..SCALE].copy_from_slice(&(from.conjugate() * off / self.size).to_array());
        let mut turn = Vec3::ZERO;
        for (k, axis) in axes.into_iter().map(usize::from).enumerate() {
            out[SCALE + axis] = (decoded.scale[k] / intended.scale[axis]).ln();
            let (was, is) = (from * Vec3::AXES[axis], to * Vec3::AXES[k]);
            turn += 0.5 * was.cross(is * was.dot(is).signum());
        }
        if turn.length() < 0.5 {
            out[TURN..OPACITY].copy_from_slice(&(from.conjugate() * turn).to_array());
        }
        // Opacity is quantised as it is, its parameter is a logit.
        let opacity = decoded.opacity.clamp(1e-6, 1.0 - 1e-6);
        out[OPACITY] = (decoded.opacity - intended.opacity) / (opacity * (1.0 - opacity));
        (0..3).for_each(|d| out[COLOUR + d] = decoded.sh0[d] - intended.sh0[d]);
        out
    }

    /// Which axis of the source each axis of `decoded` is: codecs may name the axes of a Gaussian anew.
    pub(super) fn axes(&self, decoded: &Gaussian) -> [u8; 3] {
        let to_source = self.rotation.conjugate() * quat(decoded.rotation);
        let columns = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| (to_source * axis).abs().to_array());
        // The largest share first; each axis is taken once.
        let mut pairs: Vec<(usize, usize)> = (0..9).map(|k| (k / 3, k % 3)).collect();
        pairs.sort_by(|a, b| columns[b.0][b.1].total_cmp(&columns[a.0][a.1]).then(a.cmp(b)));
        let (mut axes, mut taken) = ([None; 3], [false; 3]);
        for (decoded, source) in pairs {
            if axes[decoded].is_none() && !taken[source] {
                (axes[decoded], taken[source]) = (Some(source as u8), true);
            }
        }
        axes.map(|axis| axis.unwrap_or(0))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::import::{
        Limits,
        synth::{self, SynthKind},
    };

    fn scene() -> Scene {
        let options =
            synth::SynthOptions { gaussians: 1000, frames: 3, kind: SynthKind::Figure, ..Default::default() };
        synth::make(&options, &Limits::default()).unwrap()
    }

    fn change(i: usize) -> Values {
        std::array::from_fn(|c| 0.1 * (((i * 31 + c * 17) % 19) as f32 / 9.0 - 1.0))
    }

    /// A function of a Gaussian whose gradient is `by`: linear in centre, log-scales, rotation, opacity logit
    /// and band 0 of colour.
    pub(in crate::train::delivery) fn linear(g: &Gaussian, by: &SplatGradient) -> f64 {
        let dot = |a: &[f32], b: &[f32]| -> f64 {
            a.iter().zip(b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum()
        };
        let logit = (f64::from(g.opacity) / (1.0 - f64::from(g.opacity))).ln();
        dot(&g.position, &by.position)
            + dot(&g.scale.map(f32::ln), &by.log_scale)
            + dot(&g.rotation, &by.rotation)
            + dot(&g.sh0, &by.sh0)
            + logit * f64::from(by.opacity_logit)
    }

    #[test]
    fn no_parameters_are_the_source_and_a_moved_scene_is_its_moved_gaussians() {
        let source = scene();
        let mut parameters = Parameters::zeros(&[1000]);
        let same = parameters.applied(&source).unwrap();
        assert_eq!(same.epochs()[0].attributes().log_scales, source.epochs()[0].attributes().log_scales);
        parameters.all_mut().enumerate().for_each(|(i, values)| *values = change(i));
        let moved = parameters.applied(&source).unwrap();
        let epoch = &source.epochs()[0];
        for t in 0..3 {
            let (before, after) = (epoch.instant(t), moved.epochs()[0].instant(t));
            for (i, (before, after)) in before.gaussians.iter().zip(&after.gaussians).enumerate() {
                let alone = Anchor::of(epoch, i, t).moved(before, [0, 1, 2], &change(i));
                for (a, b) in alone.position.iter().zip(after.position) {
                    assert!((a - b).abs() < 1e-5, "{i} {t}: {alone:?} {after:?}");
                }
                let dot: f32 = alone.rotation.iter().zip(after.rotation).map(|(a, b)| a * b).sum();
                assert!(dot.abs() > 1.0 - 1e-5 && (alone.opacity - after.opacity).abs() < 1e-5);
                assert!(alone.scale.iter().zip(after.scale).all(|(a, b)| (a / b - 1.0).abs() < 1e-4));
            }
        }
        assert_ne!(moved.instant(0), source.instant(0));
    }

    #[test]
    fn renamed_axes_are_found() {
        let source = scene();
        let epoch = &source.epochs()[0];
        let anchor = Anchor::of(epoch, 5, 1);
        let mut gaussian = epoch.instant(1).gaussians[5];
        assert_eq!(anchor.axes(&gaussian), [0, 1, 2]);
        // A quarter turn about its own z: decoded x is source y, decoded y is source −x.
        let quarter = quat(gaussian.rotation) * Quat::from_rotation_z(std::f32::consts::FRAC_PI_2);
        gaussian.rotation = [quarter.w, quarter.x, quarter.y, quarter.z];
        assert_eq!(anchor.axes(&gaussian), [1, 0, 2]);
    }

    #[test]
    fn errors_are_the_parameters_that_make_them() {
        let source = scene();
        let epoch = &source.epochs()[0];
        for i in 0..50 {
            let (anchor, gaussian) = (Anchor::of(epoch, i, 2), epoch.instant(2).gaussians[i]);
            let values = change(i + 3).map(|v| 0.2 * v);
            let mut decoded = anchor.moved(&gaussian, [0, 1, 2], &values);
            // A quarter turn about its own z names x y and y −x.
            let quarter = quat(decoded.rotation) * Quat::from_rotation_z(std::f32::consts::FRAC_PI_2);
            decoded.rotation = [quarter.w, quarter.x, quarter.y, quarter.z];
            decoded.scale.swap(0, 1);
            let axes = [1, 0, 2];
            let found = anchor.error(&gaussian, &decoded, axes);
            for c in 0..COMPONENTS {
                assert!((found[c] - values[c]).abs() < 1e-3, "{i} {c}: {} {}", found[c], values[c]);
            }
            let wrong = anchor.error(&gaussian, &decoded, [0, 1, 2]);
            assert!(wrong[SCALE..TURN] != found[SCALE..TURN], "axes as they are named would be wrong");
        }
    }

    #[test]
    fn pulled_gradients_of_a_proxy_are_differences() {
        let decoded =
            Gaussian { opacity: 0.6, scale: [0.3, 0.2, 0.1], ..scene().instant(0).unwrap().gaussians[3] };
        let by = SplatGradient {
            position: [0.3, -0.7, 0.2],
            log_scale: [0.5, -0.1, 0.9],
            opacity_logit: 0.35,
            sh0: [0.1, -0.2, 0.3],
            ..Default::default()
        };
        let follows = Follows::Proxy(0.4);
        let found = follows.pulled(&by, &decoded);
        for c in 0..COMPONENTS {
            let at = |h: f32| {
                let mut change = [0.0; COMPONENTS];
                change[c] = h;
                linear(&follows.moved(&decoded, &change), &by)
            };
            let numeric = (at(1e-2) - at(-1e-2)) / 2e-2;
            assert!((f64::from(found[c]) - numeric).abs() < 2e-3, "{c}: {} {numeric}", found[c]);
        }
    }

    /// Of a linear function of a moved Gaussian's centre, scale, rotation and colour.
    #[test]
    fn pulled_gradients_are_differences() {
        let source = scene();
        let anchor = Anchor::of(&source.epochs()[0], 7, 2);
        let decoded = source.epochs()[0].instant(2).gaussians[7];
        let by = SplatGradient {
            position: [0.3, -0.7, 0.2],
            log_scale: [0.5, -0.1, 0.9],
            rotation: [0.2, 0.8, -0.4, 0.6],
            opacity_logit: 0.35,
            sh0: [0.1, -0.2, 0.3],
            ..Default::default()
        };
        let axes = [2, 0, 1];
        let found = anchor.pulled(&by, &decoded, axes);
        for c in 0..COMPONENTS {
            let at = |h: f32| {
                let mut change = [0.0; COMPONENTS];
                change[c] = h;
                linear(&anchor.moved(&decoded, axes, &change), &by)
            };
            let numeric = (at(1e-2) - at(-1e-2)) / 2e-2;
            assert!((f64::from(found[c]) - numeric).abs() < 2e-3, "{c}: {} {numeric}", found[c]);
        }
    }
}
