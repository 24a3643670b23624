//! trainer-host imports and exports scenes, encodes them into streams, and measures what parts are worth.
//!
//! Four rooms, in the order of the walk (`train`, which fits scenes to pictures, is not built yet):
//!
//! ```text
//! scene (import) ─▶ encode ─▶ stream ─▶ (codec-core decodes) ─▶ utility
//!   └─▶ scene (export)
//! ```
//!
//! Deliberately absent: time and networks (emulator-host), pixels (render-host), and the bytes of
//! packets themselves (codec-core: this crate chooses, that one writes down).

pub mod encode;
pub mod scene;
pub mod stream;
pub mod utility;

pub use encode::{cluster, factorise, judge, sensitivity};
pub use scene::{Attributes, Epoch, Instant, Scene, SceneError, Track, export, import, viewpoint};
pub use stream::Stream;
