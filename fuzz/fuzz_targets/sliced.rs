//! `cargo +nightly fuzz run sliced`: see `fuzz::sliced`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::sliced(data));

#[cfg(not(fuzzing))]
fn main() {}
