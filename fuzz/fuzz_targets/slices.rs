//! `cargo +nightly fuzz run slices`: see `fuzz::slices`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::slices(data));

#[cfg(not(fuzzing))]
fn main() {}
