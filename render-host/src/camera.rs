//! Cameras.
/// Camera.
#[derive(Clone, Debug, PartialEq)]
pub struct Camera {}
