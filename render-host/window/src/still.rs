//! Draws one frame into memory by the pass that windows show: a picture without a display.

use dgs_viewer::{DrawOptions, Screen, ScreenError, Session};
use render_host::{
    Image,
    gpu::{Device, DeviceOptions},
};

use crate::{WindowError, WindowOptions};

/// A frame whose tile lists had no room is drawn again: each time there is room for what was wanted.
const TRIES: u32 = 4;

/// Frame `frame` of `session`, as a window of these options shows it.
///
/// # Errors
/// No device, or it refuses.
pub fn picture(session: &mut Session, frame: u32, options: &WindowOptions) -> Result<Image, WindowError> {
    let device = Device::open(&DeviceOptions::from_env()).map_err(ScreenError::from)?;
    let mut screen = Screen::in_memory(device)?;
    options.apply(session, options.size)?;
    let now = session.playback().frame();
    session.playback_mut().step(frame.cast_signed().wrapping_sub(now.cast_signed()));
    let look =
        DrawOptions { size: options.size, shown: options.size, background: options.background, sh_degree: 3 };
    let mut drawn = None;
    for _ in 0..TRIES {
        screen.draw(session, &mut drawn, &look)?;
        if let Some(image) = screen.read()? {
            return Ok(image);
        }
    }
    Err(WindowError::Room { tries: TRIES })
}
