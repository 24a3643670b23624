//! How deep the stack goes: paint below the stack pointer, run, look where the paint is gone.
//!
//! The one module with `unsafe`: paint is written to memory that belongs to nobody. That is sound
//! because all of it lies below the stack pointer and above the end of the statics
//! (`_stack_end`, set by the linker), interrupts are off, and it is touched as volatile words only.

const PAINT: u32 = 0x5ca1_ab1e;
/// Left unpainted below the stack pointer: the frames of painting itself.
const MARGIN: usize = 256;

unsafe extern "C" {
    /// Lowest address of the stack; its value is meaningless, its address counts.
    static _stack_end: u32;
}

/// Bytes of stack that `work` takes below its caller's frame; within [`MARGIN`] (256 bytes) the
/// answer is that or less.
#[inline(never)]
pub fn depth(work: impl FnOnce()) -> usize {
    let top = cortex_m::register::msp::read() as usize;
    let end = &raw const _stack_end as usize;
    let painted = end..top.saturating_sub(MARGIN);
    for address in painted.clone().step_by(4) {
        // SAFETY: aligned (the linker aligns `_stack_end`), inside RAM, below every live frame by
        // at least MARGIN, which is more than this loop and the volatile write use.
        unsafe { core::ptr::with_exposed_provenance_mut::<u32>(address).write_volatile(PAINT) };
    }
    work();
    for address in painted.clone().step_by(4) {
        // SAFETY: as above; the words were written by the loop above or by `work`'s frames.
        let word = unsafe { core::ptr::with_exposed_provenance::<u32>(address).read_volatile() };
        if word != PAINT {
            return top - address;
        }
    }
    MARGIN
}
