//! Instructions, from SysTick under `qemu -icount shift=0`, where every instruction takes one
//! nanosecond of the machine's time.
//!
//! The board's clock runs at 25 MHz, so that a tick is 40 instructions; [`Counter::start`] checks
//! that against a loop of known length instead of trusting it. Real cycles are more: QEMU knows
//! nothing of flash wait states or multi-cycle instructions.

use cortex_m::peripheral::{SYST, syst::SystClkSource};

const WRAP: u32 = 0xff_ffff;
/// Instructions of the loop that is counted at the start, and a few.
const KNOWN: u32 = 400_000;

/// A running counter. Works up to 2^24 ticks, about 670 million instructions, at a time.
pub struct Counter {
    per_tick: u32,
}

impl Counter {
    /// Starts SysTick and finds out how many instructions a tick takes.
    pub fn start(mut timer: SYST) -> Self {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(WRAP);
        timer.clear_current();
        timer.enable_counter();
        let ticks = Self { per_tick: 1 }.of(|| cortex_m::asm::delay(KNOWN));
        // To the nearest whole number: the loop ends within a tick.
        Self { per_tick: (KNOWN + ticks / 2).checked_div(ticks).unwrap_or(0) }
    }

    /// Instructions per tick, as found.
    pub fn per_tick(&self) -> u32 {
        self.per_tick
    }

    /// Instructions that `work` takes, to within two ticks.
    pub fn of(&self, work: impl FnOnce()) -> u32 {
        let start = SYST::get_current();
        work();
        let end = SYST::get_current();
        (start.wrapping_sub(end) & WRAP).wrapping_mul(self.per_tick)
    }
}
