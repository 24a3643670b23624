//! Defines the error of every reader: which file, which format, which field, where, what was found and
//! what would have been accepted. A person can act on it; a program can match on [`ErrorKind`].

use std::{fmt, path::Path};

/// A file format this crate reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum Format {
    /// 3DGS PLY, one float property per attribute.
    Ply,
    /// PlayCanvas compressed PLY.
    CompressedPly,
    /// Niantic SPZ, versions 1 to 4.
    Spz,
    /// Headerless 32-byte records.
    Splat,
    /// SOG, versions 1 and 2: JSON and lossless WebP planes.
    Sog,
    /// Unity Gaussian Splatting asset, version 20231020.
    Unity,
    /// NumPy archive of coloured points and cameras.
    PointsNpz,
    /// glTF 2.0, text or binary.
    Gltf,
    /// glTF 2.0 with `KHR_gaussian_splatting`.
    GltfSplats,
    /// mkkellogg's sections of splats.
    Ksplat,
    /// splaTV: splats with polynomial motion.
    Splatv,
    /// A training of Dynamic 3D Gaussians, as npz or safetensors.
    DynamicNpz,
    /// Parameters of gsplat, as npz or safetensors.
    GsplatNpz,
    /// A network that moves Gaussians, as npz or safetensors.
    Deformation,
    /// The `.4dgs` container.
    FourDgs,
    /// A folder of numbered files.
    Sequence,
    /// Not recognised yet, or not at all.
    Unknown,
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Format::Ply => "PLY",
            Format::CompressedPly => "compressed PLY",
            Format::Spz => "SPZ",
            Format::Splat => "splat records",
            Format::Sog => "SOG",
            Format::Unity => "Unity splat asset",
            Format::PointsNpz => "NPZ points",
            Format::Gltf => "glTF",
            Format::GltfSplats => "glTF of Gaussians",
            Format::Ksplat => "ksplat",
            Format::Splatv => "splatv",
            Format::DynamicNpz => "arrays of Dynamic 3D Gaussians",
            Format::GsplatNpz => "arrays of gsplat",
            Format::Deformation => "deformation field",
            Format::FourDgs => "4dgs",
            Format::Sequence => "numbered sequence",
            Format::Unknown => "scene file",
        })
    }
}

/// What kind of fault an [`ImportError`] is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum ErrorKind {
    /// The operating system refused.
    Io,
    /// Fewer bytes than the file says it has.
    Truncated,
    /// More than [`Limits`](super::Limits) allow.
    TooLarge,
    /// A value the format does not allow, or two that contradict each other.
    Malformed,
    /// Legal, and not read here.
    Unsupported,
    /// Nothing in it.
    Empty,
    /// The caller asked for what is not in it, such as a clip.
    NotFound,
}

/// Why a file was not read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}{format}: {field}{}: found {found}; allowed: {allowed}", prefix(.path), place(.offset))]
pub struct ImportError {
    /// The file, where one is known (readers of bytes do not know).
    pub path: Option<Box<Path>>,
    /// The format it was read as.
    pub format: Format,
    /// The kind of fault.
    pub kind: ErrorKind,
    /// The field, property or element at fault.
    pub field: Box<str>,
    /// Byte offset in the file, or in the decompressed stream for compressed formats.
    pub offset: Option<u64>,
    /// What was there.
    pub found: Box<str>,
    /// What would have been accepted.
    pub allowed: Box<str>,
}

fn prefix(path: &Option<Box<Path>>) -> String {
    path.as_ref().map(|p| format!("{}: ", p.display())).unwrap_or_default()
}

fn place(offset: &Option<u64>) -> String {
    offset.map(|o| format!(" at byte {o}")).unwrap_or_default()
}

impl ImportError {
    /// The same error with its byte offset.
    #[must_use]
    pub fn at(mut self, offset: usize) -> Self {
        self.offset = Some(offset as u64);
        self
    }

    /// The same error with its file, unless it names one already.
    #[must_use]
    pub fn in_file(mut self, path: &Path) -> Self {
        self.path.get_or_insert_with(|| path.into());
        self
    }
}

impl Format {
    pub(super) fn error(
        self,
        kind: ErrorKind,
        field: impl Into<Box<str>>,
        found: impl fmt::Display,
        allowed: impl fmt::Display,
    ) -> ImportError {
        ImportError {
            path: None,
            format: self,
            kind,
            field: field.into(),
            offset: None,
            found: found.to_string().into(),
            allowed: allowed.to_string().into(),
        }
    }

    pub(super) fn malformed(
        self,
        field: impl Into<Box<str>>,
        found: impl fmt::Display,
        allowed: impl fmt::Display,
    ) -> ImportError {
        self.error(ErrorKind::Malformed, field, found, allowed)
    }

    pub(super) fn unsupported(
        self,
        field: impl Into<Box<str>>,
        found: impl fmt::Display,
        allowed: impl fmt::Display,
    ) -> ImportError {
        self.error(ErrorKind::Unsupported, field, found, allowed)
    }

    pub(super) fn truncated(self, field: impl Into<Box<str>>, found: u64, needed: u64) -> ImportError {
        self.error(ErrorKind::Truncated, field, format_args!("{found} bytes"), format_args!("{needed} bytes"))
    }

    pub(super) fn empty(self, field: impl Into<Box<str>>) -> ImportError {
        self.error(ErrorKind::Empty, field, "nothing", "at least one")
    }

    pub(super) fn io(self, error: &std::io::Error, path: &Path) -> ImportError {
        self.error(ErrorKind::Io, "file", error, "a file that can be read").in_file(path)
    }
}
