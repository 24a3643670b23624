//! Reads coloured points with cameras from a NumPy archive, as splat trainers start from; or what gsplat has
//! made of such, which may be a safetensors file too.
//!
//! Members `means3d` (N×3 floats) and `colors` (N×3 whole numbers of 0 to 255, or floats of 0 to 1) are
//! needed; `viewmats` (C×3×4 or C×4×4 world-to-camera), `Ks` (C×3×3), `width` and `height` make cameras
//! where all four are there. Each point becomes a round Gaussian: standard deviation half the root mean
//! square distance to its three nearest, at most ten times the median (far outliers have no neighbours),
//! opacity 0.9. Axes are those of the points (OpenCV cameras).
//!
//! Shapes are checked against the limits before any value is unpacked, and memory grows with the values
//! that have been.

pub(super) mod gsplat;
pub(super) mod npy;

use codec_core::ShDegree;
use rayon::prelude::*;
use render_host::Camera;

use self::npy::{Array, Element};
use super::{
    Limits,
    archive::Archive,
    error::{Format, ImportError},
    nearest::Tree,
    snapshot::{Columns, keep, left_out, logit, scene_error, sh0_of_colour},
    tensors::Tensors,
};
use crate::scene::Scene;

const FORMAT: Format = Format::PointsNpz;
const MAX_CAMERAS: usize = 100_000;
/// How far beyond 0 to 1 a colour of floats may be: what rounding to half precision makes of 1.
const ROUNDING: f64 = 1e-3;
/// Neighbours that decide the size of a Gaussian.
const NEIGHBOURS: usize = 3;

/// Reads the archive as a scene of one frame.
///
/// # Errors
/// A damaged file, a missing or misshapen array, or more than `limits` allow.
pub fn parse(bytes: &[u8], frames_per_second: f64, limits: &Limits) -> Result<Scene, ImportError> {
    let tensors = Tensors::open(bytes, limits, FORMAT)?;
    if gsplat::is_in(&tensors) {
        return gsplat::parse(tensors, frames_per_second, limits);
    }
    let mut archive = Archive::new(bytes, limits, FORMAT)?;
    let mut positions = positions(&mut archive, limits)?;
    let mut sh0 = colours(&mut archive, positions.len(), limits)?;
    let mut notes = Vec::new();
    if limits.keep_readable {
        // Before sizes are taken from them: a place that is no number is near to nothing.
        let pairs = positions.iter().zip(&sh0);
        let readable: Vec<bool> = pairs.map(|(p, c)| p.iter().chain(c).all(|v| v.is_finite())).collect();
        notes.extend(left_out(readable.iter().filter(|r| !**r).count()));
        keep(&mut positions, &readable, 1);
        keep(&mut sh0, &readable, 1);
    }
    let count = positions.len();
    let mut columns = Columns::with_capacity(0, ShDegree::ZERO);
    columns.sh0 = sh0;
    columns.log_scales.extend(sizes(&positions).into_iter().map(|s| [s.ln(); 3]));
    columns.positions = positions;
    columns.rotations.resize(count, [1.0, 0.0, 0.0, 0.0]);
    columns.opacity_logits.resize(count, logit(0.9));

    let cameras = if ["viewmats", "Ks", "width", "height"].iter().all(|m| archive.has(&format!("{m}.npy"))) {
        cameras(&mut archive)?
    } else {
        notes.push("no cameras: viewmats, Ks, width and height are not all there".to_owned());
        Vec::new()
    };
    let snapshot = columns.finish(FORMAT, limits, notes)?;
    let mut scene =
        Scene::new(vec![snapshot.epoch], frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.cameras = cameras;
    scene.notes = snapshot.notes;
    Ok(scene)
}

/// The points, all of them finite unless `keep_readable`.
fn positions(archive: &mut Archive<'_>, limits: &Limits) -> Result<Vec<[f32; 3]>, ImportError> {
    let means = Array::open(archive, "means3d")?;
    let &[n, 3] = means.shape() else { return Err(means.misshapen("N x 3")) };
    limits.gaussians(FORMAT, n as u64)?;
    let mut points: Vec<[f32; 3]> = Vec::new();
    means.rows(3, |v| points.push([v[0] as f32, v[1] as f32, v[2] as f32]))?;
    let bad = points.iter().position(|p| p.iter().any(|v| !v.is_finite()));
    if let Some(i) = bad.filter(|_| !limits.keep_readable) {
        return Err(FORMAT.malformed(format!("means3d[{i}]"), "a value that is not finite", "finite values"));
    }
    Ok(points)
}

/// Band-0 coefficients of `count` points, whose colours are in range unless `keep_readable`.
fn colours(archive: &mut Archive<'_>, count: usize, limits: &Limits) -> Result<Vec<[f32; 3]>, ImportError> {
    let colours = Array::open(archive, "colors")?;
    if colours.shape() != [count, 3] {
        return Err(colours.misshapen(&format!("{count} x 3")));
    }
    let (full, low, high, allowed) = match colours.element() {
        Element::U8 | Element::I32 | Element::I64 => (255.0, 0.0, 255.0, "whole numbers of 0 to 255"),
        Element::F16 | Element::F32 | Element::F64 => {
            (1.0, -ROUNDING, 1.0 + ROUNDING, "floats of 0 to 1; colours of 0 to 255 are whole numbers")
        }
    };
    let mut out = Vec::new();
    let mut beyond = None;
    colours.rows(3, |v| {
        if beyond.is_none() && !v.iter().all(|c| (low..=high).contains(c)) {
            beyond = Some((out.len(), format!("{v:?}")));
        }
        out.push([v[0], v[1], v[2]].map(|c| sh0_of_colour((c / full) as f32)));
    })?;
    if let Some((index, found)) = beyond.filter(|_| !limits.keep_readable) {
        return Err(FORMAT.malformed(format!("colors[{index}]"), found, allowed));
    }
    Ok(out)
}

/// A standard deviation for each point from the distances to its neighbours.
fn sizes(points: &[[f32; 3]]) -> Vec<f32> {
    let tree = Tree::new(points);
    let size = |i: usize| {
        let near = tree.nearest(points[i], NEIGHBOURS, |j| j != i);
        let mean = near.iter().map(|n| n.0).sum::<f64>() / near.len().max(1) as f64;
        (0.5 * mean.sqrt()) as f32
    };
    let mut sizes: Vec<f32> = (0..points.len()).into_par_iter().map(size).collect();
    let mut sorted = sizes.clone();
    sorted.sort_by(f32::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().filter(|m| *m > 0.0).unwrap_or(0.01);
    for size in &mut sizes {
        *size = size.clamp(median * 0.01, median * 10.0);
    }
    sizes
}

fn cameras(archive: &mut Archive<'_>) -> Result<Vec<Camera>, ImportError> {
    let views = Array::open(archive, "viewmats")?;
    let (count, rows) = match *views.shape() {
        [count, rows @ (3 | 4), 4] if count <= MAX_CAMERAS => (count, rows),
        _ => return Err(views.misshapen(&format!("C x 3 x 4 or C x 4 x 4, C up to {MAX_CAMERAS}"))),
    };
    let views = views.values()?;
    let intrinsics = Array::open(archive, "Ks")?;
    if intrinsics.shape() != [count, 3, 3] {
        return Err(intrinsics.misshapen(&format!("{count} x 3 x 3")));
    }
    let intrinsics = intrinsics.values()?;
    let [width, height] = [side(archive, "width")?, side(archive, "height")?];
    let camera = |c: usize| {
        let view = &views[c * rows * 4..];
        let k = &intrinsics[c * 9..];
        let mut world_to_camera = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (row, target) in world_to_camera.iter_mut().enumerate().take(3) {
            target.copy_from_slice(&view[row * 4..row * 4 + 4]);
        }
        let k = [[k[0], k[1], k[2]], [k[3], k[4], k[5]], [k[6], k[7], k[8]]];
        Camera::from_opencv(k, world_to_camera, width as u32, height as u32)
            .map_err(|e| FORMAT.malformed(format!("camera {c}"), e, "a pinhole camera"))
    };
    (0..count).map(camera).collect()
}

/// Width or height of all images, pixels: one number, or one per camera of which the first counts.
fn side(archive: &mut Archive<'_>, name: &str) -> Result<f64, ImportError> {
    let array = Array::open(archive, name)?;
    match *array.shape() {
        [] => {}
        [count] if (1..=MAX_CAMERAS).contains(&count) => {}
        _ => return Err(array.misshapen("one number, or one per camera")),
    }
    Ok(array.values()?.first().copied().unwrap_or(0.0))
}

#[cfg(test)]
pub(super) mod tests {
    use std::io::{Cursor, Write};

    use super::*;
    use crate::scene::import::ErrorKind;

    fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
        let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
        let mut out = b"\x93NUMPY\x01\x00".to_vec();
        out.extend((header.len() as u16).to_le_bytes());
        out.extend(header.bytes());
        out.extend(data);
        out
    }

    fn floats(values: &[f32]) -> Vec<u8> {
        values.iter().flat_map(|v| v.to_le_bytes()).collect()
    }

    pub fn files() -> Vec<(&'static str, Vec<u8>)> {
        vec![
            ("means3d", npy("<f4", "(4, 3)", &floats(&[0., 0., 0., 1., 0., 0., 0., 1., 0., 0., 0., 1.]))),
            ("colors", npy("|u1", "(4, 3)", &[255, 0, 128, 0, 0, 0, 10, 20, 30, 40, 50, 60])),
            ("viewmats", npy("<f4", "(1, 3, 4)", &floats(&[1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 5.]))),
            ("Ks", npy("<f4", "(1, 3, 3)", &floats(&[100., 0., 50., 0., 100., 40., 0., 0., 1.]))),
            ("width", npy("<i8", "()", &100i64.to_le_bytes())),
            ("height", npy("<i8", "()", &80i64.to_le_bytes())),
        ]
    }

    pub fn zipped(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in files {
            zip.start_file(format!("{name}.npy"), zip::write::SimpleFileOptions::default()).unwrap();
            zip.write_all(bytes).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    pub fn sample() -> Vec<u8> {
        zipped(&files())
    }

    /// The sample with one member replaced.
    fn with(name: &str, bytes: Vec<u8>) -> Result<Scene, ImportError> {
        let mut files = files();
        files.iter_mut().find(|f| f.0 == name).unwrap().1 = bytes;
        parse(&zipped(&files), 30.0, &Limits::default())
    }

    #[test]
    fn points_become_round_gaussians_with_cameras() {
        let scene = parse(&sample(), 30.0, &Limits::default()).unwrap();
        let g = scene.instant(0).unwrap().gaussians;
        assert_eq!(g.len(), 4);
        assert!((g[0].scale[0] - 0.5).abs() < 1e-6, "three neighbours at distance 1: {:?}", g[0].scale);
        assert!((0.5 + 0.282_094_8 * g[0].sh0[0] - 1.0).abs() < 1e-6);
        assert_eq!(scene.cameras.len(), 1);
        assert_eq!(scene.cameras[0].translation(), [0.0, 0.0, 5.0]);
    }

    /// 0 to 255 in any type of whole numbers, 0 to 1 in any of floats.
    #[test]
    fn colours_are_of_their_type_and_in_its_range() {
        let whole = [255i64, 0, 128, 0, 0, 0, 10, 20, 30, 40, 50, 60];
        let as_i64 = |values: &[i64]| {
            npy("<i8", "(4, 3)", &values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>())
        };
        let as_f32 = |values: &[f32]| npy("<f4", "(4, 3)", &floats(values));
        let sh0 = |scene: Scene| scene.epochs()[0].attributes().sh0.clone();
        let plain = sh0(parse(&sample(), 30.0, &Limits::default()).unwrap());
        assert_eq!(sh0(with("colors", as_i64(&whole)).unwrap()), plain);
        let unit: Vec<f32> = whole.iter().map(|&v| (v as f64 / 255.0) as f32).collect();
        assert_eq!(sh0(with("colors", as_f32(&unit)).unwrap()), plain);
        let mut rounded = unit.clone();
        rounded[0] = 1.000_9;
        assert!(with("colors", as_f32(&rounded)).is_ok());

        for (at, value) in [(3, 256), (8, -1)] {
            let mut wrong = whole;
            wrong[at] = value;
            let error = with("colors", as_i64(&wrong)).unwrap_err().to_string();
            assert!(error.contains(&format!("colors[{}]", at / 3)) && error.contains("0 to 255"), "{error}");
        }
        for value in [200.0, -0.01, f32::NAN] {
            let mut wrong = unit.clone();
            wrong[9] = value;
            let error = with("colors", as_f32(&wrong)).unwrap_err().to_string();
            assert!(error.contains("colors[3]") && error.contains("floats of 0 to 1"), "{error}");
        }
    }

    #[test]
    fn points_that_are_no_numbers_are_left_out_before_sizes_are_taken() {
        let mut files = files();
        let points = [0., 0., 0., 1., 0., 0., f32::NAN, 1., 0., 0., 0., 1.];
        files[0].1 = npy("<f4", "(4, 3)", &floats(&points));
        let read = |keep_readable| {
            let limits = Limits { keep_readable, ..Limits::default() };
            parse(&zipped(&files), 30.0, &limits)
        };
        assert!(read(false).unwrap_err().to_string().contains("means3d[2]"));
        let scene = read(true).unwrap();
        let g = scene.instant(0).unwrap().gaussians;
        assert_eq!((g.len(), g[2].position), (3, [0.0, 0.0, 1.0]));
        assert!((g[0].scale[0] - 0.5).abs() < 1e-6, "two neighbours at distance 1: {:?}", g[0].scale);
        assert!((0.5 + 0.282_094_8 * g[2].sh0[0] - 40.0 / 255.0).abs() < 1e-6);
        assert!(scene.notes[0].starts_with("1 Gaussians left out"), "{:?}", scene.notes);
    }

    #[test]
    fn arrays_shorter_than_their_shape_are_refused() {
        let short = with("means3d", npy("<f4", "(4, 3)", &[0; 12])).unwrap_err();
        assert_eq!(short.kind, ErrorKind::Truncated, "{short}");
        assert!(short.to_string().contains("means3d.npy: found 12 bytes; allowed: 48 bytes"), "{short}");
        assert!(with("means3d", npy(">f4", "(4, 3)", &[0; 48])).is_err());
    }

    #[test]
    fn shapes_are_refused_before_values_are_read() {
        // None of these has the values it claims: with a limit asked later they would be truncated.
        let many = with("means3d", npy("<f4", "(89000000, 3)", &[])).unwrap_err();
        assert_eq!(many.kind, ErrorKind::TooLarge, "{many}");
        let huge = with("means3d", npy("<f8", "(18446744073709551615, 3)", &[])).unwrap_err();
        assert_eq!(huge.kind, ErrorKind::TooLarge, "{huge}");
        for (member, shape) in [("colors", "(5, 3)"), ("viewmats", "(100001, 3, 4)"), ("width", "(9, 9)")] {
            let error = with(member, npy("<f8", shape, &[])).unwrap_err();
            assert!(error.to_string().contains(&format!("shape of {member}")), "{error}");
        }
    }
}
