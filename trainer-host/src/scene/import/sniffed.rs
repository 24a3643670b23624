//! Tells formats apart: by content first, by the name only where content does not tell.

use std::path::Path;

use super::{
    Format, Limits, archive, compressed_ply, deformation, dynamic_npz, fourdgs, gltf_splats, points_npz, sog,
    splatv, spz, tensors,
};
use crate::scene::Up;

/// The format that `bytes` look like; `path` decides only where content cannot.
pub fn sniff(bytes: &[u8], path: &Path) -> Format {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
    let start = bytes.trim_ascii_start();
    if bytes.starts_with(b"ply") {
        if compressed_ply::is_compressed(bytes) { Format::CompressedPly } else { Format::Ply }
    } else if bytes.starts_with(&spz::MAGIC) || bytes.starts_with(&[0x1f, 0x8b]) {
        Format::Spz
    } else if bytes.starts_with(b"glTF") {
        if gltf_splats::is_splats(bytes) { Format::GltfSplats } else { Format::Gltf }
    } else if bytes.starts_with(b"PK") {
        let names = archive::Archive::new(bytes, &Limits::default(), Format::Unknown);
        match of_arrays(bytes) {
            _ if names.is_ok_and(|names| names.has("meta.json")) => Format::Sog,
            Some(format) => format,
            None if extension == "npz" => Format::PointsNpz,
            None => Format::Sog,
        }
    } else if start.starts_with(b"{") {
        if sog::is_meta(bytes) || path.file_name().is_some_and(|n| n == "meta.json") {
            Format::Sog
        } else if gltf_splats::is_splats(bytes) {
            Format::GltfSplats
        } else if extension == "gltf" || bytes.windows(7).any(|part| part == b"\"asset\"") {
            Format::Gltf
        } else {
            Format::Unknown
        }
    } else if bytes.starts_with(&fourdgs::START) {
        Format::FourDgs
    } else if bytes.starts_with(&splatv::MAGIC) {
        Format::Splatv
    } else if bytes.starts_with(b"%YAML") {
        Format::Unity
    } else if let Some(format) = of_safetensors(bytes) {
        format
    } else {
        match extension.as_str() {
            "ply" => Format::Ply,
            "spz" => Format::Spz,
            "sog" => Format::Sog,
            "npz" => Format::PointsNpz,
            "glb" | "gltf" => Format::Gltf,
            "asset" => Format::Unity,
            "splat" => Format::Splat,
            "ksplat" => Format::Ksplat,
            "splatv" => Format::Splatv,
            "4dgs" => Format::FourDgs,
            _ => Format::Unknown,
        }
    }
}

/// The format of an npz or safetensors file, by the arrays that it holds.
fn of_arrays(bytes: &[u8]) -> Option<Format> {
    let limits = Limits::default();
    let arrays = tensors::Tensors::open(bytes, &limits, Format::Unknown).ok()?;
    if arrays.has(dynamic_npz::MARK) {
        Some(Format::DynamicNpz)
    } else if points_npz::gsplat::is_in(&arrays) {
        Some(Format::GsplatNpz)
    } else if arrays.has("means3d") {
        Some(Format::PointsNpz)
    } else {
        deformation::is_in(&arrays).then_some(Format::Deformation)
    }
}

/// As [`of_arrays`], of a safetensors file; points are read of npz alone.
fn of_safetensors(bytes: &[u8]) -> Option<Format> {
    let format = tensors::is_safetensors(bytes).then(|| of_arrays(bytes))?;
    format.filter(|&format| format != Format::PointsNpz)
}

/// Which way is up in most files of a format. Captures keep the axes of COLMAP, whose y points down; SPZ and
/// glTF have a y that points up.
pub fn default_up(format: Format) -> Option<Up> {
    match format {
        Format::Spz | Format::Gltf | Format::GltfSplats => Some(Up::Y),
        Format::Ply | Format::CompressedPly | Format::Splat | Format::Sog | Format::Unity => Some(Up::MinusY),
        Format::Ksplat | Format::Splatv | Format::DynamicNpz | Format::GsplatNpz | Format::Deformation => {
            Some(Up::MinusY)
        }
        Format::PointsNpz | Format::FourDgs | Format::Sequence | Format::Unknown => None,
    }
}

/// What to do about a checkpoint: to read it is to run it, which is left to the program that wrote it. A
/// tuple holds what `capture()` of 3D Gaussian Splatting gives, and an iteration; that of 4D Gaussian
/// Splatting has its network third.
pub(super) const UNPICKLE: &str = "the PLY that its trainer exports (of 4D Gaussian Splatting only that, \
    with deformation.pth made an npz beside it), or an npz of its arrays (3DGS's tuple; gsplat's; Dynamic \
    3D Gaussians'; deformation fields):\n  \
    import numpy, torch; params = torch.load(\"FILE\", map_location=\"cpu\")\n  \
    names = \"means sh0 shN scales quats opacities\".split()\n  \
    is_tuple = isinstance(params, tuple)\n  \
    params = dict(zip(names, params[0][1:7])) if is_tuple else params.get(\"splats\", params)\n  \
    numpy.savez(\"params.npz\", **{name: value.detach().numpy() for name, value in params.items()})\n";

/// Whether `bytes` are a checkpoint of torch: pickled, alone or in a zip.
pub(super) fn is_pickled(bytes: &[u8]) -> bool {
    let is_plain = matches!(bytes, [0x80, 2..=5, ..]);
    is_plain
        || bytes.starts_with(b"PK")
            && archive::Archive::new(bytes, &Limits::default(), Format::Unknown)
                .is_ok_and(|archive| archive.has_ending("/data.pkl"))
}
