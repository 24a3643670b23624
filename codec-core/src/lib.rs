//! Bytes: the wire formats of dynamic Gaussian splats and the way back to Gaussians, without a heap.
//!
//! | module | what it knows |
//! | --- | --- |
//! | [`wire`] | DGSM manifest, DGSP packets, DGSF receipts, `.dgs` files, CRC: every field, offset, limit and error |
//! | [`rans`] | entropy coding: four lanes per packet, tables named by one byte, the byte-wise form of `paper` |
//! | [`receiver`] | packets in, state out, over the caller's memory |
//! | [`repair`] | lost packets from parity: XOR and a GF(256) Cauchy code |
//! | [`caps`], [`limits`] | what a receiver takes on, what the format can say |
//! | [`closure`], [`layout`], [`quant`] | which levels count, where symbols lie, what they are worth |
//! | [`decode`] | a state and a frame in, Gaussians out, the same bits on every target |
//!
//! `SPEC.md` beside this crate is the format; its tables are test input.
//!
//! ```
//! use codec_core::{Caps, receiver::Requirements, wire::manifest::Manifest};
//!
//! # fn wanted(body: &[u8]) -> codec_core::Result<usize> {
//! let manifest = Manifest::parse(body)?;
//! let symbols = Requirements::of(&manifest, &Caps::HOST)?.symbols; // i16 that the caller must lend
//! # Ok(symbols)
//! # }
//! assert!(wanted(b"no manifest").is_err());
//! ```
#![no_std]
#![forbid(unsafe_code)]

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
pub mod quant;
pub mod rans;
pub mod receiver;
pub mod repair;
pub mod wire {
    //! Everything that travels, byte by byte.
    pub mod bits;
    pub mod crc;
    pub mod file;
    pub mod manifest;
    pub mod packet;
    pub mod receipt;
}

pub use caps::Caps;
pub use error::{Error, ErrorKind, Result};
pub use gaussian::Gaussian;
