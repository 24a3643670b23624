//! Names what can go wrong on a device.

use crate::{
    image::ImageError,
    settings::{Settings, SettingsError},
    stage::TileSide,
};

/// A device, a buffer or a frame that could not be had.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GpuError {
    /// No adapter, or none of the wanted name.
    #[error(
        "no graphics adapter {}; looked for Vulkan, Metal and DX12 adapters and found {}",
        named(wanted),
        listed(found)
    )]
    NoAdapter {
        /// Part of the wanted name; empty for any.
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
    #[error("{what}: out of device memory{} ({message})", left(*free))]
    OutOfMemory {
        /// Which buffer or step.
        what: &'static str,
        /// Bytes that were free after the refusal, where the driver says so.
        free: Option<u64>,
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
    /// A browser lets nothing wait.
    #[error("{what}: needs to wait, which a browser does not allow")]
    Waits {
        /// Which step.
        what: &'static str,
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
    /// A tolerance that only the CPU stages have.
    #[error("setting {field} is {found}; on a device only {allowed} is allowed")]
    CpuOnly {
        /// Which setting.
        field: &'static str,
        /// Its value.
        found: String,
        /// The value that works.
        allowed: &'static str,
    },
    /// A setting is out of range.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The image could not be made.
    #[error(transparent)]
    Image(#[from] ImageError),
}

fn left(free: Option<u64>) -> String {
    free.map_or(String::new(), |bytes| format!(", of which {} MiB are free", bytes >> 20))
}

fn named(wanted: &str) -> String {
    if wanted.is_empty() { "of any name".to_owned() } else { format!("has {wanted:?} in its name (DGS_GPU)") }
}

fn listed(found: &[String]) -> String {
    if found.is_empty() { "none (is a driver installed?)".to_owned() } else { found.join(", ") }
}

/// Checks every range, and that the device's stages have everything it needs.
///
/// # Errors
/// The first setting that will not do.
pub(super) fn check(settings: &Settings) -> Result<(), GpuError> {
    settings.validate()?;
    let refuse = |field, found: String, allowed| Err(GpuError::CpuOnly { field, found, allowed });
    if settings.depth_bits != 32 {
        return refuse("depth_bits", settings.depth_bits.to_string(), "32");
    }
    if settings.tile != TileSide::default() {
        return refuse("tile", settings.tile.pixels().to_string(), "16");
    }
    if settings.half_attributes {
        return refuse("half_attributes", true.to_string(), "false");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tolerances_of_the_cpu_stages_are_refused_by_name() {
        check(&Settings::default()).unwrap();
        let bad = [
            ("depth_bits is 24", Settings { depth_bits: 24, ..Settings::default() }),
            ("tile is 32", Settings { tile: TileSide::ThirtyTwo, ..Settings::default() }),
            ("half_attributes is true", Settings { half_attributes: true, ..Settings::default() }),
            ("alpha_max is 2", Settings { alpha_max: 2.0, ..Settings::default() }),
        ];
        for (text, settings) in bad {
            let error = check(&settings).unwrap_err().to_string();
            assert!(error.contains(text), "{error}");
        }
    }
}
