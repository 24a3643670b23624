//! Shows streams of dynamic Gaussian splats in a browser, and is what `dgs-window` shows them with.
//!
//! ```text
//! .dgs file, ranges of one, packets ─▶ Session (decoder, clock, camera, emulated network)
//!                                        └▶ Gaussians of the frame that is due ─▶ Screen (device, canvas)
//! ```
//!
//! The decoder is `dgs-player`, the pixels are the stages of `render-host`, both compiled to WebAssembly.
//! [`Session`] is the same on every machine and tested on this one; `Screen` is compiled for browsers and
//! with feature `screen`; what a browser alone has, a canvas, for browsers alone. [`asset`] gives the page to
//! whoever serves it.
//!
//! Deliberately absent: sockets (the page's), time (an argument).

#[cfg(all(not(target_family = "wasm"), not(feature = "pack")))]
mod asset;
mod bounds;
mod channel;
mod keep_up;
mod orbit;
mod playback;
#[cfg(any(target_family = "wasm", feature = "screen"))]
mod present;
mod ranges;
#[cfg(any(target_family = "wasm", feature = "screen"))]
mod screen;
mod session;
#[cfg(target_family = "wasm")]
mod shell;

#[cfg(all(not(target_family = "wasm"), not(feature = "pack")))]
pub use asset::{Asset, asset};
pub use bounds::bounds;
pub use channel::{Channel, Conditions};
pub use keep_up::{KeepUp, Reduction};
pub use orbit::{Orbit, Up};
pub use playback::{Playback, Step};
pub use ranges::{FIRST_BYTES, RangePlan, Wanted, message};
#[cfg(any(target_family = "wasm", feature = "screen"))]
pub use screen::{DrawOptions, Drawn, Screen, ScreenError};
pub use session::{BlocksByLevel, LEVEL_COLOURS, LEVELS, Overlay, Session, Shown};
