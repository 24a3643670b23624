//! The receiver and decoder of codec-core behind a C ABI; `include/dgs.h` is the header.
//!
//! **Memory.** All of it is the caller's, one block per receiver: `dgs_sizes_of` reads the sizes
//! out of a manifest (or the caller fills [`DgsSizes`] from limits of its own),
//! `dgs_memory_bytes` says how large the block must be, `dgs_open` makes a receiver in it. The
//! block must stay where it is, untouched by anybody else, until `dgs_close`; then it is the
//! caller's again. Nothing is allocated and nothing needs freeing.
//!
//! **Lifetimes.** Every pointer passed in is used during the call only, the block excepted. The
//! one pointer handed out, [`DgsError::field`], points to constants and is good for ever.
//!
//! **Threads.** A receiver may move between threads, and two receivers share nothing; two threads
//! must not be inside calls with the same receiver at once.
//!
//! **Errors.** Calls return a status: [`DGS_OK`], or what is wrong. A [`DgsError`], where one is
//! passed, says which field, where, what was found and what is allowed. Null, misaligned,
//! overlapping and short buffers are found and refused; pointers that are not what their length
//! says cannot be. A refused packet leaves the receiver usable.
//!
//! **Panics.** There are none to cross the boundary: codec-core has no reachable panic (a linker
//! test shows it), and a function of the C ABI that unwound would abort.
//!
//! All `unsafe` is in [`ffi`]; [`block`] computes where things lie, [`types`] is what the header
//! declares.

#![no_std]

#[cfg(any(test, not(any(target_os = "none", target_family = "wasm"))))]
extern crate std;

pub mod block;
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
