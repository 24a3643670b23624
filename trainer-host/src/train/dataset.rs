//! Reads datasets: photographs with cameras and times, from the layouts that the field uses.
//!
//! The first of these that a folder has says what it is: `transforms_train.json` (Blender, D-NeRF),
//! `sparse/0` (COLMAP), `transforms.json` (Nerfstudio), a reconstruction in `sparse` or `colmap/sparse/0`
//! (COLMAP), `train_meta.json` (Panoptic of Dynamic 3D Gaussians). Anything an importer reads becomes a
//! dataset by rendering it: see [`rendered`].

mod blender;
mod colmap;
mod error;
mod files;
mod nerfstudio;
mod panoptic;
pub mod rendered;

use std::path::Path;

pub use error::DatasetError;
pub use panoptic::cameras as panoptic_cameras;

use render_host::camera::DEFAULT_NEAR;

use super::{
    start::Extent,
    views::{Dataset, PosedPhotograph},
};

/// Share of half the side of a scene that the near plane is within: units are any.
const NEAR: f64 = 0.05;

/// Reads the dataset in folder `path`.
///
/// # Errors
/// A folder of no known layout; or a file, image, camera or time that is refused, by name.
pub fn read(path: &Path) -> Result<Dataset, DatasetError> {
    let (has, has_sparse) = (|name: &str| path.join(name).is_file(), path.join("sparse/0").is_dir());
    if has("transforms_train.json") || (has("transforms.json") && !has_sparse) {
        blender::read(path).map(within_sight)
    } else if has_sparse || colmap::model(path).is_some() {
        colmap::read(path).map(within_sight)
    } else if has("train_meta.json") {
        panoptic::read(path)
    } else {
        Err(DatasetError::Unknown { path: path.to_owned() })
    }
}

/// The same, with near planes that do not hide a scene that is small in its units; others stay as they are.
fn within_sight(mut dataset: Dataset) -> Dataset {
    let near = NEAR * Extent::of(&dataset.start, dataset.train.photographs()).half_side;
    if near >= DEFAULT_NEAR {
        return dataset;
    }
    let nearer = |view: PosedPhotograph| match view.camera.clone().with_near(near) {
        Ok(camera) => PosedPhotograph { camera, ..view },
        Err(_) => view,
    };
    dataset.train = dataset.train.map(nearer);
    dataset.validation = dataset.validation.map(nearer);
    dataset.test = dataset.test.map(nearer);
    dataset
}
