//! Watches a stream as one viewer does: a camera for each frame, where it says that it is, what it sees.

use anyhow::{Result, bail};
use codec_core::internals::{receiver::Content, wire::receipt::ViewerPose};
use emulator_host::session::ViewerPath;
use render_host::{Backend, Camera, Image, Settings};
use trainer_host::evaluator;

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
        let mut around = Surroundings {
            own: &[],
            framing: &mut || frames.framing(),
            ring: RENDER_RING,
            size: view.size(),
            up,
        };
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
