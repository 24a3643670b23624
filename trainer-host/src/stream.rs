//! Name the streams of `dgs_player` and say what each packet of one brings.

mod map;
mod player;

pub use dgs_player::{Damage, Stream};
pub use map::{Mark, PacketMap};
pub use player::Player;
