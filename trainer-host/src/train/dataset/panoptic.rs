//! Reads datasets of the Panoptic layout of Dynamic 3D Gaussians: `train_meta.json`, `test_meta.json`, `ims`,
//! and masks of what moves in `seg`, where a camera has some: `ims/3/000001.jpg` has `seg/3/000001.png`, not
//! black where it shows foreground.
//!
//! A meta file has `w` and `h` (pixels) and, by frame and camera, `k` (3 × 3), `w2c` (4 × 4, OpenCV axes),
//! `fn` (file name under `ims`) and `cam_id`. Frame `i` is at time `i / (n - 1)`, where `n` is how many
//! frames `train_meta.json` has: `test_meta.json` may end before it.

use std::{
    collections::BTreeSet,
    path::{Component, Path, PathBuf},
};

use codec_core::Footprint;
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};
use render_host::{Camera, camera::View};
use serde::{
    Deserialize,
    de::{DeserializeOwned, IgnoredAny},
};

use super::{
    error::DatasetError,
    files::{name_of, read_bytes},
    listed::{Listed, ListedPhotograph, claimed_sizes},
};
use crate::{
    scene::Up,
    train::{
        reduction::ReductionReport,
        views::{ColouredPoint, Dataset, FreeSpace, PosedPhotograph, Start},
    },
};

/// The file of photographs to train on.
const TRAINING: &str = "train_meta.json";
/// The file of those to test on, which need not be there.
const TEST: &str = "test_meta.json";
/// Points that training starts with, since the layout has none that we may rely on.
const POINTS: usize = 20_000;
/// Most points drawn until there are so many.
const MAX_DRAWS: usize = 4 * POINTS;
/// Nothing nearer to a camera, in metres, is drawn, as viewers of splats do (`p_view.z <= 0.2` in the
/// rasteriser of 3DGS), so that they show what was trained.
const NEAR: f64 = 0.2;
/// What is this near to a camera and before it, in all of the cameras' reach, would hide the scene from
/// cameras between those that are trained on, where nothing tells that it is not there.
const CLEAR_DISTANCE: f64 = 0.45;
/// Cosine of the angle to the optical axis within which it counts as before a camera.
const CLEAR_COSINE: f64 = 0.35;

#[derive(Deserialize)]
struct Meta {
    w: u32,
    h: u32,
    k: Vec<Vec<[[f64; 3]; 3]>>,
    w2c: Vec<Vec<[[f64; 4]; 4]>>,
    #[serde(rename = "fn")]
    names: Vec<Vec<String>>,
}

/// How many frames a meta file has.
#[derive(Deserialize)]
struct Frames {
    #[serde(rename = "fn")]
    names: Vec<IgnoredAny>,
}

pub(super) fn read(folder: &Path, max_side: Option<u32>) -> Result<(Dataset, ReductionReport), DatasetError> {
    let has_test = folder.join(TEST).is_file();
    let listed = Listed {
        folder: folder.to_owned(),
        train: split(folder, TRAINING)?,
        validation: Vec::new(),
        test: if has_test { split(folder, TEST)? } else { Vec::new() },
    };
    if listed.train.is_empty() {
        return Err(DatasetError::Field {
            path: folder.join(TRAINING),
            field: "fn".to_owned(),
            found: "empty".to_owned(),
            allowed: "at least 1 photograph to train on is needed",
        });
    }
    let photographs = listed.read(max_side)?;
    let train = photographs.train.photographs();
    let free_space = free_space(train);
    let dataset = Dataset {
        name: name_of(folder),
        start: Start::Points(points_inside(train, &free_space)),
        frames: photographs.train.instants(),
        train: photographs.train,
        validation: photographs.validation,
        test: photographs.test,
        test_scale: photographs.test_scale,
        free_space,
        has_alpha: false,
        up: Up::MinusY,
        footprint: Footprint::Pixel,
    };
    Ok((dataset, photographs.report))
}

/// What the meta file at `path` says.
fn parsed<T: DeserializeOwned>(path: &Path) -> Result<T, DatasetError> {
    serde_json::from_slice(&read_bytes(path)?).map_err(|error| DatasetError::Field {
        path: path.to_owned(),
        field: "JSON".to_owned(),
        found: error.to_string(),
        allowed: "w, h, k, w2c and fn, by frame and camera, are needed",
    })
}

/// The cameras of a meta file, frame after frame, with their times: those of a `test_meta.json` are times of
/// the clip of the `train_meta.json` beside it, if there is one.
///
/// # Errors
/// A file that cannot be read, or is none, by field; one for testing with more frames than that for training.
pub fn cameras(path: &Path) -> Result<Vec<View>, DatasetError> {
    let refused = |field: String, found: String, allowed| DatasetError::Field {
        path: path.to_owned(),
        field,
        found,
        allowed,
    };
    let meta: Meta = parsed(path)?;
    let training = path.with_file_name(TRAINING);
    let is_test = path.file_name().is_some_and(|name| name == TEST);
    let frames = if is_test && training.is_file() {
        parsed::<Frames>(&training)?.names.len()
    } else {
        meta.names.len()
    };
    if meta.names.len() > frames {
        let found = format!("{} frames long, where {TRAINING} has {frames}", meta.names.len());
        return Err(refused("fn".to_owned(), found, "at most as many are allowed"));
    }
    let mut wanted = Vec::new();
    for (frame, names) in meta.names.iter().enumerate() {
        let (Some(k), Some(w2c)) = (meta.k.get(frame), meta.w2c.get(frame)) else {
            let found = format!("{} and {} frames", meta.k.len(), meta.w2c.len());
            return Err(refused("k and w2c".to_owned(), found, "as many frames as fn has are needed"));
        };
        if k.len() != names.len() || w2c.len() != names.len() {
            let found = format!("{} and {} cameras", k.len(), w2c.len());
            let field = format!("k and w2c of frame {frame}");
            return Err(refused(field, found, "as many cameras as fn has are needed"));
        }
        for ((name, k), w2c) in names.iter().zip(k).zip(w2c) {
            wanted.push((frame, name, *k, *w2c));
        }
    }
    let view = |(frame, name, k, w2c): (usize, &String, [[f64; 3]; 3], [[f64; 4]; 4])| {
        let camera =
            Camera::from_opencv(k, w2c, meta.w, meta.h).and_then(|camera| camera.with_near(NEAR)).map_err(
                |source| refused(format!("camera {name}"), source.to_string(), "a pinhole camera is needed"),
            )?;
        let time = frame as f64 / frames.saturating_sub(1).max(1) as f64;
        Ok(View { name: name.clone(), time: Some(time), camera })
    };
    wanted.into_iter().map(view).collect()
}

fn split(folder: &Path, file: &str) -> Result<Vec<ListedPhotograph>, DatasetError> {
    let views = cameras(&folder.join(file))?;
    // The mask of an image has its name in `seg`: a name that leads out of `ims` leads out of that too, and
    // may make an image its own mask.
    let is_inside = |name: &str| {
        Path::new(name).components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir))
    };
    if let Some(view) = views.iter().find(|view| !is_inside(&view.name)) {
        return Err(DatasetError::Field {
            path: folder.join(file),
            field: "fn".to_owned(),
            found: view.name.clone(),
            allowed: "the path of an image within ims, such as 3/000001.jpg, is needed",
        });
    }
    let paths: Vec<PathBuf> = views.iter().map(|view| folder.join("ims").join(&view.name)).collect();
    let sizes = claimed_sizes(&paths)?;
    let listed = views.into_iter().zip(paths).zip(sizes).map(|((view, image), size)| {
        let View { name, time, camera } = view;
        let mask = folder.join("seg").join(&name).with_extension("png");
        let has_masks = mask.parent().is_some_and(Path::is_dir);
        let (time, foreground) = (time.unwrap_or(0.0) as f32, has_masks.then_some(mask));
        ListedPhotograph { name, camera, time, image, size, foreground, counted: None }
    });
    Ok(listed.collect())
}

/// The box that the cameras stand in.
fn bounds(views: &[PosedPhotograph]) -> [(f64, f64); 3] {
    let centres: Vec<[f64; 3]> = views.iter().map(|view| view.camera.centre()).collect();
    let bound = |k: usize| {
        let values = || centres.iter().map(|c| c[k]);
        (values().fold(f64::INFINITY, f64::min), values().fold(f64::NEG_INFINITY, f64::max))
    };
    [bound(0), bound(1), bound(2)]
}

/// Half the longest side of a box.
fn reach(bounds: [(f64, f64); 3]) -> f64 {
    bounds.iter().map(|(low, high)| 0.5 * (high - low)).fold(0.0, f64::max)
}

/// What cameras have before them: they hang in the walls, and people stay away from those.
fn free_space(views: &[PosedPhotograph]) -> FreeSpace {
    let cameras = one_per_place(views).into_iter().cloned().collect();
    FreeSpace::before(cameras, CLEAR_DISTANCE * reach(bounds(views)), CLEAR_COSINE)
}

/// Grey points all over the place that the cameras stand around, and beyond it, but not in free space.
fn points_inside(views: &[PosedPhotograph], free_space: &FreeSpace) -> Vec<ColouredPoint> {
    let mut points = Vec::new();
    if views.is_empty() {
        return points;
    }
    let bounds = bounds(views);
    let reach = reach(bounds);
    let mut rng = Pcg64Mcg::seed_from_u64(1);
    for _ in 0..MAX_DRAWS {
        let place = bounds.map(|(low, high)| {
            let middle = 0.5 * (low + high);
            (middle + 1.3 * reach * (2.0 * rng.random::<f64>() - 1.0)) as f32
        });
        if points.len() < POINTS && !free_space.contains(place) {
            points.push(ColouredPoint { position: place, colour: [0.5; 3] });
        }
    }
    points
}

/// The cameras of `views`, one of those that stand in the same place.
fn one_per_place(views: &[PosedPhotograph]) -> Vec<&Camera> {
    let mut places = BTreeSet::new();
    let is_new = |view: &&PosedPhotograph| places.insert(view.camera.centre().map(f64::to_bits));
    views.iter().filter(is_new).map(|view| &view.camera).collect()
}
