//! Draws results as self-contained SVG.

pub mod curves;
pub mod scatter;
