//! `cargo +nightly fuzz run deformation`: see `fuzz::deformation`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::deformation(data));

#[cfg(not(fuzzing))]
fn main() {}
