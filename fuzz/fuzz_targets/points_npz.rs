//! `cargo +nightly fuzz run points_npz`: see `fuzz::points_npz`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::points_npz(data));

#[cfg(not(fuzzing))]
fn main() {}
