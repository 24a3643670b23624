//! trainer-host knows **scenes**: where they come from, how they are cut into clusters, levels and
//! packets, what each part is worth, and where they go.
//!
//! The walk, which is also the order of the modules:
//!
//! ```text
//! import ─▶ scene ─▶ cluster ─▶ factorise ─▶ encode ─▶ stream ─▶ (codec-core decodes) ─▶ utility
//!                                                         └─▶ export
//! ```
//!
//! Deliberately absent: time and networks (emulator-host), pixels (render-host), and the bytes of
//! packets themselves (codec-core: this crate chooses, that one writes down).

pub mod cluster;
pub mod encode;
pub mod export;
pub mod factorise;
pub mod import;
pub mod judge;
pub mod scene;
pub mod sensitivity;
pub mod stream;
pub mod utility;
pub mod viewpoint;

pub use scene::{Attributes, Epoch, Instant, Scene, SceneError, Track};
pub use stream::Stream;
