//! `cargo +nightly fuzz run gltf_splats`: see `fuzz::gltf_splats`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::gltf_splats(data));

#[cfg(not(fuzzing))]
fn main() {}
