//! Analyses a scene once: what decisions at any fineness are made from.

use codec_core::internals::wire::manifest::Profile;

use super::{
    EncodeError, EncodeOptions, Progress,
    progress::{part, report},
    quantiser_class::QuantiserClasses,
};
use crate::scene::Scene;

/// A scene, its clusters, and which of them share steps because errors in them show alike.
pub struct Analysis<'s> {
    pub(super) scene: &'s Scene,
    pub(super) classes: QuantiserClasses,
}

impl<'s> Analysis<'s> {
    /// Renders pictures of `scene`, measures how errors show in them, and clusters its Gaussians.
    ///
    /// # Errors
    /// What the renderer refuses; steps that the format does not hold.
    pub fn of(
        scene: &'s Scene,
        options: &EncodeOptions,
        progress: Progress<'_>,
    ) -> Result<Self, EncodeError> {
        report(progress, "analyse", 0.0)?;
        let classes = if options.profile == Profile::Paper {
            QuantiserClasses::none(scene, options)
        } else if options.pictures == 0 {
            QuantiserClasses::one(scene, options)?
        } else {
            QuantiserClasses::measured(scene, options, &part(progress, 0.0, 0.9))?
        };
        report(progress, "analyse", 1.0)?;
        Ok(Self { scene, classes })
    }

    /// The analysis of epoch `epoch` alone, which is all of `part`.
    pub(super) fn of_epoch<'p>(&self, part: &'p Scene, epoch: usize) -> Analysis<'p> {
        Analysis { scene: part, classes: self.classes.part(epoch) }
    }
}
