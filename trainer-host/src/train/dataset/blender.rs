//! Reads Blender and D-NeRF datasets, `transforms_{train,val,test}.json`, and those of Nerfstudio with one
//! `transforms.json`, which lists what is for training, validation and testing; without lists every eighth
//! frame is for testing.
//!
//! Images are the `file_path` of each frame, as PNG, JPEG or WebP where it has no extension. `time` of a
//! frame is 0 to 1; without it nothing moves. Images with alpha have outlines. Pixels that a `mask_path` has
//! black are not trained on.

use std::path::{Path, PathBuf};

use codec_core::Footprint;
use rayon::prelude::*;
use render_host::{Camera, camera::blender};

use super::{
    error::DatasetError,
    files::{is_copy, name_of, read_bytes, read_mask, read_photograph},
    nerfstudio::{self, Splits},
};
use crate::{
    scene::Up,
    train::{
        pixel_mask::PixelMask,
        views::{Dataset, FreeSpace, PosedPhotograph, Start, Views, distinct},
    },
};

/// One frame of this many is for testing where a file has all of them.
const TEST_EVERY: usize = 8;
/// Endings of images, in the order in which they are looked for.
const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "webp"];
pub(super) fn read(folder: &Path) -> Result<Dataset, DatasetError> {
    let own = |name: &str| -> Result<Listed, DatasetError> {
        let path = folder.join(format!("transforms_{name}.json"));
        if path.is_file() { photographs(folder, &path) } else { Ok(Listed::default()) }
    };
    let whole = folder.join("transforms.json");
    let in_splits = folder.join("transforms_train.json").is_file();
    let mut instants = None;
    let (train, validation, test, has_alpha) = if in_splits {
        let train = own("train")?;
        (train.views, own("val")?.views, own("test")?.views, train.has_alpha)
    } else {
        let Listed { views, has_alpha, splits } = photographs(folder, &whole)?;
        // Those of test views count: otherwise frames would fall between the instants of all others.
        instants = Some(distinct(views.iter().map(|view| view.time)));
        let splits = splits.unwrap_or_else(|| {
            let (test, train) = (0..views.len()).partition(|index| index % TEST_EVERY == TEST_EVERY - 1);
            Splits { train, validation: Vec::new(), test }
        });
        let mut views: Vec<Option<PosedPhotograph>> = views.into_iter().map(Some).collect();
        // What is for validation may be for testing too.
        let of_validation = splits.validation.iter().filter_map(|&index| views.get(index)?.clone());
        let validation = of_validation.collect();
        let mut taken = |indices: &[usize]| -> Vec<PosedPhotograph> {
            indices.iter().filter_map(|&index| views.get_mut(index)?.take()).collect()
        };
        (taken(&splits.train), validation, taken(&splits.test), has_alpha)
    };
    let of_views = |source| DatasetError::Views { path: folder.to_owned(), source };
    let train = Views::new(train).map_err(of_views)?;
    let frames = instants.unwrap_or_else(|| Views::instants(&train));
    Ok(Dataset {
        name: name_of(folder),
        train,
        validation: Views::new(validation).map_err(of_views)?,
        test: Views::new(test).map_err(of_views)?,
        start: Start::VisualHull,
        free_space: FreeSpace::default(),
        has_alpha,
        frames,
        up: Up::Z,
        footprint: Footprint::Pixel,
    })
}

/// The photographs of the frames of a file.
#[derive(Default)]
struct Listed {
    views: Vec<PosedPhotograph>,
    /// Whether some of them have an outline.
    has_alpha: bool,
    /// What they are for, where the file says so.
    splits: Option<Splits>,
}

fn photographs(folder: &Path, path: &Path) -> Result<Listed, DatasetError> {
    let bytes = read_bytes(path)?;
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&bytes);
    let cameras = |size| {
        blender::read(text, size).map_err(|source| DatasetError::Cameras { path: path.to_owned(), source })
    };
    // Names first: the file need not say how large images are, and cameras depend on it.
    let named = cameras(Some((1, 1)))?;
    let timed = named.iter().filter(|view| view.time.is_some()).count();
    if timed > 0 && timed < named.len() {
        return Err(DatasetError::Field {
            path: path.to_owned(),
            field: "time".to_owned(),
            found: format!("given of {timed} frames of {}", named.len()),
            allowed: "of all frames or of none is allowed",
        });
    }
    let paths = named.iter().map(|view| image_path(folder, &view.name)).collect::<Result<Vec<_>, _>>()?;
    let nerfstudio::Extras { masks, splits } = nerfstudio::read(path, text)?;
    let read_mask =
        |mask: &Option<PathBuf>| mask.as_ref().map(|mask| read_mask(&folder.join(mask))).transpose();
    let masks = masks.par_iter().map(read_mask).collect::<Result<Vec<_>, _>>()?;
    let images = paths.par_iter().map(|path| read_photograph(path)).collect::<Result<Vec<_>, _>>()?;
    // An image that is opaque all over may be stored without alpha.
    let has_alpha = images.iter().any(|(_, has_alpha)| *has_alpha);
    let size = images.first().map(|(photograph, _)| (photograph.width(), photograph.height()));
    let views =
        cameras(size)?.into_iter().zip(images).zip(masks).map(|((view, (photograph, _)), counted)| {
            let camera = of_size(&view.camera, photograph.width(), photograph.height());
            let time = view.time.unwrap_or(0.0) as f32;
            let size = (photograph.width(), photograph.height());
            if let Some((width, height)) = counted.as_ref().map(PixelMask::size).filter(|mask| *mask != size)
            {
                return Err(DatasetError::Field {
                    path: path.to_owned(),
                    field: format!("mask_path of {}", view.name),
                    found: format!("an image of {width} x {height}"),
                    allowed: "one of the size of file_path is needed",
                });
            }
            Ok(PosedPhotograph { name: view.name, camera, time, photograph, foreground: None, counted })
        });
    Ok(Listed { views: views.collect::<Result<_, _>>()?, has_alpha, splits })
}

/// The camera of a larger or smaller copy of its image; unchanged where that has another shape.
fn of_size(camera: &Camera, width: u32, height: u32) -> Camera {
    let is_copy = is_copy(camera, width, height);
    camera.resized(width, height).ok().filter(|_| is_copy).unwrap_or_else(|| camera.clone())
}

fn image_path(folder: &Path, name: &str) -> Result<PathBuf, DatasetError> {
    let path = folder.join(name);
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    if ending.as_ref().is_some_and(|ending| ENDINGS.contains(&ending.as_str())) {
        return Ok(path);
    }
    let with = |ending: &str| {
        let mut whole = path.clone().into_os_string();
        whole.push(".");
        whole.push(ending);
        PathBuf::from(whole)
    };
    if let Some(found) = ENDINGS.map(with).into_iter().find(|path| path.is_file()) {
        return Ok(found);
    }
    Err(DatasetError::Field {
        path: folder.to_owned(),
        field: "file_path".to_owned(),
        found: name.to_owned(),
        allowed: "no such image; .png, .jpg, .jpeg and .webp are looked for where a name has no ending",
    })
}
