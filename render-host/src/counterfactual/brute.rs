//! Renders every world alone: the slow twin that judges the engine.

use codec_core::Gaussian;
use rayon::prelude::*;

use super::{
    CounterfactualError, Distortions, States, Variants, Versions, WorldGradients,
    engine::check_weights,
    squares::{Planes, between, cut},
};
use crate::{
    Camera, Image, RenderError, Renderer, Settings, Splats,
    adjoint::{self, AdjointError, SplatGradient},
    metric,
};

/// The Gaussians of one world and their harmonics, without those whose group is absent.
pub fn world(variants: &Variants, states: &States, world: usize) -> (Vec<Gaussian>, Vec<f32>) {
    let (splats, groups) = (variants.splats(), variants.groups());
    let present = (0..splats.len()).filter(|&i| states.has(world, groups[i] as usize));
    let mut out = (Vec::new(), Vec::new());
    for i in present {
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
    let mut blank = Image::default();
    blank.reset(camera.width(), camera.height())?;
    crate::image::same_size(&blank, reference)?;
    let planes = cut(reference, settings.parallel);
    if !settings.parallel || states.len() < rayon::current_num_threads() {
        let mut renderer = Renderer::new();
        let one = |w| error(&mut renderer, variants, states, w, camera, settings, &planes);
        return (0..states.len()).map(one).collect();
    }
    let serial = Settings { parallel: false, ..settings.clone() };
    let one = |renderer: &mut Renderer, w| error(renderer, variants, states, w, camera, &serial, &planes);
    (0..states.len()).into_par_iter().map_init(Renderer::new, one).collect()
}

/// Distortion of every context and of every version in it, a full render each: the twin of
/// [`super::Engine::distortions`].
///
/// # Errors
/// A setting out of range, versions of another number of groups, a context that does not name a version of
/// every cluster, or a reference of another size.
pub fn distortions(
    variants: &Variants,
    versions: &Versions,
    contexts: &[Vec<u32>],
    camera: &Camera,
    reference: &Image,
    settings: &Settings,
) -> Result<Distortions, CounterfactualError> {
    let (found, needed) = (versions.groups(), variants.count());
    if found != needed {
        return Err(CounterfactualError::States { found, needed });
    }
    versions.check(contexts)?;
    let mut renderer = Renderer::new();
    let mut distortion = |shown: &dyn Fn(usize, usize) -> bool| {
        let mut state = States::new(versions.groups());
        state.push(|group| {
            let (cluster, version) = versions.of(group as u32);
            shown(cluster as usize, version as usize)
        });
        let picture = render(&mut renderer, variants, &state, 0, camera, settings)?;
        Ok::<_, CounterfactualError>(metric::distortion(&picture, reference)?)
    };
    let as_is = |context: &Vec<u32>, c: usize, v: usize| context[c] as usize == v;
    let base: Result<Vec<f64>, _> =
        contexts.iter().map(|context| distortion(&|c, v| as_is(context, c, v))).collect();
    let mut out = Distortions::new(versions, base?);
    for (index, context) in contexts.iter().enumerate() {
        for (cluster, &version) in context.iter().enumerate() {
            for other in (0..versions.count(cluster)).filter(|&other| other != version as usize) {
                let with = |c: usize, v: usize| if c == cluster { v == other } else { as_is(context, c, v) };
                out.set(index, versions.group(cluster, other), distortion(&with)?);
            }
        }
    }
    Ok(out)
}

/// Gradients of every world, one after the other, added up in f64: the twin of
/// [`super::Engine::gradients`] when `settings` has no early stop.
///
/// # Errors
/// As [`sse`], or weights that are not one finite number per world.
pub fn gradients(
    variants: &Variants,
    states: &States,
    weights: &[f64],
    camera: &Camera,
    reference: &Image,
    settings: &Settings,
) -> Result<WorldGradients, CounterfactualError> {
    let (found, needed) = (states.groups(), variants.count());
    if found != needed {
        return Err(CounterfactualError::States { found, needed });
    }
    check_weights(states, weights)?;
    let splats = variants.splats();
    let each = splats.sh_degree().rest_len();
    let (mut sums, mut rests) = (vec![[0.0; NUMBERS]; splats.len()], vec![0.0; splats.len() * each]);
    let mut out = WorldGradients::default();
    let (mut workspace, mut alone) = (adjoint::Workspace::new(), adjoint::Gradients::default());
    let loss = adjoint::loss::Mse::new(reference.clone());
    for (index, &weight) in weights.iter().enumerate() {
        let (gaussians, rest) = world(variants, states, index);
        let view = Splats::new(&gaussians, &rest, splats.sh_degree())?;
        adjoint::render_and_gradients_into(&mut workspace, &view, camera, settings, &loss, &mut alone)?;
        out.losses.push(alone.loss);
        out.loss += weight * alone.loss;
        out.non_finite += alone.non_finite;
        let present = (0..splats.len()).filter(|&i| states.has(index, variants.groups()[i] as usize));
        for (k, i) in present.enumerate() {
            let parts = numbers(&alone.splats[k]);
            sums[i].iter_mut().zip(parts).for_each(|(sum, v)| *sum += weight * f64::from(v));
            let rest = &alone.sh_rest[k * each..(k + 1) * each];
            let to = &mut rests[i * each..(i + 1) * each];
            to.iter_mut().zip(rest).for_each(|(sum, &v)| *sum += weight * f64::from(v));
        }
        let add = |to: &mut [f64; 3], from: [f64; 3]| (0..3).for_each(|k| to[k] += weight * from[k]);
        add(&mut out.background, alone.background);
        add(&mut out.pose.translation, alone.pose.translation);
        add(&mut out.pose.rotation, alone.pose.rotation);
    }
    out.splats = sums.iter().map(|sum| gradient(sum.map(|v| v as f32))).collect();
    out.sh_rest = rests.iter().map(|&v| v as f32).collect();
    Ok(out)
}

/// Numbers of a [`SplatGradient`].
const NUMBERS: usize = 16;

fn numbers(g: &SplatGradient) -> [f32; NUMBERS] {
    let SplatGradient { position: p, log_scale: s, rotation: q, opacity_logit: o, sh0: c, image_mean: f } =
        *g;
    [p[0], p[1], p[2], s[0], s[1], s[2], q[0], q[1], q[2], q[3], o, c[0], c[1], c[2], f[0], f[1]]
}

fn gradient(
    [p0, p1, p2, s0, s1, s2, q0, q1, q2, q3, o, c0, c1, c2, f0, f1]: [f32; NUMBERS],
) -> SplatGradient {
    SplatGradient {
        position: [p0, p1, p2],
        log_scale: [s0, s1, s2],
        rotation: [q0, q1, q2, q3],
        opacity_logit: o,
        sh0: [c0, c1, c2],
        image_mean: [f0, f1],
    }
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
    Ok(renderer.render(&splats, camera, settings)?.image)
}

impl From<RenderError> for CounterfactualError {
    fn from(error: RenderError) -> Self {
        match error {
            RenderError::Settings(e) => e.into(),
            RenderError::Image(e) => e.into(),
        }
    }
}

impl From<AdjointError> for CounterfactualError {
    fn from(error: AdjointError) -> Self {
        match error {
            AdjointError::Render(e) => e.into(),
            AdjointError::Loss(e) => e.into(),
            AdjointError::Ids { found, needed } => Self::Ids { found, needed },
            AdjointError::Group { group, count } => Self::Group { group, count },
        }
    }
}
