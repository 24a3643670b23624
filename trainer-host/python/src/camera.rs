//! Shows cameras as Python programs have them: matrices of gsplat, or a place to look from.

use std::hash::{DefaultHasher, Hash, Hasher};

use numpy::PyArrayDyn;
use pyo3::{prelude::*, types::PyType};
use render_host::{Camera as Pinhole, CameraError};

use crate::{
    array::{Numbers, array},
    error::{refused, whole},
};

/// A pinhole camera with OpenCV axes: x right, y down, z forward.
#[pyclass(module = "dgs", frozen, eq)]
#[derive(Clone, PartialEq)]
pub struct Camera(pub Pinhole);

/// The arguments that make a camera again.
type Parts<'py> = (Bound<'py, PyArrayDyn<f64>>, Bound<'py, PyArrayDyn<f64>>, u32, u32, f64);

/// What [`Pinhole::look_at`] takes, in degrees.
const FOV_Y: (f64, f64) = (1e-4, 179.9999);

/// Width and height, pixels.
fn size(width: i128, height: i128) -> PyResult<(u32, u32)> {
    Ok((whole("width", width)?, whole("height", height)?))
}

/// The camera of a row-major world-to-camera matrix and intrinsics.
fn of_matrices(viewmat: &[f64], k: &[f64], size: (u32, u32), near: f64) -> PyResult<Camera> {
    let matrix = std::array::from_fn(|row| std::array::from_fn(|column| viewmat[4 * row + column]));
    let k = std::array::from_fn(|row| std::array::from_fn(|column| k[3 * row + column]));
    let named = |error: CameraError| refused(error.to_string().replace("world_to_camera", "viewmat"));
    let camera = Pinhole::from_opencv(k, matrix, size.0, size.1).map_err(named)?;
    Ok(Camera(camera.with_near(near).map_err(refused)?))
}

/// Cameras of `viewmats` and `ks`, whose shapes end in [4, 4] and [3, 3].
fn all(viewmats: &Numbers<f64>, ks: &Numbers<f64>, size: (u32, u32), near: f64) -> PyResult<Vec<Camera>> {
    let pairs = viewmats.values.chunks_exact(16).zip(ks.values.chunks_exact(9));
    pairs.map(|(viewmat, k)| of_matrices(viewmat, k, size, near)).collect()
}

#[pymethods]
impl Camera {
    /// Camera(viewmat, K, width, height, near=0.01)
    #[new]
    #[pyo3(signature = (viewmat, K, width, height, near = 0.01))]
    #[allow(non_snake_case, reason = "the name that intrinsics have in gsplat and OpenCV")]
    fn new(
        viewmat: &Bound<'_, PyAny>,
        K: &Bound<'_, PyAny>,
        width: i128,
        height: i128,
        near: f64,
    ) -> PyResult<Self> {
        let viewmat = Numbers::<f64>::read("viewmat", viewmat)?;
        if viewmat.shape != [4, 4] {
            return Err(viewmat.misshapen("[4, 4]"));
        }
        let k = Numbers::<f64>::read("K", K)?;
        if k.shape != [3, 3] {
            return Err(k.misshapen("[3, 3]"));
        }
        of_matrices(&viewmat.values, &k.values, size(width, height)?, near)
    }

    /// Cameras of many matrices, as gsplat takes them: viewmats [C, 4, 4] and Ks [C, 3, 3].
    #[staticmethod]
    #[pyo3(signature = (viewmats, Ks, width, height, near = 0.01))]
    #[allow(non_snake_case, reason = "the name that intrinsics have in gsplat")]
    fn many(
        viewmats: &Bound<'_, PyAny>,
        Ks: &Bound<'_, PyAny>,
        width: i128,
        height: i128,
        near: f64,
    ) -> PyResult<Vec<Self>> {
        let viewmats = Numbers::<f64>::read("viewmats", viewmats)?;
        let &[count, 4, 4] = &viewmats.shape[..] else { return Err(viewmats.misshapen("[C, 4, 4]")) };
        let ks = Numbers::<f64>::read("Ks", Ks)?;
        if ks.shape != [count, 3, 3] {
            return Err(ks.misshapen(format!("[{count}, 3, 3]")));
        }
        all(&viewmats, &ks, size(width, height)?, near)
    }

    /// A camera at `eye` that looks at `target`, with a vertical field of view of `fov_y` degrees;
    /// `up` points to the top of the picture.
    #[staticmethod]
    #[pyo3(signature = (eye, target, up, fov_y, width, height, near = 0.01))]
    fn look_at(
        eye: [f64; 3],
        target: [f64; 3],
        up: [f64; 3],
        fov_y: f64,
        width: i128,
        height: i128,
        near: f64,
    ) -> PyResult<Self> {
        let (least, most) = FOV_Y;
        if !(least..=most).contains(&fov_y) {
            return Err(refused(format!("fov_y is {fov_y} degrees; {least} to {most} are allowed")));
        }
        let (width, height) = size(width, height)?;
        let camera = Pinhole::look_at(eye, target, up, fov_y.to_radians(), width, height).map_err(refused)?;
        Ok(Self(camera.with_near(near).map_err(refused)?))
    }

    /// World to camera, [4, 4].
    #[getter]
    fn viewmat<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let (r, t) = (self.0.rotation(), self.0.translation());
        let row = |i: usize| [r[i][0], r[i][1], r[i][2], t[i]];
        let rows = [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]];
        array(py, rows.as_flattened().to_vec(), &[4, 4])
    }

    /// Intrinsics in pixels, [3, 3].
    #[getter]
    #[allow(non_snake_case, reason = "the name that intrinsics have in gsplat and OpenCV")]
    fn K<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let i = self.0.intrinsics();
        array(py, vec![i.fx, 0.0, i.cx, 0.0, i.fy, i.cy, 0.0, 0.0, 1.0], &[3, 3])
    }

    /// Width of the picture, pixels.
    #[getter]
    fn width(&self) -> u32 {
        self.0.width()
    }

    /// Height of the picture, pixels.
    #[getter]
    fn height(&self) -> u32 {
        self.0.height()
    }

    /// What is nearer than this is not drawn, scene units.
    #[getter]
    fn near(&self) -> f64 {
        self.0.near()
    }

    /// Equal cameras have equal numbers; 0 and -0 are equal.
    fn __hash__(&self) -> u64 {
        let (i, mut hasher) = (self.0.intrinsics(), DefaultHasher::new());
        (i.width, i.height).hash(&mut hasher);
        let rest = [i.fx, i.fy, i.cx, i.cy, self.0.near()];
        let pose = self.0.rotation().into_iter().flatten().chain(self.0.translation());
        pose.chain(rest).for_each(|v| (v + 0.0).to_bits().hash(&mut hasher));
        hasher.finish()
    }

    /// How `pickle` and `copy` make it again, to the bit.
    fn __reduce__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyType>, Parts<'py>)> {
        let parts = (self.viewmat(py)?, self.K(py)?, self.width(), self.height(), self.near());
        Ok((py.get_type::<Self>(), parts))
    }

    fn __repr__(&self) -> String {
        let centre = self.0.centre().map(|v| format!("{v:.3}")).join(", ");
        format!("Camera({} x {} pixels, at {centre})", self.0.width(), self.0.height())
    }
}
