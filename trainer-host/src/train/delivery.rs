//! Fine-tunes a scene over sampled partial deliveries, so that what arrives looks its best (paper section 4).
//!
//! ```text
//! scene ─▶ encode once ─▶ decisions, which stay ─▶ lattice of blocks and levels
//!            parameters ─▶ scene ─▶ write ─▶ decode in each world's state ─▶ render ─▶ distortion
//!                 ▲                                                                       │
//!                 └── Adam ◀── gradients, straight through the quantisers ◀───────────────┘
//! ```
//!
//! A *world* is a state: the levels of each block that a sampled delivery brings. The forward pass is the
//! codec's own: a world's Gaussians are those that the decoder shows, dependencies enforced by its closure.
//! The gradient of a decoded value goes to the parameter it was quantised from as if quantisation were the
//! identity, and times its quantisation error to the step of its quantiser. The objective is the paper's:
//!
//! ```text
//! L = E[D] + λc CVaR(D) + λr R + λt F + λm M + λa D(complete),   D = MSE + 0.20 (1 − SSIM)
//! ```
//!
//! Trained are canonical attributes, the steps that they and their motion are quantised with, and in `dgs1`
//! the proxies that stand in for blocks whose base is missing. Equal inputs and seed give equal results on
//! any number of threads. Deliberately absent: networks (emulator-host; its deliveries come as a file of
//! states) and motion, which stays as the encoder chose it.
//!
//! States are drawn and differentiated on the processor, which draws what they share once, or one by one on
//! a graphics device ([`render_host::Backend`]). Losses, the codec and validation are of the processor on
//! both, so that candidates are chosen alike. One picture's gradients on the two agree to 1e-4; those of an
//! update, by parameters and by steps, to 1e-3 (relative L2 distance), except where a rounding decides on
//! which side of a cut-off a splat falls. A fine-tuning may be resumed on another device; bit for bit it goes
//! on only on its own.

mod adam;
mod channel;
mod coded;
mod coding;
mod config;
mod delivered;
mod drawing;
mod error;
mod evaluate;
mod fine_tune;
mod gradient;
mod masks;
mod monotone;
mod objective;
mod parameters;
mod rank;
pub(super) mod rate;
mod rate_model;
mod record;
mod recorded;
mod select;
mod shared_worlds;
mod steps;
mod tail;
mod temporal;
mod tuning;
mod view;

pub use channel::LossModel;
pub use config::{ChannelRanges, DeliveryOptions, LearningRates, LossUnit, Validation, Variant, Weights};
pub use delivered::DeliveredScene;
pub use error::DeliveryError;
pub use evaluate::{Evaluation, evaluate};
pub use fine_tune::{FineTuned, Update, fine_tune, resume};
pub use masks::Masks;
pub use objective::Terms;
pub use rank::{RankChoice, RankResult, choose_rank, input_hashes, measure_rank};
pub use record::{Preregistration, Record};
pub use recorded::Recording;
pub use select::Candidate;
pub use tuning::Tuning;
pub use view::Reference;
