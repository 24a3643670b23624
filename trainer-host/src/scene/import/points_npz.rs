//! Coloured points with cameras in a NumPy archive, as splat trainers start from.
//!
//! Members `means3d` (N×3 floats) and `colors` (N×3 bytes, or floats in 0..=1) are needed; `viewmats`
//! (C×3×4 or C×4×4 world-to-camera), `Ks` (C×3×3), `width` and `height` make cameras where all four
//! are there. Each point becomes a round Gaussian: standard deviation half the root mean square
//! distance to its three nearest, at most ten times the median (far outliers have no neighbours),
//! opacity 0.9. Axes are those of the points (OpenCV cameras).

use rayon::prelude::*;
use render_host::Camera;

use codec_core::gaussian::ShDegree;

use super::{
    Limits,
    archive::Archive,
    bytes::{array, u16_at, u32_at},
    error::{Format, ImportError},
    nearest::Tree,
    snapshot::{Columns, logit, scene_error, sh0_of_colour},
};
use crate::scene::Scene;

const FORMAT: Format = Format::PointsNpz;
const MAX_CAMERAS: usize = 100_000;

/// Reads the archive as a scene of one frame.
///
/// # Errors
/// A damaged archive, a missing or misshapen array, or more than `limits` allow.
pub fn parse(bytes: &[u8], frames_per_second: f64, limits: &Limits) -> Result<Scene, ImportError> {
    let mut archive = Archive::new(bytes, limits, FORMAT)?;
    let mut array = |name: &str| Array::parse(name, &archive.read(&format!("{name}.npy"))?);
    let means = array("means3d")?;
    let colours = array("colors")?;
    let &[n, 3] = &means.shape[..] else { return Err(means.misshapen("means3d", "N x 3")) };
    let count = limits.gaussians(FORMAT, n as u64)?;
    if colours.shape != [n, 3] {
        return Err(colours.misshapen("colors", &format!("{n} x 3")));
    }
    let full = if colours.kind == Kind::U8 { 255.0 } else { 1.0 };

    let mut notes = Vec::new();
    let mut columns = Columns::with_capacity(count, ShDegree::ZERO);
    columns.positions.extend(means.values.chunks_exact(3).map(|v| [v[0] as f32, v[1] as f32, v[2] as f32]));
    if let Some(i) = columns.positions.iter().position(|p| p.iter().any(|v| !v.is_finite())) {
        return Err(FORMAT.malformed(format!("means3d[{i}]"), "a value that is not finite", "finite values"));
    }
    let colour = |v: &[f64]| [v[0], v[1], v[2]].map(|c| sh0_of_colour((c / full) as f32));
    columns.sh0.extend(colours.values.chunks_exact(3).map(colour));
    columns.log_scales.extend(sizes(&columns.positions).into_iter().map(|s| [s.ln(); 3]));
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

/// A standard deviation for each point from the distances to its neighbours.
fn sizes(points: &[[f32; 3]]) -> Vec<f32> {
    const NEIGHBOURS: usize = 3;
    let tree = Tree::new(points);
    let mut sizes: Vec<f32> = (0..points.len())
        .into_par_iter()
        .map(|i| {
            let near = tree.nearest(points[i], NEIGHBOURS, |j| j != i);
            let mean = near.iter().map(|n| n.0).sum::<f32>() / near.len().max(1) as f32;
            0.5 * mean.sqrt()
        })
        .collect();
    let mut sorted = sizes.clone();
    sorted.sort_by(f32::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().filter(|m| *m > 0.0).unwrap_or(0.01);
    for size in &mut sizes {
        *size = size.clamp(median * 0.01, median * 10.0);
    }
    sizes
}

fn cameras(archive: &mut Archive<'_>) -> Result<Vec<Camera>, ImportError> {
    let mut array = |name: &str| Array::parse(name, &archive.read(&format!("{name}.npy"))?);
    let (views, intrinsics) = (array("viewmats")?, array("Ks")?);
    let [width, height] =
        [array("width")?, array("height")?].map(|a| a.values.first().copied().unwrap_or(0.0));
    let (count, rows) = match views.shape[..] {
        [count, rows @ (3 | 4), 4] if count <= MAX_CAMERAS => (count, rows),
        _ => return Err(views.misshapen("viewmats", "C x 3 x 4 or C x 4 x 4")),
    };
    if intrinsics.shape != [count, 3, 3] {
        return Err(intrinsics.misshapen("Ks", &format!("{count} x 3 x 3")));
    }
    (0..count)
        .map(|c| {
            let view = &views.values[c * rows * 4..];
            let k = &intrinsics.values[c * 9..];
            let mut world_to_camera = [[0.0, 0.0, 0.0, 1.0]; 4];
            for (row, target) in world_to_camera.iter_mut().enumerate().take(3) {
                target.copy_from_slice(&view[row * 4..row * 4 + 4]);
            }
            let k = [[k[0], k[1], k[2]], [k[3], k[4], k[5]], [k[6], k[7], k[8]]];
            Camera::from_opencv(k, world_to_camera, width as u32, height as u32)
                .map_err(|e| FORMAT.malformed(format!("camera {c}"), e, "a pinhole camera"))
        })
        .collect()
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    U8,
    I32,
    I64,
    F32,
    F64,
}

/// One `.npy` array as f64, row-major.
struct Array {
    kind: Kind,
    shape: Vec<usize>,
    values: Vec<f64>,
}

impl Array {
    fn parse(name: &str, bytes: &[u8]) -> Result<Self, ImportError> {
        let bad = |found: &str, allowed: &str| FORMAT.malformed(format!("{name}.npy"), found, allowed);
        if !bytes.starts_with(b"\x93NUMPY") {
            return Err(bad("other bytes", "the magic of a .npy array"));
        }
        let (start, length): (usize, _) = match bytes.get(6) {
            Some(1) => (10, u16_at(bytes, 8).map(usize::from)),
            Some(2 | 3) => (12, u32_at(bytes, 8).map(|l| l as usize)),
            _ => return Err(bad("another version", "version 1, 2 or 3")),
        };
        let header = length
            .and_then(|l| bytes.get(start..start.checked_add(l)?))
            .and_then(|h| std::str::from_utf8(h).ok())
            .ok_or_else(|| bad("a header cut short", "a whole header"))?;
        let field = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
        let text = field("descr").and_then(|f| f.strip_prefix('\'')).and_then(|f| f.split_once('\''));
        let kind = match text.map(|t| t.0) {
            Some("|u1") => Kind::U8,
            Some("<i4") => Kind::I32,
            Some("<i8") => Kind::I64,
            Some("<f4") => Kind::F32,
            Some("<f8") => Kind::F64,
            other => return Err(bad(other.unwrap_or("no descr"), "|u1, <i4, <i8, <f4 or <f8")),
        };
        if !field("fortran_order").is_some_and(|f| f.starts_with("False")) {
            return Err(bad("Fortran order", "C order"));
        }
        let shape: Option<Vec<usize>> = field("shape")
            .and_then(|f| f.strip_prefix('('))
            .and_then(|f| f.split_once(')'))
            .and_then(|(f, _)| {
                f.split(',').map(str::trim).filter(|d| !d.is_empty()).map(|d| d.parse().ok()).collect()
            });
        let shape = shape.ok_or_else(|| bad("no shape", "a tuple of lengths"))?;
        let data = bytes.get(start + header.len()..).unwrap_or_default();
        let size = match kind {
            Kind::U8 => 1,
            Kind::I32 | Kind::F32 => 4,
            Kind::I64 | Kind::F64 => 8,
        };
        let count = shape.iter().try_fold(1usize, |n, d| n.checked_mul(*d));
        let needed =
            count.and_then(|n| n.checked_mul(size)).ok_or_else(|| bad("a shape too large", "less"))?;
        let data = data
            .get(..needed)
            .ok_or_else(|| FORMAT.truncated(format!("{name}.npy"), data.len() as u64, needed as u64))?;
        let value = |at: &[u8]| match kind {
            Kind::U8 => f64::from(at[0]),
            Kind::I32 => f64::from(i32::from_le_bytes(array(at, 0).unwrap_or_default())),
            Kind::I64 => i64::from_le_bytes(array(at, 0).unwrap_or_default()) as f64,
            Kind::F32 => f64::from(f32::from_le_bytes(array(at, 0).unwrap_or_default())),
            Kind::F64 => f64::from_le_bytes(array(at, 0).unwrap_or_default()),
        };
        Ok(Self { kind, shape, values: data.chunks_exact(size).map(value).collect() })
    }

    fn misshapen(&self, name: &str, allowed: &str) -> ImportError {
        FORMAT.malformed(format!("shape of {name}"), format!("{:?}", self.shape), allowed)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::io::{Cursor, Write};

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

    #[test]
    fn arrays_shorter_than_their_shape_are_refused() {
        let bytes = npy("<f4", "(1000000000, 3)", &[0; 12]);
        assert!(Array::parse("means3d", &bytes).is_err());
        assert!(Array::parse("means3d", &npy(">f4", "(1,)", &[0; 4])).is_err());
    }
}
