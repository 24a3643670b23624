//! Lends a player its memory: one static arena.

use codec_core::{Caps, player::Waiting};
use static_cell::ConstStaticCell;

use crate::fixture;

static ARENA: ConstStaticCell<[u64; fixture::ARENA_WORDS]> = ConstStaticCell::new([0; fixture::ARENA_WORDS]);

/// Bounds of the player: room for one packet before the manifest.
const CAPS: Caps = Caps { early_bytes: fixture::EARLY_BYTES, ..Caps::SMALL };

/// A player that waits for its manifest, once.
pub fn take() -> Option<Waiting<'static>> {
    Waiting::new(ARENA.try_take()?, CAPS).ok()
}
