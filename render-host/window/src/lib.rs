//! Shows a stream of dynamic Gaussian splats in a window of this machine.
//!
//! ```text
//! Arrival (file, ranges of one, packets) ─▶ Feed ─▶ Engine (session, clock, what is drawn)
//! keys, pointer ─▶ Act ─▶ Engine                      └▶ dgs_viewer::Screen (device, window) ─▶ picture
//! ```
//!
//! Session, camera, clock and screen are `dgs-viewer`'s, the same as in a browser. [`run`] opens a window and
//! returns when it is closed; [`picture`] draws one frame by the same pass into memory, without a display.
//!
//! Deliberately absent: sockets and files (whoever fills the [`Feed`] has them), a player's bar of buttons
//! (keys do it; the title says the rest).

mod controls;
mod engine;
mod error;
mod feed;
mod flying;
mod options;
mod shell;
mod still;
mod title;

pub use controls::KEYS;
pub use error::WindowError;
pub use feed::{Arrival, Feed, FeedRequest, Feeder, feed};
pub use options::WindowOptions;
pub use shell::{Report, run};
pub use still::picture;
