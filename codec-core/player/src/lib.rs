//! Receives and decodes streams of dynamic Gaussian splats on a host: bytes or files in, Gaussians out.
//!
//! [`Player`] has everything: memory from the heap, entropy decoding and repair by the vectors of this
//! machine. [`Waiting`] is one that keeps early packets until its manifest comes, [`Stream`] the bytes
//! of a `.dgs` file, [`FrameDecoder`] a decoder for hosts that show many states of one stream.
//!
//! ```
//! # let file = include_bytes!("../../tests/conformance/one.dgs");
//! use dgs_player::Player;
//!
//! let (mut player, damage) = Player::open(file)?;
//! assert!(damage.is_none(), "{damage}");
//! for frame in 0..player.manifest().head().frames {
//!     let shown = player.frame(frame)?;
//!     println!("frame {frame}: {} Gaussians", shown.gaussians.len());
//! }
//! # Ok::<(), dgs_player::Error>(())
//! ```

mod frames;
mod player;
mod stream;

pub use codec_core::{
    Caps, Error, ErrorKind, Gaussian, Result,
    gaussian::ShDegree,
    player::{Accepted, Counters, Frame, Usable},
};
pub use frames::FrameDecoder;
pub use player::{OpenError, Player, Waiting, arena};
pub use stream::{Damage, Stream, sealed};
