//! Models are what COLMAP knows of lenses, and which of them are pinholes.

use crate::camera::{Camera, CameraError, Intrinsics, View};

/// A camera model: its name, number of focal lengths, and total number of parameters; none of a model whose
/// lens always distorts.
pub(super) struct Model {
    pub(super) name: &'static str,
    counts: Option<(usize, usize)>,
}

const fn model(name: &'static str, focals: usize, parameters: usize) -> Model {
    Model { name, counts: Some((focals, parameters)) }
}

const fn distorted(name: &'static str) -> Model {
    Model { name, counts: None }
}

/// COLMAP's models in the order of their numbers, from 0.
pub(super) const MODELS: [Model; 12] = [
    model("SIMPLE_PINHOLE", 1, 3),
    model("PINHOLE", 2, 4),
    model("SIMPLE_RADIAL", 1, 4),
    model("RADIAL", 1, 5),
    model("OPENCV", 2, 8),
    distorted("OPENCV_FISHEYE"),
    distorted("FULL_OPENCV"),
    distorted("FOV"),
    distorted("SIMPLE_RADIAL_FISHEYE"),
    distorted("RADIAL_FISHEYE"),
    distorted("THIN_PRISM_FISHEYE"),
    distorted("RAD_TAN_THIN_PRISM_FISHEYE"),
];
pub(super) const MODELS_ALLOWED: &str =
    "SIMPLE_PINHOLE, PINHOLE, or SIMPLE_RADIAL, RADIAL or OPENCV with a distortion of 0";
/// Most parameters of a model that is read.
pub(super) const MAX_PARAMETERS: usize = 8;

impl Model {
    /// Focal lengths and parameters in all.
    pub(super) fn counts(&self, camera: u32) -> Result<(usize, usize), CameraError> {
        self.counts.ok_or_else(|| self.refused(camera, &[]))
    }

    /// The intrinsics that `parameters` give, if the lens does not distort.
    pub(super) fn intrinsics(
        &self,
        camera: u32,
        (width, height): (u32, u32),
        parameters: &[f64; MAX_PARAMETERS],
    ) -> Result<Intrinsics, CameraError> {
        let (focals, count) = self.counts(camera)?;
        let distortion = &parameters[focals + 2..count];
        if distortion.iter().any(|&d| d != 0.0) {
            return Err(self.refused(camera, distortion));
        }
        let (fx, fy) = (parameters[0], parameters[focals - 1]);
        Ok(Intrinsics { width, height, fx, fy, cx: parameters[focals], cy: parameters[focals + 1] })
    }

    fn refused(&self, camera: u32, values: &[f64]) -> CameraError {
        CameraError::Distorted {
            camera: camera.to_string(),
            model: self.name.to_owned(),
            values: values.to_vec(),
            allowed: MODELS_ALLOWED,
        }
    }
}

/// A view from its quaternion and translation.
pub(super) fn view(name: String, pose: [f64; 7], intrinsics: Intrinsics) -> Result<View, CameraError> {
    let [w, x, y, z, tx, ty, tz] = pose;
    let camera =
        Camera::from_colmap([w, x, y, z], [tx, ty, tz], intrinsics).map_err(|error| error.of(&name))?;
    Ok(View { name, time: None, camera })
}
