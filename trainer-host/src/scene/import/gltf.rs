//! Reads animated glTF and GLB as a dynamic scene, whose motion and identity are known: we make both.
//!
//! The textured surface is sampled once, at the first frame of the clip; each sample is a fixed point
//! of a triangle and becomes one flat Gaussian lying on it. Every frame then poses the mesh (node
//! hierarchy, skin, morph targets) and takes the samples along, position and orientation. Colour is
//! base-colour texture × factor × vertex colour, multiplied in linear light, kept as display colour.
//!
//! World: glTF's own, right-handed, y up, front along +z; nothing is scaled or moved, and bounds are
//! noted. Masked texels are not sampled, blended ones lower opacity. Views compressed by meshopt and
//! primitives compressed by Draco are unfolded. Absent: materials beyond base colour, cameras and lights.

mod document;
mod draco;
mod mesh;
mod placement;
mod pose;
mod surface;
mod texture;

pub use pose::Clip;

use codec_core::ShDegree;
use rayon::prelude::*;

use self::{
    document::{Document, FORMAT},
    placement::{PlacedFrame, Placement},
    pose::Rig,
    surface::Surface,
};
use super::{
    Limits,
    error::ImportError,
    snapshot::{SH_C0, logit, scene_error},
};
use crate::scene::{Attributes, Epoch, Scene, Track};

/// Opacity of a sample on an opaque surface.
const OPACITY: f32 = 0.92;
/// Standard deviation across the surface over that along it.
const THINNESS: f32 = 0.1;

/// How to sample an animated mesh.
#[derive(Clone, Debug, PartialEq)]
pub struct GltfOptions {
    /// Which animation.
    pub clip: Clip,
    /// Frames per second the clip is evaluated at.
    pub frames_per_second: f64,
    /// Gaussians to place.
    pub samples: usize,
    /// Seed of the placement: same seed, same scene.
    pub seed: u64,
    /// Let Gaussians grow and shrink with their triangles. Off, sizes are constant over the clip,
    /// which costs nothing to send; thin cracks may show where skin grows.
    pub follow_area: bool,
}

impl Default for GltfOptions {
    fn default() -> Self {
        Self { clip: Clip::First, frames_per_second: 30.0, samples: 20_000, seed: 1, follow_area: false }
    }
}

/// Reads a glTF or GLB file. `beside` reads the files it names.
///
/// # Errors
/// JSON or binary data that is not glTF 2.0 or contradicts itself, an unknown clip, nothing to sample,
/// or more than `limits` allow.
pub fn parse(
    bytes: &[u8],
    beside: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
    options: &GltfOptions,
    limits: &Limits,
) -> Result<Scene, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    let samples = limits.gaussians(FORMAT, options.samples as u64)?;
    if !(options.frames_per_second.is_finite() && options.frames_per_second > 0.0) {
        return Err(FORMAT.malformed("frame rate", options.frames_per_second, "a positive number"));
    }
    let document = Document::load(bytes, beside, limits)?;
    let rig = Rig::new(&document, &options.clip, limits)?;
    let mut surface = Surface::new(&document, &rig, limits)?;

    let times = rig.frame_times(options.frames_per_second, limits)?;
    let per_frame = if options.follow_area { 40 } else { 28 };
    limits.bytes(
        FORMAT,
        "samples x frames",
        (samples as u64 * per_frame).saturating_mul(times.len() as u64),
    )?;

    let first = surface.mesh.posed(&rig.at(times[0]));
    let placed = Placement::new(&surface, &first, samples, options.seed)?;
    let frames: Vec<PlacedFrame> =
        times.par_iter().map(|&time| placed.posed(&placed.mesh.posed(&rig.at(time)))).collect();

    let n = placed.len();
    let mut positions = Vec::with_capacity(n * times.len());
    let mut rotations: Vec<[f32; 4]> = Vec::with_capacity(n * times.len());
    let mut log_scales = Vec::with_capacity(if options.follow_area { n * times.len() } else { n });
    let disc = |sigma: f32| [sigma.ln(), sigma.ln(), (sigma * THINNESS).ln()];
    for (frame, placed_frame) in frames.into_iter().enumerate() {
        positions.extend(placed_frame.positions);
        let before = rotations.len();
        for (i, q) in placed_frame.rotations.into_iter().enumerate() {
            // Signs follow the frame before, so that no quaternion jumps to its negative; a triangle
            // without a direction (all zero) keeps the one it had.
            let previous = if frame == 0 { q } else { rotations[before - n + i] };
            let dot: f32 = (0..4).map(|c| previous[c] * q[c]).sum();
            rotations.push(if q == [0.0; 4] {
                previous
            } else if dot < 0.0 {
                q.map(|v| -v)
            } else {
                q
            });
        }
        if options.follow_area {
            log_scales.extend(placed.sigmas().zip(placed_frame.growth).map(|(s, k)| disc(s * k)));
        } else if frame == 0 {
            log_scales.extend(placed.sigmas().map(disc));
        }
    }
    let (low, high) = bounds(&positions);
    let epoch = Epoch::new(
        times.len(),
        Attributes {
            positions: Track::PerFrame(positions),
            rotations: Track::PerFrame(rotations),
            log_scales: if options.follow_area {
                Track::PerFrame(log_scales)
            } else {
                Track::Constant(log_scales)
            },
            opacity_logits: Track::Constant(placed.colours().map(|c| logit(OPACITY * c[3])).collect()),
            sh0: Track::Constant(placed.colours().map(|c| [0, 1, 2].map(|i| (c[i] - 0.5) / SH_C0)).collect()),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        },
    )
    .map_err(|e| scene_error(FORMAT, &e))?;
    let mut scene =
        Scene::new(vec![epoch], options.frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes.push(clips_note(rig.clip_name(), &document));
    scene.notes.push(format!("bounds over all frames: {low:?} to {high:?}, y up"));
    scene.notes.append(&mut surface.notes);
    Ok(scene)
}

/// Names of the clips in a file, in order; a clip without a name is its number.
///
/// # Errors
/// As [`parse`].
pub fn clips(
    bytes: &[u8],
    beside: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
    limits: &Limits,
) -> Result<Vec<String>, ImportError> {
    Ok(Document::load(bytes, beside, limits)?.clip_names())
}

/// For people: the clip called `chosen`, and which there are.
fn clips_note(chosen: &str, document: &Document) -> String {
    let names: Vec<Option<&str>> = document.gltf.animations().map(|clip| clip.name()).collect();
    match names[..] {
        [] => "no clip: nothing moves".to_owned(),
        [None] => "1 clip, unnamed".to_owned(),
        [Some(name)] => format!("1 clip: {name}"),
        _ => format!("clip {chosen}; clips in the file: {}", document.clip_list()),
    }
}

fn bounds(positions: &[[f32; 3]]) -> ([f32; 3], [f32; 3]) {
    positions.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(low, high), p| {
        ([0, 1, 2].map(|i| low[i].min(p[i])), [0, 1, 2].map(|i| high[i].max(p[i])))
    })
}

#[cfg(test)]
#[path = "gltf/tests.rs"]
pub(super) mod tests;
