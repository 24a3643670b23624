//! What every verb takes that reads a scene.

use clap::{Args, ValueEnum};
use trainer_host::import::{Format, deformation::DEFAULT_FRAMES};

use super::number::{real, whole};

const FRAMES_PER_SECOND: f64 = 30.0;
const SAMPLES: usize = 20_000;
const SEED: u64 = 1;
const MAX_GAUSSIANS: usize = 5_000_000;

/// A scene and how to read it.
#[derive(Clone, Debug, Args)]
pub struct SceneArgs {
    /// Frames per second for sources that do not say: 0.001 to 10000 [default: 30].
    #[arg(long, value_parser = real(0.001..=10_000.0, "frames per second"), allow_negative_numbers = true)]
    pub fps: Option<f64>,
    /// Gaussians to place on an animated mesh: at least 1.
    #[arg(long, default_value_t = SAMPLES, value_parser = whole::<usize>(1..=5_000_000, "Gaussians"))]
    pub samples: usize,
    /// Clip of an animated mesh: name or number from 0 [default: the first].
    #[arg(long)]
    pub clip: Option<String>,
    /// Frames at which a deformation field (4D Gaussian Splatting, Deformable 3D Gaussians) is evaluated, at
    /// times from 0 to 1, both included.
    #[arg(
        long, value_name = "FRAMES", default_value_t = DEFAULT_FRAMES,
        value_parser = whole::<usize>(1..=100_000, "frames")
    )]
    pub deformation_frames: usize,
    /// Seed of everything random in the scene [default: 1].
    #[arg(long)]
    pub seed: Option<u64>,
    /// Rows of a numbered PLY sequence are the same Gaussians in every frame.
    #[arg(long)]
    pub identity_stored: bool,
    /// Keep the readable part of a damaged source instead of refusing it: Gaussians of which everything is
    /// there, without harmonics where only those are missing. Meshes, and zip archives (SOG, npz) that have
    /// lost their end, are read whole or not at all.
    #[arg(long)]
    pub keep_readable: bool,
    /// Most Gaussians to accept from one file.
    #[arg(long, default_value_t = MAX_GAUSSIANS)]
    pub max_gaussians: usize,
    /// Which way is up: cameras placed around the scene stand upright by it, those that the encoder
    /// chooses on too [default: as usual in the format: -y in PLY, compressed PLY, .splat, SOG and Unity
    /// assets, which keep the axes of captures; y in SPZ, glTF and everything else; a .dgs stream says it
    /// itself].
    #[arg(long, value_enum)]
    pub up: Option<Up>,
    /// How Gaussians are drawn, if not as the file says [default: dilated, where it says nothing]; a .dgs
    /// stream says it itself.
    #[arg(long, value_enum)]
    pub footprint: Option<Footprint>,
}

impl SceneArgs {
    /// Frames per second for sources that do not say.
    pub fn frames_per_second(&self) -> f64 {
        self.fps.unwrap_or(FRAMES_PER_SECOND)
    }

    /// Seed of everything random in the scene.
    pub fn seed(&self) -> u64 {
        self.seed.unwrap_or(SEED)
    }

    /// The options that differ from their defaults.
    pub fn given(&self) -> Vec<&'static str> {
        let options = [
            ("--keep-readable", self.keep_readable),
            ("--max-gaussians", self.max_gaussians != MAX_GAUSSIANS),
            ("--up", self.up.is_some()),
            ("--footprint", self.footprint.is_some()),
        ];
        let others = options.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name);
        self.scene_only().into_iter().chain(others).collect()
    }

    /// The options that were given and mean nothing to a file of `format`.
    pub(crate) fn unused_in(&self, format: Format) -> Vec<&'static str> {
        let is_mesh = format == Format::Gltf;
        let options = [
            ("--samples", self.samples != SAMPLES && !is_mesh),
            ("--clip", self.clip.is_some() && !is_mesh),
            ("--seed", self.seed.is_some() && !is_mesh),
            (
                "--deformation-frames",
                self.deformation_frames != DEFAULT_FRAMES && format != Format::Deformation,
            ),
            ("--identity-stored", self.identity_stored && format != Format::Sequence),
        ];
        options.into_iter().filter(|(_, unused)| *unused).map(|(name, _)| name).collect()
    }

    /// The options that were given and are for scenes alone: a stream has no use for them.
    pub fn scene_only(&self) -> Vec<&'static str> {
        let options = [
            ("--fps", self.fps.is_some()),
            ("--samples", self.samples != SAMPLES),
            ("--clip", self.clip.is_some()),
            ("--deformation-frames", self.deformation_frames != DEFAULT_FRAMES),
            ("--seed", self.seed.is_some()),
            ("--identity-stored", self.identity_stored),
        ];
        options.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect()
    }
}

/// How Gaussians are widened where they are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Footprint {
    /// By 0.3 pixels², and as opaque as before (3DGS).
    Dilated,
    /// By 0.3 pixels², and dimmed as much (gsplat's antialiased mode).
    Compensated,
    /// By 0.1 pixels², and dimmed as much (Mip-Splatting).
    Pixel,
}

impl From<Footprint> for codec_core::Footprint {
    fn from(footprint: Footprint) -> Self {
        match footprint {
            Footprint::Dilated => Self::Dilated,
            Footprint::Compensated => Self::Compensated,
            Footprint::Pixel => Self::Pixel,
        }
    }
}

/// An axis that points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Up {
    /// +x.
    X,
    /// +y.
    Y,
    /// +z.
    Z,
    /// −x.
    MinusX,
    /// −y (COLMAP and 3DGS captures).
    MinusY,
    /// −z.
    MinusZ,
}

impl From<Up> for trainer_host::scene::Up {
    fn from(up: Up) -> Self {
        match up {
            Up::X => Self::X,
            Up::Y => Self::Y,
            Up::Z => Self::Z,
            Up::MinusX => Self::MinusX,
            Up::MinusY => Self::MinusY,
            Up::MinusZ => Self::MinusZ,
        }
    }
}
