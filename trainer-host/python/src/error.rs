//! Raises errors as exceptions that Python programs expect: ValueError, DamagedError, OSError, IndexError.

use codec_core::Error;
use pyo3::{
    create_exception,
    exceptions::{PyFileNotFoundError, PyIndexError, PyOSError, PyValueError},
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
    let message = format!("{}: {error}", path.display());
    match error.kind() {
        std::io::ErrorKind::NotFound => PyFileNotFoundError::new_err(message),
        std::io::ErrorKind::InvalidInput | std::io::ErrorKind::InvalidData => PyValueError::new_err(message),
        _ => PyOSError::new_err(message),
    }
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
