//! Reads Blender and D-NeRF datasets: `transforms_{train,val,test}.json` and PNG images.
//!
//! Images are the `file_path` of each frame, with `.png` where it has no extension. `time` of a frame is 0 to
//! 1; without it nothing moves. Images with alpha have outlines.

use std::path::{Path, PathBuf};

use codec_core::Footprint;
use rayon::prelude::*;
use render_host::camera::blender;

use super::{
    error::DatasetError,
    files::{name_of, read_bytes, read_photograph},
};
use crate::{
    scene::Up,
    train::views::{Dataset, FreeSpace, PosedPhotograph, Start, Views},
};

pub(super) fn read(folder: &Path) -> Result<Dataset, DatasetError> {
    let (train, has_alpha) = split(folder, "train", true)?;
    let (validation, _) = split(folder, "val", false)?;
    let (test, _) = split(folder, "test", false)?;
    let frames = Views::instants(&train);
    Ok(Dataset {
        name: name_of(folder),
        train,
        validation,
        test,
        start: Start::VisualHull,
        free_space: FreeSpace::default(),
        has_alpha,
        frames,
        up: Up::Z,
        footprint: Footprint::Pixel,
    })
}

/// The views of one split; none where it is not `needed` and its file is not there.
fn split<S>(folder: &Path, split: &str, needed: bool) -> Result<(Views<S>, bool), DatasetError> {
    let path = folder.join(format!("transforms_{split}.json"));
    let of_views = |source| DatasetError::Views { path: path.clone(), source };
    if !needed && !path.is_file() {
        return Ok((Views::new(Vec::new()).map_err(of_views)?, false));
    }
    let bytes = read_bytes(&path)?;
    let cameras = |size| {
        blender::read(&bytes, size).map_err(|source| DatasetError::Cameras { path: path.clone(), source })
    };
    // Names first: the file need not say how large images are, and cameras depend on it.
    let named = cameras(Some((1, 1)))?;
    let paths: Vec<PathBuf> = named.iter().map(|view| image_path(folder, &view.name)).collect();
    let images = paths.par_iter().map(|path| read_photograph(path)).collect::<Result<Vec<_>, _>>()?;
    // An image that is opaque all over may be stored without alpha.
    let has_alpha = images.iter().any(|(_, has_alpha)| *has_alpha);
    let size = images.first().map(|(photograph, _)| (photograph.width(), photograph.height()));
    let views = cameras(size)?.into_iter().zip(images).map(|(view, (photograph, _))| {
        let time = view.time.unwrap_or(0.0) as f32;
        PosedPhotograph { name: view.name, camera: view.camera, time, photograph }
    });
    Ok((Views::new(views.collect()).map_err(of_views)?, has_alpha))
}

fn image_path(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(name);
    if path
        .extension()
        .is_some_and(|e| ["png", "jpg", "jpeg", "webp"].contains(&&*e.to_string_lossy().to_lowercase()))
    {
        return path;
    }
    let mut with_extension = path.into_os_string();
    with_extension.push(".png");
    with_extension.into()
}
