//! dgs
