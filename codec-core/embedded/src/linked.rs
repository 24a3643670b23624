// The program of `panicless` and `planted`: they differ in what `planted()` does.

use core::hint::black_box;

use codec_core::{
    internals::wire::{crc::crc32, receipt::Receipt},
    player::Waiting,
};
use codec_embedded::memory;
use cortex_m_rt::entry;

#[allow(unsafe_code, reason = "a symbol that nobody defines can only be declared")]
unsafe extern "C" {
    /// Defined nowhere: whatever still calls it after optimisation fails to link.
    safe fn a_panic_can_be_reached() -> !;
}

#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    a_panic_can_be_reached()
}

#[entry]
fn main() -> ! {
    planted();
    // What the optimiser cannot see through: any bytes, any length, any frame.
    let bytes: &'static [u8] = black_box(&[]);
    if let Some(mut waiting) = memory::take() {
        let _ = black_box(waiting.push(black_box(bytes)));
        let _ = black_box(waiting.required(black_box(bytes)));
        play(waiting, bytes);
    }
    loop {
        black_box(0);
    }
}

/// Everything that a player does.
fn play(waiting: Waiting<'static>, bytes: &'static [u8]) {
    let mut player = match waiting.manifest(black_box(bytes)) {
        Ok(player) => player,
        Err((waiting, error)) => {
            black_box((waiting.counters(), error));
            return;
        }
    };
    loop {
        let bytes = black_box(bytes);
        let _ = black_box(player.push(bytes));
        let _ = black_box(player.frame(black_box(0)).map(|frame| frame.decoded));
        let _ = black_box(player.usable(black_box(0)));
        let _ = black_box(Receipt::parse(bytes, crc32).map(|r| r.sequence));
        let mut receipt = [0u8; 1200];
        let _ = black_box(player.receipt(black_box(0), black_box(0), black_box(None), &mut receipt));
        black_box((&receipt, player.counters()));
    }
}
