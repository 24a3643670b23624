//! Runs the player on a Cortex-M4F, in three binaries:
//!
//! - `receive` takes a baked-in stream, repairs a loss, decodes and prints a digest, instruction
//!   counts and stack depths over semihosting;
//! - `panicless` is the player and nothing else; it links only if no panic can be reached, with or without
//!   the feature `paper-context`, and its size is the player's;
//! - `planted` is the same with a panic in it, and must not link.
//!
//! All memory is one static arena; its length comes from the manifest when the fixture is written.

#![no_std]

pub mod count;
pub mod fixture;
pub mod memory;
pub mod stack;
