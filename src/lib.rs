//! `dgs` knows **the order of the walk**: scene → stream → link → pixels → figures.
//!
//! The rooms: codec-core knows bytes, render-host pixels, trainer-host scenes, emulator-host time.
//! This package is the only one that sees all of them. Its library holds the walk
//! ([`pipeline`], [`delivery`]), the report ([`report`]) and the verbs of the command
//! line ([`command`]); the binary parses what was typed. What measures is package `dgs-lab`.
//!
//! Deliberately absent: anything that could live in one room. What only needs bytes, pixels,
//! scenes or time belongs there.

pub mod args;
pub mod command;
pub mod delivery;
pub mod figures;
pub mod files;
pub mod output;
pub mod pictures;
pub mod pipeline;
pub mod progress;
pub mod report;
mod sweep;
