//! An engine answers questions about many states of its scene.

use super::{
    backward, distortion,
    engine::{Engine, check_weights},
    error::CounterfactualError,
    fast,
    gradients::WorldGradients,
    states::States,
    strict,
    utilities::{self, Utilities},
    variants::Variants,
    versions::{Distortions, Versions},
};
use crate::metric;

impl Engine {
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
        self.distortions_where(versions, contexts, None)
    }

    /// The same, where pixels whose value in `counted`, one per pixel, row by row, is 0 are taken as equal to
    /// the reference: the distortion of [`metric::where_counted()`].
    ///
    /// # Errors
    /// As [`Engine::distortions`], or not one value per pixel.
    pub fn distortions_where(
        &self,
        versions: &Versions,
        contexts: &[Vec<u32>],
        counted: Option<&[u8]>,
    ) -> Result<Distortions, CounterfactualError> {
        let (found, needed) = (versions.groups(), self.groups);
        if found != needed {
            return Err(CounterfactualError::States { found, needed });
        }
        versions.check(contexts)?;
        counted.map(|counted| metric::where_counted::check(&self.against, counted)).transpose()?;
        Ok(distortion::distortions(self, versions, contexts, counted))
    }

    /// Squared error of each world without early stop: relative error below 2e-6 against f64 arithmetic.
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn fast(&self, states: &States) -> Result<Vec<f64>, CounterfactualError> {
        self.check(states)?;
        Ok(self.with_overflow_rescue(|engine| fast::errors(engine, states)))
    }

    /// Δ_g(m) of every group g in every context m: leave-one-out of those present and add-one-in of those
    /// absent, in one pass. Arithmetic as in [`Engine::fast`].
    ///
    /// # Errors
    /// States of another number of groups.
    pub fn utilities(&self, contexts: &States) -> Result<Utilities, CounterfactualError> {
        self.check(contexts)?;
        Ok(self.with_overflow_rescue(|engine| utilities::utilities(engine, contexts)))
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
}
