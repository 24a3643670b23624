//! Publishes streams to a relay of Media over QUIC, and plays them from it: fan-out beyond one machine.
//!
//! A stream is a broadcast: its manifest, and per level a track of attributes and one of motion. A group of
//! a track is what one epoch or window has of that level, most useful packets first. The relay caches and
//! copies groups; where a subscriber's path is too narrow, those of high levels are cut short. `SESSION.md`,
//! section 8, defines tracks and numbers. The protocol itself is `moq-net`'s, over WebTransport by `quinn`.

mod broadcast;
mod channel;
mod growing;
mod numbering;
mod player;
mod publisher;
mod relay;
#[cfg(test)]
mod tests;
mod track;
mod units;

pub use broadcast::{BroadcastReport, ChannelError};
pub use player::play;
pub use publisher::{PublishConfig, PublishError, PublishEvent, PublishReport, publish};
