//! Scenes.
pub mod scene;
pub use scene::{Attributes, Epoch, Instant, Scene, SceneError, Track};
