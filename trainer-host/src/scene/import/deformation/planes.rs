//! Evaluates the field of 4D Gaussian Splatting: features on planes through space and time, a network on
//! them, and a small network for each attribute that moves.
//!
//! Features are the product of six planes (xy, xz, xt, yz, yt, zt), sampled bilinearly; those of several
//! resolutions follow each other. Three of the planes do not depend on time: their product is kept.

use codec_core::internals::math::quat_mul;

use super::{
    deformed::{Canonical, Deformed},
    layers::{Mlp, relu},
    options::FieldOptions,
};
use crate::scene::import::{
    error::{Format, ImportError},
    tensors::Tensors,
};

/// Name of what every such field has.
pub const MARK: &str = "deformation_net.grid.aabb";
/// The axes of each plane: x, y, z and time.
const AXES: [[usize; 2]; 6] = [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]];
/// The axis of time.
const TIME: usize = 3;
/// Harmonics of degree 3: coefficients of three colours.
const HARMONICS: usize = 16 * 3;

/// Features on a grid over two axes.
struct Plane {
    width: usize,
    height: usize,
    features: usize,
    /// Row by row, the features of a point together.
    values: Vec<f32>,
}

/// Six planes of one resolution.
struct Scale {
    planes: Vec<Plane>,
    features: usize,
}

/// What the trunk takes.
#[derive(Clone, Copy)]
enum Input {
    Features,
    /// Features, their sines and their cosines at a frequency.
    Encoded(f32),
}

/// A field of 4D Gaussian Splatting.
pub struct Planes {
    /// Corner of the box at -1 on the planes, and the one at +1.
    corners: [[f32; 3]; 2],
    scales: Vec<Scale>,
    input: Input,
    trunk: Mlp,
    position: Option<Mlp>,
    log_scale: Option<Mlp>,
    rotation: Option<Mlp>,
    /// Rotations are multiplied, not added.
    multiplies: bool,
    opacity: Option<Mlp>,
    harmonics: Option<Mlp>,
    /// How much of the canonical attributes is left.
    share: Option<Mlp>,
}

impl Planes {
    /// Reads the field.
    ///
    /// # Errors
    /// Arrays that are missing or do not fit together, or options that are not read here.
    pub fn read(tensors: &mut Tensors<'_>, options: &FieldOptions) -> Result<Self, ImportError> {
        let format = tensors.format();
        if tensors.has("deformation_net.empty_voxel.grid") {
            return Err(format.unsupported("empty_voxel", "a grid of voxels", "trainings without it"));
        }
        let corners = tensors.get(MARK)?.expect(format, MARK, &[2, 3])?.values;
        let corners = [[corners[0], corners[1], corners[2]], [corners[3], corners[4], corners[5]]];
        let scales = (0..tensors.numbered("deformation_net.grid.grids")?)
            .map(|number| Scale::read(tensors, number))
            .collect::<Result<Vec<_>, _>>()?;
        let trunk = Mlp::read(tensors, "deformation_net.feature_out", 0)?;
        let features: usize = scales.iter().map(|scale| scale.features).sum();
        let input = input(format, options, trunk.inputs(), features)?;
        let width = trunk.outputs();
        let mut head = |name: &str, stays: bool, outputs: usize| {
            if stays {
                return Ok(None);
            }
            let name = format!("deformation_net.{name}");
            let mlp = Mlp::read(tensors, &name, 1)?;
            if (mlp.inputs(), mlp.outputs()) != (width, outputs) {
                let found = format!("{} to {} values", mlp.inputs(), mlp.outputs());
                return Err(format.malformed(name, found, format_args!("{width} to {outputs}")));
            }
            Ok(Some(mlp))
        };
        let position = head("pos_deform", options.no_dx, 3)?;
        let log_scale = head("scales_deform", options.no_ds, 3)?;
        let rotation = head("rotations_deform", options.no_dr, 4)?;
        let opacity = head("opacity_deform", options.no_do, 1)?;
        let harmonics = head("shs_deform", options.no_dshs, HARMONICS)?;
        let has_share = tensors.numbered("deformation_net.static_mlp")? > 0;
        let share = if has_share { Some(Mlp::read(tensors, "deformation_net.static_mlp", 1)?) } else { None };
        if let Some(share) = share.as_ref().filter(|share| (share.inputs(), share.outputs()) != (width, 1)) {
            let found = format!("{} to {} values", share.inputs(), share.outputs());
            return Err(format.malformed("static_mlp", found, format_args!("{width} to 1")));
        }
        let multiplies = options.apply_rotation;
        Ok(Self {
            corners,
            scales,
            input,
            trunk,
            position,
            log_scale,
            rotation,
            multiplies,
            opacity,
            harmonics,
            share,
        })
    }

    /// Whether colours move, of which [`Deformed::harmonics`] then has all.
    pub fn moves_harmonics(&self) -> bool {
        self.harmonics.is_some()
    }

    /// Values that [`Planes::static_features`] gives.
    pub fn static_feature_count(&self) -> usize {
        self.scales.iter().map(|scale| scale.features).sum()
    }

    /// What does not depend on time of the features at a position.
    pub fn static_features(&self, position: [f32; 3]) -> Vec<f32> {
        let mut out = vec![1.0; self.static_feature_count()];
        self.multiply(&mut out, self.on_planes(position), |axes| !axes.contains(&TIME));
        out
    }

    /// A Gaussian at `time`; `static_features` is that of its position.
    pub fn at(&self, canonical: &Canonical<'_>, static_features: &[f32], time: f32) -> Deformed {
        let position = canonical.position;
        let mut features = static_features.to_vec();
        let mut place = self.on_planes(position);
        place[TIME] = time;
        self.multiply(&mut features, place, |axes| axes.contains(&TIME));
        if let Input::Encoded(frequency) = self.input {
            let sines: Vec<f32> = features.iter().map(|f| (f * frequency).sin()).collect();
            let cosines: Vec<f32> = features.iter().map(|f| (f * frequency).cos()).collect();
            features.extend(sines.into_iter().chain(cosines));
        }
        let mut hidden = self.trunk.apply(&features);
        relu(&mut hidden);
        let share = self.share.as_ref().map_or(1.0, |share| share.apply(&hidden)[0]);
        let moved = |head: &Option<Mlp>, values: &mut [f32]| {
            if let Some(head) = head {
                for (value, change) in values.iter_mut().zip(head.apply(&hidden)) {
                    *value = *value * share + change;
                }
            }
        };
        let mut out = Deformed {
            position,
            rotation: canonical.rotation,
            log_scale: canonical.log_scale,
            opacity_logit: canonical.opacity_logit,
            harmonics: Vec::new(),
        };
        moved(&self.position, &mut out.position);
        moved(&self.log_scale, &mut out.log_scale);
        moved(&self.opacity, std::slice::from_mut(&mut out.opacity_logit));
        match &self.rotation {
            Some(head) if self.multiplies => {
                let turn = head.apply(&hidden);
                out.rotation = quat_mul(canonical.rotation, [turn[0], turn[1], turn[2], turn[3]]);
            }
            // The share of the canonical attributes does not concern rotations.
            Some(head) => {
                let change = head.apply(&hidden);
                out.rotation.iter_mut().zip(change).for_each(|(value, change)| *value += change);
            }
            None => {}
        }
        if self.harmonics.is_some() {
            out.harmonics = canonical.harmonics();
            moved(&self.harmonics, &mut out.harmonics);
        }
        out
    }

    /// A position in the coordinates of the planes, and zero for time.
    fn on_planes(&self, position: [f32; 3]) -> [f32; 4] {
        let [low, high] = self.corners;
        let on = |i: usize| (position[i] - low[i]) * (2.0 / (high[i] - low[i])) - 1.0;
        [on(0), on(1), on(2), 0.0]
    }

    /// Multiplies `features` by those of the planes whose axes are `wanted`, at `place`.
    fn multiply(&self, features: &mut [f32], place: [f32; 4], wanted: impl Fn(&[usize; 2]) -> bool) {
        let mut rest = features;
        for scale in &self.scales {
            let Some((of_scale, others)) = rest.split_at_mut_checked(scale.features) else { return };
            for (plane, axes) in scale.planes.iter().zip(&AXES).filter(|(_, axes)| wanted(axes)) {
                plane.multiply(of_scale, axes.map(|axis| place[axis]));
            }
            rest = others;
        }
    }
}

/// What a trunk of `inputs` takes where there are `features`.
fn input(
    format: Format,
    options: &FieldOptions,
    inputs: usize,
    features: usize,
) -> Result<Input, ImportError> {
    if options.no_grid {
        return Err(format.unsupported("no_grid", "a network without planes", "trainings with planes"));
    }
    if inputs == features {
        return Ok(Input::Features);
    }
    if inputs != 3 * features {
        let allowed = format!("{features} features, or three values for each");
        return Err(format.malformed("inputs of deformation_net.feature_out.0", inputs, allowed));
    }
    if options.grid_pe < 2 {
        let allowed = "2 or more in cfg_args: the network takes sines and cosines of features";
        return Err(format.malformed("grid_pe", options.grid_pe, allowed));
    }
    Ok(Input::Encoded(options.grid_pe as f32))
}

impl Scale {
    fn read(tensors: &mut Tensors<'_>, number: usize) -> Result<Self, ImportError> {
        let mut planes: Vec<Plane> = Vec::new();
        for plane in 0..AXES.len() {
            let name = format!("deformation_net.grid.grids.{number}.{plane}");
            let tensor = tensors.get(&name)?;
            let expected = planes.first().map(|first| first.features);
            let (features, height, width) = match tensor.shape[..] {
                [1, f, h, w] if f * h * w > 0 && expected.is_none_or(|expected| expected == f) => (f, h, w),
                _ => {
                    let features = expected.map_or("features".to_owned(), |f| f.to_string());
                    let allowed = format!("1 x {features} x height x width");
                    let found = format!("{:?}", tensor.shape);
                    return Err(tensors.format().malformed(format!("shape of {name}"), found, allowed));
                }
            };
            // The file has all points of one feature together.
            let points = height * width;
            let of_point = |point: usize| tensor.values[point..].iter().step_by(points).copied();
            let values = (0..points).flat_map(of_point).collect();
            planes.push(Plane { width, height, features, values });
        }
        let features = planes[0].features;
        Ok(Self { planes, features })
    }
}

impl Plane {
    /// Multiplies `features` by those at a place from -1 to 1, ends on the outermost points; beyond them is
    /// what is on the edge.
    fn multiply(&self, features: &mut [f32], place: [f32; 2]) {
        let on = |place: f32, count: usize| {
            let last = (count - 1) as f32;
            let at = ((place + 1.0) / 2.0 * last).clamp(0.0, last);
            let low = at.floor();
            let low_index = (low as usize).min(count - 1);
            (low_index, (low_index + 1).min(count - 1), at - low)
        };
        let (left, right, fx) = on(place[0], self.width);
        let (top, bottom, fy) = on(place[1], self.height);
        let point = |y: usize, x: usize| &self.values[(y * self.width + x) * self.features..];
        let corners = [point(top, left), point(top, right), point(bottom, left), point(bottom, right)];
        let weights = [(1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy];
        for (i, feature) in features.iter_mut().enumerate() {
            let value: f32 = corners.iter().zip(weights).map(|(corner, weight)| corner[i] * weight).sum();
            *feature *= value;
        }
    }
}
