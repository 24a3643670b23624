//! Renders arrays, and takes gradients of pictures back to them.
//!
//! `alpha`, the fourth channel, is 1 minus the transmittance. Its gradient is that of a picture of the same
//! Gaussians, all black, over a background of 1: the picture is the transmittance.

use pyo3::{prelude::*, types::PyDict};
use render_host::{
    Camera as Pinhole, Footprint, Image, ImageError, Loss, Renderer, Settings, Workspace, adjoint,
};
use trainer_host::scene::LOG_SCALE_RANGE;

use crate::{
    activation::Activation,
    array::{Numbers, array},
    camera::Camera,
    error::{refused, whole},
    gaussians::{Splatting, footprint, needed},
    scene::{Scene, footprint_of},
};

/// Cameras, which must agree on the size of their pictures.
fn cameras(value: &Bound<'_, PyAny>) -> PyResult<Vec<Pinhole>> {
    let cameras: Vec<Pinhole> = match value.cast::<Camera>() {
        Ok(one) => vec![one.get().0.clone()],
        Err(_) => {
            let mut all = Vec::new();
            let items = value.try_iter().map_err(|_| {
                refused(format!("cameras: found a {}; a dgs.Camera or several are wanted", value.get_type()))
            })?;
            for item in items {
                let item = item?;
                let camera = item.cast::<Camera>().map_err(|_| {
                    refused(format!("cameras: found a {}; dgs.Camera is wanted", item.get_type()))
                })?;
                all.push(camera.get().0.clone());
            }
            all
        }
    };
    let size = |camera: &Pinhole| (camera.width(), camera.height());
    let Some(first) = cameras.first() else { return Err(refused("cameras: found none; one is wanted")) };
    match cameras.iter().find(|camera| size(camera) != size(first)) {
        None => Ok(cameras),
        Some(other) => {
            let (found, wanted) = (size(other), size(first));
            Err(refused(format!("cameras: found sizes {wanted:?} and {found:?}; one size is wanted")))
        }
    }
}

/// How to render.
fn settings(
    background: Option<[f32; 3]>,
    footprint: Footprint,
    sh_degree: i128,
    alpha_cutoff: Option<f32>,
) -> PyResult<Settings> {
    let max_sh_degree = whole("sh_degree", sh_degree)?;
    let usual = Settings::over(background.unwrap_or_default());
    let alpha_cutoff = alpha_cutoff.unwrap_or(usual.alpha_cutoff);
    let settings = Settings { max_sh_degree, alpha_cutoff, ..usual }.with_footprint(footprint);
    settings.validate().map_err(refused)?;
    Ok(settings)
}

/// The footprint that is named, else that of the scene or of the arrays.
fn drawn(source: &Bound<'_, PyAny>, named: Option<&str>) -> PyResult<Footprint> {
    match (named, source.cast::<Scene>()) {
        (Some(name), _) => footprint_of(name),
        (None, Ok(scene)) => Ok(scene.get().0.footprint),
        (None, Err(_)) => match footprint(source)? {
            Some(name) => footprint_of(&name),
            None => Ok(Footprint::default()),
        },
    }
}

/// The Gaussians of arrays, or of a frame of a scene.
fn splatting(source: &Bound<'_, PyAny>, frame: i64, activation: Activation) -> PyResult<Splatting> {
    match source.cast::<Scene>() {
        Ok(scene) => Splatting::read(&scene.get().at(source.py(), frame, "log")?, Activation::Log),
        Err(_) => Splatting::read(source, activation),
    }
}

/// Renders Gaussians from every camera: [C, H, W, 3], or 4 with alpha.
#[pyfunction]
#[pyo3(signature = (
    gaussians, cameras, *, frame = 0, activation = "log", background = None, alpha = false,
    footprint = None, sh_degree = 3, alpha_cutoff = None
))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn render<'py>(
    py: Python<'py>,
    gaussians: &Bound<'py, PyAny>,
    cameras: &Bound<'py, PyAny>,
    frame: i64,
    activation: &str,
    background: Option<[f32; 3]>,
    alpha: bool,
    footprint: Option<&str>,
    sh_degree: i128,
    alpha_cutoff: Option<f32>,
) -> PyResult<Bound<'py, PyAny>> {
    let activation = Activation::of(activation)?;
    let cameras = self::cameras(cameras)?;
    let settings = settings(background, drawn(gaussians, footprint)?, sh_degree, alpha_cutoff)?;
    let splatting = splatting(gaussians, frame, activation)?;
    let channels = if alpha { 4 } else { 3 };
    let (width, height) = (cameras[0].width() as usize, cameras[0].height() as usize);
    let pixels = py.detach(|| {
        let splats = splatting.splats()?;
        let mut renderer = Renderer::new();
        let mut pixels = Vec::new();
        for camera in &cameras {
            Python::attach(|py| py.check_signals())?;
            let rendered = renderer.render(&splats, camera, &settings).map_err(refused)?;
            for (rgb, transmittance) in
                rendered.image.rgb().as_chunks::<3>().0.iter().zip(&rendered.transmittance)
            {
                pixels.extend_from_slice(rgb);
                pixels.extend(alpha.then_some(1.0 - transmittance));
            }
        }
        Ok::<_, PyErr>(pixels)
    })?;
    Ok(array(py, pixels, &[cameras.len(), height, width, channels])?.into_any())
}

/// A loss whose gradient with respect to the picture the caller knows already.
struct GivenGradient(Vec<f32>);

impl Loss for GivenGradient {
    fn differentiate(&self, image: &Image, _: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        gradient.copy_from_slice(&self.0);
        let products = image.rgb().iter().zip(&self.0).map(|(&v, &g)| f64::from(v) * f64::from(g));
        Ok(products.sum())
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        rgb.iter().zip(&self.0).map(|(v, &g)| v * f64::from(g)).sum()
    }
}

/// Sums of gradients over cameras, per value of each array.
struct Sums {
    arrays: [Vec<f64>; 6],
    background: [f64; 3],
}

impl Sums {
    fn new(splatting: &Splatting, rest: usize) -> Self {
        let n = splatting.gaussians.len();
        let arrays = [3 * n, 3 * n, 4 * n, n, 3 * n, rest].map(|length| vec![0.0; length]);
        Self { arrays, background: [0.0; 3] }
    }

    /// Adds gradients; those of colours only if `has_colours`.
    fn add(&mut self, gradients: &render_host::Gradients, has_colours: bool) {
        let [means, scales, quats, opacities, sh0, sh_rest] = &mut self.arrays;
        for (i, splat) in gradients.splats.iter().enumerate() {
            add(&mut means[3 * i..], &splat.position);
            add(&mut scales[3 * i..], &splat.log_scale);
            add(&mut quats[4 * i..], &splat.rotation);
            add(&mut opacities[i..], &[splat.opacity_logit]);
            if has_colours {
                add(&mut sh0[3 * i..], &splat.sh0);
            }
        }
        if has_colours {
            add(sh_rest, &gradients.sh_rest);
            for (sum, value) in self.background.iter_mut().zip(gradients.background) {
                *sum += value;
            }
        }
    }

    /// Takes gradients of logarithms and logits to the domain that the arrays are in. Linear values are
    /// inside their range, so that nothing is divided by 0.
    fn in_domain(mut self, splatting: &Splatting, scales: &[f32], activation: Activation) -> Self {
        for (i, gaussian) in splatting.gaussians.iter().enumerate() {
            for axis in 0..3 {
                let slope = &mut self.arrays[1][3 * i + axis];
                let is_clamped = !(LOG_SCALE_RANGE.0..=LOG_SCALE_RANGE.1).contains(&scales[3 * i + axis]);
                match activation {
                    Activation::Log if is_clamped => *slope = 0.0,
                    Activation::Log => (),
                    Activation::Linear => *slope /= f64::from(gaussian.scale[axis]),
                }
            }
            if activation == Activation::Linear {
                let opacity = f64::from(gaussian.opacity);
                self.arrays[3][i] /= opacity * (1.0 - opacity);
            }
        }
        self
    }
}

/// Adds `values` to as many sums.
fn add(sums: &mut [f64], values: &[f32]) {
    for (sum, &value) in sums.iter_mut().zip(values) {
        *sum += f64::from(value);
    }
}

/// Gradients of a number, whose gradient of the pictures is given, with respect to every array.
#[pyfunction]
#[pyo3(signature = (
    gaussians, cameras, grad_images, *, activation = "log", background = None,
    footprint = None, sh_degree = 3, alpha_cutoff = None
))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn render_backward<'py>(
    py: Python<'py>,
    gaussians: &Bound<'py, PyAny>,
    cameras: &Bound<'py, PyAny>,
    grad_images: &Bound<'py, PyAny>,
    activation: &str,
    background: Option<[f32; 3]>,
    footprint: Option<&str>,
    sh_degree: i128,
    alpha_cutoff: Option<f32>,
) -> PyResult<Bound<'py, PyDict>> {
    let activation = Activation::of(activation)?;
    let cameras = self::cameras(cameras)?;
    let settings = settings(background, drawn(gaussians, footprint)?, sh_degree, alpha_cutoff)?;
    let mut splatting = splatting(gaussians, 0, activation)?;
    if activation == Activation::Linear {
        splatting.move_inside();
    }
    let given = Numbers::<f32>::read("grad_images", grad_images)?;
    let (width, height) = (cameras[0].width() as usize, cameras[0].height() as usize);
    let channels = match given.shape[..] {
        [c, h, w, channels @ (3 | 4)] if [c, h, w] == [cameras.len(), height, width] => channels,
        _ => return Err(given.misshapen(format!("[{}, {height}, {width}, 3 or 4]", cameras.len()))),
    };
    let scales = Numbers::<f32>::read("scales", &needed(gaussians, "scales")?)?;
    let sums = py.detach(|| {
        let picture = given.values.chunks_exact((width * height * channels).max(1));
        differentiated(&splatting, cameras.iter().zip(picture), channels, &settings)
    })?;
    let sums = sums.in_domain(&splatting, &scales.values, activation);
    let narrow = |values: &Vec<f64>| values.iter().map(|&v| v as f32).collect();
    let out = splatting.dictionary(py, sums.arrays.each_ref().map(narrow))?;
    out.set_item("background", array(py, sums.background.map(|v| v as f32).to_vec(), &[3])?)?;
    Ok(out)
}

/// Gradients over all cameras, each with the gradient of its picture.
fn differentiated<'a>(
    splatting: &Splatting,
    pictures: impl Iterator<Item = (&'a Pinhole, &'a [f32])>,
    channels: usize,
    settings: &Settings,
) -> PyResult<Sums> {
    let splats = splatting.splats()?;
    let mut sums = Sums::new(splatting, splats.len() * splats.sh_degree().rest_len());
    let mut workspace = Workspace::new();
    let black = black(splatting);
    let over_white = Settings { background: [1.0; 3], max_sh_degree: 0, ..settings.clone() };
    for (camera, given) in pictures {
        Python::attach(|py| py.check_signals())?;
        let colours = given.chunks_exact(channels).flat_map(|pixel| [pixel[0], pixel[1], pixel[2]]);
        let loss = GivenGradient(colours.collect());
        let found = adjoint::render_and_gradients(&mut workspace, &splats, camera, settings, &loss);
        sums.add(&found.map_err(refused)?, true);
        if channels == 4 {
            let alphas = given.chunks_exact(4).flat_map(|pixel| [-pixel[3], 0.0, 0.0]);
            let loss = GivenGradient(alphas.collect());
            let black = render_host::Splats::plain(&black);
            let found = adjoint::render_and_gradients(&mut workspace, &black, camera, &over_white, &loss);
            sums.add(&found.map_err(refused)?, false);
        }
    }
    Ok(sums)
}

/// The same Gaussians without light: far below the colour at which it is clamped to 0.
fn black(splatting: &Splatting) -> Vec<render_host::Gaussian> {
    let sh0 = [-1e3; 3];
    splatting.gaussians.iter().map(|&gaussian| render_host::Gaussian { sh0, ..gaussian }).collect()
}
