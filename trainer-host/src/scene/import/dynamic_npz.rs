//! Reads what Dynamic 3D Gaussians trains: `params.npz`, in which every Gaussian lives through the clip, or
//! the same arrays in a safetensors file.
//!
//! Arrays: `means3D` (T×N×3), `unnorm_rotations` (T×N×4, wxyz), `rgb_colors` (T×N×3 or N×3, display colour),
//! `logit_opacities` (N×1), `log_scales` (N×3 or N×1). Others are skipped. Axes are kept: those of the
//! cameras it was trained with, y down.

use codec_core::ShDegree;

use super::{
    Limits,
    error::{Format, ImportError},
    snapshot::{finished, scene_error, sh0_of_colour},
    tensors::Tensors,
};
use crate::scene::{Attributes, Scene, Track};

const FORMAT: Format = Format::DynamicNpz;
/// An array that only files of this kind have.
pub(super) const MARK: &str = "unnorm_rotations";
/// Bytes that a Gaussian takes in one frame: position, rotation, colour.
const FRAME_BYTES: u64 = 12 + 16 + 12;

/// Reads an npz or safetensors file as a scene of one epoch.
///
/// # Errors
/// A damaged file, a missing or misshapen array, values that are not numbers (unless `keep_readable`), or
/// more than `limits` allow.
pub fn parse(bytes: &[u8], frames_per_second: f64, limits: &Limits) -> Result<Scene, ImportError> {
    let mut tensors = Tensors::open(bytes, limits, FORMAT)?;
    let means = tensors.unread("means3D")?;
    let &[frames, n, 3] = means.shape() else { return Err(means.misshapen("T x N x 3")) };
    limits.gaussians(FORMAT, n as u64)?;
    limits.gaussians(FORMAT, frames as u64)?;
    limits.bytes(FORMAT, "frames", (frames as u64 * FRAME_BYTES).saturating_mul(n as u64))?;
    let mut positions: Vec<[f32; 3]> = Vec::new();
    means.rows(3, |v| positions.push(three(v)))?;

    let array = tensors.unread("unnorm_rotations")?;
    if array.shape() != [frames, n, 4] {
        return Err(array.misshapen(&format!("{frames} x {n} x 4")));
    }
    let mut rotations: Vec<[f32; 4]> = Vec::new();
    array.rows(4, |v| rotations.push([0, 1, 2, 3].map(|i| v[i] as f32)))?;

    let array = tensors.unread("rgb_colors")?;
    let is_still = array.shape() == [n, 3];
    if !is_still && array.shape() != [frames, n, 3] {
        return Err(array.misshapen(&format!("{frames} x {n} x 3 or {n} x 3")));
    }
    let mut sh0: Vec<[f32; 3]> = Vec::new();
    array.rows(3, |v| sh0.push(three(v).map(sh0_of_colour)))?;

    let array = tensors.unread("logit_opacities")?;
    if array.shape() != [n, 1] && array.shape() != [n] {
        return Err(array.misshapen(&format!("{n} x 1")));
    }
    let mut opacity_logits: Vec<f32> = Vec::new();
    array.rows(1, |v| opacity_logits.push(v[0] as f32))?;

    let array = tensors.unread("log_scales")?;
    let mut log_scales: Vec<[f32; 3]> = Vec::new();
    match *array.shape() {
        [count, 3] if count == n => array.rows(3, |v| log_scales.push(three(v)))?,
        [count, 1] if count == n => array.rows(1, |v| log_scales.push([v[0] as f32; 3]))?,
        _ => return Err(array.misshapen(&format!("{n} x 3 or {n} x 1"))),
    }
    let attributes = Attributes {
        positions: Track::PerFrame(positions),
        rotations: Track::PerFrame(rotations),
        log_scales: Track::Constant(log_scales),
        opacity_logits: Track::Constant(opacity_logits),
        sh0: if is_still { Track::Constant(sh0) } else { Track::PerFrame(sh0) },
        sh_rest: Vec::new(),
        sh_degree: ShDegree::ZERO,
    };
    let mut notes = Vec::new();
    let epoch = finished(frames, n, attributes, FORMAT, limits, &mut notes)?;
    let mut scene = Scene::new(vec![epoch], frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes = notes;
    Ok(scene)
}

fn three(v: &[f64]) -> [f32; 3] {
    [v[0] as f32, v[1] as f32, v[2] as f32]
}

#[cfg(test)]
pub(super) mod tests {
    use std::io::{Cursor, Write};

    use safetensors::{Dtype, tensor::TensorView};

    use super::*;

    /// An archive of members: name, shape, values; `edit` may change a shape.
    pub fn archive(members: &[(&str, &str, &[f32])], edit: impl Fn(&str, &str) -> String) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, shape, values) in members {
            let shape = edit(name, shape);
            let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({shape}), }}\n");
            zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            zip.write_all(b"\x93NUMPY\x01\x00").unwrap();
            zip.write_all(&(header.len() as u16).to_le_bytes()).unwrap();
            zip.write_all(header.as_bytes()).unwrap();
            zip.write_all(&values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>()).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    /// The arrays `names` of an npz as a safetensors file.
    pub fn safetensors_of(npz: &[u8], names: &[&str]) -> Vec<u8> {
        let limits = Limits::default();
        let mut arrays = Tensors::open(npz, &limits, FORMAT).unwrap();
        let read: Vec<(&str, Vec<usize>, Vec<u8>)> = names
            .iter()
            .map(|&name| {
                let array = arrays.get(name).unwrap();
                (name, array.shape, array.values.iter().flat_map(|v| v.to_le_bytes()).collect())
            })
            .collect();
        let views = read
            .iter()
            .map(|(name, shape, bytes)| (*name, TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap()));
        safetensors::serialize(views.collect::<Vec<_>>(), None).unwrap()
    }

    /// Two frames of two Gaussians; `edit` may change a member's shape.
    pub fn sample(edit: impl Fn(&str, &str) -> String) -> Vec<u8> {
        archive(
            &[
                ("means3D", "2, 2, 3", &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 0.5, 0.0, 0.0, 1.0, 2.0, 1.0]),
                ("unnorm_rotations", "2, 2, 4", &[[2.0, 0.0, 0.0, 0.0]; 4].concat()),
                ("rgb_colors", "2, 2, 3", &[[0.25, 0.5, 0.75]; 4].concat()),
                ("logit_opacities", "2, 1", &[0.0, 1.0]),
                ("log_scales", "2, 3", &[-3.0; 6]),
            ],
            edit,
        )
    }

    #[test]
    fn a_clip_keeps_identity() {
        let scene = parse(&sample(|_, shape| shape.to_owned()), 30.0, &Limits::default()).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames(), scene.max_count()), (1, 2, 2));
        let g = scene.instant(1).unwrap().gaussians;
        assert_eq!((g[0].position, g[1].position), ([0.5, 0.0, 0.0], [1.0, 2.0, 1.0]));
        assert_eq!((g[0].rotation, g[0].opacity), ([1.0, 0.0, 0.0, 0.0], 0.5));
        assert!((0.5 + 0.282_094_8 * g[1].sh0[2] - 0.75).abs() < 1e-6);
        assert!(scene.epochs()[0].attributes().sh0.is_constant());
    }

    #[test]
    fn a_safetensors_file_of_the_same_arrays_is_the_same_scene() {
        let npz = sample(|_, shape| shape.to_owned());
        let tensors = safetensors_of(
            &npz,
            &["means3D", "unnorm_rotations", "rgb_colors", "logit_opacities", "log_scales"],
        );
        let [scene, same] = [&npz, &tensors].map(|bytes| parse(bytes, 30.0, &Limits::default()).unwrap());
        assert_eq!(same.instant(1), scene.instant(1));
        assert_eq!((same.frames(), same.max_count(), &same.notes), (2, 2, &scene.notes));
        let without = safetensors_of(&npz, &["means3D", "unnorm_rotations", "logit_opacities", "log_scales"]);
        let error = parse(&without, 30.0, &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("rgb_colors: found nothing"), "{error}");
        let limits = Limits { max_gaussians: 1, ..Limits::default() };
        assert!(parse(&tensors, 30.0, &limits).unwrap_err().to_string().contains("Gaussian count"));
    }

    #[test]
    fn gaussians_that_are_no_numbers_are_left_out_of_all_frames() {
        // The first Gaussian is none in the second frame alone.
        let means = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0, f32::NAN, 0.0, 0.0, 1.0, 2.0, 1.0];
        let members: [(&str, &str, &[f32]); 5] = [
            ("means3D", "2, 2, 3", &means),
            ("unnorm_rotations", "2, 2, 4", &[[2.0, 0.0, 0.0, 0.0]; 4].concat()),
            ("rgb_colors", "2, 3", &[[0.25; 3], [0.75; 3]].concat()),
            ("logit_opacities", "2, 1", &[0.0, 1.0]),
            ("log_scales", "2, 1", &[-3.0, -2.0]),
        ];
        let bad = archive(&members, |_, shape| shape.to_owned());
        assert!(parse(&bad, 30.0, &Limits::default()).unwrap_err().to_string().contains("frame 1"));
        let keep = Limits { keep_readable: true, ..Limits::default() };
        let scene = parse(&bad, 30.0, &keep).unwrap();
        assert_eq!((scene.frames(), scene.max_count()), (2, 1));
        let left = scene.instant(1).unwrap().gaussians[0];
        assert_eq!((left.position, left.scale), ([1.0, 2.0, 1.0], [(-2.0f32).exp(); 3]));
        assert!(left.sh0[0] > 0.0, "{:?}", left.sh0);
        assert!(scene.notes[0].starts_with("1 Gaussians left out"), "{:?}", scene.notes);
    }

    #[test]
    fn shapes_that_contradict_each_other_are_named() {
        for (name, shape) in [
            ("means3D", "4, 3"),
            ("unnorm_rotations", "2, 3, 4"),
            ("rgb_colors", "3, 2, 3"),
            ("logit_opacities", "4, 1"),
            ("log_scales", "2, 2"),
            ("means3D", "99999999999, 99999999999, 3"),
        ] {
            let bytes = sample(|n, s| if n == name { shape.to_owned() } else { s.to_owned() });
            let error = parse(&bytes, 30.0, &Limits::default()).unwrap_err().to_string();
            assert!(error.contains(name) || error.contains("Gaussian count"), "{name}: {error}");
        }
    }
}
