//! Plays streams of dynamic Gaussian splats from C and WebAssembly: codec-core's player behind a C ABI.
//!
//! `include/dgs.h` is the header, `tests/decode.c` a whole program.
//!
//! **Memory.** All of it is the caller's, one block per player: `dgs_memory_bytes` says from caps alone
//! how large one is that holds every stream within them, `dgs_required` how large one must be for a
//! stream whose manifest is there. The block must stay where it is, untouched by anybody else, from
//! `dgs_open` to `dgs_close`; then it is the caller's again. Nothing is allocated, nothing needs freeing.
//!
//! **Lifetimes.** Every pointer passed in is used during the call only, the block excepted. Of the
//! pointers handed out, [`DgsError::field`] is good for ever, those of a [`DgsFrame`] until the next call
//! with its player.
//!
//! **Threads.** A player may move between threads, and two players share nothing; two threads must not
//! be inside calls with the same player at once.
//!
//! **Errors.** Calls return a status: [`DGS_OK`], or what is wrong. A [`DgsError`], where one is
//! passed, says which field, where, what was found and what is allowed. Null, misaligned and short
//! buffers and buffers that overlap the block, the error's own among them, are found and refused; pointers
//! that are not what their length says cannot be. A refused packet leaves the player usable.
//!
//! **Panics.** There are none to cross the boundary: codec-core has no reachable panic (a linker
//! test shows it), and a function of the C ABI that unwound would abort.
//!
//! All `unsafe` is in [`ffi`]; [`types`] is what the header declares.

#![no_std]

#[cfg(any(test, not(any(target_os = "none", target_family = "wasm"))))]
extern crate std;

pub mod ffi;
pub mod types;

pub use types::*;

#[cfg(all(feature = "panic-handler", not(test), any(target_os = "none", target_family = "wasm")))]
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    #[cfg(target_family = "wasm")]
    core::arch::wasm32::unreachable();
    #[cfg(not(target_family = "wasm"))]
    loop {
        core::hint::spin_loop();
    }
}
