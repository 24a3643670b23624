//! Shows scenes to Python: files and arrays in, arrays and files out.

use std::{
    io::Read,
    path::{Path, PathBuf},
};

use codec_core::{Footprint, ShDegree, internals::wire::file};
use numpy::PyArrayDyn;
use pyo3::{
    exceptions::{PyTypeError, PyUserWarning},
    prelude::*,
    types::PyDict,
};
use trainer_host::{
    edit::{self, Similarity, turn_between},
    encode::{self, EncodeOptions},
    export::{self, FileFormat},
    import::{self, Format, ImportOptions, Limits, SEQUENCE_INDEX, SequenceIndex, gltf, synth},
    scene::Up,
    viewpoint::{Framing, Ring},
};

use crate::{
    activation::Activation,
    array::array,
    camera::Camera,
    clip,
    error::{checked_frame, checked_rate, of_file, refused, unreadable, whole},
    gaussians::{self, Frame},
    received::received_scene,
};

/// Gaussians over frames.
#[pyclass(module = "dgs", frozen)]
pub struct Scene(pub trainer_host::Scene);

/// The footprint of this name.
pub fn footprint_of(name: &str) -> PyResult<Footprint> {
    let allowed = || Footprint::ALL.map(Footprint::name).join(", ");
    Footprint::named(name)
        .ok_or_else(|| refused(format!("footprint: found {name:?}; {} are wanted", allowed())))
}

/// The axis of that name.
pub fn up_of(name: &str) -> PyResult<Up> {
    let found = Up::ALL.into_iter().find(|up| up.to_string() == name);
    found.ok_or_else(|| {
        let names = Up::ALL.map(|up| up.to_string()).join(", ");
        refused(format!("up is {name:?}; {names} are allowed"))
    })
}

/// A clip of an animated mesh, as a caller names it.
#[derive(FromPyObject)]
pub enum ClipArgument {
    /// By place in the file, from 0.
    Number(i128),
    /// By name, or by place as text.
    Text(String),
}

impl ClipArgument {
    fn clip(self) -> PyResult<gltf::Clip> {
        Ok(match self {
            Self::Number(number) => gltf::Clip::Index(whole("clip", number)?),
            Self::Text(text) => text.parse().map_or_else(|_| gltf::Clip::Name(text), gltf::Clip::Index),
        })
    }
}

/// Most cameras of a ring.
const MAX_CAMERAS: usize = 100_000;

/// Whether the name of `path` is that of a `.dgs` stream.
fn is_stream(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("dgs"))
}

/// How checkpoints of trainings begin.
const CHECKPOINT_MAGIC: [u8; 8] = *b"DGSTRAIN";

/// Whether the file at `path` begins with `magic`.
fn begins_with<const N: usize>(path: &Path, magic: [u8; N]) -> PyResult<bool> {
    let mut found = [0; N];
    match std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut found)) {
        Ok(()) => Ok(found == magic),
        // Short, as `read` will say; a folder cannot be read on some systems, and not opened on others.
        Err(error) if error.kind() == std::io::ErrorKind::UnexpectedEof || path.is_dir() => Ok(false),
        Err(error) => Err(of_file(path, &error)),
    }
}

/// Whether `path` is read as a stream: its content is one, or its name says so and its content nothing else.
fn is_read_as_stream(path: &Path) -> PyResult<bool> {
    if begins_with(path, file::MAGIC)? {
        return Ok(true);
    }
    if !is_stream(path) || path.is_dir() {
        return Ok(false);
    }
    let bytes = std::fs::read(path).map_err(|error| of_file(path, &error))?;
    Ok(import::sniff(&bytes, path) == Format::Unknown)
}

/// `scene` turned so that `to` is up, unless it is.
fn turned(scene: &trainer_host::Scene, to: Up) -> PyResult<Option<trainer_host::Scene>> {
    let from = scene.up;
    if from == to {
        return Ok(None);
    }
    let turn = Similarity { rotation: turn_between(from, to), ..Similarity::default() };
    edit::transform(scene, &turn).map(Some).map_err(refused)
}

/// Warns a caller of each of `said`.
fn warn(py: Python<'_>, said: impl IntoIterator<Item = String>) -> PyResult<()> {
    for sentence in said {
        let message = std::ffi::CString::new(sentence).map_err(refused)?;
        PyErr::warn(py, &py.get_type::<PyUserWarning>(), &message, 1)?;
    }
    Ok(())
}

/// Writes frame `frame` of `scene` in `format`, and says what that cannot hold of it.
fn write_frame(
    scene: &trainer_host::Scene,
    format: FileFormat,
    path: &Path,
    frame: i64,
) -> PyResult<Vec<String>> {
    let frame = checked_frame(frame, scene.frames())?;
    let Some((epoch, t)) = scene.locate(frame) else { return Ok(Vec::new()) };
    let epoch = &scene.epochs()[epoch];
    let failed = |error| of_file(path, &error);
    let files = format.encode(epoch, t, scene.footprint, path).map_err(failed)?;
    if let Some((path, buffer)) = format.buffer_path(path).zip(files.buffer) {
        // Nobody named it: what is there may be something else.
        let mut new = std::fs::File::create_new(&path).map_err(|error| of_file(&path, &error))?;
        std::io::Write::write_all(&mut new, &buffer).map_err(|error| of_file(&path, &error))?;
    }
    std::fs::write(path, files.bytes).map_err(failed)?;
    Ok(format.losses(epoch.attributes().sh_degree, scene.footprint))
}

/// Writes every frame as a PLY into the folder `path`, which must be empty or not there. Its index says that
/// frames are missing until all are there.
fn write_folder(scene: &trainer_host::Scene, path: &Path) -> PyResult<()> {
    std::fs::create_dir_all(path).map_err(|error| of_file(path, &error))?;
    let mut entries = std::fs::read_dir(path).map_err(|error| of_file(path, &error))?;
    if entries.next().is_some() {
        return Err(refused(format!("{}: the folder is not empty", path.display())));
    }
    let put = |name: &str, bytes: &[u8]| {
        let path = path.join(name);
        std::fs::write(&path, bytes).map_err(|error| of_file(&path, &error))
    };
    let put_index =
        |index: &SequenceIndex| put(SEQUENCE_INDEX, &serde_json::to_vec_pretty(index).map_err(refused)?);
    let mut index = SequenceIndex {
        frames_per_second: Some(scene.frames_per_second()),
        identity_stored: scene.epochs().len() == 1,
        ..SequenceIndex::default()
    };
    put_index(&index)?;
    for frame in 0..scene.frames() {
        let Some((epoch, t)) = scene.locate(frame) else { continue };
        let name = format!("frame_{frame:05}.ply");
        put(&name, &export::ply::encode(&scene.epochs()[epoch], t))?;
        index.files.push(name);
    }
    (index.frames, index.complete) = (index.files.len(), true);
    put_index(&index)
}

/// Writes `scene` as the ending of `path` says, and warns of what that cannot hold of it.
fn save(
    py: Python<'_>,
    scene: &trainer_host::Scene,
    path: &Path,
    frame: i64,
    keep_axes: bool,
) -> PyResult<()> {
    let losses = py.detach(|| write(scene, path, frame, keep_axes))?;
    warn(py, losses.into_iter().map(|loss| format!("{}: {loss}", path.display())))
}

/// Writes `scene` as the ending of `path` says, and says what that cannot hold of it.
fn write(scene: &trainer_host::Scene, path: &Path, frame: i64, keep_axes: bool) -> PyResult<Vec<String>> {
    if is_stream(path) {
        let encoded =
            encode::encode(scene, &EncodeOptions::default(), &encode::no_progress).map_err(refused)?;
        let bytes = encoded.stream.to_bytes().map_err(refused)?;
        std::fs::write(path, bytes).map_err(|error| of_file(path, &error))?;
        return Ok(Vec::new());
    }
    let is_folder = path.is_dir() || path.extension().is_none();
    let is_clip = !is_folder && path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("4dgs"));
    let format = if is_folder || is_clip { FileFormat::Ply } else { format_of(path)? };
    // A .4dgs file has y up, as `dgs convert` writes it.
    let up = if is_clip { Up::Y } else { format.default_up() };
    let turned = if keep_axes { None } else { turned(scene, up)? };
    let scene = turned.as_ref().unwrap_or(scene);
    if is_clip {
        let bytes = export::fourdgs::encode(scene).map_err(|error| of_file(path, &error))?;
        std::fs::write(path, bytes).map_err(|error| of_file(path, &error))?;
    } else if is_folder {
        write_folder(scene, path)?;
    } else {
        return write_frame(scene, format, path, frame);
    }
    // A .4dgs holds what a PLY does; neither leaves harmonics out.
    Ok(FileFormat::Ply.losses(ShDegree::default(), scene.footprint))
}

/// The format that the ending of `path` names.
fn format_of(path: &Path) -> PyResult<FileFormat> {
    FileFormat::of(path).ok_or_else(|| {
        let endings = FileFormat::ENDINGS;
        refused(format!(
            "{}: no format that scenes are written in; {endings}, .4dgs, .dgs, or a folder without an \
             ending are allowed",
            path.display()
        ))
    })
}

#[pymethods]
impl Scene {
    /// Reads a file or a folder of numbered files.
    #[staticmethod]
    #[pyo3(signature = (
        path, *, fps = None, samples = 20_000, clip = None, seed = 1, identity_stored = false,
        keep_readable = false, max_gaussians = 5_000_000, up = None
    ))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    pub fn load(
        py: Python<'_>,
        path: PathBuf,
        fps: Option<f64>,
        samples: i128,
        clip: Option<ClipArgument>,
        seed: i128,
        identity_stored: bool,
        keep_readable: bool,
        max_gaussians: i128,
        up: Option<&str>,
    ) -> PyResult<Self> {
        let (up, fps) = (up.map(up_of).transpose()?, fps.map(checked_rate).transpose()?);
        let (samples, seed) = (whole("samples", samples)?, whole("seed", seed)?);
        let max_gaussians = whole("max_gaussians", max_gaussians)?;
        let clip = clip.map_or(Ok(gltf::Clip::First), ClipArgument::clip)?;
        if samples == 0 {
            return Err(refused("samples is 0; a whole number of at least 1 is wanted"));
        }
        if !path.exists() {
            return Err(of_file(&path, &std::io::Error::from(std::io::ErrorKind::NotFound)));
        }
        if begins_with(&path, CHECKPOINT_MAGIC)? {
            return Err(refused(format!(
                "{}: is a checkpoint of a training; dgs convert makes a scene of it (.4dgs or a folder: of \
                 every frame), dgs encode a stream",
                path.display()
            )));
        }
        if is_read_as_stream(&path)? {
            let (mut scene, warnings) = py.detach(|| received_scene(&path))?;
            warn(py, (!warnings.is_empty()).then(|| warnings.join("; ")))?;
            scene.up = up.unwrap_or(scene.up);
            return Ok(Self(scene));
        }
        let limits = Limits { max_gaussians, keep_readable, ..Limits::default() };
        let identity = if identity_stored { import::Identity::Stored } else { import::Identity::PerFrame };
        let frames_per_second = fps.unwrap_or(ImportOptions::FRAMES_PER_SECOND);
        let mesh = gltf::GltfOptions { clip, frames_per_second, samples, seed, ..Default::default() };
        let options = ImportOptions {
            limits,
            identity,
            frames_per_second: fps,
            gltf: mesh,
            ..ImportOptions::default()
        };
        let mut scene = py.detach(|| import::import(&path, &options)).map_err(|error| unreadable(&error))?;
        scene.up = up.or(scene.default_up).unwrap_or_default();
        Ok(Self(scene))
    }

    /// A scene of arrays.
    #[staticmethod]
    #[pyo3(signature = (
        means, scales = None, quats = None, opacities = None, sh0 = None, shN = None, *, fps = 30.0,
        activation = "log", up = "minus-y", footprint = None
    ))]
    #[allow(clippy::too_many_arguments, reason = "keyword arguments of Python")]
    #[allow(non_snake_case, reason = "the name that higher bands have in gsplat")]
    fn from_arrays(
        means: &Bound<'_, PyAny>,
        scales: Option<&Bound<'_, PyAny>>,
        quats: Option<&Bound<'_, PyAny>>,
        opacities: Option<&Bound<'_, PyAny>>,
        sh0: Option<&Bound<'_, PyAny>>,
        shN: Option<&Bound<'_, PyAny>>,
        fps: f64,
        activation: &str,
        up: &str,
        footprint: Option<&str>,
    ) -> PyResult<Self> {
        let up = up_of(up)?;
        let arrays = [Some(means), scales, quats, opacities, sh0, shN];
        let source = if arrays[1..].iter().all(Option::is_none) {
            means.clone()
        } else {
            let source = PyDict::new(means.py());
            for (name, array) in gaussians::NAMES.into_iter().zip(arrays) {
                source.set_item(name, array)?;
            }
            source.into_any()
        };
        let named = footprint.map(|name| Ok(Some(name.to_owned())));
        let named = named.unwrap_or_else(|| gaussians::footprint(&source))?;
        let footprint = named.map_or(Ok(Footprint::default()), |name| footprint_of(&name))?;
        let mut scene = clip::scene(&source, fps, Activation::of(activation)?)?;
        (scene.up, scene.footprint) = (up, footprint);
        Ok(Self(scene))
    }

    /// A scene that needs no file.
    #[staticmethod]
    #[pyo3(signature = (kind = "figure", *, gaussians = 2000, frames = 8, seed = 1))]
    fn synth(py: Python<'_>, kind: &str, gaussians: i128, frames: i128, seed: i128) -> PyResult<Self> {
        let kind = synth::SynthKind::ALL.into_iter().find(|found| found.name() == kind).ok_or_else(|| {
            let names = synth::SynthKind::ALL.map(synth::SynthKind::name).join(", ");
            refused(format!("kind is {kind:?}; {names} are allowed"))
        })?;
        let (gaussians, frames) = (whole("gaussians", gaussians)?, whole("frames", frames)?);
        let seed = whole("seed", seed)?;
        let options = synth::SynthOptions { kind, gaussians, frames, seed, ..Default::default() };
        let scene = py.detach(|| synth::make(&options, &Limits::default()));
        // Whatever is wrong is an argument: no file is read.
        Ok(Self(scene.map_err(refused)?))
    }

    /// The arrays of a frame.
    #[pyo3(signature = (frame, *, activation = "log"))]
    pub fn at<'py>(&self, py: Python<'py>, frame: i64, activation: &str) -> PyResult<Bound<'py, PyAny>> {
        let activation = Activation::of(activation)?;
        let frame = checked_frame(frame, self.0.frames())?;
        let (epoch, t) = self.0.locate(frame).unwrap_or_default();
        Frame::of_epoch(&self.0.epochs()[epoch], t, activation).into_python(py, self.0.footprint)
    }

    /// Writes a frame, or all, as the ending of the path says.
    #[pyo3(signature = (path, *, frame = 0, keep_axes = false))]
    fn save(&self, py: Python<'_>, path: PathBuf, frame: i64, keep_axes: bool) -> PyResult<()> {
        save(py, &self.0, &path, frame, keep_axes)
    }

    fn __len__(&self) -> usize {
        self.0.frames()
    }

    /// How its Gaussians are drawn.
    #[getter]
    fn footprint(&self) -> &'static str {
        self.0.footprint.name()
    }

    /// Number of frames.
    #[getter]
    fn frames(&self) -> usize {
        self.0.frames()
    }

    /// Gaussians of the frame that has most.
    #[getter]
    fn gaussians(&self) -> usize {
        self.0.max_count()
    }

    /// Frames per second.
    #[getter]
    fn fps(&self) -> f64 {
        self.0.frames_per_second()
    }

    /// Which axis points up.
    #[getter]
    fn up(&self) -> String {
        self.0.up.to_string()
    }

    /// What a person should know of the source.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.0.notes.clone()
    }

    /// Cameras that the source came with.
    #[getter]
    fn cameras(&self) -> Vec<Camera> {
        self.0.cameras.iter().cloned().map(Camera).collect()
    }

    /// The least and the greatest corner of all centres at all frames, [2, 3].
    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f32>>> {
        let (mut low, mut high) = ([f32::NAN; 3], [f32::NAN; 3]);
        for epoch in self.0.epochs() {
            let frames = if epoch.attributes().positions.is_constant() { 1 } else { epoch.frames() };
            for position in (0..frames).flat_map(|t| epoch.attributes().positions.frame(t, epoch.count())) {
                for axis in 0..3 {
                    // The other operand of a value that is none.
                    low[axis] = low[axis].min(position[axis]);
                    high[axis] = high[axis].max(position[axis]);
                }
            }
        }
        array(py, [low, high].as_flattened().to_vec(), &[2, 3])
    }

    /// Cameras around the scene.
    #[pyo3(signature = (count, width, height, *, held_out = true))]
    fn ring(&self, count: i128, width: i128, height: i128, held_out: bool) -> PyResult<Vec<Camera>> {
        let found = usize::try_from(count).ok().filter(|count| (1..=MAX_CAMERAS).contains(count));
        let wrong = || refused(format!("count is {count}; 1 to {MAX_CAMERAS} cameras are allowed"));
        let count = found.ok_or_else(wrong)?;
        let (width, height) = (whole("width", width)?, whole("height", height)?);
        let ring = if held_out { Ring::HeldOut } else { Ring::Validation };
        let cameras = Framing::of(&self.0).ring(ring, count, (width, height)).map_err(refused)?;
        Ok(cameras.into_iter().map(Camera).collect())
    }

    /// A scene does not change: a copy is the scene itself.
    fn __deepcopy__(slf: Py<Self>, _memo: &Bound<'_, PyAny>) -> Py<Self> {
        slf
    }

    /// A scene does not change: a copy is the scene itself.
    fn __copy__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    /// A scene is not pickled: it may be of gigabytes.
    fn __reduce__(&self) -> PyResult<()> {
        Err(PyTypeError::new_err(
            "a dgs.Scene is not pickled; pickle its arrays, scene.at(frame), or save and load it: .4dgs has \
             every frame but no footprint, .dgs is lossy",
        ))
    }

    fn __repr__(&self) -> String {
        let (gaussians, frames) = (self.0.max_count(), self.0.frames());
        format!("Scene({gaussians} Gaussians, {frames} frames, {} fps)", self.0.frames_per_second())
    }
}

/// Reads a scene and writes it as the ending of the other path says.
#[pyfunction]
#[pyo3(signature = (source, target, *, fps = None, frame = 0, keep_axes = false, up = None))]
pub fn convert(
    py: Python<'_>,
    source: PathBuf,
    target: PathBuf,
    fps: Option<f64>,
    frame: i64,
    keep_axes: bool,
    up: Option<&str>,
) -> PyResult<()> {
    let scene = Scene::load(py, source, fps, 20_000, None, 1, false, false, 5_000_000, up)?;
    save(py, &scene.0, &target, frame, keep_axes)
}
