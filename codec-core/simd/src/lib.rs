//! Decodes several packets at once, for hosts that receive many: the four-lane rANS decoder of
//! [`codec_core::internals::rans::lanes`] over 8 packets in AVX2 or 16 in AVX-512.
//!
//! Packets need no common table, length or run list: each keeps its own place in its own runs, and
//! one that is done makes room for the next. What the vectors do is pop tokens of whole groups of
//! four values, from words and from what the states keep, and put raw bits behind them; everything
//! else (escapes, the last values of all, every check) is the scalar decoder's, which takes over
//! where they stop. A packet that is refused is decoded again by
//! the scalar decoder, so that its error is the scalar one.
//!
//! The instruction set is found at run time; without one the scalar decoder does all of it. All
//! `unsafe` of the codec is in the kernels here.

mod batch;
mod bundle;
mod crc;
mod job;
mod kernel;
mod lockstep;
mod many;
mod repair;

pub use batch::BatchReceiver;
pub use crc::crc32;
pub use job::{Job, Tables};
pub use kernel::Kernel;
pub use many::decode_many_with;
pub use repair::{combine, combines};

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
