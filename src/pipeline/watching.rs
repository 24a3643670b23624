//! Watches a stream as one viewer does: a camera for each frame, where it says that it is, what it sees.

use anyhow::{Result, bail};
use codec_core::internals::{receiver::Content, wire::receipt::ViewerPose};
use emulator_host::session::ViewerPath;
use render_host::{Backend, Camera, Image, Settings};
use trainer_host::{evaluator, scene::Up, viewpoint::Framing};

use super::{Frames, RENDER_RING, Showing, Surroundings, viewpoints};
use crate::args::{CameraArgs, ViewArgs};

/// One viewer.
#[derive(Clone, Debug)]
pub struct Watching {
    /// At least one; the camera of a frame is that of its number, again from the first after the last.
    cameras: Vec<Camera>,
    description: String,
}

impl Watching {
    /// The camera that the options name, else the one that `dgs render` looks from, before `frames`.
    ///
    /// # Errors
    /// Cameras that cannot be read or placed, or several that do not follow the frames.
    pub fn of(typed: &CameraArgs, view: &ViewArgs, frames: &mut Frames) -> Result<Self> {
        let up = frames.up();
        Self::within(typed, view, up, &mut || frames.framing())
    }

    /// The viewer of a file of cameras (`--cameras`), which does not depend on the scene; `None` where
    /// cameras are placed around it. Options that no scene makes valid are refused, so that this can be
    /// called before the work that makes one.
    ///
    /// # Errors
    /// As [`Watching::of`].
    pub(crate) fn of_file(typed: &CameraArgs, view: &ViewArgs) -> Result<Option<Self>> {
        // Without --target, --eye looks at the middle of the scene, which is not known yet.
        if typed.eye.is_some() && typed.target.is_none() {
            return Ok(None);
        }
        let up = Up::default();
        let found = Self::within(typed, view, up, &mut || Ok(Framing::of_positions(&[], up)))?;
        Ok(typed.cameras.is_some().then_some(found))
    }

    /// The viewer in a scene that lies as `framing` says, with `up` up.
    fn within(
        typed: &CameraArgs,
        view: &ViewArgs,
        up: Up,
        framing: &mut dyn FnMut() -> Result<Framing>,
    ) -> Result<Self> {
        let mut around = Surroundings { own: &[], framing, ring: RENDER_RING, size: view.size(), up };
        let found = viewpoints(typed, view, &mut around)?;
        let (cameras, description) = match found.showing {
            Showing::PlayAlong => (found.views.len(), found.description.clone()),
            // Every camera of a ring could show the whole clip.
            Showing::Clip => (1, found.of_first()),
            Showing::OwnFrame => {
                bail!("a viewer has one camera; found {}: --camera chooses one", found.description)
            }
        };
        let cameras = found.views.into_iter().take(cameras).map(|view| view.camera).collect();
        Ok(Self { cameras, description })
    }

    /// For people: what its cameras are.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// Its camera at `frame`.
    pub fn camera(&self, frame: u32) -> &Camera {
        &self.cameras[frame as usize % self.cameras.len()]
    }

    /// What its receipts say.
    pub fn path(&self) -> Option<ViewerPath> {
        let poses: Vec<ViewerPose> = self.cameras.iter().map(Camera::pose).collect();
        ViewerPath::new(&poses)
    }

    /// What it sees of `shown`, frames of `content` each in its state; without one, nothing.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn pictures(
        &self,
        content: &Content<'_>,
        shown: &[(u32, Option<&[u8]>)],
        settings: &Settings,
    ) -> Result<Vec<Image>> {
        let backend = Backend::Cpu;
        if let [camera] = self.cameras.as_slice() {
            return Ok(evaluator::renders(content, shown, camera, settings, &backend)?);
        }
        let mut images = Vec::new();
        for one in shown {
            let camera = self.camera(one.0);
            images.append(&mut evaluator::renders(content, &[*one], camera, settings, &backend)?);
        }
        Ok(images)
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::args::{Cli, Verb};

    /// The viewer of a file that is typed after `dgs stream`.
    fn of_file(typed: &[&str]) -> Result<Option<Watching>> {
        let typed = [&["dgs", "stream", "none.dgs"], typed].concat();
        let Ok(Cli { verb: Verb::Stream(args), .. }) = Cli::try_parse_from(&typed) else {
            panic!("{typed:?}")
        };
        Watching::of_file(&args.cameras, &args.view)
    }

    #[test]
    fn what_no_scene_is_seen_by_is_refused_before_there_is_one() {
        for (typed, says) in [
            (&["--cameras", "nofile.json"][..], "nofile.json"),
            (&["--eye", "1,1,1", "--target", "1,1,1"], "--eye, --target, --up: look_at: "),
            (&["--target", "1,1,1"], "--target is for --eye or --turntable"),
            (&["--turntable", "3", "--camera", "3"], "--camera"),
        ] {
            let error = format!("{:#}", of_file(typed).unwrap_err());
            assert!(error.contains(says), "{typed:?}: {error}");
        }
        for typed in
            [&["--eye", "0,0,0"][..], &["--eye", "0,1,0", "--target", "0,0,0"], &["--turntable", "3"]]
        {
            assert!(of_file(typed).unwrap().is_none(), "{typed:?}");
        }
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let text = r#"{"camera_angle_x": 0.8, "w": 8, "h": 6, "frames": [{"file_path": "a",
            "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#;
        std::fs::write(&path, text).unwrap();
        let found = of_file(&["--cameras", path.to_str().unwrap()]).unwrap().unwrap();
        assert_eq!(found.camera(0).width(), 8);
    }
}
