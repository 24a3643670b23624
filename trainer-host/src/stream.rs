//! Says what each packet of a stream brings, and shows its frames as scenes take them.
//!
//! The stream itself, bytes that a host receives and decodes, is `dgs-player`'s.

pub mod decoded;
mod map;
mod player;

pub use dgs_player::{Damage, Stream};
pub use map::{PacketMap, SlicePlacement};
pub use player::Player;
