//! Receives the fixture's stream and says what came of it; see the library.
//!
//! Lines are `key value`. The exit status of the machine is 0 if the digest is the host's.

#![no_std]
#![no_main]

use codec_core::{
    internals::{
        cursor::Reader,
        digest::Digest,
        rans::{
            lanes::{self, Compact, Lookup},
            table::{SLOTS, Table},
        },
    },
    player::Counters,
};
use codec_embedded::{count::Counter, fixture, memory, stack};
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use static_cell::ConstStaticCell;

static LAW_SLOTS: ConstStaticCell<[u32; SLOTS]> = ConstStaticCell::new([0; SLOTS]);
static LAW_TOKENS: ConstStaticCell<[u8; SLOTS]> = ConstStaticCell::new([0; SLOTS]);
static LAW_RANGES: ConstStaticCell<[u32; 256]> = ConstStaticCell::new([0; 256]);
static LAW_OUT: ConstStaticCell<[i16; 4096]> = ConstStaticCell::new([0; 4096]);

#[panic_handler]
fn panic(info: &core::panic::PanicInfo<'_>) -> ! {
    hprintln!("panic {}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}

#[entry]
fn main() -> ! {
    let good = run().unwrap_or(false);
    debug::exit(if good { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::nop();
    }
}

/// Whether the stream and the laws decode to what the host says; `None` if a part is missing.
fn run() -> Option<bool> {
    cortex_m::interrupt::disable();
    let counter = Counter::start(cortex_m::Peripherals::take()?.SYST);
    hprintln!("instructions_per_tick {}", counter.per_tick());
    let laws = laws(&counter)?;
    let mut waiting = memory::take()?;
    // The first packet comes before the manifest and waits.
    let mut packets = fixture::packets(fixture::ARRIVALS);
    let _ = waiting.push(packets.next()?);
    let mut player = None;
    let mut instructions = 0;
    let depth = stack::depth(|| {
        instructions = counter.of(|| player = Some(waiting.manifest(fixture::MESSAGE)));
    });
    let mut player = match player? {
        Ok(player) => player,
        Err((_, error)) => {
            hprintln!("refused {}", error);
            return None;
        }
    };
    hprintln!("control.stack {}", depth);
    hprintln!("control.instructions {}", instructions);
    let (mut deepest, mut sum) = (0, 0u32);
    for packet in packets {
        let depth = stack::depth(|| {
            // Counted by kind in the player's counters.
            sum += counter.of(|| {
                let _ = player.push(packet);
            });
        });
        deepest = deepest.max(depth);
    }
    hprintln!("media.stack {}", deepest);
    hprintln!("media.instructions {}", sum);
    let Counters { media, parity, early, recovered, repair_failed, refused } = *player.counters();
    for (name, count) in [
        ("media", media),
        ("parity", parity),
        ("early", early),
        ("recovered", recovered),
        ("repair_failed", repair_failed),
        ("refused", refused.iter().sum()),
    ] {
        hprintln!("count.{} {}", name, count);
    }
    let mut digest = Digest::new();
    let (mut deepest, mut sum, mut gaussians) = (0, 0u32, 0);
    for &frame in fixture::FRAMES {
        let mut decoded = false;
        let depth = stack::depth(|| sum += counter.of(|| decoded = player.frame(frame).is_ok()));
        if !decoded {
            return None;
        }
        deepest = deepest.max(depth);
        // Decoded again, where it is not counted, for what it shows.
        let shown = player.frame(frame).ok()?;
        gaussians += shown.gaussians.len();
        digest = digest.frame(shown.gaussians, shown.sh_rest);
    }
    hprintln!("frame.stack {}", deepest);
    hprintln!("frame.instructions {}", sum);
    hprintln!("frame.gaussians {}", gaussians);
    hprintln!("digest {:016x}", digest.get());
    Some(laws && digest.get() == fixture::DIGEST)
}

/// The coder alone, one law and one form of table at a time: instructions, stack, and whether the
/// symbols are right.
fn laws(counter: &Counter) -> Option<bool> {
    let slots = LAW_SLOTS.try_take()?;
    let tokens = LAW_TOKENS.try_take()?;
    let ranges = LAW_RANGES.try_take()?;
    let out = LAW_OUT.try_take()?;
    let mut good = true;
    for (&(name, symbols, raw_bits), law) in fixture::LAWS.iter().zip(&fixture::BODIES) {
        let table = Table::read(&mut Reader::new(law.table)).ok()?;
        let out = out.get_mut(..symbols)?;
        hprintln!("{}.symbols {}", name, symbols);
        let fill = counter.of(|| table.fill_slots(slots));
        hprintln!("{}.slots.fill {}", name, fill);
        good &= one(counter, name, "slots", law, &*slots, (raw_bits, table.raw_bits()), out)?;
        let mut compact = None;
        let fill = counter.of(|| compact = Some(Compact::fill(&table, tokens, ranges)));
        hprintln!("{}.compact.fill {}", name, fill);
        good &= one(counter, name, "compact", law, &compact?, (raw_bits, table.raw_bits()), out)?;
    }
    Some(good)
}

/// One law with one form of table; `raw_bits` of the body and of each value.
fn one(
    counter: &Counter,
    name: &str,
    form: &str,
    law: &fixture::Law,
    table: &impl Lookup,
    raw_bits: (usize, u8),
    out: &mut [i16],
) -> Option<bool> {
    out.fill(0);
    let mut whole = Ok(());
    let instructions = counter.of(|| {
        whole = lanes::Decoder::new(law.body, out.len(), raw_bits.0).and_then(|mut decoder| {
            decoder.run(table, raw_bits.1, out)?;
            decoder.finish()
        });
    });
    let digest = out.iter().fold(Digest::new(), |d, s| d.bytes(&s.to_le_bytes()));
    let mut decoder = lanes::Decoder::new(law.body, out.len(), raw_bits.0).ok()?;
    let mut again = Ok(());
    let depth = stack::depth(|| again = decoder.run(table, raw_bits.1, out));
    hprintln!("{}.{}.instructions {}", name, form, instructions);
    hprintln!("{}.{}.stack {}", name, form, depth);
    Some(whole.and(again).is_ok() && digest.get().to_le_bytes()[..] == *law.digest)
}
