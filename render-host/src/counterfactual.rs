//! Renders many states of one scene at once, and says what each is missing and what each group adds.
//!
//! A scene is given as [`Variants`]: Gaussians, each with the id of its *group*. A *world* (or state) is a
//! set of groups; its picture is the picture of the Gaussians whose group is in the set. Where a level
//! replaces the one below it, every level of a cluster is a group of its own, and [`Versions`] says which.
//! All worlds share one camera and one reference image, so projection, depth order and tile lists are made
//! once, and a world matters to a tile only through the groups that reach the tile.
//!
//! ```text
//! Variants + Camera + reference ─▶ Engine: shared tile lists
//!     distortions  MSE + 0.20 (1 − SSIM) of contexts, and with any one cluster at another version   exact
//!     strict       sum of squared errors of each world, pictures                                     exact
//!     fast         sum of squared errors of each world                                               2e-6
//!     utilities    the same for every world with any one group toggled                               2e-6
//!     gradients    of the mean squared errors of all worlds together                                 1e-5
//! ```
//!
//! *Exact* is bit for bit the picture of the world rendered alone ([`brute`] is the twin); the others have no
//! early stop and no division, and the relative error given against f64 arithmetic. Sums over tiles are f64
//! in order of tiles, so every result is the same for any number of threads, and a world's result does not
//! depend on what other worlds were asked about in the same call.
//!
//! [`WorldBatch`] and [`render_worlds`] draw many worlds without a reference image.
//!
//! ```
//! use render_host::counterfactual::{Engine, Variants, Versions};
//! use render_host::{Camera, Gaussian, Settings, Splats, render};
//!
//! // Cluster 0 is a ball behind, cluster 1 one in front that is absent, coarse or fine.
//! let ball = |z: f32, size: f32| Gaussian {
//!     position: [0.0, 0.0, z],
//!     scale: [size; 3],
//!     opacity: 0.9,
//!     ..Gaussian::ABSENT
//! };
//! let gaussians = [ball(1.0, 0.5), ball(0.0, 0.3), ball(0.0, 0.2)];
//! let versions = Versions::new(&[1, 3])?;
//! let groups = [(0, 0), (1, 1), (1, 2)].map(|(cluster, version)| versions.group(cluster, version) as u32);
//! let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 64, 48)?;
//! let settings = Settings::default();
//!
//! // What should be seen: the fine version.
//! let whole = [gaussians[0], gaussians[2]];
//! let reference = render(&Splats::plain(&whole), &camera, &settings)?.image;
//!
//! let variants = Variants::new(Splats::plain(&gaussians), &groups, versions.groups())?;
//! let engine = Engine::new(&variants, &camera, &reference, &settings)?;
//! let absent = vec![0, 0];
//! let found = engine.distortions(&versions, &[absent])?;
//! let (absent, fine) = (found.of_context(0), found.of(0, 1, 2));
//! assert!(fine < 1e-12 && fine < absent, "{fine:e} {absent:e}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Deliberately absent: which groups depend on which.

mod answers;
mod backward;
mod batch;
pub mod brute;
mod classes;
mod culling;
mod distortion;
mod engine;
mod error;
mod fast;
mod gradients;
mod hidden;
mod lanes;
mod operator;
mod overflow;
mod patches;
mod plan;
mod segments;
mod shared_lists;
mod splat_runs;
mod squares;
mod states;
mod strict;
mod tree;
pub mod tuner;
mod utilities;
mod variants;
mod versions;

pub use batch::{WorldBatch, render_worlds};
pub use engine::Engine;
pub use error::CounterfactualError;
pub use gradients::WorldGradients;
pub use states::States;
pub use utilities::Utilities;
pub use variants::Variants;
pub use versions::{Distortions, Versions};
