//! Reads files of cameras: Blender/NeRF `transforms_*.json`, or COLMAP's `cameras` and `images`.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use render_host::camera::{
    View, blender,
    colmap::{self, Format},
};

/// Most bytes of one file of cameras.
const MAX_BYTES: u64 = 1 << 30;

/// The cameras of `path`: a JSON file, one of COLMAP's two files, or the folder with both. `size` is the
/// width
/// and height of images in pixels for files that do not say.
///
/// # Errors
/// A file that is not there, is none of these, or that its reader refuses.
pub fn read_cameras(path: &Path, size: Option<(u32, u32)>) -> Result<Vec<View>> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let views = if path.is_dir() {
        let text = path.join("images.txt").is_file() && !path.join("images.bin").is_file();
        read_colmap(path, if text { Format::Text } else { Format::Binary })?
    } else if name.ends_with(".json") {
        let views = blender::read(&read(path)?, size);
        views.with_context(|| format!("{}: --width and --height give a size", path.display()))?
    } else if name.ends_with(".bin") || name.ends_with(".txt") {
        let format = if name.ends_with(".bin") { Format::Binary } else { Format::Text };
        read_colmap(path.parent().unwrap_or(Path::new("")), format)?
    } else {
        bail!(
            "{}: not a file of cameras; transforms_*.json, or cameras and images as .bin or .txt are allowed",
            path.display()
        );
    };
    if views.is_empty() {
        bail!("{}: holds no camera; at least one is needed", path.display());
    }
    Ok(views)
}

fn read_colmap(folder: &Path, format: Format) -> Result<Vec<View>> {
    let ending = if format == Format::Binary { "bin" } else { "txt" };
    let [cameras, images]: [PathBuf; 2] =
        ["cameras", "images"].map(|name| folder.join(format!("{name}.{ending}")));
    let views = colmap::read(&read(&cameras)?, &read(&images)?, format);
    views.with_context(|| format!("{} and {}", cameras.display(), images.display()))
}

fn read(path: &Path) -> Result<Vec<u8>> {
    let length = std::fs::metadata(path).with_context(|| format!("{}: cannot read", path.display()))?.len();
    if length > MAX_BYTES {
        bail!("{}: found {length} bytes; up to {MAX_BYTES} are allowed", path.display());
    }
    std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))
}
