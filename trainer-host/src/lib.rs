//! trainer-host imports, exports and trains scenes, encodes them into streams, and measures what parts add.
//!
//! Its modules, in the order in which a scene goes through them:
//!
//! ```text
//! photographs ─▶ train ─▶ scene (import) ─▶ encode ─▶ stream ─▶ (codec-core decodes) ─▶ utility
//!                           └─▶ scene (export)
//! ```
//!
//! ```
//! use trainer_host::{encode, import::{Limits, synth}};
//!
//! let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..synth::SynthOptions::default() };
//! let scene = synth::make(&options, &Limits::default())?;
//! let encoded = encode::encode(&scene, &encode::EncodeOptions::default(), &encode::no_progress)?;
//! // Everything that was chosen is plain data, and replays to the same bytes.
//! let again = encode::write(&scene, &encoded.decisions, &encode::no_progress)?;
//! assert_eq!(again.stream.to_bytes()?, encoded.stream.to_bytes()?);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Deliberately absent: time and networks (emulator-host), how pixels are made (render-host), and the bytes
//! of packets themselves (codec-core: this crate chooses, that one writes down).

pub mod encode;
pub mod scene;
pub mod stream;
pub mod train;
pub mod utility;

pub use encode::{cluster, evaluator, factorise, sensitivity};
pub use scene::{
    Attributes, Epoch, Instant, Scene, SceneError, Track, activation, edit, export, import, viewpoint,
};
pub use stream::Stream;

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
