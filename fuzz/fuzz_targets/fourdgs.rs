//! `cargo +nightly fuzz run fourdgs`: see `fuzz::fourdgs`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::fourdgs(data));

#[cfg(not(fuzzing))]
fn main() {}
