//! What can go wrong on a device.

use crate::image::ImageError;
use crate::settings::SettingsError;

/// A device, a buffer or a frame that could not be had.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter, or none of the name asked for.
    #[error("no graphics adapter matches {wanted:?}; found {found:?} (is a Vulkan driver installed?)")]
    NoAdapter {
        /// Part of the name asked for; empty for any.
        wanted: String,
        /// Names of the adapters there are.
        found: Vec<String>,
    },
    /// The adapter refused a device.
    #[error("adapter {adapter}: {message}")]
    Device {
        /// Adapter name.
        adapter: String,
        /// What the driver said.
        message: String,
    },
    /// A buffer is larger than the device allows.
    #[error("{what}: {bytes} bytes needed; the device allows {allowed}")]
    TooLarge {
        /// Which buffer.
        what: &'static str,
        /// Bytes needed.
        bytes: u64,
        /// Bytes allowed.
        allowed: u64,
    },
    /// The device has no memory left.
    #[error("{what}: out of device memory ({message})")]
    OutOfMemory {
        /// Which buffer or step.
        what: &'static str,
        /// What the driver said.
        message: String,
    },
    /// The device refused a command; a mistake in this crate.
    #[error("{what}: {message}")]
    Refused {
        /// Which step.
        what: &'static str,
        /// What the driver said.
        message: String,
    },
    /// The tile lists of the last frame did not fit; its picture is not whole.
    #[error("tile entries: found {found}; there is room for {room}")]
    Entries {
        /// Entries there are, up to `u32::MAX`.
        found: u32,
        /// Entries that fit.
        room: u32,
    },
    /// Slices that do not describe the same things.
    #[error("{field}: found {found} values, need {needed}")]
    Length {
        /// Which slice.
        field: &'static str,
        /// Values found.
        found: usize,
        /// Values needed.
        needed: usize,
    },
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The image could not be made.
    #[error(transparent)]
    Image(#[from] ImageError),
}
