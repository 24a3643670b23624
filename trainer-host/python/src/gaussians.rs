//! Holds the arrays of one frame, under the names that gsplat gives them, and turns them into Gaussians.

use codec_core::{Footprint, Gaussian, ShDegree};
use pyo3::{
    prelude::*,
    types::{PyDict, PyMapping},
};
use render_host::Splats;
use trainer_host::Epoch;

use crate::{
    activation::Activation,
    array::{Numbers, array},
    error::refused,
};

/// Names of the arrays, in the order of the named tuple.
pub const NAMES: [&str; 6] = ["means", "scales", "quats", "opacities", "sh0", "shN"];

/// What says how a frame is drawn.
const FOOTPRINT: &str = "footprint";

/// How far from the ends of their range opacities and scales are where gradients of linear values are taken.
const INSIDE: f32 = 1e-6;

/// The harmonic degree that has `each` coefficients above band 0 per channel.
pub fn degree_of(each: usize) -> Option<ShDegree> {
    [0, 3, 8, 15].iter().position(|&k| k == each).and_then(|degree| ShDegree::new(degree as u8))
}

/// Values of N Gaussians as arrays hold them: rows one after the other.
pub struct Frame {
    means: Vec<f32>,
    scales: Vec<f32>,
    quats: Vec<f32>,
    opacities: Vec<f32>,
    sh0: Vec<f32>,
    sh_rest: Vec<f32>,
    each: usize,
}

impl Frame {
    /// Frame `t` of an epoch.
    pub fn of_epoch(epoch: &Epoch, t: usize, activation: Activation) -> Self {
        let (n, a) = (epoch.count(), epoch.attributes());
        let logs = a.log_scales.frame(t, n).as_flattened().iter();
        let logits = a.opacity_logits.frame(t, n).iter();
        Self {
            means: a.positions.frame(t, n).as_flattened().to_vec(),
            scales: logs.map(|&log| activation.of_log_scale(log)).collect(),
            quats: a.rotations.frame(t, n).as_flattened().to_vec(),
            opacities: logits.map(|&logit| activation.of_logit(logit)).collect(),
            sh0: a.sh0.frame(t, n).as_flattened().to_vec(),
            sh_rest: a.sh_rest.clone(),
            each: a.sh_degree.rest_len() / 3,
        }
    }

    /// A decoded frame; a Gaussian that is not drawn has the least opacity.
    pub fn decoded(
        gaussians: &[Gaussian],
        sh_rest: &[f32],
        degree: ShDegree,
        activation: Activation,
    ) -> Self {
        let scales = gaussians.iter().flat_map(|g| g.scale);
        Self {
            means: gaussians.iter().flat_map(|g| g.position).collect(),
            scales: scales.map(|scale| activation.of_linear_scale(scale)).collect(),
            quats: gaussians.iter().flat_map(|g| g.rotation).collect(),
            opacities: gaussians.iter().map(|g| activation.of_linear_opacity(g.opacity)).collect(),
            sh0: gaussians.iter().flat_map(|g| g.sh0).collect(),
            sh_rest: sh_rest.to_vec(),
            each: degree.rest_len() / 3,
        }
    }

    /// The `dgs.Gaussians`, which are drawn with `footprint`.
    pub fn into_python(self, py: Python<'_>, footprint: Footprint) -> PyResult<Bound<'_, PyAny>> {
        let n = self.opacities.len();
        let arrays = (
            array(py, self.means, &[n, 3])?,
            array(py, self.scales, &[n, 3])?,
            array(py, self.quats, &[n, 4])?,
            array(py, self.opacities, &[n])?,
            array(py, self.sh0, &[n, 1, 3])?,
            array(py, self.sh_rest, &[n, self.each, 3])?,
        );
        let gaussians = py.import("dgs._gaussians")?.getattr("Gaussians")?.call1(arrays)?;
        gaussians.setattr(FOOTPRINT, footprint.name())?;
        Ok(gaussians)
    }
}

/// The array called `name` of a mapping or an object; `None` where it has none.
fn field<'py>(source: &Bound<'py, PyAny>, name: &str) -> PyResult<Option<Bound<'py, PyAny>>> {
    let found = match source.cast::<PyMapping>() {
        Ok(mapping) if mapping.contains(name)? => Some(mapping.get_item(name)?),
        Ok(_) => None,
        Err(_) => source.getattr_opt(name)?,
    };
    Ok(found.filter(|value| !value.is_none()))
}

/// What `source` says of how it is drawn, if it does.
pub fn footprint(source: &Bound<'_, PyAny>) -> PyResult<Option<String>> {
    field(source, FOOTPRINT)?.map(|name| name.extract()).transpose()
}

/// The array called `name`, which must be there.
pub fn needed<'py>(source: &Bound<'py, PyAny>, name: &str) -> PyResult<Bound<'py, PyAny>> {
    let kind = source.get_type();
    field(source, name)?.ok_or_else(|| {
        refused(format!("{kind} has no {name}; dgs.Gaussians, or a mapping with {NAMES:?}, is wanted"))
    })
}

/// Gaussians as a renderer takes them, and the shapes that their arrays had.
pub struct Splatting {
    /// N Gaussians.
    pub gaussians: Vec<Gaussian>,
    sh_rest: Vec<f32>,
    degree: ShDegree,
    shapes: Vec<Vec<usize>>,
}

impl Splatting {
    /// Reads the arrays of `source`.
    pub fn read(source: &Bound<'_, PyAny>, activation: Activation) -> PyResult<Self> {
        let means = Numbers::<f32>::read("means", &needed(source, "means")?)?;
        let &[n, 3] = &means.shape[..] else { return Err(means.misshapen("[N, 3]")) };
        let rows = |numbers: Numbers<f32>, tail: &[usize]| {
            let is_wanted =
                numbers.shape.split_first().is_some_and(|(&rows, rest)| rows == n && rest == tail);
            let wanted: Vec<usize> = [n].iter().chain(tail).copied().collect();
            if is_wanted { Ok(numbers) } else { Err(numbers.misshapen(format!("{wanted:?}"))) }
        };
        let scales = rows(Numbers::read("scales", &needed(source, "scales")?)?, &[3])?;
        let quats = rows(Numbers::read("quats", &needed(source, "quats")?)?, &[4])?;
        let opacities = rows(opacities(source, activation)?, &[])?;
        if activation == Activation::Linear {
            scales.check("scales of at least 0", |v| v >= 0.0)?;
            opacities.check("opacities of 0 to 1", |v| (0.0..=1.0).contains(&v))?;
        }
        let sh0 = Numbers::<f32>::read("sh0", &needed(source, "sh0")?)?;
        if sh0.shape != [n, 3] && sh0.shape != [n, 1, 3] {
            return Err(sh0.misshapen(format!("[{n}, 1, 3] or [{n}, 3]")));
        }
        let bands = higher_bands(source, n)?;
        let degree = degree_of(bands.shape[1]).unwrap_or_default();
        let shapes = [&means, &scales, &quats, &opacities, &sh0, &bands].map(|n| n.shape.clone()).to_vec();
        let (scales, quats, sh0) = (scales.rows::<3>(), quats.rows::<4>(), sh0.rows::<3>());
        let gaussians = means.rows::<3>().into_iter().enumerate().map(|(i, position)| Gaussian {
            position,
            scale: scales[i].map(|scale| activation.to_linear_scale(scale)),
            rotation: quats[i],
            opacity: activation.to_linear_opacity(opacities.values[i]),
            sh0: sh0[i],
        });
        Ok(Self { gaussians: gaussians.collect(), sh_rest: bands.values, degree, shapes })
    }

    /// Moves opacities of 0 and 1 and scales of 0 inside by [`INSIDE`]: at the ends themselves the gradients
    /// of logits and logarithms are 0, and say nothing of those of what they stand for.
    pub fn move_inside(&mut self) {
        for gaussian in &mut self.gaussians {
            gaussian.opacity = gaussian.opacity.clamp(INSIDE, 1.0 - INSIDE);
            gaussian.scale = gaussian.scale.map(|scale| scale.max(INSIDE));
        }
    }

    /// What a renderer takes.
    pub fn splats(&self) -> PyResult<Splats<'_>> {
        Splats::new(&self.gaussians, &self.sh_rest, self.degree).map_err(refused)
    }

    /// Arrays in the order of [`NAMES`], each in the shape that came in, by name.
    pub fn dictionary<'py>(&self, py: Python<'py>, arrays: [Vec<f32>; 6]) -> PyResult<Bound<'py, PyDict>> {
        let out = PyDict::new(py);
        for ((name, values), shape) in NAMES.into_iter().zip(arrays).zip(&self.shapes) {
            out.set_item(name, array(py, values, shape)?)?;
        }
        Ok(out)
    }
}

/// The opacities of `source`; logits may be infinite.
pub fn opacities(source: &Bound<'_, PyAny>, activation: Activation) -> PyResult<Numbers<f32>> {
    let value = needed(source, "opacities")?;
    match activation {
        Activation::Log => Numbers::read_unbounded("opacities", &value),
        Activation::Linear => Numbers::read("opacities", &value),
    }
}

/// The higher bands of `n` Gaussians of `source`, [n, K, 3]; K is 0 where there are none.
pub fn higher_bands(source: &Bound<'_, PyAny>, n: usize) -> PyResult<Numbers<f32>> {
    let Some(value) = field(source, "shN")? else {
        return Ok(Numbers { field: "shN", shape: vec![n, 0, 3], values: Vec::new() });
    };
    let numbers = Numbers::<f32>::read("shN", &value)?;
    match numbers.shape[..] {
        [rows, each, 3] if rows == n && degree_of(each).is_some() => Ok(numbers),
        _ => Err(numbers.misshapen(format!("[{n}, K, 3] with K 0, 3, 8 or 15, the same at every frame,"))),
    }
}
