// The program of `panicless` and `planted`: they differ in what `planted()` does.

use codec_core::{
    decode::Decoder,
    ids::PacketId,
    receiver::Receiver,
    wire::crc::crc32,
    wire::receipt::{Receipt, Value},
};
use codec_embedded::memory::Memory;
use core::hint::black_box;
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
    if let Some(Memory { receiver, decoder, out, sh_rest }) = Memory::take() {
        let mut receiver = Receiver::new(black_box(receiver));
        let mut decoder = Decoder::new(black_box(decoder));
        loop {
            let bytes = black_box(bytes);
            if black_box(true) {
                let _ = black_box(receiver.control(bytes));
            }
            let _ = black_box(receiver.media(bytes));
            if let Some(content) = receiver.content() {
                let _ = black_box(decoder.frame(&content, black_box(0), black_box(out), black_box(sh_rest)));
            }
            let _ = black_box(Receipt::parse(bytes, crc32).map(|r| r.sequence));
            let mut receipt = [0u8; 1200];
            let recovered = [PacketId::default()];
            let value = Value {
                sequence: black_box(0),
                playout_us: black_box(0),
                pose: black_box(None),
                acknowledged: black_box(&[]),
                recovered: black_box(&recovered),
                completed: black_box(&[]),
            };
            let _ = black_box(value.write(black_box(&mut receipt)));
            black_box(receiver.counters());
        }
    }
    loop {
        black_box(0);
    }
}
