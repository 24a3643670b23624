//! Names what a counterfactual call refuses.

use crate::{image::ImageError, settings::SettingsError, splats::SplatsError};

/// An input that cannot be used.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CounterfactualError {
    /// Another number of group ids than of Gaussians.
    #[error("groups: found {found} ids for {needed} Gaussians")]
    Ids {
        /// Ids found.
        found: usize,
        /// Gaussians, hence ids needed.
        needed: usize,
    },
    /// A group id out of range.
    #[error("group {group}; ids below {count} are allowed")]
    Group {
        /// The id.
        group: u32,
        /// Number of groups.
        count: usize,
    },
    /// States of another number of groups than the variants have.
    #[error("states of {found} groups for variants of {needed}")]
    States {
        /// Groups of the states.
        found: usize,
        /// Groups of the variants.
        needed: usize,
    },
    /// A cluster that shows nothing in any context.
    #[error("cluster {cluster} has no version; at least one is needed")]
    NoVersion {
        /// The cluster.
        cluster: usize,
    },
    /// A context that does not name a version of every cluster.
    #[error("context of {found} clusters; need {needed}")]
    Context {
        /// Clusters found.
        found: usize,
        /// Clusters of the versions.
        needed: usize,
    },
    /// A context that names a version that its cluster has not.
    #[error("version {version} of cluster {cluster}; versions below {count} are allowed")]
    Version {
        /// The cluster.
        cluster: usize,
        /// The version it is said to show.
        version: u32,
        /// Its versions.
        count: usize,
    },
    /// Weights that are not one finite number per world.
    #[error("weights must be {needed} finite numbers")]
    Weights {
        /// Number of worlds.
        needed: usize,
    },
    /// Variants of another number of Gaussians than the engine was made of.
    #[error("variants of {found} Gaussians for an engine of {needed}")]
    Variants {
        /// Gaussians found.
        found: usize,
        /// Gaussians of the engine.
        needed: usize,
    },
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The reference has another size than the camera, or an image could not be made.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Slices that do not describe the same Gaussians.
    #[error(transparent)]
    Splats(#[from] SplatsError),
}
