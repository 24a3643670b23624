//! Reads datasets: photographs with cameras and times, from the layouts that the field uses.
//!
//! A folder with `transforms_train.json` is a Blender or D-NeRF one, with `transforms.json` one of
//! Nerfstudio, with a reconstruction in `sparse/0`, `sparse` or `colmap/sparse/0` a COLMAP one, with
//! `train_meta.json` a Panoptic one (Dynamic 3D Gaussians). Anything an importer reads becomes a dataset by
//! rendering it: see [`rendered`].

mod blender;
mod colmap;
mod error;
mod files;
mod panoptic;
pub mod rendered;

use std::path::Path;

pub use error::DatasetError;

use super::views::Dataset;

/// Reads the dataset in folder `path`.
///
/// # Errors
/// A folder of no known layout; or a file, image, camera or time that is refused, by name.
pub fn read(path: &Path) -> Result<Dataset, DatasetError> {
    if ["transforms_train.json", "transforms.json"].iter().any(|name| path.join(name).is_file()) {
        blender::read(path)
    } else if colmap::model(path).is_some() || path.join("sparse/0").is_dir() {
        colmap::read(path)
    } else if path.join("train_meta.json").is_file() {
        panoptic::read(path)
    } else {
        Err(DatasetError::Unknown { path: path.to_owned() })
    }
}
