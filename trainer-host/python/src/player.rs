//! Plays streams for Python: packets in, arrays out.

use std::sync::{Mutex, MutexGuard, PoisonError};

use codec_core::{ErrorKind, internals::ids::Level};
use dgs_player::{Caps, Player as Receiver};
use numpy::PyArrayDyn;
use pyo3::{prelude::*, types::PyDict};

use crate::{
    activation::Activation,
    array::array,
    error::{checked_frame, damaged},
    gaussians::Frame,
    stream::{self, Stream, bytes_of},
};

/// Why packets are refused.
const KINDS: [ErrorKind; ErrorKind::COUNT] = [
    ErrorKind::Short,
    ErrorKind::Illegal,
    ErrorKind::Unknown,
    ErrorKind::Checksum,
    ErrorKind::Contradiction,
    ErrorKind::Duplicate,
    ErrorKind::Capacity,
];

/// What has arrived of a stream.
#[pyclass(module = "dgs", frozen)]
pub struct Player {
    receiver: Mutex<Receiver>,
    damage: Option<String>,
}

impl Player {
    fn of(receiver: Receiver, damage: Option<String>) -> Self {
        Self { receiver: Mutex::new(receiver), damage }
    }

    /// Nothing that runs under the lock leaves a receiver half changed.
    fn lock(&self) -> MutexGuard<'_, Receiver> {
        self.receiver.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The receiver, if it has the frame.
    fn at(&self, frame: i64) -> PyResult<(MutexGuard<'_, Receiver>, u32)> {
        let receiver = self.lock();
        let frame = checked_frame(frame, receiver.info().frames as usize)?;
        Ok((receiver, frame as u32))
    }
}

#[pymethods]
impl Player {
    /// Player(source): a Stream, bytes of a .dgs file, or its path, all of whose packets have arrived.
    #[new]
    fn new(source: &Bound<'_, PyAny>) -> PyResult<Self> {
        let py = source.py();
        let read;
        let stream = match source.cast::<Stream>() {
            Ok(stream) => stream.get(),
            Err(_) => {
                read = Stream::read(source)?;
                &read
            }
        };
        let receiver = py.detach(|| stream.stream.receive()).map_err(damaged)?;
        Ok(Self::of(receiver, stream.damage().map(str::to_owned)))
    }

    /// A player of the stream of this manifest, none of whose packets have arrived.
    #[staticmethod]
    fn from_manifest(manifest: &Bound<'_, PyAny>) -> PyResult<Self> {
        let manifest = bytes_of("manifest", manifest)?;
        Ok(Self::of(Receiver::new(&manifest, &Caps::HOST).map_err(damaged)?, None))
    }

    /// Takes one packet; gives the ids of the packets that are known by it, none if it has come before.
    fn push(&self, py: Python<'_>, packet: &Bound<'_, PyAny>) -> PyResult<Vec<u32>> {
        let packet = bytes_of("packet", packet)?;
        let packet = packet.as_ref();
        let accepted = match py.detach(|| self.lock().push(packet)) {
            Err(error) if error.kind == ErrorKind::Duplicate => return Ok(Vec::new()),
            accepted => accepted.map_err(damaged)?,
        };
        let ids = std::iter::once(accepted.id).chain(accepted.recovered.iter());
        Ok(ids.map(|id| id.index() as u32).collect())
    }

    /// Takes many packets; those that are refused are counted.
    fn push_all(&self, py: Python<'_>, packets: Vec<Bound<'_, PyAny>>) -> PyResult<()> {
        let packets =
            packets.iter().map(|packet| bytes_of("packets", packet)).collect::<PyResult<Vec<_>>>()?;
        let packets: Vec<&[u8]> = packets.iter().map(AsRef::as_ref).collect();
        py.detach(|| self.lock().push_all(packets.into_iter().filter(|packet| !packet.is_empty())));
        Ok(())
    }

    /// The arrays of a frame, as far as it has arrived.
    #[pyo3(signature = (frame, *, activation = "log"))]
    fn frame<'py>(&self, py: Python<'py>, frame: i64, activation: &str) -> PyResult<Bound<'py, PyAny>> {
        let activation = Activation::of(activation)?;
        let (frame, footprint) = py.detach(|| {
            let (mut receiver, frame) = self.at(frame)?;
            let footprint = receiver.info().footprint;
            let shown = receiver.frame(frame).map_err(damaged)?;
            let frame = Frame::decoded(shown.gaussians, shown.sh_rest, shown.sh_degree, activation);
            Ok::<_, PyErr>((frame, footprint))
        })?;
        frame.into_python(py, footprint)
    }

    /// Which Gaussians of a frame are drawn, [N]: what has arrived, and stand-ins for what has not.
    fn drawn<'py>(&self, py: Python<'py>, frame: i64) -> PyResult<Bound<'py, PyArrayDyn<bool>>> {
        let drawn: Vec<bool> = py.detach(|| {
            let (mut receiver, frame) = self.at(frame)?;
            let shown = receiver.frame(frame).map_err(damaged)?;
            Ok::<_, PyErr>(shown.gaussians.iter().map(|gaussian| !gaussian.is_absent()).collect())
        })?;
        let n = drawn.len();
        array(py, drawn, &[n])
    }

    /// How many blocks of a frame can be shown, by level.
    fn usable<'py>(&self, py: Python<'py>, frame: i64) -> PyResult<Bound<'py, PyDict>> {
        let usable = py.detach(|| {
            let (receiver, frame) = self.at(frame)?;
            receiver.usable(frame).map_err(damaged)
        })?;
        let [canonical, motion]: [[u32; Level::COUNT]; 2] = [usable.canonical, usable.motion];
        let out = PyDict::new(py);
        out.set_item("blocks", usable.blocks)?;
        out.set_item("canonical", canonical)?;
        out.set_item("motion", motion)?;
        Ok(out)
    }

    /// What the manifest says.
    #[getter]
    fn info<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let found = py.detach(|| self.lock().info());
        stream::info(py, &found)
    }

    /// What happened to packets so far.
    #[getter]
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counters = py.detach(|| *self.lock().counters());
        let out = PyDict::new(py);
        out.set_item("media", counters.media)?;
        out.set_item("parity", counters.parity)?;
        out.set_item("early", counters.early)?;
        out.set_item("recovered", counters.recovered)?;
        out.set_item("repair_failed", counters.repair_failed)?;
        let refused = PyDict::new(py);
        for kind in KINDS {
            refused.set_item(kind.name(), counters.refused[kind.index()])?;
        }
        out.set_item("refused", refused)?;
        Ok(out)
    }

    /// What was amiss with the bytes, if something was.
    #[getter]
    fn damage(&self) -> Option<&str> {
        self.damage.as_deref()
    }

    fn __repr__(&self, py: Python<'_>) -> String {
        let (info, counters) = py.detach(|| {
            let receiver = self.lock();
            (receiver.info(), *receiver.counters())
        });
        format!("Player({} frames, {} of {} packets)", info.frames, counters.media, info.packets)
    }
}
