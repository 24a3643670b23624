//! Parses where pictures look from: what every verb takes that lets a person choose cameras.

use std::path::PathBuf;

use clap::Args;

use super::number::{point, real, whole};

/// Which cameras to look from.
///
/// What is typed wins: a file, else an eye, else a turntable, else the cameras that the scene came with, else
/// a ring around the middle (median) of all Gaussians at 2.6 times the radius that holds 98 % of them, 20°
/// above the horizon. None of it depends on the order of Gaussians.
#[derive(Clone, Debug, Default, Args)]
pub struct CameraArgs {
    /// Cameras to look from: a Blender/NeRF transforms_*.json (times 0 to 1 choose frames), or COLMAP's
    /// cameras and images (.bin or .txt): either file, the folder with both, or that of the dataset; or
    /// Panoptic's train_meta.json or test_meta.json. Lenses must be undistorted.
    /// [default: the scene's own, else a ring around it that holds 98 % of the Gaussians]
    #[arg(long, value_name = "FILE")]
    pub cameras: Option<PathBuf>,
    /// Which camera: its number from 0, or its name in the file of --cameras or the end of that, without the
    /// ending, if no other has it [default: 0, or all of --cameras, or all of --turntable].
    #[arg(long, value_name = "NUMBER|NAME")]
    pub camera: Option<String>,
    /// One camera here, in scene units.
    #[arg(
        long, value_name = "X,Y,Z", value_parser = point, conflicts_with_all = ["cameras", "turntable"],
        allow_hyphen_values = true
    )]
    pub eye: Option<[f64; 3]>,
    /// What the camera of --eye looks at, or what --turntable goes around [default: the middle of the scene].
    #[arg(
        long, value_name = "X,Y,Z", value_parser = point, conflicts_with = "cameras",
        allow_hyphen_values = true
    )]
    pub target: Option<[f64; 3]>,
    /// Vertical field of view of --eye and --turntable, 1 to 170 degrees [default: 45].
    #[arg(
        long, value_name = "DEGREES", conflicts_with = "cameras", allow_negative_numbers = true,
        value_parser = real(1.0..=170.0, "degrees")
    )]
    pub fov: Option<f64>,
    /// Number of cameras in a full circle around the scene; of a moving scene each shows the next frame.
    #[arg(
        long, value_name = "CAMERAS", conflicts_with = "cameras",
        value_parser = whole::<usize>(1..=10_000, "cameras")
    )]
    pub turntable: Option<usize>,
}

impl CameraArgs {
    /// Whether any of them is given.
    pub fn is_given(&self) -> bool {
        !self.given().is_empty()
    }

    /// The options that are given.
    pub fn given(&self) -> Vec<&'static str> {
        let Self { cameras, camera, eye, target, fov, turntable } = self;
        let options = [
            ("--cameras", cameras.is_some()),
            ("--camera", camera.is_some()),
            ("--eye", eye.is_some()),
            ("--target", target.is_some()),
            ("--fov", fov.is_some()),
            ("--turntable", turntable.is_some()),
        ];
        options.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect()
    }

    /// Whether cameras are to be placed: by --eye or --turntable.
    pub fn is_placed(&self) -> bool {
        self.eye.is_some() || self.turntable.is_some()
    }
}
