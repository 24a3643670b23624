//! Holds the pictures that a scene is fine-tuned towards, and what should change after each.

use std::ops::Range;

use render_host::{Camera, Image, Renderer, Settings, Splats};

use super::{error::DeliveryError, temporal};
use crate::scene::Scene;

/// A picture of a scene: a photograph, or a render of a better scene.
#[derive(Clone, Debug)]
pub struct Reference {
    /// Frame of the scene, from 0.
    pub frame: u32,
    /// Where it was seen from.
    pub camera: Camera,
    /// What is behind everything in the picture, r g b.
    pub background: [f32; 3],
    /// What was seen; the camera's size, data range 1.
    pub picture: Image,
}

/// A reference with the change to the next frame.
#[derive(Clone, Debug)]
pub(super) struct View {
    pub frame: u32,
    pub camera: Camera,
    pub background: [f32; 3],
    pub picture: Image,
    /// Picture of the next frame less this one; none at the last frame of an epoch.
    pub change: Option<Image>,
}

impl Reference {
    /// `settings` with what is behind everything in the picture.
    pub(super) fn settings(&self, settings: &Settings) -> Settings {
        Settings { background: self.background, ..settings.clone() }
    }
}

/// Checks `references` against `scene` and finds the change after each: from the reference of the next frame
/// by the same camera if there is one, else from the scene's own renders of both frames.
///
/// # Errors
/// A picture of another size than its camera's, a frame past the end, or what the renderer refuses.
pub(super) fn views(
    scene: &Scene,
    references: &[Reference],
    settings: &Settings,
) -> Result<Vec<View>, DeliveryError> {
    let of = |(index, reference): (usize, &Reference)| view(scene, references, index, reference, settings);
    references.iter().enumerate().map(of).collect()
}

fn view(
    scene: &Scene,
    references: &[Reference],
    index: usize,
    reference: &Reference,
    settings: &Settings,
) -> Result<View, DeliveryError> {
    let Reference { frame, camera, background, picture } = reference;
    let (background, settings) = (*background, reference.settings(settings));
    let refuse = |field, found, allowed| Err(DeliveryError::Reference { index, field, found, allowed });
    let (width, height) = (camera.width(), camera.height());
    if (picture.width(), picture.height()) != (width, height) {
        let found = format!("{} x {}", picture.width(), picture.height());
        return refuse("size of the picture", found, format!("{width} x {height}, as the camera has it"));
    }
    let Some(span) = frames_of_epoch(scene, *frame) else {
        let allowed = format!("0 to {}", scene.frames().saturating_sub(1));
        return refuse("frame", frame.to_string(), allowed);
    };
    let next = frame + 1;
    let change = if !span.contains(&next) {
        None
    } else if let Some(given) = references.iter().find(|r| r.frame == next && r.camera == *camera) {
        Some(temporal::before(&given.picture, picture)?)
    } else {
        let [this, next] = [*frame, next].map(|frame| render(scene, frame, camera, &settings));
        Some(temporal::before(&next?, &this?)?)
    };
    Ok(View { frame: *frame, camera: camera.clone(), background, picture: picture.clone(), change })
}

fn frames_of_epoch(scene: &Scene, frame: u32) -> Option<Range<u32>> {
    let (epoch, t) = scene.locate(frame as usize)?;
    let first = frame - t as u32;
    Some(first..first + scene.epochs().get(epoch)?.frames() as u32)
}

fn render(scene: &Scene, frame: u32, camera: &Camera, settings: &Settings) -> Result<Image, DeliveryError> {
    let instant = scene.instant(frame as usize).unwrap_or_default();
    let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
    Ok(Renderer::new().render(&splats, camera, settings)?.image)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::{
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        viewpoint::{Framing, Ring},
    };

    /// A small scene, and pictures of a finer one at all frames from `cameras` cameras.
    pub(in crate::train::delivery) fn study(frames: usize, cameras: usize) -> (Scene, Vec<Reference>) {
        let make = |gaussians: usize| {
            let options =
                synth::SynthOptions { gaussians, frames, kind: SynthKind::Balls, ..Default::default() };
            synth::make(&options, &Limits::default()).unwrap()
        };
        let (scene, finer) = (make(1000), make(1600));
        let ring = Framing::of(&finer).ring(Ring::Validation, cameras, (40, 32)).unwrap();
        let mut references = Vec::new();
        for frame in 0..frames as u32 {
            for camera in &ring {
                let picture = render(&finer, frame, camera, &Settings::default()).unwrap();
                let background = Settings::default().background;
                references.push(Reference { frame, camera: camera.clone(), background, picture });
            }
        }
        (scene, references)
    }

    #[test]
    fn changes_come_from_the_next_reference_of_the_camera_or_from_the_scene() {
        let (scene, references) = study(3, 2);
        let settings = Settings::default();
        let found = views(&scene, &references, &settings).unwrap();
        let wanted = temporal::before(&references[2].picture, &references[0].picture).unwrap();
        assert_eq!(found[0].change, Some(wanted.clone()));
        assert!(found[4].change.is_none() && found[5].change.is_none(), "there is no frame 3");
        let alone = views(&scene, &references[..1], &settings).unwrap();
        assert!(alone[0].change.is_some() && alone[0].change != Some(wanted));
    }

    #[test]
    fn a_reference_that_does_not_fit_is_named() {
        let (scene, references) = study(2, 1);
        let refused = |change: &dyn Fn(&mut Reference)| {
            let mut references = references.clone();
            change(&mut references[1]);
            views(&scene, &references, &Settings::default()).unwrap_err().to_string()
        };
        let late = refused(&|r| r.frame = 9);
        assert!(late.contains("reference 1: frame is 9; 0 to 1"), "{late}");
        let small = refused(&|r| r.picture = Image::filled(4, 3, [0.0; 3]).unwrap());
        assert!(small.contains("4 x 3") && small.contains("40 x 32"), "{small}");
    }
}
