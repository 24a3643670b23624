//! codec-core
#![no_std]
#![forbid(unsafe_code)]
pub mod gaussian;
pub use gaussian::Gaussian;
