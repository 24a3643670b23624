//! Chooses where pictures look from: one place for every verb.
//!
//! What is typed wins: a file of cameras, an eye, a turntable; else the scene's own cameras; else a ring
//! around the scene, which depends on where its Gaussians lie and never on their order.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use render_host::{
    Camera, CameraError,
    camera::{
        View, blender,
        colmap::{self, Format},
    },
};
use trainer_host::{
    scene::Up,
    train::dataset::panoptic_cameras,
    viewpoint::{FIELD_OF_VIEW, Framing, Ring},
};

use super::camera_names::choose;
use crate::{
    args::{CameraArgs, FrameRange, ViewArgs},
    figures::counted,
};

/// Cameras around a scene without its own, for `dgs render` and for what compares its pictures with renders.
pub(crate) const RENDER_RING: (Ring, usize) = (Ring::HeldOut, 8);

/// Most bytes of one file of cameras.
const MAX_BYTES: u64 = 1 << 30;

/// Cameras, and where they come from.
#[derive(Clone, Debug)]
pub struct Viewpoints {
    /// At least one.
    pub views: Vec<View>,
    /// For people: what they are.
    pub description: String,
    /// Which frames they show.
    pub showing: Showing,
}

impl Viewpoints {
    /// For people: what they are, with the frames over which cameras play along, if those were chosen.
    pub(crate) fn of_frames(&self, chosen: Option<FrameRange>) -> String {
        match chosen.filter(|_| self.showing == Showing::PlayAlong) {
            Some(range) => format!("{}, frames {range}", self.description),
            None => self.description.clone(),
        }
    }

    /// For people: what its first camera is.
    pub(crate) fn of_first(&self) -> String {
        let from = if self.views.len() > 1 { "the first of " } else { "" };
        format!("{from}{}", self.description)
    }
}

/// Which frames a list of cameras shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Showing {
    /// Each may show the whole clip.
    Clip,
    /// Each one frame: that of its own time, or the first.
    OwnFrame,
    /// Each the frame after that of the camera before, from the first again after the last.
    PlayAlong,
}

impl Showing {
    /// The frame, of a clip of `count` of which `chosen` are shown, that camera `index` shows first. A camera
    /// with a time of its own may show one that is not chosen.
    ///
    /// # Errors
    /// A time outside of 0 to 1.
    pub fn frame_of(self, view: &View, index: usize, count: u32, chosen: &Range<u32>) -> Result<u32> {
        match view.time {
            None if self == Self::PlayAlong => Ok(chosen.start + index as u32 % (chosen.len() as u32).max(1)),
            None => Ok(0),
            Some(time) if (0.0..=1.0).contains(&time) => Ok((time * f64::from(count - 1)).round() as u32),
            Some(time) => bail!("{}: time is {time}; 0 to 1 is allowed, or --frame", view.name),
        }
    }
}

/// What cameras are placed around, where none are typed.
pub struct Surroundings<'a> {
    /// The scene's own cameras.
    pub own: &'a [Camera],
    /// Where the scene lies; asked for only where it matters.
    pub framing: &'a mut dyn FnMut() -> Result<Framing>,
    /// Cameras of the ring.
    pub ring: (Ring, usize),
    /// Width and height of pictures where nothing else says, pixels.
    pub size: (u32, u32),
    /// Which way is up, for what is said.
    pub up: Up,
}

/// Why cameras around a scene cannot be placed, by what a person can change: their size, or else that others
/// are named.
pub(super) fn around_the_scene(error: CameraError) -> anyhow::Error {
    let context = match error {
        CameraError::Range { field: "width" | "height", .. } => "--width, --height",
        _ => "cameras around the scene, where a Gaussian may be far away (--eye or --cameras names others)",
    };
    anyhow::Error::from(error).context(context)
}

/// The cameras that `typed` asks for, at the size that `view` asks for.
///
/// # Errors
/// A file that cannot be read, an image size or direction the camera refuses, a camera that is not there.
pub fn viewpoints(typed: &CameraArgs, view: &ViewArgs, around: &mut Surroundings<'_>) -> Result<Viewpoints> {
    let size = (view.width.unwrap_or(around.size.0), view.height.unwrap_or(around.size.1));
    let is_placed = typed.cameras.is_none() && (typed.is_placed() || around.own.is_empty());
    let mut found = match placed(typed, size, around)? {
        Some(found) => found,
        None => match &typed.cameras {
            Some(path) => {
                let views = read_cameras(path, view.width.zip(view.height));
                let views = views.map_err(|error| with_missing_side(error, view))?;
                let description = format!("{} cameras of {}", views.len(), path.display());
                let showing = if views.len() > 1 { Showing::OwnFrame } else { Showing::Clip };
                Viewpoints { views, description, showing }
            }
            None if !around.own.is_empty() => {
                let description = format!("{} of the scene", counted(around.own.len(), "camera"));
                Viewpoints { views: unnamed(around.own.to_vec()), description, showing: Showing::Clip }
            }
            None => {
                let (ring, count) = around.ring;
                let cameras = (around.framing)()?.ring(ring, count, size).map_err(around_the_scene)?;
                let cameras_around = counted(count, "camera");
                let description = format!("{cameras_around} around the scene, up {}", around.up);
                Viewpoints { views: unnamed(cameras), description, showing: Showing::Clip }
            }
        },
    };
    for found in &mut found.views {
        let own = (found.camera.width(), found.camera.height());
        let wanted = if is_placed { size } else { sized(own, view) };
        if wanted != own {
            found.camera = found.camera.resized(wanted.0, wanted.1).context("--width, --height")?;
        }
    }
    if let Some(text) = &typed.camera {
        let view = choose(&found.views, text)?.clone();
        let description = format!("camera {text} of {}", found.description);
        found = Viewpoints { views: vec![view], description, showing: Showing::Clip };
    }
    Ok(found)
}

/// Width and height that `view` asks for of a camera whose pictures are `own` pixels: where one side is
/// typed, the other follows, so that nothing is squashed.
fn sized(own: (u32, u32), view: &ViewArgs) -> (u32, u32) {
    let along = |side: u32, of: u32, other: u32| {
        let scaled = f64::from(side) * f64::from(other) / f64::from(of.max(1));
        scaled.round().clamp(1.0, f64::from(u32::MAX)) as u32
    };
    match (view.width, view.height) {
        (None, None) => own,
        (Some(width), None) => (width, along(width, own.0, own.1)),
        (None, Some(height)) => (along(height, own.1, own.0), height),
        (Some(width), Some(height)) => (width, height),
    }
}

/// The cameras of --eye or --turntable, if either is typed.
fn placed(typed: &CameraArgs, size: (u32, u32), around: &mut Surroundings<'_>) -> Result<Option<Viewpoints>> {
    let degrees = typed.fov.unwrap_or(FIELD_OF_VIEW);
    if let Some(eye) = typed.eye {
        let framing = (around.framing)()?;
        let target = typed.target.unwrap_or(framing.target);
        let looking = |up| Camera::look_at(eye, target, up, degrees.to_radians(), size.0, size.1);
        // Straight down or up, no direction of the picture is up: then one across is.
        let across = if framing.up[2] == 0.0 { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] };
        let camera = looking(framing.up).or_else(|error| match error {
            CameraError::Direction(CameraError::ALONG_UP) => looking(across),
            error => Err(error),
        });
        let away = (0..3).map(|d| (eye[d] - target[d]).powi(2)).sum::<f64>().sqrt();
        let camera = camera.and_then(|camera| camera.with_near(Framing::near_at(away)));
        let camera = camera.context("--eye, --target, --up")?;
        let description = format!("1 camera at {eye:?}, up {}", around.up);
        return Ok(Some(Viewpoints { views: unnamed(vec![camera]), description, showing: Showing::Clip }));
    }
    if let Some(count) = typed.turntable {
        let framing = (around.framing)()?;
        let framing = Framing { target: typed.target.unwrap_or(framing.target), ..framing };
        let cameras = framing.turntable(count, size, degrees).context("--turntable")?;
        let description = format!("turntable of {count} cameras, up {}", around.up);
        return Ok(Some(Viewpoints { views: unnamed(cameras), description, showing: Showing::PlayAlong }));
    }
    for (option, typed) in [("--target", typed.target.is_some()), ("--fov", typed.fov.is_some())] {
        if typed {
            bail!("{option} is for --eye or --turntable; one of them is needed");
        }
    }
    Ok(None)
}

fn unnamed(cameras: Vec<Camera>) -> Vec<View> {
    cameras.into_iter().map(|camera| View { name: String::new(), time: None, camera }).collect()
}

/// `error` with the options that give what a file of cameras does not say.
fn with_missing_side(error: anyhow::Error, view: &ViewArgs) -> anyhow::Error {
    fn is_size(error: &CameraError) -> bool {
        match error {
            CameraError::SizeUnknown => true,
            CameraError::Of { source, .. } => is_size(source),
            _ => false,
        }
    }
    match error.downcast_ref::<CameraError>() {
        Some(found) if is_size(found) => {}
        _ => return error,
    }
    let missing = match (view.width, view.height) {
        (Some(_), None) => "--height is missing beside --width",
        (None, Some(_)) => "--width is missing beside --height",
        _ => "--width and --height are missing",
    };
    error.context(missing)
}

/// The cameras of `path`: a JSON file, one of COLMAP's two files, the folder with both, or that of a dataset
/// of COLMAP. `size` is the width and height of images in pixels for files that do not say.
///
/// # Errors
/// A file that is not there, is none of these, or that its reader refuses.
pub fn read_cameras(path: &Path, size: Option<(u32, u32)>) -> Result<Vec<View>> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let views = if path.is_dir() {
        let folder = colmap_folder(path)?;
        let text = folder.join("images.txt").is_file() && !folder.join("images.bin").is_file();
        read_colmap(&folder, if text { Format::Text } else { Format::Binary })?
    } else if name.ends_with("_meta.json") {
        panoptic_cameras(path)?
    } else if name.ends_with(".json") {
        blender::read(&read(path)?, size).with_context(|| path.display().to_string())?
    } else if name.ends_with(".bin") || name.ends_with(".txt") {
        let format = if name.ends_with(".bin") { Format::Binary } else { Format::Text };
        read_colmap(path.parent().unwrap_or(Path::new("")), format)?
    } else if !path.exists() {
        bail!("{}: no such file or folder", path.display());
    } else {
        bail!(
            "{}: not a file of cameras; transforms_*.json, *_meta.json (Panoptic), or cameras and images as \
             .bin or .txt are allowed",
            path.display()
        );
    };
    if views.is_empty() {
        bail!("{}: holds no camera; at least one is needed", path.display());
    }
    Ok(views)
}

/// The folder with COLMAP's two files: `folder`, or the one in it where datasets have it.
///
/// # Errors
/// A folder with files of cameras in JSON alone: which of them is meant is to be said.
fn colmap_folder(folder: &Path) -> Result<PathBuf> {
    let has_cameras =
        |inside: &PathBuf| ["cameras.bin", "cameras.txt"].iter().any(|name| inside.join(name).is_file());
    let places = ["", "sparse/0", "sparse", "colmap/sparse/0"].map(|inside| folder.join(inside));
    if let Some(found) = places.into_iter().find(has_cameras) {
        return Ok(found);
    }
    let entries = std::fs::read_dir(folder).with_context(|| format!("{}: cannot read", folder.display()))?;
    let names = entries.filter_map(|entry| Some(entry.ok()?.file_name().to_string_lossy().into_owned()));
    let is_json = |name: &String| {
        name.ends_with(".json") && (name.starts_with("transforms") || name.ends_with("_meta.json"))
    };
    let mut files: Vec<String> = names.filter(is_json).collect();
    files.sort();
    match files.is_empty() {
        true => Ok(folder.to_owned()),
        false => bail!(
            "{}: is the folder of a dataset; a file in it is needed: {}",
            folder.display(),
            files.join(", ")
        ),
    }
}

fn read_colmap(folder: &Path, format: Format) -> Result<Vec<View>> {
    let ending = if format == Format::Binary { "bin" } else { "txt" };
    let [cameras, images]: [PathBuf; 2] =
        ["cameras", "images"].map(|name| folder.join(format!("{name}.{ending}")));
    let views = colmap::read(&read(&cameras)?, &read(&images)?, format);
    views.with_context(|| folder.display().to_string())
}

fn read(path: &Path) -> Result<Vec<u8>> {
    let length = std::fs::metadata(path).with_context(|| format!("{}: cannot read", path.display()))?.len();
    if length > MAX_BYTES {
        bail!("{}: found {length} bytes; up to {MAX_BYTES} are allowed", path.display());
    }
    std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(name: &str, time: Option<f64>) -> View {
        let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 8, 8).unwrap();
        View { name: name.to_owned(), time, camera }
    }

    #[test]
    fn a_folder_of_a_dataset_has_its_cameras_in_it_or_says_which_file_has_them() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        std::fs::write(at.join("transforms_train.json"), "{}").unwrap();
        let error = read_cameras(at, None).unwrap_err().to_string();
        assert!(error.contains("a file in it is needed: transforms_train.json"), "{error}");
        std::fs::create_dir_all(at.join("sparse/0")).unwrap();
        std::fs::write(at.join("sparse/0/cameras.txt"), "1 PINHOLE 8 6 7 7 4 3\n").unwrap();
        std::fs::write(at.join("sparse/0/images.txt"), "1 1 0 0 0 0 0 4 1 a.png\n\n").unwrap();
        assert_eq!(read_cameras(at, None).unwrap()[0].name, "a.png");
    }

    #[test]
    fn the_side_that_is_missing_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let text = r#"{"camera_angle_x": 0.8, "frames": [{"file_path": "a",
            "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#;
        std::fs::write(&path, text).unwrap();
        let typed = CameraArgs { cameras: Some(path), ..CameraArgs::default() };
        let found = |width, height| {
            let mut around = Surroundings {
                own: &[],
                framing: &mut || bail!("nothing is placed around the scene"),
                ring: RENDER_RING,
                size: (64, 64),
                up: Up::Y,
            };
            viewpoints(&typed, &ViewArgs { width, height, background: [0.0; 3] }, &mut around)
        };
        for (width, height, says) in [
            (Some(64), None, "--height is missing"),
            (None, Some(64), "--width is missing"),
            (None, None, "--width and --height are missing"),
        ] {
            let error = format!("{:#}", found(width, height).unwrap_err());
            assert!(error.starts_with(says) && error.contains("no w and h"), "{error}");
        }
        assert_eq!(found(Some(64), Some(48)).unwrap().views[0].camera.height(), 48);
    }

    #[test]
    fn own_cameras_are_never_squashed() {
        let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 80, 45).unwrap();
        let size = |width, height| {
            let own = [camera.clone()];
            let mut around = Surroundings {
                own: &own,
                framing: &mut || bail!("nothing is placed around the scene"),
                ring: RENDER_RING,
                size: (64, 64),
                up: Up::Y,
            };
            let view = ViewArgs { width, height, background: [0.0; 3] };
            let found = viewpoints(&CameraArgs::default(), &view, &mut around).unwrap();
            assert_eq!(found.description, "1 camera of the scene");
            (found.views[0].camera.width(), found.views[0].camera.height())
        };
        assert_eq!((size(None, None), size(Some(160), None)), ((80, 45), (160, 90)));
        assert_eq!((size(None, Some(9)), size(Some(8), Some(8))), ((16, 9), (8, 8)));
    }

    fn placed_by(typed: &CameraArgs) -> Result<Viewpoints> {
        let framing = Framing { target: [1.0, 0.0, 0.0], radius: 2.0, up: [0.0, -1.0, 0.0] };
        let view = ViewArgs { width: Some(40), height: None, background: [0.0; 3] };
        let mut around = Surroundings {
            own: &[],
            framing: &mut || Ok(framing),
            ring: (Ring::HeldOut, 8),
            size: (64, 30),
            up: Up::MinusY,
        };
        viewpoints(typed, &view, &mut around)
    }

    #[test]
    fn an_eye_a_turntable_and_the_ring_look_at_the_scene() {
        let eye = CameraArgs { eye: Some([1.0, 0.0, -9.0]), fov: Some(30.0), ..CameraArgs::default() };
        let found = placed_by(&eye).unwrap();
        let camera = &found.views[0].camera;
        assert_eq!((camera.centre(), camera.width(), camera.height()), ([1.0, 0.0, -9.0], 40, 30));
        assert_eq!(camera.to_camera([1.0, 0.0, 0.0]), [0.0, 0.0, 9.0], "the middle is ahead");
        assert!(camera.to_camera([1.0, -1.0, 0.0])[1] < 0.0, "up is up in the picture");

        let turntable = CameraArgs { turntable: Some(4), ..CameraArgs::default() };
        let found = placed_by(&turntable).unwrap();
        assert!(
            found.showing == Showing::PlayAlong && found.description.contains("minus-y"),
            "{}",
            found.description
        );
        let centres: Vec<_> = found.views.iter().map(|view| view.camera.centre()).collect();
        let opposite = |a: usize, b: usize| (centres[a][0] + centres[b][0] - 2.0).abs() < 1e-9;
        assert!(opposite(0, 2) && opposite(1, 3) && !opposite(0, 1));

        assert_eq!(placed_by(&CameraArgs::default()).unwrap().views.len(), 8);
        let lone = CameraArgs { fov: Some(30.0), ..CameraArgs::default() };
        assert!(placed_by(&lone).unwrap_err().to_string().contains("--eye or --turntable"));
        // Straight above, another direction is up in the picture.
        let above = CameraArgs { eye: Some([1.0, 5.0, 0.0]), ..CameraArgs::default() };
        let centre = placed_by(&above).unwrap().views[0].camera.centre();
        assert!((centre[1] - 5.0).abs() < 1e-9, "{centre:?}");
        let target = Some([1.0, 5.0, 0.0]);
        let inside = CameraArgs { target, ..above };
        assert!(format!("{:#}", placed_by(&inside).unwrap_err()).contains("--target"));
    }

    #[test]
    fn frames_follow_times_or_go_round() {
        assert_eq!(Showing::OwnFrame.frame_of(&view("a", Some(0.5)), 3, 11, &(0..11)).unwrap(), 5);
        assert_eq!(Showing::OwnFrame.frame_of(&view("a", None), 13, 10, &(0..10)).unwrap(), 0);
        assert_eq!(Showing::PlayAlong.frame_of(&view("a", None), 13, 10, &(0..10)).unwrap(), 3);
        assert_eq!(Showing::PlayAlong.frame_of(&view("a", None), 4, 10, &(5..8)).unwrap(), 6);
        assert!(Showing::Clip.frame_of(&view("a", Some(1.5)), 0, 10, &(0..10)).is_err());
    }
}
