//! Says why nothing can be shown.

use dgs_viewer::ScreenError;
use winit::error::{EventLoopError, OsError};

/// Why nothing is shown, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum WindowError {
    /// There is nothing on which a window could be.
    #[error("no window can be opened here: {0}")]
    Display(#[from] EventLoopError),
    /// The system refuses a window.
    #[error("the system opens no window: {0}")]
    Window(#[from] OsError),
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
