//! The experiments behind `dgs bench`: one file per bench, one [`Bench`] each.

mod accounting;
mod clock;
mod cloud;
mod counterfactual;
mod decode;
mod demo;
mod embedded;
mod entropy;
mod gpu;
mod gradient;
mod loss;
mod pareto;
mod partial;
mod rate;
mod render;
mod repair;
mod skips;
mod stress;
mod transport;
mod worlds;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use trainer_host::{Scene, encode};

use crate::{
    args::{CodecArgs, LinkArgs, ProfileName, SceneArgs},
    figures::Bench,
    pipeline::{self, Quiet},
};

/// A bench by name.
pub struct Experiment {
    /// As typed.
    pub name: &'static str,
    /// What it measures.
    pub about: &'static str,
    /// Measures.
    pub run: fn(&Setup) -> Result<Bench>,
}

/// All benches, in the order of the walk.
pub const ALL: &[Experiment] = &[
    Experiment { name: "demo", about: "wall time and peak memory of `dgs demo`", run: demo::run },
    Experiment {
        name: "rate",
        about: "rate and distortion of dgs1 beside the paper's format and public peers, Bjøntegaard rates, overheads (--out)",
        run: rate::run,
    },
    Experiment {
        name: "accounting",
        about: "the paper's accounting table for profile paper, its own figures beside",
        run: accounting::run,
    },
    Experiment {
        name: "entropy",
        about: "the packet coder: symbols per second beside bytes over entropy, public coders in the same run",
        run: entropy::run,
    },
    Experiment {
        name: "decode",
        about: "bytes to Gaussians on one core: receiver, frames, packet parse, CRC, closure",
        run: decode::run,
    },
    Experiment {
        name: "loss",
        about: "random packet subsets render; quality at 1, 5, 10 and 20 % packet loss",
        run: loss::run,
    },
    Experiment {
        name: "embedded",
        about: "flash, RAM, stack, instructions and digests on Cortex-M4F, WebAssembly and in C, within budget",
        run: embedded::run,
    },
    Experiment {
        name: "repair",
        about: "residual loss of XOR and of the Cauchy code at equal overhead, and the code's speed beside public peers",
        run: repair::run,
    },
    Experiment {
        name: "render",
        about: "CPU render time per frame beside its error against the f64 reference",
        run: render::run,
    },
    Experiment {
        name: "worlds",
        about: "pictures of 1 to 128 states in one call against serial renders, with memory",
        run: worlds::run,
    },
    Experiment {
        name: "counterfactual",
        about: "states, utilities and gradients per second against rendering every state alone",
        run: counterfactual::run,
    },
    Experiment {
        name: "gradient",
        about: "gradients against f64 differences, time with gradients, utilities of groups estimated from them",
        run: gradient::run,
    },
    Experiment {
        name: "skips",
        about: "work, time and error of every skip of the CPU renderer, and of what a sequence keeps",
        run: skips::run,
    },
    Experiment {
        name: "stress",
        about: "numerical stress: time, error against f64 and refusals of every hard case",
        run: stress::run,
    },
    Experiment {
        name: "pareto",
        about: "time against error of every tolerance, precision and skip, alone and together (--out)",
        run: pareto::run,
    },
    Experiment {
        name: "gpu",
        about: "wgpu backend: time per stage beside its error, world batches",
        run: gpu::run,
    },
    Experiment {
        name: "transport",
        about: "startup, miss, utility and waste of four schedulers on measured traces",
        run: transport::run,
    },
];

/// What all benches are told.
#[derive(Debug)]
pub struct Setup {
    data: Option<PathBuf>,
    /// Smaller sizes.
    pub quick: bool,
    /// Whether progress is shown.
    pub quiet: Quiet,
    /// Where tables and drawings go, if anywhere.
    pub out: Option<PathBuf>,
}

impl Setup {
    /// A setup with the data folder typed, else `../shared/data` if it is there.
    pub fn new(data: Option<PathBuf>, quick: bool, quiet: Quiet) -> Self {
        let beside = PathBuf::from("../shared/data");
        Self { data: data.or_else(|| beside.is_dir().then_some(beside)), quick, quiet, out: None }
    }

    /// Writes `text` as `name` in the folder for tables and drawings, where one was given.
    ///
    /// # Errors
    /// What the system says about the path.
    pub fn write(&self, name: &str, text: &str) -> Result<()> {
        let Some(folder) = &self.out else { return Ok(()) };
        let path = folder.join(name);
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        crate::files::write(&path, text.as_bytes())
    }

    /// `path` in the data folder, or why it is not there (for [`Bench::skipped`]).
    ///
    /// # Errors
    /// Absence, where `DGS_REQUIRE_DATA=1` says that real data must be there.
    pub fn data(&self, path: &str, bench: &mut Bench) -> Result<Option<PathBuf>> {
        let found = self.data.as_ref().map(|d| d.join(path)).filter(|p| p.exists());
        if found.is_none() {
            if std::env::var_os("DGS_REQUIRE_DATA").is_some_and(|v| v == "1") {
                bail!("{path} is not in the data folder, and DGS_REQUIRE_DATA=1 demands it");
            }
            bench.skipped.push(format!("{path} is not here (see --data)"));
        }
        Ok(found)
    }
}

/// Defaults as if typed.
pub(crate) fn scene_args(samples: usize) -> SceneArgs {
    SceneArgs {
        fps: 30.0,
        samples,
        clip: None,
        seed: 1,
        identity_stored: false,
        keep_readable: false,
        max_gaussians: 5_000_000,
        up: crate::args::Up::Y,
    }
}

/// Defaults as if typed.
pub(crate) fn codec_args(profile: ProfileName) -> CodecArgs {
    CodecArgs {
        profile,
        coarseness: 1.0,
        target_bits_per_gaussian: None,
        target_bytes: None,
        target_psnr: None,
        pictures: encode::Options::default().pictures,
        search: 0,
        cluster_size: 512,
        block_len: 64,
        window_frames: None,
        rank: None,
        packet_bytes: 1150,
        repair_set: None,
        repair: None,
    }
}

/// Defaults as if typed.
pub(crate) fn link_args(trace: Option<PathBuf>) -> LinkArgs {
    LinkArgs {
        trace,
        trace_offset: 0.0,
        scale: None,
        load: 1.6,
        delay_ms: None,
        burst_loss: 0.02,
        queue_ms: 250,
        controller: crate::args::ControllerName::Newreno,
        link_seed: 1,
    }
}

/// A scene of the data folder, or a synthetic one.
pub(crate) fn load(path: &Path, samples: usize) -> Result<Scene> {
    Ok(pipeline::import(&path.to_string_lossy(), &scene_args(samples))?.scene)
}

/// A synthetic scene.
pub(crate) fn synth(kind: &str, gaussians: usize, frames: usize) -> Result<Scene> {
    Ok(pipeline::import(&format!("synth:{kind}:{gaussians}:{frames}"), &scene_args(gaussians))?.scene)
}

/// Up to `count` frames spread over a clip of `frames`.
pub(crate) fn spread(frames: usize, count: usize) -> Vec<u32> {
    trainer_host::judge::spread(0, frames as u32, count as u32)
}
