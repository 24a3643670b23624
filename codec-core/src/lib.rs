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
//!
//! Everything that a player is made of is open to the encoder, the fuzzers and tests:
//!
//! | module | what it knows |
//! | --- | --- |
//! | [`wire`] | DGSM manifest, DGSP packets, DGSF receipts, `.dgs` files, CRC: every field, offset, limit and error |
//! | [`rans`] | entropy coding: four lanes per packet, tables named by one byte, the byte-wise form of `paper` |
//! | [`arena`] | how one block of memory is divided |
//! | [`receiver`] | packets in, state out |
//! | [`repair`] | lost packets from parity: XOR and a GF(256) Cauchy code |
//! | [`closure`], [`layout`], [`quant`] | which levels count, where symbols lie, what they are worth |
//! | [`decode`] | a state and a frame in, Gaussians out, the same bits on every target |
#![no_std]
#![forbid(unsafe_code)]

pub mod arena;
pub mod caps;
pub mod closure;
pub mod cursor;
pub mod decode;
pub mod digest;
pub mod error;
pub mod gaussian;
pub mod ids;
pub mod layout;
pub mod limits;
pub mod math;
pub mod pack;
pub mod player;
pub mod quant;
pub mod rans;
pub mod receiver;
pub mod repair;
pub mod wire {
    //! Everything that travels, byte by byte.
    pub mod bits;
    pub mod checked;
    pub mod crc;
    pub mod file;
    pub mod manifest;
    pub mod packet;
    pub mod receipt;
}

pub use wire::file;

pub use caps::Caps;
pub use error::{Error, ErrorKind, Result};
pub use gaussian::Gaussian;
