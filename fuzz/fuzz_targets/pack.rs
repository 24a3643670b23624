//! `cargo +nightly fuzz run pack`: see `fuzz::pack`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::pack(data));

#[cfg(not(fuzzing))]
fn main() {}
