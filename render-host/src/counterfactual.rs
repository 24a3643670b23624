//! Many states of one scene at once: what each of them costs in squared error, and what each group is worth.
//!
//! A scene is given as *variants*: Gaussians, each with the id of its *group*. A *world* is a set of groups;
//! its picture is the picture of the Gaussians whose group is in the set. All worlds share one camera and
//! one reference image, so projection, depth order and tile lists are made once ([`Engine::new`]), and a
//! world matters to a tile only through the groups that reach the tile.
//!
//! ```text
//! Variants + Camera ─▶ shared lists ─▶ per tile, per block of 4 × 4 pixels (sixteen lanes), alphas once:
//!     strict    worlds blended as one until a group comes that only some hold
//!     fast      runs of one group composed once ─▶ segments of few groups once per look ─▶ worlds walk
//!     gradients the same, then back over segments, runs and splats; projection once for all worlds
//! ```
//!
//! *Strict* does the operations of [`crate::Renderer`] in its order: images and errors equal, bit for bit,
//! those of the world rendered alone ([`brute`]). *Fast* has no early stop and no division; its relative
//! error of a sum of squares is below 2e-6 against f64 arithmetic. The fast modes are one kernel under
//! different plans of lanes: whole worlds, one group toggled, two groups toggled, groups arriving in order.
//! [`Engine::single_pass`] has no lanes: one context at a time, every group for one number per pixel. Groups
//! that change nothing but colours need no engine at all: [`Quadratic`] answers every state without drawing.
//! Sums over tiles are f64 in order of tiles, so every result is the same for any number of threads, and a
//! world's result does not depend on what other worlds were asked about in the same call.
//!
//! [`WorldBatch`] and [`render_worlds`] draw many worlds without a reference image.
//!
//! Deliberately absent: which groups depend on which. A level that replaces the one below it is two
//! variants; [`levels`] maps delivered levels to worlds.

mod backward;
mod batch;
pub mod brute;
mod classes;
mod dimmed;
mod distortion;
mod engine;
mod error;
mod faded;
mod fast;
mod gradients;
pub mod greedy;
mod lanes;
pub mod levels;
mod operator;
mod patches;
pub mod pairs;
mod plan;
mod prefixes;
pub mod quadratic;
mod runs;
mod scaffold;
mod segments;
mod sieve;
mod single_pass;
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
pub use greedy::Greedy;
pub use levels::Lattice;
pub use pairs::Pairs;
pub use quadratic::Quadratic;
pub use states::States;
pub use utilities::Utilities;
pub use variants::Variants;
pub use versions::{Distortions, Versions};
