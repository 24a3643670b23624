//! LPIPS v0.1 (Zhang et al. 2018) compares images by what the layers of AlexNet make of them.
//!
//! Each layer's features are normalised over channels; squared differences are weighted per channel,
//! averaged over pixels and summed over layers. Input is sRGB display values, clamped to 0..=1. Weights are
//! the user's: a safetensors file with `features.0..4.{weight,bias}` (the convolutions, `[out, in, height,
//! width]`) and `linear.0..4.weight` (the weights per channel), all f32.
//!
//! Features are f32, sums over pixels f64: the result is within 1e-5 of that of f64 throughout.

use rayon::prelude::*;
use safetensors::{Dtype, SafeTensors};

use crate::image::{Image, ImageError, same_size};

/// Mean and deviation of the images that the network knows, per channel of -1 to 1.
const MEAN: [f32; 3] = [-0.030, -0.088, -0.188];
const DEVIATION: [f32; 3] = [0.458, 0.448, 0.450];
/// Keeps features of length 0 from being divided by it.
const EPSILON: f32 = 1e-10;
/// Output pixels and channels that are summed at a time: they stay in registers.
const PIXELS: usize = 16;
const CHANNELS: usize = 4;

/// What a convolution of AlexNet is besides its weights.
struct Shape {
    input: usize,
    output: usize,
    side: usize,
    stride: usize,
    padding: usize,
    /// Whether its input is reduced by the largest of 3 x 3, every other pixel.
    is_pooled: bool,
}

const fn shape(input: usize, output: usize, side: usize, is_pooled: bool) -> Shape {
    Shape { input, output, side, stride: 1, padding: side / 2, is_pooled }
}

const SHAPES: [Shape; 5] = [
    Shape { input: 3, output: 64, side: 11, stride: 4, padding: 2, is_pooled: false },
    shape(64, 192, 5, true),
    shape(192, 384, 3, true),
    shape(384, 256, 3, false),
    shape(256, 256, 3, false),
];

/// Weights that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LpipsError {
    /// Not a safetensors file.
    #[error("not a safetensors file: {0}")]
    File(String),
    /// A tensor that is missing, or of another type or shape.
    #[error("tensor {name}: {found}; f32 of shape {needed:?} is needed")]
    Tensor {
        /// Name of the tensor.
        name: String,
        /// What was found.
        found: String,
        /// Shape that is needed.
        needed: Vec<usize>,
    },
}

/// A convolution and the weight of each of its channels in the distance.
#[derive(Clone, Debug)]
struct Layer {
    /// Output by output; of each, rows, columns and input channels of its window, in this order.
    weights: Vec<f32>,
    bias: Vec<f32>,
    linear: Vec<f32>,
}

/// The network.
#[derive(Clone, Debug)]
pub struct Lpips {
    layers: [Layer; 5],
}

/// Features of all pixels: row by row, channels of a pixel together.
#[derive(Clone, Debug, PartialEq)]
struct Features {
    width: usize,
    height: usize,
    channels: usize,
    values: Vec<f32>,
}

impl Lpips {
    /// Smallest side of an image, pixels: below it a layer has nothing left.
    pub const SMALLEST_SIDE: u32 = 31;

    /// Reads the weights of a safetensors file.
    ///
    /// # Errors
    /// Bytes of another format, or a tensor that is missing or of another type or shape.
    pub fn from_safetensors(bytes: &[u8]) -> Result<Self, LpipsError> {
        let file = SafeTensors::deserialize(bytes).map_err(|error| LpipsError::File(error.to_string()))?;
        let layer = |index: usize| -> Result<Layer, LpipsError> {
            let Shape { input, output, side, .. } = SHAPES[index];
            let name = |kind: &str| format!("features.{index}.{kind}");
            let outermost = tensor(&file, &name("weight"), &[output, input, side, side])?;
            Ok(Layer {
                weights: channels_last(&outermost, input, side * side),
                bias: tensor(&file, &name("bias"), &[output])?,
                linear: tensor(&file, &format!("linear.{index}.weight"), &[output])?,
            })
        };
        Ok(Self { layers: [layer(0)?, layer(1)?, layer(2)?, layer(3)?, layer(4)?] })
    }

    /// Distance of `test` from `reference`: 0 for equal images, about 0.7 for unrelated ones; NaN where one
    /// holds a NaN.
    ///
    /// # Errors
    /// Different sizes, or a side below 31 pixels.
    pub fn distance(&self, test: &Image, reference: &Image) -> Result<f64, ImageError> {
        same_size(test, reference)?;
        let side = test.width().min(test.height());
        if side < Self::SMALLEST_SIDE {
            let (field, found) = ("side of an image for LPIPS", side.to_string());
            return Err(ImageError::Range { field, found, allowed: "31 or more" });
        }
        // What is cut off at 0 on the way would make a NaN one.
        if [test, reference].iter().any(|image| image.rgb().iter().any(|value| value.is_nan())) {
            return Ok(f64::NAN);
        }
        let (mut a, mut b) = (Features::of(test), Features::of(reference));
        let mut sum = 0.0;
        for (shape, layer) in SHAPES.iter().zip(&self.layers) {
            if shape.is_pooled {
                (a, b) = (a.pooled(), b.pooled());
            }
            (a, b) = (convolved(&a, shape, layer), convolved(&b, shape, layer));
            sum += distance(&a, &b, &layer.linear);
        }
        Ok(sum)
    }
}

/// Values of a tensor of this shape.
fn tensor(file: &SafeTensors, name: &str, needed: &[usize]) -> Result<Vec<f32>, LpipsError> {
    let refused =
        |found: String| LpipsError::Tensor { name: name.to_owned(), found, needed: needed.to_vec() };
    let view = file.tensor(name).map_err(|error| refused(error.to_string()))?;
    if view.dtype() != Dtype::F32 || view.shape() != needed {
        return Err(refused(format!("{:?} of shape {:?}", view.dtype(), view.shape())));
    }
    let values: Vec<f32> = view.data().as_chunks().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    match values.iter().find(|value| !value.is_finite()) {
        Some(value) => Err(refused(format!("holds {value}"))),
        None => Ok(values),
    }
}

/// Windows with their input channels innermost, from windows with them outermost.
fn channels_last(weights: &[f32], input: usize, places: usize) -> Vec<f32> {
    let window = |from: &[f32]| -> Vec<f32> {
        (0..places)
            .flat_map(|place| (0..input).map(move |c| (place, c)))
            .map(|(p, c)| from[c * places + p])
            .collect()
    };
    weights.chunks_exact(input * places).flat_map(window).collect()
}

impl Features {
    /// The image as the network expects it.
    fn of(image: &Image) -> Self {
        let pixels = image.rgb().as_chunks::<3>().0.iter();
        let values = pixels.flat_map(|pixel| {
            [0, 1, 2].map(|c| ((2.0 * pixel[c].clamp(0.0, 1.0) - 1.0) - MEAN[c]) / DEVIATION[c])
        });
        let (width, height) = (image.width() as usize, image.height() as usize);
        Self { width, height, channels: 3, values: values.collect() }
    }

    fn pixel(&self, x: usize, y: usize) -> &[f32] {
        &self.values[(y * self.width + x) * self.channels..][..self.channels]
    }

    /// The largest of every 3 x 3 pixels, at every other one.
    fn pooled(&self) -> Self {
        let (width, height) = ((self.width - 3) / 2 + 1, (self.height - 3) / 2 + 1);
        let mut values = vec![f32::NEG_INFINITY; width * height * self.channels];
        for (index, out) in values.chunks_exact_mut(self.channels).enumerate() {
            let (x, y) = (2 * (index % width), 2 * (index / width));
            for place in 0..9 {
                let from = self.pixel(x + place % 3, y + place / 3);
                out.iter_mut().zip(from).for_each(|(out, &from)| *out = out.max(from));
            }
        }
        Self { width, height, channels: self.channels, values }
    }

    /// The window around output pixel `index` of `width` a row, place by place, into `out[k][lane]`.
    fn window(&self, shape: &Shape, width: usize, index: usize, lane: usize, out: &mut [[f32; PIXELS]]) {
        let Shape { side, stride, padding, .. } = *shape;
        let (left, top) = (index % width * stride, index / width * stride);
        for (place, out) in out.chunks_exact_mut(self.channels).enumerate() {
            let (x, y) = (left + place % side, top + place / side);
            let is_inside =
                (padding..self.width + padding).contains(&x) && (padding..self.height + padding).contains(&y);
            if is_inside {
                let from = self.pixel(x - padding, y - padding);
                out.iter_mut().zip(from).for_each(|(out, &from)| out[lane] = from);
            } else {
                out.iter_mut().for_each(|out| out[lane] = 0.0);
            }
        }
    }
}

/// A convolution of `from`, negative results replaced by 0.
fn convolved(from: &Features, shape: &Shape, layer: &Layer) -> Features {
    let Shape { output, side, stride, padding, .. } = *shape;
    let sides = [from.width, from.height].map(|length| (length + 2 * padding - side) / stride + 1);
    let [width, height] = sides;
    let taps = side * side * from.channels;
    let mut values = vec![0.0; width * height * output];
    let arch = pulp::Arch::new();
    values.par_chunks_mut(PIXELS * output).enumerate().for_each_init(
        || vec![[0.0; PIXELS]; taps],
        |windows, (block, out)| {
            for lane in 0..out.len() / output {
                from.window(shape, width, block * PIXELS + lane, lane, windows);
            }
            arch.dispatch(SumWindows { windows, layer, out });
        },
    );
    Features { width, height, channels: output, values }
}

/// Sums all channels of up to [`PIXELS`] output pixels. A type of its own, because a closure would not be
/// compiled for the wide registers that are there.
struct SumWindows<'a> {
    windows: &'a [[f32; PIXELS]],
    layer: &'a Layer,
    out: &'a mut [f32],
}

impl pulp::NullaryFnOnce for SumWindows<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { windows, layer, out } = self;
        let output = layer.bias.len();
        for first in (0..output).step_by(CHANNELS) {
            let mut sums = [0, 1, 2, 3].map(|c| [layer.bias[first + c]; PIXELS]);
            let weights: [&[f32]; CHANNELS] =
                [0, 1, 2, 3].map(|c| &layer.weights[(first + c) * windows.len()..][..windows.len()]);
            for (tap, values) in windows.iter().enumerate() {
                for (sums, weights) in sums.iter_mut().zip(&weights) {
                    let weight = weights[tap];
                    for (sum, value) in sums.iter_mut().zip(values) {
                        *sum += value * weight;
                    }
                }
            }
            for (lane, out) in out.chunks_exact_mut(output).enumerate() {
                for (c, sums) in sums.iter().enumerate() {
                    out[first + c] = sums[lane].max(0.0);
                }
            }
        }
    }
}

/// Mean over pixels of the weighted squared difference of normalised features.
fn distance(a: &Features, b: &Features, linear: &[f32]) -> f64 {
    let channels = linear.len();
    let length = |values: &[f32]| values.iter().map(|v| v * v).sum::<f32>().sqrt() + EPSILON;
    let of_pixel = |(a, b): (&[f32], &[f32])| {
        let (by_a, by_b) = (1.0 / length(a), 1.0 / length(b));
        let terms = a.iter().zip(b).zip(linear);
        terms.map(|((a, b), weight)| f64::from(weight * (a * by_a - b * by_b).powi(2))).sum::<f64>()
    };
    let pixels = a.values.chunks_exact(channels).zip(b.values.chunks_exact(channels));
    let count = a.values.len() / channels;
    pixels.map(of_pixel).sum::<f64>() / count as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers between -1 and 1 that look random.
    fn noise(count: usize, seed: u32) -> Vec<f32> {
        let mix =
            |i: usize| (i as u32).wrapping_mul(0x9E37_79B9).wrapping_add(seed).wrapping_mul(0x85EB_CA6B);
        (0..count).map(|i| ((mix(i) >> 8) as f32 / (1 << 23) as f32) - 1.0).collect()
    }

    /// A file of noise as weights; with `change`, one tensor of another name.
    fn file(change: Option<&str>) -> Vec<u8> {
        let mut tensors: Vec<(String, Vec<usize>, Vec<u8>)> = Vec::new();
        for (index, shape) in SHAPES.iter().enumerate() {
            let Shape { input, output, side, .. } = *shape;
            let scale = 1.5 / ((input * side * side) as f32).sqrt();
            let mut push = |name: String, shape: Vec<usize>, scale: f32| {
                let count = shape.iter().product();
                let values = noise(count, index as u32 + 7 * name.len() as u32);
                let bytes = values.iter().flat_map(|v| (scale * v).to_le_bytes()).collect();
                let name = if change == Some(name.as_str()) { format!("{name}.other") } else { name };
                tensors.push((name, shape, bytes));
            };
            push(format!("features.{index}.weight"), vec![output, input, side, side], scale);
            push(format!("features.{index}.bias"), vec![output], 0.1);
            push(format!("linear.{index}.weight"), vec![output], 0.01);
        }
        let views = tensors.iter().map(|(name, shape, bytes)| {
            let view = safetensors::tensor::TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap();
            (name.clone(), view)
        });
        safetensors::serialize(views, None).unwrap()
    }

    fn picture(width: u32, height: u32, seed: u32) -> Image {
        let values = noise(3 * (width * height) as usize, seed).iter().map(|v| 0.5 + 0.6 * v).collect();
        Image::new(width, height, values).unwrap()
    }

    /// A convolution as it is defined, in f64, over weights with input channels outermost.
    fn plainly_convolved(from: &Features, shape: &Shape, weights: &[f32], bias: &[f32]) -> Vec<f64> {
        let Shape { input, output, side, stride, padding, .. } = *shape;
        let sides = [from.width, from.height].map(|length| (length + 2 * padding - side) / stride + 1);
        let mut out = Vec::new();
        for y in 0..sides[1] {
            for x in 0..sides[0] {
                for o in 0..output {
                    let mut sum = f64::from(bias[o]);
                    for c in 0..input {
                        for place in 0..side * side {
                            let (u, v) = (x * stride + place % side, y * stride + place / side);
                            let (u, v) = (u.wrapping_sub(padding), v.wrapping_sub(padding));
                            if u < from.width && v < from.height {
                                let weight = weights[(o * input + c) * side * side + place];
                                sum += f64::from(weight) * f64::from(from.pixel(u, v)[c]);
                            }
                        }
                    }
                    out.push(sum.max(0.0));
                }
            }
        }
        out
    }

    #[test]
    fn a_picture_with_nan_is_not_perfect() {
        let lpips = Lpips::from_safetensors(&file(None)).unwrap();
        let (whole, mut broken) = (picture(40, 40, 1), picture(40, 40, 1));
        assert_eq!(lpips.distance(&whole, &broken).unwrap(), 0.0);
        broken.rgb_mut()[700] = f32::NAN;
        for (test, reference) in [(&whole, &broken), (&broken, &whole), (&broken, &broken)] {
            assert!(lpips.distance(test, reference).unwrap().is_nan());
        }
    }

    #[test]
    fn convolutions_are_those_of_their_definition() {
        for shape in [
            Shape { input: 3, output: 8, side: 11, stride: 4, padding: 2, is_pooled: false },
            super::shape(5, 12, 3, false),
        ] {
            let Shape { input, output, side, .. } = shape;
            let weights = noise(output * input * side * side, 3);
            let bias = noise(output, 5);
            let from = Features { width: 23, height: 17, channels: input, values: noise(23 * 17 * input, 9) };
            let expected = plainly_convolved(&from, &shape, &weights, &bias);
            let mut layer =
                Layer { weights: channels_last(&weights, input, side * side), bias, linear: Vec::new() };
            let off = |layer: &Layer| {
                let found = convolved(&from, &shape, layer).values;
                assert_eq!(found.len(), expected.len());
                found.iter().zip(&expected).map(|(a, b)| (f64::from(*a) - b).abs()).fold(0.0, f64::max)
            };
            assert!(off(&layer) < 1e-4);
            // Weights in another order are another convolution.
            layer.weights = weights;
            assert!(off(&layer) > 0.1);
        }
    }

    #[test]
    fn equal_images_are_at_distance_0_and_others_are_not() {
        let network = Lpips::from_safetensors(&file(None)).unwrap();
        let (a, b) = (picture(40, 33, 1), picture(40, 33, 2));
        assert_eq!(network.distance(&a, &a).unwrap(), 0.0);
        let found = network.distance(&a, &b).unwrap();
        assert!(found.is_finite() && found != 0.0);
        assert_eq!(network.distance(&b, &a).unwrap(), found, "symmetric");
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        assert_eq!(pool.install(|| network.distance(&a, &b).unwrap()), found);
        assert!(network.distance(&a, &picture(33, 40, 1)).is_err());
        let small = picture(30, 40, 1);
        let error = network.distance(&small, &small).unwrap_err().to_string();
        assert!(error.contains("30") && error.contains("31 or more"), "{error}");
        let smallest = picture(31, 31, 1);
        assert_eq!(network.distance(&smallest, &smallest).unwrap(), 0.0);
    }

    #[test]
    fn weights_that_do_not_fit_are_refused_by_name() {
        let error = Lpips::from_safetensors(&file(Some("linear.3.weight"))).unwrap_err().to_string();
        assert!(error.contains("linear.3.weight") && error.contains("[256]"), "{error}");
        assert!(matches!(Lpips::from_safetensors(b"no"), Err(LpipsError::File(_))));
        let mut cut = file(None);
        cut.truncate(1000);
        assert!(Lpips::from_safetensors(&cut).is_err());
    }

    /// The values that the authors' repository documents for its three example images.
    #[test]
    fn the_authors_examples_have_the_authors_values() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/lpips");
        let Ok(weights) = std::fs::read(folder.join("alexnet.safetensors")) else {
            assert_ne!(std::env::var("DGS_REQUIRE_DATA").as_deref(), Ok("1"), "LPIPS weights are missing");
            println!("SKIPPED: LPIPS weights are not here");
            return;
        };
        let network = Lpips::from_safetensors(&weights).unwrap();
        let image = |name: &str| {
            let found = image::open(folder.join(name)).unwrap().to_rgb8();
            let values = found.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect();
            Image::new(found.width(), found.height(), values).unwrap()
        };
        let reference = image("ex_ref.png");
        for (name, expected) in [("ex_p0.png", 0.721_880_7), ("ex_p1.png", 0.137_565_6)] {
            let found = network.distance(&image(name), &reference).unwrap();
            assert!((found - expected).abs() < 1e-5, "{name}: {found}, not {expected}");
        }
    }
}
