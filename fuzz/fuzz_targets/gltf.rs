//! `cargo +nightly fuzz run gltf`: see `fuzz::gltf`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::gltf(data));

#[cfg(not(fuzzing))]
fn main() {}
