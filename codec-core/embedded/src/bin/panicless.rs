//! The receiver and nothing else. Links only if no panic can be reached from it.

#![no_std]
#![no_main]

include!("../linked.rs");

/// Nothing to add.
fn planted() {}
