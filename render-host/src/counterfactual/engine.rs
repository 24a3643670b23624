//! Answers questions about many states of one scene, seen by one camera, against one reference image.

use super::{
    CounterfactualError, Distortions, States, Utilities, Variants, Versions, WorldGradients, backward,
    bright::ScaledDown,
    distortion, fast,
    scaffold::SharedLists,
    squares::{Planes, cut},
    states::CHUNK,
    strict, utilities,
};
use crate::{
    Camera, Settings,
    image::{Image, same_size},
};

/// What all worlds share. Every answer is the same for any number of threads.
#[derive(Debug)]
pub struct Engine {
    pub(super) shared: SharedLists,
    pub(super) reference: Vec<Planes>,
    /// The reference image as it was given.
    pub(super) against: Image,
    pub(super) settings: Settings,
    pub(super) camera: Camera,
    /// Number of groups.
    pub(super) groups: usize,
    /// The same scene, darker, for squares that leave f32.
    pub(super) scaled_down: Option<Box<ScaledDown>>,
}

impl Engine {
    /// Projects, orders and bins all variants as `camera` sees them. Errors are measured against
    /// `reference`, as sums of squares over all channels of all pixels (data range 1, values not clamped).
    ///
    /// # Errors
    /// A setting out of range, or a reference of another size than the camera.
    pub fn new(
        variants: &Variants,
        camera: &Camera,
        reference: &Image,
        settings: &Settings,
    ) -> Result<Self, CounterfactualError> {
        settings.validate_for_one_tile_side()?;
        let mut film = Image::default();
        film.reset(camera.width(), camera.height())?;
        same_size(&film, reference)?;
        let shared = SharedLists::new(variants, camera, settings);
        let (reference, against) = (cut(reference, settings.parallel), reference.clone());
        let (settings, camera, groups) = (settings.clone(), camera.clone(), variants.count());
        let scaled_down = ScaledDown::new(&shared, &reference, &settings, &camera, groups);
        Ok(Self { shared, reference, against, settings, camera, groups, scaled_down })
    }

    /// Squared error of each world, bit for bit that of the world rendered alone.
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn strict(&self, states: &States) -> Result<Vec<f64>, CounterfactualError> {
        self.check(states)?;
        Ok(strict::errors(self, states))
    }

    /// Distortion, MSE + 0.20 (1 − SSIM), of each context and of each context with any one cluster at each of
    /// its versions: a context names the version of every cluster, and the groups of the engine's variants
    /// are those of `versions`. Pictures are bit for bit those of the states rendered alone, the distortion
    /// is within 1e-12 of theirs. Source: the paper's section 5.
    ///
    /// # Errors
    /// Versions of another number of groups, or a context that does not name a version of every cluster.
    pub fn distortions(
        &self,
        versions: &Versions,
        contexts: &[Vec<u32>],
    ) -> Result<Distortions, CounterfactualError> {
        let (found, needed) = (versions.groups(), self.groups);
        if found != needed {
            return Err(CounterfactualError::States { found, needed });
        }
        versions.check(contexts)?;
        Ok(distortion::distortions(self, versions, contexts))
    }

    /// Picture of `world`, bit for bit that of the world rendered alone.
    ///
    /// # Errors
    /// States of another number of groups, or no such world.
    pub fn image(&self, states: &States, world: usize) -> Result<Image, CounterfactualError> {
        self.check_world(states, world)?;
        Ok(self.images(&states.one(world))?.pop().unwrap_or_default())
    }

    /// Pictures of all worlds, each bit for bit that of the world rendered alone.
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn images(&self, states: &States) -> Result<Vec<Image>, CounterfactualError> {
        self.check(states)?;
        Ok(strict::images(&self.shared, &self.camera, &self.settings, states)?.images)
    }

    /// Squared error of each world without early stop: relative error below 2e-6 against f64 arithmetic.
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn fast(&self, states: &States) -> Result<Vec<f64>, CounterfactualError> {
        self.check(states)?;
        Ok(self.ask(|engine| fast::errors(engine, states)))
    }

    /// Δ_g(m) of every group g in every context m: leave-one-out of those present and add-one-in of those
    /// absent, in one pass. Arithmetic as in [`Engine::fast`].
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn utilities(&self, contexts: &States) -> Result<Utilities, CounterfactualError> {
        self.check(contexts)?;
        Ok(self.ask(|engine| utilities::utilities(engine, contexts)))
    }

    /// Mean squared error of every world, and the gradient of their sum weighted by `weights`, one finite
    /// number per world, with respect to everything `variants` and the camera hold. `variants` are those the
    /// engine was made of. No early stop; gradients as [`crate::render_and_gradients`] has them with early
    /// stop off, within 1e-5 relative to their length ([`super::brute::gradients`] is the twin).
    ///
    /// # Errors
    /// States of another number of groups, variants that are not the engine's, or weights that are not one
    /// finite number per world.
    pub fn gradients(
        &self,
        variants: &Variants,
        states: &States,
        weights: &[f64],
    ) -> Result<WorldGradients, CounterfactualError> {
        self.check(states)?;
        let (found, needed) = (variants.splats().len(), self.shared.projected.splats.len());
        if found != needed {
            return Err(CounterfactualError::Variants { found, needed });
        }
        check_weights(states, weights)?;
        Ok(backward::gradients(self, variants, states, weights))
    }

    /// Bytes that [`Engine::fast`] or [`Engine::strict`] of `worlds` worlds needs, this engine included.
    pub fn predict_bytes(&self, worlds: usize) -> u64 {
        let (tiles, groups) = (self.shared.tiles(), self.groups);
        // A sum per tile and world; the set of each world; that set again, transposed in chunks.
        let sums = 8 * worlds * (tiles + 1);
        let sets = 8 * worlds * groups.div_ceil(64) + 16 * groups * worlds.div_ceil(CHUNK);
        let scaled_down = self.scaled_down.as_ref().map_or(0, |scaled_down| scaled_down.bytes());
        self.shared.bytes() + scaled_down + (tiles * size_of::<Planes>() + sums + sets) as u64
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.groups
    }

    fn check(&self, states: &States) -> Result<(), CounterfactualError> {
        let (found, needed) = (states.groups(), self.groups);
        if found == needed { Ok(()) } else { Err(CounterfactualError::States { found, needed }) }
    }

    fn check_world(&self, states: &States, world: usize) -> Result<(), CounterfactualError> {
        self.check(states)?;
        let count = states.len();
        if world < count { Ok(()) } else { Err(CounterfactualError::World { world, count }) }
    }

    /// Changes every ellipse, as if the projection had given another.
    #[cfg(test)]
    pub(crate) fn map_splats(&mut self, change: impl Fn(&crate::stage::Splat) -> crate::stage::Splat) {
        self.shared.projected.splats.iter_mut().for_each(|splat| *splat = change(splat));
    }
}

/// One finite weight per world.
pub(super) fn check_weights(states: &States, weights: &[f64]) -> Result<(), CounterfactualError> {
    let needed = states.len();
    let good = weights.len() == needed && weights.iter().all(|w| w.is_finite());
    if good { Ok(()) } else { Err(CounterfactualError::Weights { needed }) }
}
