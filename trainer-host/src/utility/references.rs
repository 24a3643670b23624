//! References are the pictures that states are compared with: renders of the source, or photographs.

use std::ops::Range;

use codec_core::internals::{
    ids::{EpochId, Span},
    receiver::Content,
};
use rand::{RngExt, seq::SliceRandom};
use rand_pcg::Pcg64;
use rayon::prelude::*;
use render_host::{Camera, Image, Renderer, Settings, Splats, metric};

use super::error::UtilityError;
use crate::{
    scene::Scene,
    stream::Player,
    train::{PixelMask, Views, trimmed},
};

/// How far a photograph is from the frame that it is compared with at most, where there are such, frames.
const NEAR_FRAME: f64 = 0.25;

/// What states are compared with.
#[derive(Clone, Copy, Debug)]
pub enum References<'a> {
    /// Renders of the source.
    Renders(SourceRenders<'a>),
    /// Photographs of what the scene shows.
    Photographs(&'a ReferencePhotographs),
}

/// Renders of the source as references.
#[derive(Clone, Copy, Debug)]
pub struct SourceRenders<'a> {
    /// The source.
    pub scene: &'a Scene,
    /// Cameras to render states from, at least one.
    pub cameras: &'a [Camera],
    /// Cameras to measure gains from, at least one: each costs one state, so that there may be more.
    pub gain_cameras: &'a [Camera],
    /// Frames of a span (a window, or an epoch for canonical groups) that each camera renders, at least 1.
    pub frames_per_span: usize,
}

/// Photographs as references: the scene's own posed images (paper, section 5).
#[derive(Clone, Debug)]
pub struct ReferencePhotographs {
    photographs: Vec<ReferencePhotograph>,
    per_span: usize,
}

/// A photograph over the background, from where and when it was taken.
#[derive(Clone, Debug)]
pub struct ReferencePhotograph {
    /// Name of the image in its source.
    pub name: String,
    /// Camera, of the image's size.
    pub camera: Camera,
    /// Time in the clip, 0 to 1.
    pub time: f32,
    /// The photograph.
    pub image: Image,
    /// What of it is compared, where a mask of its size says so: elsewhere states count as equal to it.
    pub counted: Option<PixelMask>,
}

/// What a view of a span is rendered for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Quantity {
    /// Mean, tail and deviation: in every context.
    Utility,
    /// The gain: in the complete state.
    Gain,
}

/// A camera and frame in which a span is rendered.
#[derive(Debug)]
pub(super) struct View {
    pub(super) frame: u32,
    pub(super) camera: Camera,
    pub(super) reference: Image,
    pub(super) counted: Option<PixelMask>,
}

impl View {
    /// D of the picture that `state` shows.
    pub(super) fn distance(
        &self,
        content: &Content<'_>,
        state: &[u8],
        settings: &Settings,
        player: &mut Player,
        renderer: &mut Renderer,
    ) -> Result<f64, UtilityError> {
        let shown = player.show(&content.with_state(state), self.frame)?;
        let refused = |e: &dyn std::fmt::Display| UtilityError::Render(e.to_string());
        let splats = Splats::new(shown.gaussians, shown.sh_rest, shown.sh_degree).map_err(|e| refused(&e))?;
        // The threads are busy with other states: one render is one task.
        let settings = Settings { parallel: false, ..settings.clone() };
        let rendered = renderer.render(&splats, &self.camera, &settings);
        let picture = rendered.map_err(|e| refused(&e))?.image;
        let picture = match &self.counted {
            Some(mask) => metric::where_counted(&picture, &self.reference, mask.values()),
            None => Ok(picture),
        };
        picture.and_then(|picture| metric::distortion(&picture, &self.reference)).map_err(|e| refused(&e))
    }
}

impl ReferencePhotographs {
    /// The photographs of `views` over `background`, each reduced by a whole number so that neither side is
    /// longer than `longest_side` pixels, unless the other had less than a pixel then. Where that leaves a
    /// rest, it is cut off at the right and the bottom. Of each span, up to `per_span` are used, and twice as
    /// many for gains: at least 1.
    ///
    /// # Errors
    /// No photographs, or one that cannot be reduced.
    pub fn new<S: Sync>(
        views: &Views<S>,
        background: [f32; 3],
        longest_side: u32,
        per_span: usize,
    ) -> Result<Self, UtilityError> {
        let reduced = |view: &crate::train::PosedPhotograph| {
            let refused = |why: String| UtilityError::Photograph { name: view.name.clone(), why };
            let by = reduction((view.camera.width(), view.camera.height()), longest_side);
            let view = trimmed(view.clone(), by);
            let (width, height) = (view.camera.width() / by, view.camera.height() / by);
            let camera = view.camera.resized(width, height).map_err(|error| refused(error.to_string()))?;
            let whole = view.photograph.over(background);
            let image = whole.resized_box(width, height).map_err(|error| refused(error.to_string()))?;
            let counted = view.counted.as_ref().map(|mask| mask.reduced(by));
            Ok(ReferencePhotograph { name: view.name, camera, time: view.time, image, counted })
        };
        let photographs: Result<Vec<_>, UtilityError> = views.photographs().par_iter().map(reduced).collect();
        let photographs = photographs?;
        if photographs.is_empty() {
            return Err(UtilityError::NoCamera);
        }
        Ok(Self { photographs, per_span: per_span.max(1) })
    }

    /// The photographs in the order of their source.
    pub fn photographs(&self) -> &[ReferencePhotograph] {
        &self.photographs
    }

    /// Photographs used of a span, at most; for gains twice as many.
    pub const fn per_span(&self) -> usize {
        self.per_span
    }

    /// Those of a span of `frames` in which `quantity` is measured, each with the frame nearest to it.
    fn of_span(
        &self,
        frames: &Range<u32>,
        clip: u32,
        quantity: Quantity,
        rng: &mut Pcg64,
    ) -> Result<Vec<(usize, u32)>, UtilityError> {
        let last = f64::from(clip.saturating_sub(1));
        let at = |photograph: &ReferencePhotograph| f64::from(photograph.time) * last;
        let placed = self.photographs.iter().map(|photograph| at(photograph).round() as u32).enumerate();
        let mut inside: Vec<(usize, u32)> = placed.filter(|(_, frame)| frames.contains(frame)).collect();
        // Where there are others, those from between two frames, which no frame shows, are left out.
        let off = |&(index, frame): &(usize, u32)| (at(&self.photographs[index]) - f64::from(frame)).abs();
        if inside.iter().any(|placed| off(placed) <= NEAR_FRAME) {
            inside.retain(|placed| off(placed) <= NEAR_FRAME);
        }
        if inside.is_empty() {
            return Err(UtilityError::NoPhotograph { first: frames.start, end: frames.end });
        }
        inside.shuffle(rng);
        inside.truncate(match quantity {
            Quantity::Utility => self.per_span,
            Quantity::Gain => 2 * self.per_span,
        });
        Ok(inside)
    }
}

impl<'a> References<'a> {
    /// Renders of `scene`, one frame per span and camera: states from `cameras`, gains from `gain_cameras`.
    pub const fn renders(scene: &'a Scene, cameras: &'a [Camera], gain_cameras: &'a [Camera]) -> Self {
        Self::Renders(SourceRenders { scene, cameras, gain_cameras, frames_per_span: 1 })
    }
}

impl References<'_> {
    /// Views in which `quantity` of the groups of `span` is measured.
    ///
    /// # Errors
    /// No camera, or a span that no photograph shows.
    pub(super) fn views_of(
        &self,
        content: &Content<'_>,
        span: Span,
        quantity: Quantity,
        seed: u64,
    ) -> Result<usize, UtilityError> {
        match self {
            Self::Renders(renders) => match renders.cameras_of(quantity).len() {
                0 => Err(UtilityError::NoCamera),
                cameras => Ok(cameras * renders.frames_per_span.max(1)),
            },
            Self::Photographs(photographs) => {
                let clip = content.manifest.head().frames;
                let (_, frames) = frames_of(content, span)?;
                Ok(photographs.of_span(&frames, clip, quantity, &mut random(span, 0, 0, seed))?.len())
            }
        }
    }

    /// View `index` of `span`, and the epoch that it shows.
    ///
    /// # Errors
    /// A source that cannot be rendered, or a span that no photograph shows.
    pub(super) fn view(
        &self,
        content: &Content<'_>,
        span: Span,
        quantity: Quantity,
        index: usize,
        seed: u64,
        settings: &Settings,
    ) -> Result<(EpochId, View), UtilityError> {
        let (epoch, frames) = frames_of(content, span)?;
        let view = match self {
            Self::Renders(renders) => {
                let count = frames.len().max(1) as u32;
                let frame = frames.start + random(span, index as u32, 0, seed).random_range(0..count);
                let cameras = renders.cameras_of(quantity);
                let camera = &cameras[index % cameras.len()];
                let reference = renders.render(frame, camera, settings)?;
                View { frame, camera: camera.clone(), reference, counted: None }
            }
            Self::Photographs(photographs) => {
                let clip = content.manifest.head().frames;
                let chosen = photographs.of_span(&frames, clip, quantity, &mut random(span, 0, 0, seed))?;
                let (place, frame) = chosen[index % chosen.len()];
                let ReferencePhotograph { camera, image, counted, .. } = &photographs.photographs[place];
                let (camera, reference, counted) = (camera.clone(), image.clone(), counted.clone());
                View { frame, camera, reference, counted }
            }
        };
        Ok((epoch, view))
    }

    /// What they are, for people.
    pub(super) fn description(&self) -> String {
        let size = |camera: Option<&Camera>| camera.map_or((0, 0), |c| (c.width(), c.height()));
        match self {
            Self::Renders(renders) => {
                let (width, height) = size(renders.cameras.first());
                format!(
                    "renders of the source from {} cameras (gains: {}) at {width}x{height}, {} frames per \
                     span and camera",
                    renders.cameras.len(),
                    renders.gain_cameras.len(),
                    renders.frames_per_span
                )
            }
            Self::Photographs(photographs) => {
                let all = &photographs.photographs;
                let (width, height) = size(all.first().map(|photograph| &photograph.camera));
                let masked = all.iter().filter(|photograph| photograph.counted.is_some()).count();
                let masked = if masked > 0 { format!(", {masked} of them masked") } else { String::new() };
                format!(
                    "{} photographs at {width}x{height}{masked}, up to {} per span (gains: {})",
                    all.len(),
                    photographs.per_span,
                    2 * photographs.per_span
                )
            }
        }
    }
}

impl SourceRenders<'_> {
    const fn cameras_of(&self, quantity: Quantity) -> &[Camera] {
        match quantity {
            Quantity::Utility => self.cameras,
            Quantity::Gain => self.gain_cameras,
        }
    }

    fn render(&self, frame: u32, camera: &Camera, settings: &Settings) -> Result<Image, UtilityError> {
        let refused = |error: &dyn std::fmt::Display| UtilityError::Render(error.to_string());
        let frames = self.scene.frames();
        let source = self.scene.instant(frame as usize).ok_or(UtilityError::Frame { frame, frames })?;
        let splats = Splats::new(&source.gaussians, &source.sh_rest, source.sh_degree);
        let splats = splats.map_err(|error| refused(&error))?;
        let rendered = Renderer::new().render(&splats, camera, settings);
        Ok(rendered.map_err(|error| refused(&error))?.image)
    }
}

/// What sides of `size` are divided by so that none is longer than `longest`, pixels, as far as the shorter
/// one allows: what divides both, unless that leaves less than half of what is allowed.
fn reduction((width, height): (u32, u32), longest: u32) -> u32 {
    let least = width.max(height).div_ceil(longest.max(1)).clamp(1, width.min(height).max(1));
    let divides = |by: &u32| width.is_multiple_of(*by) && height.is_multiple_of(*by);
    (least..=2 * least).find(divides).unwrap_or(least)
}

/// The epoch of a span and its frames.
///
/// # Errors
/// A span that the manifest does not hold.
fn frames_of(content: &Content<'_>, span: Span) -> Result<(EpochId, Range<u32>), UtilityError> {
    let missing = UtilityError::NoSpan { span };
    Ok(match span {
        Span::Canonical(id) => {
            let epoch = content.manifest.epoch(id).ok_or(missing)?;
            (id, epoch.first_frame..epoch.first_frame + epoch.frames)
        }
        Span::Motion(id) => {
            let window = content.manifest.window(id).ok_or(missing)?;
            let end = window.first_frame + u32::from(window.frames);
            (EpochId(window.epoch), window.first_frame..end)
        }
    })
}

/// Numbers for one purpose, keyed by what they are for, so that how often one span draws does not change
/// another.
pub(super) fn random(span: Span, index: u32, purpose: u32, seed: u64) -> Pcg64 {
    let label = match span {
        Span::Canonical(e) => u64::from(e.0) << 1,
        Span::Motion(w) => u64::from(w.0) << 1 | 1,
    };
    let key = u128::from(label) << 32 | u128::from(purpose) << 31 | u128::from(index);
    Pcg64::new(u128::from(seed) << 64 | key, 0xa02_bdbf_7bb3_c0a7)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_of_any_size_become_small_and_not_tiny() {
        for (size, by) in [
            ((800, 800), 5),
            ((400, 400), 4),
            ((160, 90), 1),
            // Common divisors are 1, 3, 173, 519; 1 and 257; 1; 1 and 521.
            ((1557, 1038), 10),
            ((514, 514), 4),
            ((799, 601), 5),
            ((521, 521), 4),
            ((4000, 3), 3),
        ] {
            assert_eq!(reduction(size, 160), by, "{size:?}");
        }
    }
}
