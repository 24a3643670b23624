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
mod listed;
mod nerfstudio;
mod panoptic;
pub mod rendered;

use std::path::Path;

pub use error::DatasetError;
pub use panoptic::cameras as panoptic_cameras;

use render_host::camera::DEFAULT_NEAR;

use super::{
    reduction::ReductionReport,
    start::Extent,
    views::{Dataset, PosedPhotograph},
};

/// Share of half the side of a scene that the near plane is within: units are any.
const NEAR: f64 = 0.05;

/// Reads the dataset in folder `path`, photographs as they are.
///
/// # Errors
/// A folder of no known layout; or a file, image, camera or time that is refused, by name.
pub fn read(path: &Path) -> Result<Dataset, DatasetError> {
    Ok(read_at(path, None)?.0)
}

/// The same, with photographs reduced by a whole number as they are read, so that no side is longer than
/// `max_side` pixels; those for testing may be twice as large ([`Dataset::test_scale`]). Sides that no number
/// divides are cut first, by less than a 64th or than they are reduced by. With them comes what a person
/// should know: what was cut, and where reducing all by one number leaves some too small or too large.
///
/// No more photographs than threads are in memory in full size.
///
/// # Errors
/// As [`read`].
pub fn read_reduced(path: &Path, max_side: u32) -> Result<(Dataset, ReductionReport), DatasetError> {
    read_at(path, Some(max_side))
}

fn read_at(path: &Path, max_side: Option<u32>) -> Result<(Dataset, ReductionReport), DatasetError> {
    let (has, has_sparse) = (|name: &str| path.join(name).is_file(), path.join("sparse/0").is_dir());
    let (dataset, report) = if has("transforms_train.json") || (has("transforms.json") && !has_sparse) {
        blender::read(path, max_side)?
    } else if has_sparse || colmap::model(path).is_some() {
        colmap::read(path, max_side)?
    } else if has("train_meta.json") {
        return panoptic::read(path, max_side);
    } else {
        return Err(DatasetError::Unknown { path: path.to_owned() });
    };
    Ok((within_sight(dataset), report))
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
