//! Scenes.
pub mod cluster;
pub mod encode;
pub mod factorise;
pub mod stream;
pub mod export;
pub mod import;
pub mod scene;
pub use scene::{Attributes, Epoch, Instant, Scene, SceneError, Track};
