//! `cargo +nightly fuzz run dynamic_npz`: see `fuzz::dynamic_npz`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::dynamic_npz(data));

#[cfg(not(fuzzing))]
fn main() {}
