//! Shows streams to Python: the bytes of a manifest and of packets.

use std::{borrow::Cow, collections::BTreeSet, path::PathBuf};

use pyo3::{
    exceptions::PyTypeError,
    prelude::*,
    types::{PyByteArray, PyBytes, PyDict, PyMemoryView},
};

use crate::error::{damaged, of_file, refused, whole};

/// The bytes of a bytes, bytearray or memoryview, if `value` is one.
fn octets<'a>(value: &'a Bound<'_, PyAny>) -> PyResult<Option<Cow<'a, [u8]>>> {
    if let Ok(bytes) = value.cast::<PyBytes>() {
        return Ok(Some(Cow::Borrowed(bytes.as_bytes())));
    }
    if let Ok(bytes) = value.cast::<PyByteArray>() {
        return Ok(Some(Cow::Owned(bytes.to_vec())));
    }
    if value.cast::<PyMemoryView>().is_err() {
        return Ok(None);
    }
    let bytes = value.call_method0("tobytes")?.cast_into::<PyBytes>()?;
    Ok(Some(Cow::Owned(bytes.as_bytes().to_vec())))
}

/// The bytes of the argument called `field`.
pub fn bytes_of<'a>(field: &str, value: &'a Bound<'_, PyAny>) -> PyResult<Cow<'a, [u8]>> {
    octets(value)?.ok_or_else(|| {
        let found = value.get_type();
        PyTypeError::new_err(format!("{field} is a {found}; bytes, a bytearray or a memoryview is wanted"))
    })
}

/// The bytes of a stream.
#[pyclass(module = "dgs", frozen)]
pub struct Stream {
    /// What is readable of it.
    pub stream: dgs_player::Stream,
    damage: Option<String>,
}

impl Stream {
    /// A stream without damage.
    pub fn whole(stream: dgs_player::Stream) -> Self {
        Self { stream, damage: None }
    }

    /// The stream of bytes, or of the file of that name.
    pub fn read(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = source.py();
        let bytes = match octets(source)? {
            Some(bytes) => bytes.into_owned(),
            None => {
                let path: PathBuf = source.extract().map_err(|_| {
                    let found = source.get_type();
                    PyTypeError::new_err(format!("source is a {found}; bytes, a path or a Stream is wanted"))
                })?;
                py.detach(|| std::fs::read(&path)).map_err(|error| of_file(&path, &error))?
            }
        };
        let (stream, damage) = py.detach(|| dgs_player::Stream::from_bytes(&bytes)).map_err(damaged)?;
        Ok(Self { stream, damage: (!damage.is_none()).then(|| damage.to_string()) })
    }
}

/// The bytes of a stream, and what was amiss with it.
type Saved<'py> = (Bound<'py, PyBytes>, Option<String>);

/// What a manifest says, by name.
pub fn info<'py>(py: Python<'py>, info: &dgs_player::StreamInfo) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let (frames, seconds) = info.frames_per_seconds;
    out.set_item("frames", info.frames)?;
    out.set_item("fps", f64::from(frames) / f64::from(seconds))?;
    out.set_item("packets", info.packets)?;
    out.set_item("gaussians", info.gaussians)?;
    out.set_item("sh_degree", info.sh_degree.get())?;
    out.set_item("footprint", info.footprint.name())?;
    out.set_item("up", info.up.name())?;
    Ok(out)
}

#[pymethods]
impl Stream {
    /// Stream(source): bytes of a .dgs file, or its path.
    #[new]
    fn new(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        Self::read(source)
    }

    /// The message that makes every packet readable.
    #[getter]
    fn manifest<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        PyBytes::new(py, self.stream.message())
    }

    /// The packets, by id; one that is missing is empty.
    #[getter]
    fn packets<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyBytes>> {
        self.stream.packets().iter().map(|packet| PyBytes::new(py, packet)).collect()
    }

    /// What is amiss with the bytes, if something is.
    #[getter]
    pub fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    /// What the manifest says.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        info(py, &self.stream.receive().map_err(damaged)?.info())
    }

    /// Bytes of the manifest and all packets.
    #[getter]
    fn wire_bytes(&self) -> usize {
        self.stream.wire_bytes()
    }

    /// The same stream without these packets.
    fn without(&self, packets: &Bound<'_, PyAny>) -> PyResult<Self> {
        let packets = packets.try_iter()?.map(|id| whole("packets", id?.extract()?));
        let packets = packets.collect::<PyResult<BTreeSet<usize>>>()?;
        let count = self.stream.packets().len();
        if let Some(last) = packets.last().filter(|&&last| last >= count) {
            return Err(refused(format!("packets: found {last}; the stream has {count}")));
        }
        let stream = self.stream.with_packets(|id| !packets.contains(&id));
        Ok(Self { stream, damage: self.damage.clone() })
    }

    /// The bytes of a .dgs file.
    pub fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        Ok(PyBytes::new(py, &self.stream.to_bytes().map_err(refused)?))
    }

    /// Writes a .dgs file.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let bytes = self.stream.to_bytes().map_err(refused)?;
        std::fs::write(&path, bytes).map_err(|error| of_file(&path, &error))
    }

    /// The stream of the bytes of a file, with what was amiss when it was first read.
    #[staticmethod]
    fn _restored(bytes: &[u8], damage: Option<String>) -> PyResult<Self> {
        let (stream, _) = dgs_player::Stream::from_bytes(bytes).map_err(damaged)?;
        Ok(Self { stream, damage })
    }

    /// How `pickle` and `copy` make it again.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyAny>, Saved<'py>)> {
        let made_by = py.get_type::<Self>().getattr("_restored")?;
        Ok((made_by, (self.to_bytes(py)?, self.damage.clone())))
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.to_bytes(py)
    }

    fn __len__(&self) -> usize {
        self.stream.packets().len()
    }

    fn __repr__(&self) -> String {
        format!("Stream({} packets, {} bytes)", self.stream.packets().len(), self.stream.wire_bytes())
    }
}
