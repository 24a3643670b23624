//! Defines why a dataset cannot be read: which file, which field, what was found.

use std::path::PathBuf;

use render_host::{CameraError, ImageError};

use crate::train::views::ViewsError;

/// A dataset that cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file or folder that the system does not give.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder of none of the layouts.
    #[error(
        "{}: no dataset; transforms_train.json (Blender, D-NeRF), transforms.json (Nerfstudio), sparse/0 \
         with cameras.bin or cameras.txt (COLMAP) or train_meta.json (Panoptic) is needed",
        path.display()
    )]
    Unknown {
        /// The folder.
        path: PathBuf,
    },
    /// Cameras that cannot be read.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: CameraError,
    },
    /// An image that cannot be read.
    #[error("{}: {source}", path.display())]
    Image {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: ImageError,
    },
    /// A field with a value that is not allowed.
    #[error("{}: {field} is {found}; {allowed}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// Which field.
        field: String,
        /// Its value.
        found: String,
        /// What is allowed.
        allowed: &'static str,
    },
    /// Views that do not fit together.
    #[error("{}: {source}", path.display())]
    Views {
        /// The dataset.
        path: PathBuf,
        /// What is wrong.
        source: ViewsError,
    },
}
