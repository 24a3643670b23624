//! Reads Gaussians that a network moves, as trainings of 4D Gaussian Splatting and of Deformable 3D Gaussians
//! leave them, and evaluates the network frame by frame.
//!
//! The network is an npz or safetensors file of the arrays that `state_dict()` names. The Gaussians are in
//! `point_cloud.ply`, where the trainers write it, or in the same file under the names of the model (`_xyz`,
//! `_features_dc`, `_features_rest`, `_scaling`, `_rotation`, `_opacity`). Sizes of networks and planes
//! follow from the arrays; what moves at all is in `cfg_args`. Times go from 0 to 1, both included. Axes are
//! kept: those of the cameras it was trained with.
//!
//! Higher harmonics cannot change over an epoch: where the network moves them their mean is kept, and a note.

mod deformed;
mod layers;
mod options;
mod planes;
mod warp;

use codec_core::ShDegree;
use rayon::prelude::*;

use self::{
    deformed::{Canonical, Deformed},
    options::FieldOptions,
    planes::Planes,
    warp::Warp,
};
use super::{
    Limits,
    error::{Format, ImportError},
    ply,
    snapshot::{Columns, scene_error},
    tensors::Tensors,
};
use crate::scene::{Attributes, Epoch, Scene, Track};

const FORMAT: Format = Format::Deformation;
/// Frames where nobody says how many.
pub const DEFAULT_FRAMES: usize = 60;
/// Bytes that a Gaussian takes in one frame: position, rotation, size, opacity, colour.
const FRAME_BYTES: u64 = 12 + 16 + 12 + 4 + 12;

/// What lies beside the file of a network.
#[derive(Clone, Copy, Debug, Default)]
pub struct SidecarFiles<'a> {
    /// The Gaussians, as PLY.
    pub gaussians: Option<&'a [u8]>,
    /// The options of the training: `cfg_args`, or JSON of the same names.
    pub options: Option<&'a [u8]>,
}

/// A network that moves Gaussians.
enum Field {
    Planes(Box<Planes>),
    Warp(Box<Warp>),
}

/// Whether a file holds such a network.
pub(super) fn is_in(tensors: &Tensors<'_>) -> bool {
    std::iter::once(planes::MARK).chain(warp::MARKS).any(|mark| tensors.has(mark))
}

/// Reads the network in `bytes` and what it moves, at `frames` times.
///
/// # Errors
/// Arrays that are missing, misshapen or of a kind of network that is not read, no Gaussians, values that are
/// not numbers, or more than `limits` allow.
pub fn parse(
    bytes: &[u8],
    beside: SidecarFiles<'_>,
    frames: usize,
    frames_per_second: f64,
    limits: &Limits,
) -> Result<Scene, ImportError> {
    let mut tensors = Tensors::open(bytes, limits, FORMAT)?;
    let mut notes = Vec::new();
    let columns = match beside.gaussians {
        Some(ply) => {
            let (columns, ply_notes) = ply::columns(ply, limits)?;
            notes.extend(ply_notes);
            columns
        }
        None => own_gaussians(&mut tensors, limits)?,
    };
    let n = limits.gaussians(FORMAT, columns.positions.len() as u64)?;
    if frames == 0 {
        return Err(FORMAT.empty("frames"));
    }
    limits.bytes(FORMAT, "frames", (frames as u64 * FRAME_BYTES).saturating_mul(n as u64))?;
    let field = read_field(&mut tensors, beside.options, &columns, &mut notes)?;
    let (epoch, spread) = deformed_epoch(&field, columns, frames, limits)?;
    if spread > 0.0 {
        notes.push(format!("higher harmonics move by up to {spread:.3}; their mean over the frames is kept"));
    }
    notes.push(format!("evaluated at {frames} times from 0 to 1"));
    let mut scene = Scene::new(vec![epoch], frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes = notes;
    Ok(scene)
}

/// The network, and notes on what is taken for granted.
fn read_field(
    tensors: &mut Tensors<'_>,
    options: Option<&[u8]>,
    columns: &Columns,
    notes: &mut Vec<String>,
) -> Result<Field, ImportError> {
    if !tensors.has(planes::MARK) {
        notes.push("a network of Deformable 3D Gaussians".to_owned());
        return Warp::read(tensors).map(|warp| Field::Warp(Box::new(warp)));
    }
    let options = match options {
        Some(text) => FieldOptions::parse(text)?,
        None => {
            notes.push(
                "no cfg_args: position, size and rotation are taken to move, opacity and colour to stay"
                    .to_owned(),
            );
            FieldOptions::default()
        }
    };
    let planes = Planes::read(tensors, &options)?;
    if planes.moves_harmonics() && columns.sh_degree != ShDegree::MAX {
        let found = columns.sh_degree.get();
        return Err(FORMAT.malformed("harmonics of the Gaussians", found, "degree 3, as the network moves"));
    }
    notes.push("a network of 4D Gaussian Splatting".to_owned());
    Ok(Field::Planes(Box::new(planes)))
}

/// The Gaussians that are in the same file.
fn own_gaussians(tensors: &mut Tensors<'_>, limits: &Limits) -> Result<Columns, ImportError> {
    if !tensors.has("_xyz") {
        let allowed = "point_cloud.ply where the trainer writes it, or _xyz and the like in the same file";
        return Err(FORMAT.malformed("Gaussians", "none", allowed));
    }
    let positions = tensors.get("_xyz")?;
    let &[n, 3] = &positions.shape[..] else {
        return Err(FORMAT.malformed("shape of _xyz", format!("{:?}", positions.shape), "N x 3"));
    };
    limits.gaussians(FORMAT, n as u64)?;
    let mut values = |name: &str, shape: &[usize]| -> Result<Vec<f32>, ImportError> {
        Ok(tensors.get(name)?.expect(FORMAT, name, shape)?.values)
    };
    let sh0 = values("_features_dc", &[n, 1, 3])?;
    let log_scales = values("_scaling", &[n, 3])?;
    let rotations = values("_rotation", &[n, 4])?;
    let opacity_logits = values("_opacity", &[n, 1])?;
    let rest = tensors.get("_features_rest")?;
    let degree = match rest.shape[..] {
        [count, coefficients, 3] if count == n => {
            [0, 3, 8, 15].iter().position(|&allowed| allowed == coefficients)
        }
        _ => None,
    };
    let degree = degree.and_then(|degree| ShDegree::new(degree as u8)).ok_or_else(|| {
        let found = format!("{:?}", rest.shape);
        FORMAT.malformed("shape of _features_rest", found, format_args!("{n} x 0, 3, 8 or 15 x 3"))
    })?;
    Ok(Columns {
        positions: positions.values.as_chunks().0.to_vec(),
        rotations: rotations.as_chunks().0.to_vec(),
        log_scales: log_scales.as_chunks().0.to_vec(),
        opacity_logits,
        sh0: sh0.as_chunks().0.to_vec(),
        sh_rest: rest.values,
        sh_degree: degree,
    })
}

/// The Gaussians at all times, and how far a higher harmonic goes from where it was first.
fn deformed_epoch(
    field: &Field,
    columns: Columns,
    frames: usize,
    limits: &Limits,
) -> Result<(Epoch, f32), ImportError> {
    let n = columns.positions.len();
    let rest_len = columns.sh_degree.rest_len();
    let canonical = |i: usize| Canonical {
        position: columns.positions[i],
        rotation: columns.rotations[i],
        log_scale: columns.log_scales[i],
        opacity_logit: columns.opacity_logits[i],
        sh0: columns.sh0[i],
        sh_rest: &columns.sh_rest[i * rest_len..(i + 1) * rest_len],
    };
    let static_features: Vec<Vec<f32>> = match field {
        Field::Warp(_) => Vec::new(),
        Field::Planes(planes) => {
            let bytes = (n as u64).saturating_mul(4 * planes.static_feature_count() as u64);
            limits.bytes(FORMAT, "features", bytes)?;
            (0..n).into_par_iter().map(|i| planes.static_features(columns.positions[i])).collect()
        }
    };
    let mut attributes = Attributes {
        positions: Track::PerFrame(Vec::new()),
        rotations: Track::PerFrame(Vec::new()),
        log_scales: Track::PerFrame(Vec::new()),
        opacity_logits: Track::PerFrame(Vec::new()),
        sh0: Track::PerFrame(Vec::new()),
        sh_rest: Vec::new(),
        sh_degree: columns.sh_degree,
    };
    let mut harmonics = Harmonics::default();
    for frame in 0..frames {
        let time = if frames == 1 { 0.0 } else { frame as f32 / (frames - 1) as f32 };
        let gaussians: Vec<Deformed> = match field {
            Field::Planes(planes) => {
                (0..n).into_par_iter().map(|i| planes.at(&canonical(i), &static_features[i], time)).collect()
            }
            Field::Warp(warp) => {
                let of_time = warp.encode_time(time);
                (0..n).into_par_iter().map(|i| warp.at(&canonical(i), &of_time)).collect()
            }
        };
        append(&mut attributes.positions, gaussians.iter().map(|g| g.position));
        append(&mut attributes.rotations, gaussians.iter().map(|g| g.rotation));
        append(&mut attributes.log_scales, gaussians.iter().map(|g| g.log_scale));
        append(&mut attributes.opacity_logits, gaussians.iter().map(|g| g.opacity_logit));
        let moving = gaussians.iter().any(|g| !g.harmonics.is_empty());
        if moving {
            append(
                &mut attributes.sh0,
                gaussians.iter().map(|g| [g.harmonics[0], g.harmonics[1], g.harmonics[2]]),
            );
            harmonics.add(&gaussians);
        } else {
            append(&mut attributes.sh0, columns.sh0.iter().copied());
        }
    }
    let spread = harmonics.spread;
    attributes.sh_rest = harmonics.mean(frames).unwrap_or(columns.sh_rest);
    let epoch = Epoch::new(frames, attributes).map_err(|e| scene_error(FORMAT, &e))?;
    Ok((epoch, spread))
}

fn append<T>(track: &mut Track<T>, values: impl Iterator<Item = T>) {
    match track {
        Track::Constant(all) | Track::PerFrame(all) => all.extend(values),
    }
}

/// Higher harmonics over the frames.
#[derive(Default)]
struct Harmonics {
    first: Vec<f32>,
    sums: Vec<f64>,
    spread: f32,
}

impl Harmonics {
    fn add(&mut self, gaussians: &[Deformed]) {
        let rest: Vec<f32> = gaussians.iter().flat_map(|g| &g.harmonics[3..]).copied().collect();
        if self.sums.is_empty() {
            self.sums = vec![0.0; rest.len()];
            self.first.clone_from(&rest);
        }
        for ((sum, value), first) in self.sums.iter_mut().zip(&rest).zip(&self.first) {
            *sum += f64::from(*value);
            self.spread = self.spread.max((value - first).abs());
        }
    }

    /// Their mean, if any were added.
    fn mean(&self, frames: usize) -> Option<Vec<f32>> {
        let mean = |sum: &f64| (sum / frames as f64) as f32;
        (!self.sums.is_empty()).then(|| self.sums.iter().map(mean).collect())
    }
}

#[cfg(test)]
#[path = "deformation/tests.rs"]
pub(super) mod tests;
