//! Reads Blender and D-NeRF datasets, `transforms_{train,val,test}.json`, and those of Nerfstudio with one
//! `transforms.json`, which lists what is for training, validation and testing; without lists every eighth
//! frame is for testing.
//!
//! Images are the `file_path` of each frame, as PNG, JPEG or WebP where it has no extension. `time` of a
//! frame is 0 to 1; without it nothing moves. Images with alpha have outlines. Pixels that a `mask_path` has
//! black are not trained on.

use std::path::{Path, PathBuf};

use codec_core::Footprint;
use render_host::{
    Camera,
    camera::{View, blender},
};

use super::{
    error::DatasetError,
    files::{is_copy, name_of, read_bytes},
    listed::{Listed, ListedPhotograph, claimed_sizes},
    nerfstudio::{self, Splits},
};
use crate::{
    scene::Up,
    train::{
        reduction::ReductionReport,
        views::{Dataset, FreeSpace, Start, distinct},
    },
};

/// One frame of this many is for testing where a file has all of them.
const TEST_EVERY: usize = 8;
/// Endings of images, in the order in which they are looked for.
const ENDINGS: [&str; 4] = ["png", "jpg", "jpeg", "webp"];

pub(super) fn read(folder: &Path, max_side: Option<u32>) -> Result<(Dataset, ReductionReport), DatasetError> {
    let (listed, instants) = if folder.join("transforms_train.json").is_file() {
        let own = |name: &str| {
            let path = folder.join(format!("transforms_{name}.json"));
            if path.is_file() { photographs(folder, &path).map(Some) } else { Ok(None) }
        };
        let (train, validation, test) = (own("train")?, own("val")?, own("test")?);
        check_times(folder, [("val", &validation), ("test", &test)], &train)?;
        let [train, validation, test] =
            [train, validation, test].map(|file| file.map_or(Vec::new(), |f| f.listed));
        (Listed { folder: folder.to_owned(), train, validation, test }, None)
    } else {
        let File { listed: all, splits, .. } = photographs(folder, &folder.join("transforms.json"))?;
        // Those of test views count: otherwise frames would fall between the instants of all others.
        let instants = distinct(all.iter().map(|view| view.time));
        let splits = splits.unwrap_or_else(|| {
            let (test, train) = (0..all.len()).partition(|index| index % TEST_EVERY == TEST_EVERY - 1);
            Splits { train, validation: Vec::new(), test }
        });
        let of = |indices: &[usize]| indices.iter().filter_map(|&index| all.get(index).cloned()).collect();
        let (train, validation, test) = (of(&splits.train), of(&splits.validation), of(&splits.test));
        (Listed { folder: folder.to_owned(), train, validation, test }, Some(instants))
    };
    if listed.train.is_empty() {
        let name = if instants.is_none() { "transforms_train.json" } else { "transforms.json" };
        return Err(DatasetError::Field {
            path: folder.join(name),
            field: "frames".to_owned(),
            found: "empty".to_owned(),
            allowed: "at least 1 to train on is needed",
        });
    }
    let photographs = listed.read(max_side)?;
    let dataset = Dataset {
        name: name_of(folder),
        frames: instants.unwrap_or_else(|| photographs.train.instants()),
        train: photographs.train,
        validation: photographs.validation,
        test: photographs.test,
        test_scale: photographs.test_scale,
        start: Start::VisualHull,
        free_space: FreeSpace::default(),
        has_alpha: photographs.has_alpha,
        up: Up::Z,
        footprint: Footprint::Pixel,
    };
    Ok((dataset, photographs.report))
}

/// What a file says of its frames.
struct File {
    listed: Vec<ListedPhotograph>,
    /// What they are for, where it says so.
    splits: Option<Splits>,
    /// Whether it gives their times.
    is_timed: bool,
}

/// Refuses files of which some give times and others do not: views without would all be of the first instant.
fn check_times(
    folder: &Path,
    files: [(&str, &Option<File>); 2],
    train: &Option<File>,
) -> Result<(), DatasetError> {
    let of_train = train.as_ref().is_some_and(|train| train.is_timed);
    for (name, file) in files {
        let differs = |file: &&File| !file.listed.is_empty() && file.is_timed != of_train;
        if let Some(file) = file.as_ref().filter(differs) {
            let (found, allowed) = if file.is_timed {
                ("given", "absent, as in transforms_train.json, is allowed")
            } else {
                ("absent", "given of all frames, as in transforms_train.json, is allowed")
            };
            return Err(DatasetError::Field {
                path: folder.join(format!("transforms_{name}.json")),
                field: "time".to_owned(),
                found: found.to_owned(),
                allowed,
            });
        }
    }
    Ok(())
}

/// The photographs of the frames of a file.
fn photographs(folder: &Path, path: &Path) -> Result<File, DatasetError> {
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
    let is_outside = |time: f64| !(0.0..=1.0).contains(&(time as f32));
    for (index, view) in named.iter().enumerate() {
        if let Some(time) = view.time.filter(|&time| is_outside(time)) {
            return Err(DatasetError::Field {
                path: path.to_owned(),
                field: format!("time of frame {index}, {},", view.name),
                found: time.to_string(),
                allowed: "0 to 1 is allowed",
            });
        }
    }
    let image = |(index, view): (usize, &View)| {
        image_path(folder, &view.name).ok_or_else(|| DatasetError::Field {
            path: path.to_owned(),
            field: format!("frame {index}'s file_path"),
            found: if view.name.is_empty() { "absent".to_owned() } else { view.name.clone() },
            allowed: "no such image; .png, .jpg, .jpeg and .webp are looked for where a name has no ending",
        })
    };
    let images = named.iter().enumerate().map(image).collect::<Result<Vec<_>, _>>()?;
    let nerfstudio::Extras { masks, splits } = nerfstudio::read(path, text)?;
    let sizes = claimed_sizes(&images)?;
    let views = cameras(sizes.first().copied())?;
    let listed = views.into_iter().zip(images).zip(sizes).zip(masks).map(|(((view, image), size), mask)| {
        ListedPhotograph {
            camera: of_size(&view.camera, size.0, size.1),
            name: view.name,
            time: view.time.unwrap_or(0.0) as f32,
            image,
            size,
            foreground: None,
            counted: mask.map(|mask| folder.join(mask)),
        }
    });
    Ok(File { listed: listed.collect(), splits, is_timed: timed > 0 })
}

/// The camera of a larger or smaller copy of its image; unchanged where that has another shape.
fn of_size(camera: &Camera, width: u32, height: u32) -> Camera {
    let is_copy = is_copy(camera, width, height);
    camera.resized(width, height).ok().filter(|_| is_copy).unwrap_or_else(|| camera.clone())
}

/// The image of a frame by its `file_path`; none where it has no ending, and no image has one added to it.
fn image_path(folder: &Path, name: &str) -> Option<PathBuf> {
    let path = folder.join(name);
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_lowercase());
    if ending.as_ref().is_some_and(|ending| ENDINGS.contains(&ending.as_str())) {
        return Some(path);
    }
    let with = |ending: &str| {
        let mut whole = path.clone().into_os_string();
        whole.push(".");
        whole.push(ending);
        PathBuf::from(whole)
    };
    ENDINGS.map(with).into_iter().find(|path| path.is_file())
}
