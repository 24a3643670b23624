//! `cargo +nightly fuzz run repair`: see `fuzz::repair`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::repair(data));

#[cfg(not(fuzzing))]
fn main() {}
