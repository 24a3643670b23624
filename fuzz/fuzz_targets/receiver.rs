//! `cargo +nightly fuzz run receiver`: see `fuzz::receiver`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::receiver(data));

#[cfg(not(fuzzing))]
fn main() {}
