//! Says why nothing can be shown.

use dgs_viewer::ScreenError;
use winit::error::{EventLoopError, OsError};

/// Why nothing is shown, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum WindowError {
    /// There is nothing on which a window could be, or the system refuses one.
    #[error("no window can be opened here: {0}")]
    Display(String),
    /// Nothing can be drawn.
    #[error(transparent)]
    Screen(#[from] ScreenError),
    /// The stream is none, or cannot be decoded.
    #[error(transparent)]
    Stream(#[from] dgs_player::Error),
    /// Whoever brings the stream has given up before there was anything to show.
    #[error("{0}")]
    Feed(String),
    /// The device never had room for a picture.
    #[error("the device has no room for the picture: {tries} tries")]
    Room {
        /// How often it was drawn.
        tries: u32,
    },
}

impl From<EventLoopError> for WindowError {
    fn from(error: EventLoopError) -> Self {
        match error {
            EventLoopError::Os(error) => error.into(),
            other => Self::Display(other.to_string()),
        }
    }
}

impl From<OsError> for WindowError {
    fn from(error: OsError) -> Self {
        let text = error.to_string();
        // Before it stands where in the library it was noticed: `os error at FILE:LINE: `.
        Self::Display(text.split_once(": ").map_or(text.as_str(), |(_, said)| said).to_owned())
    }
}
