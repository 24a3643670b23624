//! `cargo +nightly fuzz run closure`: see `fuzz::closure`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::closure(data));

#[cfg(not(fuzzing))]
fn main() {}
