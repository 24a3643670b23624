//! Holds the pictures that a scene is fine-tuned towards, and what should change after each.

use std::ops::Range;

use render_host::{Camera, Image, Renderer, Settings, Splats, metric};

use super::{error::DeliveryError, temporal};
use crate::{scene::Scene, train::PosedPhotograph};

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
    /// A photograph as a picture of the frame of `scene` at its time, `by` times smaller (1 to its shorter
    /// side) and over `background`. Where a mask leaves pixels out there is what `scene` itself shows:
    /// nothing else is known of them, and they stay as they are.
    ///
    /// # Errors
    /// A picture that cannot be reduced so far, or what the renderer refuses.
    pub fn of_photograph(
        view: &PosedPhotograph,
        scene: &Scene,
        by: u32,
        background: [f32; 3],
    ) -> Result<Self, DeliveryError> {
        let (width, height) = (view.camera.width() / by.max(1), view.camera.height() / by.max(1));
        let photograph = view.photograph.over(background).resized_box(width, height)?;
        let camera = view.camera.resized(width, height)?;
        let last = scene.frames().saturating_sub(1) as f64;
        let frame = (f64::from(view.time) * last).round() as u32;
        let picture = match &view.counted {
            None => photograph,
            Some(mask) => {
                let settings = Settings { parallel: true, ..Settings::over(background) };
                let shown = render(scene, frame, &camera, &settings.with_footprint(scene.footprint))?;
                metric::where_counted(&photograph, &shown, mask.reduced(by.max(1)).values())?
            }
        };
        Ok(Self { frame, camera, background, picture })
    }

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
    use render_host::adjoint::loss::photograph::Photograph;

    use super::*;
    use crate::{
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        train::PixelMask,
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
    fn where_a_mask_leaves_pixels_out_a_reference_is_what_the_scene_shows() {
        let (scene, references) = study(3, 1);
        let (width, height) = (40, 32);
        let grey = vec![128; 4 * width * height];
        let values = (0..width * height).map(|at| u8::from(at % width < 20)).collect();
        let view = PosedPhotograph {
            name: "r_0.png".into(),
            time: 0.4,
            camera: references[0].camera.clone(),
            photograph: Photograph::new(width as u32, height as u32, grey).unwrap(),
            foreground: None,
            counted: PixelMask::new(width as u32, height as u32, values),
        };
        let made = Reference::of_photograph(&view, &scene, 2, [0.0; 3]).unwrap();
        assert_eq!((made.frame, made.picture.width(), made.picture.height()), (1, 20, 16));
        let shown = render(&scene, 1, &made.camera, &Settings::over([0.0; 3])).unwrap();
        let whole = PosedPhotograph { counted: None, ..view };
        let photograph = Reference::of_photograph(&whole, &scene, 2, [0.0; 3]).unwrap().picture;
        for (at, pixel) in made.picture.rgb().chunks_exact(3).enumerate() {
            let wanted = if at % 20 < 10 { &photograph } else { &shown };
            assert_eq!(pixel, &wanted.rgb()[3 * at..][..3], "pixel {at}");
        }
        assert_ne!(photograph, shown);
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
