//! Imports scenes: a file or folder in, a [`Scene`] out.
//!
//! [`import`] looks at the content first and at the name only when the content does not tell. Each
//! format has one file with a `parse` over bytes, free of file access, which is what fuzzing calls.
//!
//! No file is trusted. Declared sizes are checked against [`Limits`] and against the bytes at hand
//! before anything is allocated; whatever is wrong comes back as an [`ImportError`] that names file,
//! field and place. With `keep_readable`, files that end early give what they still hold, and a note.
//!
//! Readers never change axes: every format here is right-handed. They convert domains (log scales,
//! opacity logits, wxyz, band-0 coefficients) and say in [`Scene::notes`] what a person should know.
//!
//! ```no_run
//! use trainer_host::import::{ImportOptions, import};
//! let scene = import("capture/time_00000.ply".as_ref(), &ImportOptions::default())?;
//! assert_eq!(scene.frames(), 1);
//! # Ok::<(), trainer_host::import::ImportError>(())
//! ```

mod archive;
mod bytes;
pub mod compressed_ply;
pub mod deformation;
pub mod dynamic_npz;
mod error;
pub mod fourdgs;
pub mod gltf;
mod gltf_buffers;
pub mod gltf_splats;
pub mod ksplat;
mod limits;
mod meshopt;
pub mod nearest;
pub mod ply;
pub mod points_npz;
mod sequence;
pub(crate) mod snapshot;
mod sniffed;
pub mod sog;
pub mod splat;
pub mod splatv;
pub mod spz;
pub mod synth;
mod tensors;
pub mod unity;

use std::path::{Path, PathBuf};

pub use error::{ErrorKind, Format, ImportError};
pub use limits::Limits;
pub use sequence::{Identity, SEQUENCE_INDEX, SequenceIndex};
pub use snapshot::Snapshot;
pub use sniffed::{default_up, sniff};

use self::sniffed::{UNPICKLE, is_pickled};
use crate::scene::Scene;

/// How to import.
#[derive(Clone, Debug, PartialEq)]
pub struct ImportOptions {
    /// What is accepted.
    pub limits: Limits,
    /// What is known of numbered sequences that do not say it themselves.
    pub identity: Identity,
    /// Frame rate of numbered sequences and of single files; without it what the sequence says, or
    /// [`ImportOptions::FRAMES_PER_SECOND`].
    pub frames_per_second: Option<f64>,
    /// How animated meshes are sampled.
    pub gltf: gltf::GltfOptions,
    /// Times from 0 to 1 at which a deformation field is evaluated.
    pub deformation_frames: usize,
}

impl ImportOptions {
    /// Frame rate where nothing says one.
    pub const FRAMES_PER_SECOND: f64 = 30.0;

    /// Frames per second of what does not say it.
    fn rate(&self) -> f64 {
        self.frames_per_second.unwrap_or(ImportOptions::FRAMES_PER_SECOND)
    }
}

impl Default for ImportOptions {
    fn default() -> Self {
        Self {
            limits: Limits::default(),
            identity: Identity::default(),
            frames_per_second: None,
            gltf: gltf::GltfOptions::default(),
            deformation_frames: deformation::DEFAULT_FRAMES,
        }
    }
}

/// Reads a scene from a file, or from a folder that is a SOG, a training with a deformation field, or holds
/// numbered frames.
///
/// # Errors
/// The file cannot be read, is no format known here, or is refused by its reader.
pub fn import(path: &Path, options: &ImportOptions) -> Result<Scene, ImportError> {
    if path.is_dir() {
        if path.join("meta.json").is_file() {
            return import(&path.join("meta.json"), options);
        }
        if path.join(LEVELS_OF_DETAIL).is_file() {
            return Err(of_one_level(path).in_file(path));
        }
        if let Some(file) = field_in(path) {
            return import(&file, options);
        }
        return folder(path, options);
    }
    if path.file_name().is_some_and(|name| name == LEVELS_OF_DETAIL) {
        return Err(of_one_level(path.parent().unwrap_or(Path::new(""))).in_file(path));
    }
    let bytes = read(path, options)?;
    if is_pickled(&bytes) {
        return Err(Format::Unknown
            .unsupported("content", "a pickled torch checkpoint", UNPICKLE)
            .in_file(path));
    }
    let format = sniff(&bytes, path);
    let in_file = |e: ImportError| e.in_file(path);
    let scene = match format {
        Format::Gltf => {
            let beside = |name: &str| read_beside(path, name, options, Format::Gltf);
            gltf::parse(&bytes, beside, &options.gltf, &options.limits).map_err(in_file)
        }
        Format::PointsNpz | Format::GsplatNpz => {
            points_npz::parse(&bytes, options.rate(), &options.limits).map_err(in_file)
        }
        Format::DynamicNpz => dynamic_npz::parse(&bytes, options.rate(), &options.limits).map_err(in_file),
        Format::Deformation => field(&bytes, path, options).map_err(in_file),
        Format::FourDgs => {
            // It says itself which way is up.
            return fourdgs::parse(&bytes, options.rate(), &options.limits).map_err(in_file);
        }
        Format::Splatv => splatv::parse(&bytes, options.rate(), &options.limits).map_err(in_file),
        _ => {
            let frame = snapshot_of(&bytes, path, options)?;
            sequence::assemble(vec![(path.to_owned(), frame)], options.identity, options.rate())
                .map_err(in_file)
        }
    }?;
    Ok(Scene { default_up: default_up(format), ..scene })
}

/// SOG's list of levels of detail, each of which is a folder beside it.
const LEVELS_OF_DETAIL: &str = "lod-meta.json";

/// That `folder` holds levels of detail, and which of them is a scene.
fn of_one_level(folder: &Path) -> ImportError {
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let entries = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let first = entries.filter(|level| level.join("meta.json").is_file()).min();
    let such = first.map(|level| format!(", such as {}", level.display())).unwrap_or_default();
    let allowed = format!("the folder of one level, which holds a meta.json{such}");
    Format::Sog.unsupported(LEVELS_OF_DETAIL, "SOG's list of levels of detail", allowed)
}

impl Format {
    /// The format of what [`import`] reads at `path`, where it can be read.
    pub fn of(path: &Path) -> Option<Self> {
        if path.is_dir() {
            return match field_in(path) {
                _ if path.join("meta.json").is_file() => Some(Self::Sog),
                Some(_) => Some(Self::Deformation),
                None => Some(Self::Sequence),
            };
        }
        Some(sniff(&std::fs::read(path).ok()?, path))
    }
}

fn folder(path: &Path, options: &ImportOptions) -> Result<Scene, ImportError> {
    let sequence::Files { files, notes, index } = sequence::files(path, &options.limits)?;
    let mut left = options.limits.max_bytes;
    let mut frames = Vec::with_capacity(files.len());
    let mut up = None;
    for file in files {
        let bytes = read(&file, options)?;
        up = default_up(sniff(&bytes, &file));
        // What the frames become is bounded too: a compressed frame may hold far more than its bytes.
        // Of a clip a frame may well show nothing.
        let frame = snapshot_of(&bytes, &file, options).or_else(Snapshot::of_nothing)?;
        let per_gaussian = (14 + frame.epoch.attributes().sh_degree.rest_len()) * 4;
        let bytes_of_frame = (frame.epoch.count() * per_gaussian).max(bytes.len()) as u64;
        left = left.checked_sub(bytes_of_frame).ok_or_else(|| {
            let allowed = format!("up to {} bytes in all", options.limits.max_bytes);
            Format::Sequence.error(ErrorKind::TooLarge, "frames", "more", allowed).in_file(&file)
        })?;
        frames.push((file, frame));
    }
    if frames.iter().all(|(_, frame)| frame.epoch.count() == 0) {
        return Err(Format::Sequence.empty("Gaussians in all frames").in_file(path));
    }
    let is_stored = index.as_ref().is_some_and(|index| index.identity_stored);
    let identity = if is_stored { Identity::Stored } else { options.identity };
    let written = index.and_then(|index| index.frames_per_second);
    let rate = options.frames_per_second.or(written).unwrap_or(ImportOptions::FRAMES_PER_SECOND);
    let mut scene = sequence::assemble(frames, identity, rate)?;
    scene.notes.extend(notes);
    Ok(Scene { default_up: up, ..scene })
}

/// The file of a deformation field that a folder holds: one iteration of a training, or a whole training, of
/// which it is the last. One that is pickled is found too, so that it can be refused by name.
fn field_in(folder: &Path) -> Option<PathBuf> {
    field_file(folder).or_else(|| field_file(&last_iteration(folder)?))
}

fn field_file(folder: &Path) -> Option<PathBuf> {
    let endings = ["npz", "safetensors", "pth"];
    let files = endings.iter().flat_map(|ending| ["deformation", "deform"].map(|name| (name, ending)));
    files.map(|(name, ending)| folder.join(name).with_extension(ending)).find(|file| file.is_file())
}

/// The folder of a training's last iteration.
fn last_iteration(training: &Path) -> Option<PathBuf> {
    let iterations = ["deform", "point_cloud"].iter().find_map(|name| training.join(name).read_dir().ok())?;
    let numbered = |entry: std::io::Result<std::fs::DirEntry>| {
        let path = entry.ok()?.path();
        let number: u64 = path.file_name()?.to_str()?.strip_prefix(ITERATION)?.parse().ok()?;
        Some((number, path))
    };
    iterations.filter_map(numbered).max().map(|(_, path)| path)
}

/// What trainers call the folder of an iteration, before its number.
const ITERATION: &str = "iteration_";

/// A deformation field, with what its trainer writes beside it.
fn field(bytes: &[u8], path: &Path, options: &ImportOptions) -> Result<Scene, ImportError> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut gaussians = vec![folder.join("point_cloud.ply")];
    let mut arguments = vec![folder.join("cfg_args")];
    if let Some(name) =
        folder.file_name().filter(|name| name.as_encoded_bytes().starts_with(ITERATION.as_bytes()))
    {
        let training = folder.join("../..");
        gaussians.push(training.join("point_cloud").join(name).join("point_cloud.ply"));
        arguments.push(training.join("cfg_args"));
    }
    let first_of = |files: &[PathBuf]| {
        files.iter().find(|file| file.is_file()).map(|file| read(file, options)).transpose()
    };
    let (gaussians, arguments) = (first_of(&gaussians)?, first_of(&arguments)?);
    let beside = deformation::SidecarFiles { gaussians: gaussians.as_deref(), options: arguments.as_deref() };
    let frames = options.deformation_frames;
    deformation::parse(bytes, beside, frames, options.rate(), &options.limits)
}

/// Reads one still file of any format that is one.
fn snapshot_of(bytes: &[u8], path: &Path, options: &ImportOptions) -> Result<Snapshot, ImportError> {
    let limits = &options.limits;
    match sniff(bytes, path) {
        Format::Ply => ply::parse(bytes, limits),
        Format::CompressedPly => compressed_ply::parse(bytes, limits),
        Format::Spz => spz::parse(bytes, limits),
        Format::Splat => splat::parse(bytes, limits),
        Format::Ksplat => ksplat::parse(bytes, limits),
        Format::Sog if bytes.trim_ascii_start().starts_with(b"{") => {
            sog::parse_files(bytes, |name| read_beside(path, name, options, Format::Sog), limits)
        }
        Format::Sog => sog::parse(bytes, limits),
        Format::Unity => unity_frame(bytes, path, options),
        Format::GltfSplats => {
            gltf_splats::parse(bytes, |name| read_beside(path, name, options, Format::GltfSplats), limits)
        }
        other => {
            let start = bytes[..bytes.len().min(8)].escape_ascii();
            let found = if bytes.is_empty() { "an empty file".into() } else { format!("bytes \"{start}\"") };
            Err(other.malformed(
                "content",
                found,
                "PLY, SPZ, SOG, .splat, .ksplat, .splatv, .4dgs, glTF, a Unity asset, NPZ or safetensors",
            ))
        }
    }
    .map_err(|e| e.in_file(path))
}

fn unity_frame(description: &[u8], path: &Path, options: &ImportOptions) -> Result<Snapshot, ImportError> {
    unity::described_count(description, &options.limits)?;
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let name = |plane: &str| format!("{stem}_{plane}.bytes");
    let plane = |which: &str| read_beside(path, &name(which), options, Format::Unity);
    let [chunks, positions, others, colours] = [plane("chk")?, plane("pos")?, plane("oth")?, plane("col")?];
    let has_harmonics = path.with_file_name(name("shs")).is_file();
    let harmonics = if has_harmonics { Some(plane("shs")?) } else { None };
    let asset = unity::Asset {
        description,
        chunks: &chunks,
        positions: &positions,
        others: &others,
        colours: &colours,
        harmonics: harmonics.as_deref(),
    };
    unity::parse(&asset, &options.limits)
}

fn read(path: &Path, options: &ImportOptions) -> Result<Vec<u8>, ImportError> {
    let io = |e: std::io::Error| Format::Unknown.io(&e, path);
    let found = std::fs::metadata(path).map_err(io)?;
    if is_device(&found) {
        // It may give bytes without end.
        return Err(Format::Unknown.unsupported("file", "a device", "a file or a folder").in_file(path));
    }
    let length = found.len();
    options.limits.bytes(Format::Unknown, "file", length).map_err(|e| e.in_file(path))?;
    let bytes = std::fs::read(path).map_err(io)?;
    if bytes.is_empty() {
        return Err(Format::Unknown.empty("file").in_file(path));
    }
    Ok(bytes)
}

/// Whether what is found is a device, such as `/dev/zero`.
fn is_device(found: &std::fs::Metadata) -> bool {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt;
        found.file_type().is_char_device() || found.file_type().is_block_device()
    }
    #[cfg(not(unix))]
    {
        let _ = found;
        false
    }
}

/// A file that another one names; names that lead out of its folder are refused.
fn read_beside(
    path: &Path,
    name: &str,
    options: &ImportOptions,
    format: Format,
) -> Result<Vec<u8>, ImportError> {
    let inside = Path::new(name).components().all(|c| matches!(c, std::path::Component::Normal(_)));
    if !inside {
        return Err(format.malformed("file name", name, "a name inside the folder").in_file(path));
    }
    let file = path.parent().unwrap_or(Path::new("")).join(name);
    read(&file, options).map_err(|e| ImportError { format, ..e })
}

#[cfg(test)]
mod damage;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Up;

    fn file(name: &str, bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    }

    #[test]
    fn content_decides_before_the_name() {
        let (_folder, path) = file("wrong.splat", &ply::tests::sample("binary_little_endian", 0, 5));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 5);
        let (_folder, path) = file("wrong.ply", &spz::tests::sample(2));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 2);
        let (_folder, path) = file("scene.zip", &sog::tests::sample());
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 6);
        let (_folder, path) = file("a.splat", &splat::tests::sample(4));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 4);
        let (_folder, path) = file("a.ksplat", &ksplat::tests::sample(7, 1));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 7);
        let (_folder, path) = file("a.bin", &splatv::tests::sample(2));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().frames(), splatv::FRAMES);
        let (_folder, path) = file("params.npz", &dynamic_npz::tests::sample(|_, shape| shape.to_owned()));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().frames(), 2);
        let arrays = ["means", "scales", "quats", "opacities", "sh0"];
        let gsplat = points_npz::gsplat::tests::sample(|_, shape| shape.to_owned());
        let (_folder, path) = file("a.bin", &dynamic_npz::tests::safetensors_of(&gsplat, &arrays));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 2);
        assert_eq!(Format::of(&path), Some(Format::GsplatNpz));
        let (_folder, path) = file("a.bin", deformation::tests::PLANES);
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().frames(), deformation::DEFAULT_FRAMES);
        let (_folder, path) = file("a.glb", &gltf_splats::tests::sample(8));
        let scene = import(&path, &ImportOptions::default()).unwrap();
        assert_eq!((scene.max_count(), scene.default_up), (8, Some(Up::Y)));
        let (_folder, path) = file("a.ply", &compressed_ply::tests::sample(3));
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 3);
        assert_eq!(sniff(br#"{"asset": {}}"#, "a.json".as_ref()), Format::Gltf);
        assert_eq!(sniff(br#"{"frames": []}"#, "transforms.json".as_ref()), Format::Unknown);
    }

    #[test]
    fn errors_name_the_file() {
        let (_folder, path) = file("nothing.bin", b"no scene");
        let error = import(&path, &ImportOptions::default()).unwrap_err();
        assert!(error.to_string().contains("nothing.bin"), "{error}");
        let (_folder, path) = file("empty.ply", b"");
        assert_eq!(import(&path, &ImportOptions::default()).unwrap_err().kind, ErrorKind::Empty);
        let missing = import("no/such/file.ply".as_ref(), &ImportOptions::default()).unwrap_err();
        assert_eq!(missing.kind, ErrorKind::Io);
    }

    #[test]
    fn checkpoints_of_torch_are_refused_with_what_converts_them() {
        let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
        zip.start_file("archive/data.pkl", zip::write::SimpleFileOptions::default()).unwrap();
        let packed = zip.finish().unwrap().into_inner();
        for bytes in [&packed[..], b"\x80\x02}q\x00."] {
            let (_folder, path) = file("chkpnt30000.pth", bytes);
            let error = import(&path, &ImportOptions::default()).unwrap_err();
            assert_eq!(error.kind, ErrorKind::Unsupported);
            // The tuple of 3DGS, from its second entry on, by the names that gsplat's arrays are read by.
            let lines = error.to_string();
            assert!(lines.contains("\"means sh0 shN scales quats opacities\".split()"), "{error}");
            assert!(lines.contains("params[0][1:7])) if is_tuple else params.get(\"splats\""), "{error}");
            assert!(lines.contains("numpy.savez"), "{error}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_device_is_not_read_without_end() {
        let error = import("/dev/zero".as_ref(), &ImportOptions::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Unsupported);
        assert!(error.to_string().starts_with("/dev/zero: ") && error.to_string().contains("a device"));
    }

    #[test]
    fn files_above_the_limit_are_not_read() {
        let (_folder, path) = file("a.splat", &splat::tests::sample(4));
        let limits = Limits { max_bytes: 100, ..Limits::default() };
        let error = import(&path, &ImportOptions { limits, ..ImportOptions::default() }).unwrap_err();
        assert_eq!(error.kind, ErrorKind::TooLarge);
        let limits = Limits { max_gaussians: 3, ..Limits::default() };
        let error = import(&path, &ImportOptions { limits, ..ImportOptions::default() }).unwrap_err();
        assert_eq!(error.kind, ErrorKind::TooLarge);
    }

    #[test]
    fn a_unity_frame_finds_its_planes() {
        let sample = unity::tests::sample(20);
        let (folder, path) = file("000001.asset", sample.description.as_bytes());
        for (plane, bytes) in ["chk", "pos", "oth", "col", "shs"].iter().zip(&sample.planes) {
            std::fs::write(folder.path().join(format!("000001_{plane}.bytes")), bytes).unwrap();
        }
        assert_eq!(import(&path, &ImportOptions::default()).unwrap().max_count(), 20);
        assert_eq!(import(folder.path(), &ImportOptions::default()).unwrap().frames(), 1);
        std::fs::remove_file(folder.path().join("000001_oth.bytes")).unwrap();
        let error = import(&path, &ImportOptions::default()).unwrap_err();
        assert!(error.to_string().contains("000001_oth.bytes"), "{error}");
    }
}
