//! Receives and decodes streams of dynamic Gaussian splats on a host: bytes or files in, Gaussians out.
//!
//! [`Player`] has everything: memory from the heap, entropy decoding and repair by the vectors of this
//! machine. [`Waiting`] is one that keeps early packets until its manifest comes, [`Stream`] the bytes
//! of a `.dgs` file, [`FrameDecoder`] a decoder for hosts that show many states of one stream.
//!
//! Decoding a file:
//!
//! ```no_run
#![doc = include_str!("../examples/decode_file.rs")]
//! ```
//!
//! Playing datagrams while they come, some of them lost:
//!
//! ```no_run
#![doc = include_str!("../examples/decode_udp.rs")]
//! ```

mod frames;
mod index;
mod player;
mod stream;

pub use codec_core::{
    Caps, Error, ErrorKind, Footprint, Gaussian, PacketId, Result,
    internals::{gaussian::ShDegree, wire::receipt::ViewerPose},
    player::{Accepted, Counters, Frame, StreamInfo, Usable},
};
pub use frames::FrameDecoder;
pub use player::{OpenError, Player, Waiting, arena};
pub use stream::{Damage, Stream, sealed};

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
