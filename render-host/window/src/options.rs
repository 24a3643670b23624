//! Options say how a window begins.

use dgs_viewer::{Overlay, Session, Up};

use crate::WindowError;

/// How a window begins.
#[derive(Clone, Debug, PartialEq)]
pub struct WindowOptions {
    /// What the title calls the stream.
    pub name: String,
    /// Width and height of the window, pixels.
    pub size: [u32; 2],
    /// Behind everything, 0 to 1 each.
    pub background: [f32; 3],
    /// Which way is up, if not as the stream says.
    pub up: Option<Up>,
    /// Highest level shown, 0 to 3.
    pub cap: usize,
    /// What blocks are painted by.
    pub overlay: Overlay,
    /// Where the clock begins, seconds.
    pub time_s: f64,
    /// Whether it runs.
    pub playing: bool,
    /// Whether the window takes the whole display.
    pub fullscreen: bool,
    /// Whether the window closes when the clip has been played once.
    pub closes: bool,
    /// Schedulers that a server may be asked for, by the names that [`crate::FeedRequest::Network`] gives
    /// back, in the order in which a key goes through them.
    pub schedulers: Vec<&'static str>,
}

impl WindowOptions {
    /// Sets `session` to them, seen on a picture of `size` pixels.
    pub(crate) fn apply(&self, session: &mut Session, size: [u32; 2]) -> Result<(), WindowError> {
        session.set_cap(self.cap);
        session.set_overlay(self.overlay);
        session.playback_mut().set_looping(!self.closes);
        session.playback_mut().seek(self.time_s);
        let up = self.up.unwrap_or_else(|| session.up_of_stream());
        session.look_at_all(aspect(size), up)?;
        session.playback_mut().set_playing(self.playing);
        Ok(())
    }
}

/// Width by height.
pub(crate) fn aspect([width, height]: [u32; 2]) -> f64 {
    f64::from(width.max(1)) / f64::from(height.max(1))
}
