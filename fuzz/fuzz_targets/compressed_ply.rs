//! `cargo +nightly fuzz run compressed_ply`: see `fuzz::compressed_ply`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::compressed_ply(data));

#[cfg(not(fuzzing))]
fn main() {}
