//! Draws pictures of many worlds in one call, each bit for bit that of the world rendered alone.

use std::cell::Cell;

use codec_core::Gaussian;

use super::{
    CounterfactualError, States, Variants,
    shared_lists::SharedLists,
    states::CHUNK,
    strict,
    tuner::{self, OutOfMemory, Tuned},
};
use crate::{
    Camera, Counters, Rendered, Renderer, Settings, Splats,
    image::Image,
    stage::{TILE, bin, project, sort},
};

/// What the worlds of a batch share, ready to draw any of them.
#[derive(Debug)]
pub struct WorldBatch {
    shared: SharedLists,
    camera: Camera,
    settings: Settings,
    groups: usize,
}

/// Bytes of a picture of one class of worlds of one tile.
const TILE_BYTES: usize = 4 * 3 * TILE * TILE;

impl WorldBatch {
    /// Projects, orders and bins all variants as `camera` sees them.
    ///
    /// # Errors
    /// A setting out of range.
    pub fn new(
        variants: &Variants,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Self, CounterfactualError> {
        settings.validate_for_one_tile_side()?;
        let shared = SharedLists::new(variants, camera, settings);
        Ok(Self { shared, camera: camera.clone(), settings: settings.clone(), groups: variants.count() })
    }

    /// Pictures of all worlds, bit for bit those of [`super::brute::image`].
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn images(&self, states: &States) -> Result<Vec<Image>, CounterfactualError> {
        let (found, needed) = (states.groups(), self.groups);
        if found != needed {
            return Err(CounterfactualError::States { found, needed });
        }
        Ok(strict::images(&self.shared, &self.camera, &self.settings, states)?.images)
    }

    /// Bytes that [`WorldBatch::images`] of `worlds` worlds needs at most, this batch included. Saturates.
    pub fn predict_bytes(&self, worlds: usize) -> u64 {
        let [width, height] = self.shared.size;
        let picture = 12 * width * height + size_of::<Image>();
        // A row of tiles, every world a class of its own; the class of each world; the set of each world, and
        // that set again, transposed in chunks.
        let of_world = picture + self.shared.columns * TILE_BYTES + 8 * self.groups.div_ceil(64);
        let of_chunk = 4 * CHUNK * self.shared.columns + 16 * self.groups;
        let chunks = worlds.div_ceil(CHUNK).saturating_mul(of_chunk);
        let states = worlds.saturating_mul(of_world).saturating_add(chunks);
        self.shared.bytes().saturating_add(states as u64)
    }

    /// The largest number of the first worlds of `states` that one call may hold within `budget` bytes:
    /// predicted, then drawn to see what it really takes.
    pub fn largest(&self, states: &States, budget: u64) -> Tuned {
        self.largest_with(states, budget, &mut reserve)
    }

    /// As [`WorldBatch::largest`], with `reserve` to say whether so many bytes can be had.
    pub fn largest_with(
        &self,
        states: &States,
        budget: u64,
        reserve: &mut dyn FnMut(u64) -> Result<(), OutOfMemory>,
    ) -> Tuned {
        let predict = |worlds| self.predict_bytes(worlds);
        tuner::largest(budget, states.len(), predict, |worlds| {
            reserve(self.predict_bytes(worlds) - self.shared.bytes())?;
            let drawn = strict::images(&self.shared, &self.camera, &self.settings, &states.range(0..worlds));
            let drawn = drawn.map_err(|_| OutOfMemory)?;
            let pictures: usize =
                drawn.images.iter().map(|i| size_of_val(i.rgb()) + size_of::<Image>()).sum();
            Ok(self.shared.bytes() + (pictures + drawn.scratch) as u64)
        })
    }
}

/// Worlds up to which each has tile lists of its own: lists of all variants, shared by so few worlds, cost
/// more than they saved (`dgs bench worlds` prints the ratio).
const FEW: usize = 4;

/// Renders all worlds of `states` with one projection, one depth order and, unless they are few, one set of
/// tile lists; picture `w` is bit for bit that of world `w` rendered alone.
///
/// # Errors
/// A setting out of range, or states of another number of groups.
pub fn render_worlds(
    variants: &Variants,
    states: &States,
    camera: &Camera,
    settings: &Settings,
) -> Result<Vec<Image>, CounterfactualError> {
    let (found, needed) = (states.groups(), variants.count());
    if found != needed || states.len() > FEW {
        return WorldBatch::new(variants, camera, settings)?.images(states);
    }
    settings.validate_for_one_tile_side()?;
    let mut memory = FEW_WORLDS.take().unwrap_or_default();
    let pictures = if states.len() == 1 {
        memory.alone(variants, states, camera, settings).map(|picture| vec![picture])
    } else {
        memory.one_by_one(variants, states, camera, settings)
    };
    FEW_WORLDS.set(Some(memory));
    pictures
}

thread_local! {
    /// What the last call on this thread allocated, so that calls for a few worlds do not pay for new memory
    /// each time. A call takes it away while it works, since its thread may be given another meanwhile.
    static FEW_WORLDS: Cell<Option<Box<FewWorlds>>> = const { Cell::new(None) };
}

/// What rendering a few worlds takes.
#[derive(Default)]
struct FewWorlds {
    renderer: Renderer,
    rendered: Rendered,
    /// Depth order of what any of the worlds holds.
    order: sort::Order,
    gaussians: Vec<Gaussian>,
    sh_rest: Vec<f32>,
}

impl FewWorlds {
    /// Picture of the first world: what it does not hold is not even projected, and what it holds lies side
    /// by side, which saves more than the copy costs.
    fn alone(
        &mut self,
        variants: &Variants,
        states: &States,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Image, CounterfactualError> {
        let Self { renderer, rendered, gaussians, sh_rest, .. } = self;
        let (all, groups, present) = (variants.splats(), variants.groups(), present(states, 0));
        gaussians.clear();
        sh_rest.clear();
        for (index, (gaussian, &group)) in all.gaussians().iter().zip(groups).enumerate() {
            if present[group as usize] {
                gaussians.push(*gaussian);
                sh_rest.extend_from_slice(all.rest(index));
            }
        }
        let splats = Splats::new(gaussians, sh_rest, all.sh_degree())?;
        renderer.render_into(&splats, camera, settings, rendered)?;
        Ok(std::mem::take(&mut rendered.image))
    }

    /// Pictures of worlds that share a projection of what any of them holds, and a depth order.
    fn one_by_one(
        &mut self,
        variants: &Variants,
        states: &States,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Vec<Image>, CounterfactualError> {
        let Self { renderer, rendered, order: all, .. } = self;
        let size = [camera.width() as usize, camera.height() as usize];
        let (splats, groups) = (variants.splats(), variants.groups());
        let worlds: Vec<Vec<bool>> = (0..states.len()).map(|world| present(states, world)).collect();
        let any: Vec<bool> =
            (0..states.groups()).map(|group| worlds.iter().any(|present| present[group])).collect();
        let has = |index: usize| any[groups[index] as usize];
        project::project_some(&splats, has, camera, settings, &mut renderer.projected);
        sort::sort(&renderer.projected.keys, settings.parallel, all);
        let mut pictures = Vec::with_capacity(states.len());
        for present in &worlds {
            renderer.order.take(all, |splat| present[groups[splat as usize] as usize]);
            let Renderer { projected, order, bands, .. } = &mut *renderer;
            bin::bands(projected, order, size, settings, bands);
            rendered.image.reset(camera.width(), camera.height())?;
            rendered.transmittance.resize(size[0] * size[1], 1.0);
            renderer.compose(size, settings, rendered, &mut Counters::default());
            pictures.push(std::mem::take(&mut rendered.image));
        }
        Ok(pictures)
    }
}

/// Whether `world` holds each group.
fn present(states: &States, world: usize) -> Vec<bool> {
    (0..states.groups()).map(|group| states.has(world, group)).collect()
}

/// Whether the system gives so many bytes.
fn reserve(bytes: u64) -> Result<(), OutOfMemory> {
    let bytes = usize::try_from(bytes).map_err(|_| OutOfMemory)?;
    Vec::<u8>::new().try_reserve_exact(bytes).map_err(|_| OutOfMemory)
}
