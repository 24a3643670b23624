//! Reads datasets: photographs with cameras and times, from the layouts that the field uses.
//!
//! A folder with `transforms_train.json` is a Blender or D-NeRF one, with `sparse/0` a COLMAP one, with
//! `train_meta.json` a Panoptic one (Dynamic 3D Gaussians). Anything an importer reads becomes a dataset by
//! rendering it: see [`rendered`].

mod blender;
mod colmap;
mod panoptic;
pub mod rendered;

use std::path::{Path, PathBuf};

use render_host::{
    CameraError, ImageError,
    adjoint::loss::photograph::Photograph,
    camera::MAX_SIDE,
    image_file::{Bounds, Rgba8},
};

use super::views::{Dataset, ViewsError};

/// A dataset that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file or folder that the system does not give.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder of none of the layouts.
    #[error(
        "{}: no dataset; transforms_train.json (Blender, D-NeRF), sparse/0 (COLMAP) or train_meta.json \
         (Panoptic) is needed",
        path.display()
    )]
    Unknown {
        /// The folder.
        path: PathBuf,
    },
    /// Cameras that cannot be read.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: CameraError,
    },
    /// An image that cannot be read.
    #[error("{}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: ImageError,
    },
    /// A field with a value that is not allowed.
    #[error("{}: {field} is {found}; {allowed}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Which field.
        field: String,
        /// Its value.
        found: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// Views that do not fit together.
    #[error("{}: {source}", path.display())]
    Views {
        /// The dataset.
        path: PathBuf,
        /// What is wrong.
        source: ViewsError,
    },
}

/// Reads the dataset in folder `path`.
///
/// # Errors
/// A folder of no known layout; or a file, image, camera or time that is refused, by name.
pub fn read(path: &Path) -> Result<Dataset, DatasetError> {
    if path.join("transforms_train.json").is_file() {
        blender::read(path)
    } else if path.join("sparse/0").is_dir() {
        colmap::read(path)
    } else if path.join("train_meta.json").is_file() {
        panoptic::read(path)
    } else {
        Err(DatasetError::Unknown { path: path.to_owned() })
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>, DatasetError> {
    std::fs::read(path).map_err(|source| DatasetError::File { path: path.to_owned(), source })
}

/// The photograph in an image file; `true` where some of it is transparent.
fn read_photograph(path: &Path) -> Result<(Photograph, bool), DatasetError> {
    let bytes = read_bytes(path)?;
    let failed = |source| DatasetError::Image { path: path.to_owned(), source };
    let bounds = Bounds { side: MAX_SIDE, bytes: 4 * u64::from(MAX_SIDE) * u64::from(MAX_SIDE) };
    let image = Rgba8::decode(&bytes, bounds).map_err(|e| failed(ImageError::Codec(e.to_string())))?;
    let premultiplied = image.data().chunks_exact(4).flat_map(|pixel| {
        let by_alpha = |c: usize| ((u32::from(pixel[c]) * u32::from(pixel[3]) + 127) / 255) as u8;
        [by_alpha(0), by_alpha(1), by_alpha(2), pixel[3]]
    });
    let (width, height) = image.size();
    let has_alpha = image.data().iter().skip(3).step_by(4).any(|&alpha| alpha < 255);
    Photograph::new(width, height, premultiplied.collect()).map(|p| (p, has_alpha)).map_err(failed)
}

/// The name of the last part of a path.
fn name_of(path: &Path) -> String {
    let path = std::fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    path.file_name().map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into_owned())
}
