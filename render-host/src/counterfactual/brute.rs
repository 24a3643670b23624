//! Every world rendered alone: the slow twin that judges the engine.

use super::squares::{Planes, between, cut};
use super::{CounterfactualError, States, Variants};
use crate::{Camera, Image, Renderer, Settings, Splats};
use codec_core::Gaussian;
use rayon::prelude::*;

/// The Gaussians of one world and their harmonics, without those whose group is absent.
pub fn world(variants: &Variants, states: &States, world: usize) -> (Vec<Gaussian>, Vec<f32>) {
    let (splats, groups) = (variants.splats(), variants.groups());
    let kept = (0..splats.len()).filter(|&i| states.has(world, groups[i] as usize));
    let mut out = (Vec::new(), Vec::new());
    for i in kept {
        out.0.push(splats.gaussians()[i]);
        out.1.extend_from_slice(splats.rest(i));
    }
    out
}

/// The picture of one world.
///
/// # Errors
/// A setting out of range.
pub fn image(
    variants: &Variants,
    states: &States,
    index: usize,
    camera: &Camera,
    settings: &Settings,
) -> Result<Image, CounterfactualError> {
    render(&mut Renderer::new(), variants, states, index, camera, settings)
}

/// Squared error of every world, a full render each: worlds in parallel when there are enough.
///
/// # Errors
/// A setting out of range, states of another number of groups, or a reference of another size.
pub fn sse(
    variants: &Variants,
    states: &States,
    camera: &Camera,
    reference: &Image,
    settings: &Settings,
) -> Result<Vec<f64>, CounterfactualError> {
    let (found, needed) = (states.groups(), variants.count());
    if found != needed {
        return Err(CounterfactualError::States { found, needed });
    }
    let mut film = Image::default();
    film.reset(camera.width(), camera.height())?;
    crate::image::same_size(&film, reference)?;
    let planes = cut(reference);
    if !settings.parallel || states.len() < rayon::current_num_threads() {
        let mut renderer = Renderer::new();
        let one = |w| error(&mut renderer, variants, states, w, camera, settings, &planes);
        return (0..states.len()).map(one).collect();
    }
    let serial = Settings { parallel: false, ..settings.clone() };
    let one = |renderer: &mut Renderer, w| error(renderer, variants, states, w, camera, &serial, &planes);
    (0..states.len()).into_par_iter().map_init(Renderer::new, one).collect()
}

fn error(
    renderer: &mut Renderer,
    variants: &Variants,
    states: &States,
    index: usize,
    camera: &Camera,
    settings: &Settings,
    reference: &[Planes],
) -> Result<f64, CounterfactualError> {
    Ok(between(&render(renderer, variants, states, index, camera, settings)?, reference))
}

fn render(
    renderer: &mut Renderer,
    variants: &Variants,
    states: &States,
    index: usize,
    camera: &Camera,
    settings: &Settings,
) -> Result<Image, CounterfactualError> {
    let (gaussians, rest) = world(variants, states, index);
    let splats = Splats::new(&gaussians, &rest, variants.splats().sh_degree())?;
    renderer.render(&splats, camera, settings).map(|out| out.image).map_err(|error| match error {
        crate::RenderError::Settings(e) => e.into(),
        crate::RenderError::Image(e) => e.into(),
    })
}
