//! Evaluates the network of Deformable 3D Gaussians: positional encodings of position and time through linear
//! layers, then what is added to position, rotation and size.

use super::{
    deformed::{Canonical, Deformed},
    layers::{Linear, Mlp, follows, relu},
};
use crate::scene::import::{error::ImportError, tensors::Tensors};

/// Names of which every such network has one.
pub const MARKS: [&str; 2] = ["gaussian_warp.weight", "branch_w.weight"];
/// Frequencies of the encoding of position where the weights do not tell.
const FREQUENCIES: usize = 10;
/// Most frequencies: beyond, single precision holds no sines.
const MAX_FREQUENCIES: usize = 24;
/// What the trainer adds to an axis that it has brought to unit length.
const OFFSET: f32 = 1e-5;

/// How positions move.
enum Movement {
    /// By a shift.
    Shift(Linear),
    /// Along a screw: its axis and angle, and its moment.
    Screw { axis: Linear, moment: Linear },
}

/// A network of Deformable 3D Gaussians.
pub struct Warp {
    position_frequencies: usize,
    time_frequencies: usize,
    /// What the encoding of time goes through first.
    of_time: Option<Mlp>,
    layers: Vec<Linear>,
    movement: Movement,
    rotation: Linear,
    scale: Linear,
}

impl Warp {
    /// Reads the network.
    ///
    /// # Errors
    /// Arrays that are missing or do not fit together.
    pub fn read(tensors: &mut Tensors<'_>) -> Result<Self, ImportError> {
        let format = tensors.format();
        let layers = (0..tensors.numbered("linear")?)
            .map(|number| Linear::read(tensors, &format!("linear.{number}")))
            .collect::<Result<Vec<_>, _>>()?;
        let first = layers.first().ok_or_else(|| format.empty("linear.0.weight"))?.inputs;
        let has_timenet = tensors.has("timenet.0.weight");
        let of_time = if has_timenet { Some(Mlp::read(tensors, "timenet", 0)?) } else { None };
        let malformed = |found: usize| {
            let allowed = "values of positional encodings: 1 and 2 per frequency, of position for each axis";
            format.malformed("inputs of the first layer", found, allowed)
        };
        let (of_position, time_values) = match &of_time {
            Some(mlp) => (first.checked_sub(mlp.outputs()), Some(mlp.inputs())),
            None => {
                let of_position = 3 * (1 + 2 * FREQUENCIES);
                (Some(of_position), first.checked_sub(of_position))
            }
        };
        let of_position = of_position.and_then(|values| frequencies(values, 3));
        let time_values = time_values.and_then(|values| frequencies(values, 1));
        let position_frequencies = of_position.ok_or_else(|| malformed(first))?;
        let time_frequencies = time_values.ok_or_else(|| malformed(first))?;
        for (number, pair) in layers.windows(2).enumerate() {
            // A layer may take the encodings again.
            let given = pair[0].outputs;
            let allowed = if pair[1].inputs == given + first { given + first } else { given };
            follows(tensors, &format!("linear.{}", number + 1), pair[1].inputs, allowed)?;
        }
        let is_screw = tensors.has(MARKS[1]);
        let width = layers.last().map_or(0, |layer| layer.outputs);
        let mut head = |name: &str, outputs: usize| {
            let head = Linear::read(tensors, name)?;
            follows(tensors, name, head.inputs, width)?;
            if head.outputs != outputs {
                return Err(format.malformed(format!("outputs of {name}"), head.outputs, outputs));
            }
            Ok(head)
        };
        let rotation = head("gaussian_rotation", 4)?;
        let scale = head("gaussian_scaling", 3)?;
        let movement = if is_screw {
            Movement::Screw { axis: head("branch_w", 3)?, moment: head("branch_v", 3)? }
        } else {
            Movement::Shift(head("gaussian_warp", 3)?)
        };
        Ok(Self { position_frequencies, time_frequencies, of_time, layers, movement, rotation, scale })
    }

    /// The encoding of `time`.
    pub fn encode_time(&self, time: f32) -> Vec<f32> {
        let encoded = positional_encoding(&[time], self.time_frequencies);
        self.of_time.as_ref().map_or(encoded.clone(), |mlp| mlp.apply(&encoded))
    }

    /// A Gaussian at the time whose encoding is `of_time`.
    pub fn at(&self, canonical: &Canonical<'_>, of_time: &[f32]) -> Deformed {
        let mut input = positional_encoding(&canonical.position, self.position_frequencies);
        input.extend(of_time);
        let mut hidden = Vec::new();
        for (number, layer) in self.layers.iter().enumerate() {
            if number == 0 {
                hidden.clone_from(&input);
            } else if layer.inputs > hidden.len() {
                hidden = [&input[..], &hidden].concat();
            }
            hidden = layer.apply(&hidden);
            relu(&mut hidden);
        }
        let turn = self.rotation.apply(&hidden);
        let growth = self.scale.apply(&hidden);
        let unit = crate::scene::normalised(canonical.rotation);
        // Sizes may come out negative, and count by their magnitude.
        let log_scale = |i: usize| (canonical.log_scale[i].exp() + growth[i]).abs().ln();
        Deformed {
            position: self.movement.apply(canonical.position, &hidden),
            rotation: [0, 1, 2, 3].map(|i| unit[i] + turn[i]),
            log_scale: [0, 1, 2].map(log_scale),
            opacity_logit: canonical.opacity_logit,
            harmonics: Vec::new(),
        }
    }
}

impl Movement {
    fn apply(&self, position: [f32; 3], hidden: &[f32]) -> [f32; 3] {
        let three = |layer: &Linear| {
            let values = layer.apply(hidden);
            [values[0], values[1], values[2]]
        };
        match self {
            Movement::Shift(layer) => {
                let shift = three(layer);
                [0, 1, 2].map(|i| position[i] + shift[i])
            }
            Movement::Screw { axis, moment } => {
                let (axis, moment) = (three(axis), three(moment));
                let angle = axis.iter().map(|v| v * v).sum::<f32>().sqrt();
                let axis = axis.map(|v| v / angle + OFFSET);
                let moment = moment.map(|v| v / angle + OFFSET);
                let (sin, cos) = angle.sin_cos();
                // Rodrigues' formula for the position, and its integral for the moment.
                let turned = along(axis, position, [1.0, sin, 1.0 - cos]);
                let moved = along(axis, moment, [angle, 1.0 - cos, angle - sin]);
                [0, 1, 2].map(|i| turned[i] + moved[i])
            }
        }
    }
}

/// `vector`, its product with `axis` and the product of that with `axis`, by their weights.
fn along(axis: [f32; 3], vector: [f32; 3], weights: [f32; 3]) -> [f32; 3] {
    let once = cross(axis, vector);
    let twice = cross(axis, once);
    [0, 1, 2].map(|i| weights[0] * vector[i] + weights[1] * once[i] + weights[2] * twice[i])
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// How many frequencies `values` encode, on so many axes.
fn frequencies(values: usize, axes: usize) -> Option<usize> {
    let doubled = (values / axes).checked_sub(1)?;
    let fits = values.is_multiple_of(axes) && doubled.is_multiple_of(2) && doubled / 2 <= MAX_FREQUENCIES;
    fits.then_some(doubled / 2)
}

/// Values, then the sines and cosines of all of them at each power of two.
fn positional_encoding(values: &[f32], frequencies: usize) -> Vec<f32> {
    let mut out = values.to_vec();
    for power in 0..frequencies {
        let frequency = (1u32 << power) as f32;
        out.extend(values.iter().map(|v| (v * frequency).sin()));
        out.extend(values.iter().map(|v| (v * frequency).cos()));
    }
    out
}
