//! How deep the stack goes: paint below the stack pointer, run, look where the paint is gone.
//!
//! The one module with `unsafe`: paint is written to memory that belongs to nobody. That is sound
//! because all of it lies below the stack pointer and above the end of the statics
//! (`_stack_end`, set by the linker), interrupts are off, and the loop that paints is assembly,
//! which has no frame of its own.

#![allow(unsafe_code, reason = "see above")]

use core::arch::asm;

const PAINT: u32 = 0x5ca1_ab1e;

unsafe extern "C" {
    /// Lowest address of the stack; its value is meaningless, its address counts.
    static _stack_end: u32;
}

/// Bytes of stack that `work` takes, its own frame included. Interrupts must be off.
#[inline(never)]
pub fn depth(work: impl FnOnce()) -> usize {
    let end = &raw const _stack_end as usize;
    let top: usize;
    // SAFETY: writes words from `_stack_end` (which the linker aligns) up to the stack pointer:
    // inside RAM, below every live frame, and no handler runs that could push one meanwhile.
    unsafe {
        asm!(
            "2: cmp {at}, sp",
            "bhs 3f",
            "str {paint}, [{at}], #4",
            "b 2b",
            "3: mov {top}, sp",
            at = inout(reg) end => _,
            paint = in(reg) PAINT,
            top = lateout(reg) top,
        );
    }
    apart(work);
    for address in (end..top).step_by(4) {
        // SAFETY: the words painted above, written since by nothing but `work`'s frames.
        let word = unsafe { core::ptr::with_exposed_provenance::<u32>(address).read_volatile() };
        if word != PAINT {
            return top - address;
        }
    }
    0
}

/// Runs `work` in a frame of its own, so that it is counted.
#[inline(never)]
fn apart(work: impl FnOnce()) {
    work();
}
