//! Encodes scenes for Python, with the options of `dgs encode`.

use std::{ops::ControlFlow, path::PathBuf, sync::Mutex};

use pyo3::{
    prelude::*,
    types::{PyBytes, PyDict},
};
use serde_json::json;
use trainer_host::encode::{EncodeOptions, Protection, QuantiserSteps, Target};

use crate::{
    error::{of_file, refused, whole},
    scene::Scene,
    stream::Stream,
};

/// An encoded scene.
#[pyclass(module = "dgs", frozen)]
pub struct Encoded {
    stream: Py<Stream>,
    report: Py<PyAny>,
}

#[pymethods]
impl Encoded {
    /// The manifest and the packets.
    #[getter]
    fn stream(&self, py: Python<'_>) -> Py<Stream> {
        self.stream.clone_ref(py)
    }

    /// What was chosen and what it came to.
    #[getter]
    fn report(&self, py: Python<'_>) -> Py<PyAny> {
        self.report.clone_ref(py)
    }

    /// The bytes of a .dgs file.
    fn to_bytes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.stream.get().to_bytes(py)
    }

    /// Writes a .dgs file.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        let bytes = self.stream.get().stream.to_bytes().map_err(refused)?;
        std::fs::write(&path, bytes).map_err(|error| of_file(&path, &error))
    }

    fn __bytes__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyBytes>> {
        self.to_bytes(py)
    }

    fn __repr__(&self) -> String {
        format!("Encoded({} bytes on the wire)", self.stream.get().stream.wire_bytes())
    }
}

/// The one target among these, if there is one.
fn target(bits_per_gaussian: Option<f64>, bytes: Option<u64>, psnr: Option<f64>) -> PyResult<Option<Target>> {
    let targets =
        [bits_per_gaussian.map(Target::BitsPerGaussian), bytes.map(Target::Bytes), psnr.map(Target::PsnrDb)];
    let mut named = targets.into_iter().flatten();
    match (named.next(), named.next()) {
        (Some(a), Some(b)) => {
            let names = [a.name(), b.name()].join(" and ");
            Err(refused(format!("{names} are both given; one of them is allowed")))
        }
        (found, _) => Ok(found),
    }
}

/// Encodes a scene.
#[pyfunction]
#[pyo3(signature = (
    scene, *, profile = "dgs1", coarseness = 1.0, target_bits_per_gaussian = None, target_bytes = None,
    target_psnr = None, pictures = 16, search = 0, cluster_size = 512, block_len = 64,
    window_frames = None, rank = None, packet_bytes = 1150, repair = "none", progress = None
))]
#[allow(clippy::too_many_arguments, reason = "keyword arguments of Python")]
pub fn encode(
    py: Python<'_>,
    scene: &Bound<'_, Scene>,
    profile: &str,
    coarseness: f32,
    target_bits_per_gaussian: Option<f64>,
    target_bytes: Option<i128>,
    target_psnr: Option<f64>,
    pictures: i128,
    search: i128,
    cluster_size: i128,
    block_len: i128,
    window_frames: Option<i128>,
    rank: Option<i128>,
    packet_bytes: i128,
    repair: &str,
    progress: Option<Py<PyAny>>,
) -> PyResult<Encoded> {
    let base = match profile {
        "dgs1" => EncodeOptions::default(),
        "paper" => EncodeOptions::paper(),
        "paper-context" => EncodeOptions::paper_context(),
        other => {
            let allowed = "\"dgs1\", \"paper\" or \"paper-context\" are allowed";
            return Err(refused(format!("profile is {other:?}; {allowed}")));
        }
    };
    if !(0.001..=1000.0).contains(&coarseness) {
        return Err(refused(format!("coarseness is {coarseness}; 0.001 to 1000 are allowed")));
    }
    let cluster_size = whole("cluster_size", cluster_size)?;
    let target_bytes = target_bytes.map(|bytes| whole("target_bytes", bytes)).transpose()?;
    let mut cluster = base.cluster;
    cluster.max_gaussians = cluster_size;
    cluster.min_gaussians = cluster.min_gaussians.min(cluster_size);
    let options = EncodeOptions {
        cluster,
        block_len: whole("block_len", block_len)?,
        window_frames: window_frames.map(|frames| whole("window_frames", frames)).transpose()?,
        rank: rank.map_or(Ok(base.rank), |rank| whole("rank", rank))?,
        quality: QuantiserSteps::default().scaled(coarseness),
        target: target(target_bits_per_gaussian, target_bytes, target_psnr)?,
        pictures: whole("pictures", pictures)?,
        search: whole("search", search)?,
        packet_bytes: whole("packet_bytes", packet_bytes)?,
        repair: Protection::parse(repair).map_err(|error| refused(format!("repair: {error}")))?,
        ..base
    };
    // What a signal or the listener raised, which is raised again once the encoder has stopped or ended.
    let raised: Mutex<Option<PyErr>> = Mutex::new(None);
    let listen = |stage: &'static str, share: f64| {
        let heard = Python::attach(|py| {
            py.check_signals()?;
            progress.as_ref().map_or(Ok(()), |progress| progress.call1(py, (stage, share)).map(drop))
        });
        let Err(error) = heard else { return ControlFlow::Continue(()) };
        if let Ok(mut raised) = raised.lock() {
            *raised = Some(error);
        }
        ControlFlow::Break(())
    };
    let scene = &scene.get().0;
    let encoded = py.detach(|| trainer_host::encode::encode(scene, &options, &listen));
    if let Some(error) = raised.into_inner().ok().flatten() {
        return Err(error);
    }
    // One that came since the last report, or while a thread reported that hears no signals.
    py.check_signals()?;
    let encoded = encoded.map_err(refused)?;
    let packets = encoded.packet_report().map_err(refused)?;
    let report = json!({
        "report": encoded.report, "packets": packets, "wire_bytes": encoded.stream.wire_bytes(),
        "bits_per_gaussian": encoded.report.ledger.bits_per_gaussian(),
    });
    let report = py.import("json")?.call_method1("loads", (report.to_string(),))?;
    let report = report.cast_into::<PyDict>()?.into_any().unbind();
    Ok(Encoded { stream: Py::new(py, Stream::whole(encoded.stream))?, report })
}
