//! Measures what the project quotes: experiments, public peers, fixtures.
//!
//! `dgs bench NAME` runs this package's binary. Every number a document or an issue names is a figure
//! of one bench here ([`experiment::ALL`]), beside its error and, where there is one, a public peer
//! that ran in the same process. Nothing of the product depends on it.

pub mod browser;
pub mod draw;
pub mod experiment;
pub mod figures;
pub mod fixture;
mod relay;
pub mod setup;
pub mod source;
pub mod stress;
