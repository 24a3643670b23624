//! Raises errors as exceptions that Python programs expect: ValueError, DamagedError, OSError, IndexError.
//! What a caller passes is a ValueError that names the argument; what is in bytes is a DamagedError.

use codec_core::Error;
use pyo3::{
    create_exception,
    exceptions::{PyIndexError, PyOSError, PyValueError},
    prelude::*,
};
use trainer_host::import::{ErrorKind, ImportError};

create_exception!(
    dgs,
    DamagedError,
    PyValueError,
    "Bytes that are not what they should be: a damaged or truncated file, stream or packet."
);

/// A ValueError that says `message`.
pub fn refused(message: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(message.to_string())
}

/// What the codec says of bytes.
pub fn damaged(error: Error) -> PyErr {
    let message = error.to_string();
    match error.kind {
        codec_core::ErrorKind::Capacity => PyValueError::new_err(message),
        _ => DamagedError::new_err(message),
    }
}

/// What an importer says of a file.
pub fn unreadable(error: &ImportError) -> PyErr {
    let message = error.to_string();
    match error.kind {
        ErrorKind::Io => PyOSError::new_err(message),
        ErrorKind::Truncated | ErrorKind::Malformed | ErrorKind::Empty => DamagedError::new_err(message),
        _ => PyValueError::new_err(message),
    }
}

/// What the operating system says of the file at `path`.
pub fn of_file(path: &std::path::Path, error: &std::io::Error) -> PyErr {
    let message = error.to_string();
    let number = match (error.kind(), error.raw_os_error()) {
        (_, Some(number)) => number,
        (std::io::ErrorKind::NotFound, None) => NO_SUCH_FILE,
        (std::io::ErrorKind::InvalidInput | std::io::ErrorKind::InvalidData, None) => {
            return PyValueError::new_err(format!("{}: {message}", path.display()));
        }
        _ => return PyOSError::new_err(format!("{}: {message}", path.display())),
    };
    // Of these arguments Python makes a FileNotFoundError, PermissionError and the like, their fields set.
    let message = message.split(" (os error").next().unwrap_or_default().to_owned();
    PyOSError::new_err((number, message, path.to_owned()))
}

/// The number of the operating system for a file that is not there, on every system that Python runs on.
const NO_SUCH_FILE: i32 = 2;

/// `value` of the argument called `field`, if its type holds it.
pub fn whole<T: TryFrom<i128>>(field: &str, value: i128) -> PyResult<T> {
    T::try_from(value).map_err(|_| {
        let bound =
            if value < 0 { "of at least 0".to_owned() } else { format!("below 2^{}", 8 * size_of::<T>()) };
        refused(format!("{field} is {value}; a whole number {bound} is wanted"))
    })
}

/// A frame rate of a caller.
pub fn checked_rate(fps: f64) -> PyResult<f64> {
    if fps.is_finite() && fps > 0.0 {
        return Ok(fps);
    }
    Err(refused(format!("fps is {fps}; a frame rate above 0, in frames per second, is wanted")))
}

/// `frame` if it is below `frames`.
pub fn checked_frame(frame: i64, frames: usize) -> PyResult<usize> {
    match usize::try_from(frame) {
        Ok(frame) if frame < frames => Ok(frame),
        _ => {
            let last = frames.saturating_sub(1);
            Err(PyIndexError::new_err(format!("frame is {frame}; 0 to {last} are allowed")))
        }
    }
}
