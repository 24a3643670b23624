//! `cargo +nightly fuzz run splatv`: see `fuzz::splatv`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::splatv(data));

#[cfg(not(fuzzing))]
fn main() {}
