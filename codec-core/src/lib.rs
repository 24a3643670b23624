//! Plays streams of dynamic Gaussian splats: bytes in, Gaussians out, without a heap.
//!
//! A [`player::Waiting`] takes the caller's memory and [`Caps`]; the manifest turns it into a
//! [`player::Player`], which takes packets in any order, keeps what it can use of them, repairs losses, and
//! decodes any frame from what has arrived.
//!
//! ```
#![doc = include_str!("../examples/static_memory.rs")]
//! ```
//!
//! The same player over heap memory, with SIMD and files, is the crate `dgs-player`; over a C ABI it is
//! `codec-capi`. `SPEC.md` beside this crate is the format; its tables are test input.
#![no_std]
#![forbid(unsafe_code)]

mod caps;
pub mod internals;
pub mod player;

pub use caps::Caps;
pub use internals::{
    error::{Error, ErrorKind, Result},
    footprint::Footprint,
    gaussian::{Gaussian, ShDegree},
    ids::PacketId,
    up::Up,
};

pub mod file {
    //! Finds the parts of a `.dgs` file.
    pub use crate::internals::wire::file::parts;
}

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

// So that paths inside the crate stay short.
use internals::{
    arena, closure, cursor, decode, error, footprint, gaussian, ids, layout, limits, math, pack, quant, rans,
    receiver, repair, up, wire,
};
