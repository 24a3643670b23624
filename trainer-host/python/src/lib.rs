//! The Python package dgs: scenes, streams and pictures as numpy arrays.
//!
//! ```text
//! files, arrays ─▶ Scene ─▶ encode ─▶ Stream ─▶ Player ─▶ arrays          (trainer-host, dgs-player)
//! arrays + Camera ─▶ render ─▶ pictures; render_backward ─▶ gradients       (render-host)
//! ```
//!
//! Long work runs without the interpreter's lock. Types and what each call takes are written down for Python
//! programs in `package/dgs/_native.pyi`, which tests compare with this module.

mod activation;
mod array;
mod camera;
mod clip;
mod encoding;
mod error;
mod gaussians;
mod player;
mod received;
mod render;
mod scene;
mod stream;

/// The native half of the package.
#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::{
        camera::Camera,
        encoding::{Encoded, encode},
        error::DamagedError,
        player::Player,
        render::{render, render_backward},
        scene::{Scene, convert},
        stream::Stream,
    };
    use pyo3::{
        Bound, PyResult,
        types::{PyModule, PyModuleMethods},
    };

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
