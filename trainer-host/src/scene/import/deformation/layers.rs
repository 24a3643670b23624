//! Evaluates small networks: linear layers with ReLU between them.

use crate::scene::import::{
    error::{ErrorKind, ImportError},
    tensors::Tensors,
};

/// Most weights of a layer: every one is work for every Gaussian and frame.
const MAX_WEIGHTS: usize = 1 << 20;

/// A linear layer.
pub struct Linear {
    pub inputs: usize,
    pub outputs: usize,
    /// Of each input, what it adds to all outputs.
    weights: Vec<f32>,
    bias: Vec<f32>,
}

impl Linear {
    /// Reads `NAME.weight` (outputs x inputs) and `NAME.bias`.
    pub fn read(tensors: &mut Tensors<'_>, name: &str) -> Result<Self, ImportError> {
        let format = tensors.format();
        let weight_name = format!("{name}.weight");
        let weight = tensors.get(&weight_name)?;
        let &[outputs, inputs] = &weight.shape[..] else {
            let found = format!("{:?}", weight.shape);
            return Err(format.malformed(format!("shape of {weight_name}"), found, "outputs x inputs"));
        };
        if inputs == 0 || outputs == 0 {
            return Err(format.empty(weight_name));
        }
        if weight.values.len() > MAX_WEIGHTS {
            let found = weight.values.len();
            return Err(format.error(ErrorKind::TooLarge, weight_name, found, MAX_WEIGHTS));
        }
        let bias_name = format!("{name}.bias");
        let bias = tensors.get(&bias_name)?.expect(format, &bias_name, &[outputs])?.values;
        let by_input = |i: usize| weight.values[i..].iter().step_by(inputs).copied();
        let weights = (0..inputs).flat_map(by_input).collect();
        Ok(Self { inputs, outputs, weights, bias })
    }

    /// The outputs of `input`, which has as many values as the layer takes.
    pub fn apply(&self, input: &[f32]) -> Vec<f32> {
        let mut out = self.bias.clone();
        for (&value, weights) in input.iter().zip(self.weights.chunks_exact(self.outputs)) {
            for (sum, weight) in out.iter_mut().zip(weights) {
                *sum += value * weight;
            }
        }
        out
    }
}

/// A multilayer perceptron: linear layers with ReLU between each two.
pub struct Mlp(Vec<Linear>);

impl Mlp {
    /// Reads `NAME.FIRST`, `NAME.FIRST + 2` and so on: the ReLU between have numbers and no weights.
    pub fn read(tensors: &mut Tensors<'_>, name: &str, first: usize) -> Result<Self, ImportError> {
        let mut layers: Vec<Linear> = Vec::new();
        for number in (first..tensors.numbered(name)?.max(first + 1)).step_by(2) {
            let layer_name = format!("{name}.{number}");
            let layer = Linear::read(tensors, &layer_name)?;
            if let Some(last) = layers.last() {
                follows(tensors, &layer_name, layer.inputs, last.outputs)?;
            }
            layers.push(layer);
        }
        Ok(Self(layers))
    }

    /// Values that the first layer takes.
    pub fn inputs(&self) -> usize {
        self.0.first().map_or(0, |layer| layer.inputs)
    }

    /// Values that the last layer gives.
    pub fn outputs(&self) -> usize {
        self.0.last().map_or(0, |layer| layer.outputs)
    }

    /// The outputs of `input`.
    pub fn apply(&self, input: &[f32]) -> Vec<f32> {
        let mut values = input.to_vec();
        for (number, layer) in self.0.iter().enumerate() {
            if number > 0 {
                relu(&mut values);
            }
            values = layer.apply(&values);
        }
        values
    }
}

/// Sets what is negative to zero.
pub fn relu(values: &mut [f32]) {
    values.iter_mut().for_each(|value| *value = value.max(0.0));
}

/// Refuses a layer that does not take what the one before it gives.
pub fn follows(tensors: &Tensors<'_>, name: &str, inputs: usize, given: usize) -> Result<(), ImportError> {
    if inputs == given {
        return Ok(());
    }
    let field = format!("inputs of {name}");
    Err(tensors.format().malformed(field, inputs, format_args!("{given}, what comes before it gives")))
}
