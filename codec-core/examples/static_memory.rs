//! Plays a stream as a microcontroller does: no heap, static memory sized by caps alone.

use std::sync::Mutex;

use codec_core::{Caps, Result, file, player::Waiting};

const CAPS: Caps = Caps { gaussians_per_epoch: 256, symbols: 32 << 10, tables: 32, ..Caps::SMALL };
static ARENA: Mutex<[u64; CAPS.arena_words()]> = Mutex::new([0; CAPS.arena_words()]);
static FILE: &[u8] = include_bytes!("../tests/conformance/one.dgs");

fn main() -> Result<()> {
    let mut arena = ARENA.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
    let (message, packets) = file::parts(FILE)?;
    let mut player = Waiting::new(&mut arena[..], CAPS)?.manifest(message).map_err(|(_, error)| error)?;
    for packet in packets {
        player.push(packet)?;
    }
    println!("{:?}", player.frame(0)?.gaussians[0]);
    Ok(())
}
