//! As `panicless`, with one index out of bounds: must not link, or the test is worth nothing.

#![no_std]
#![no_main]

include!("../linked.rs");

/// An index that nobody can know.
fn planted() {
    let values = core::hint::black_box([1u8, 2, 3]);
    core::hint::black_box(values[core::hint::black_box(2usize)]);
}
