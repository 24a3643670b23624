//! Prepares what every experiment starts from: sizes, data folder, scenes, options as if typed.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::Parser;
use dgs::{
    args::{CodecArgs, LinkArgs, ProfileName, SceneArgs, Up},
    pipeline::{self, Quiet},
};
use trainer_host::Scene;

use crate::figures::Bench;

/// What every bench is given.
#[derive(Debug)]
pub struct Setup {
    data: Option<PathBuf>,
    /// Smaller sizes.
    pub quick: bool,
    /// Whether progress is shown.
    pub quiet: Quiet,
    /// Where tables and drawings go, if anywhere.
    pub out: Option<PathBuf>,
    /// Weights of LPIPS, to measure it too where pictures are rated.
    pub lpips: Option<PathBuf>,
    /// States per loss that a study of states measures with FLIP and LPIPS.
    pub perceptual_states: usize,
    /// Part of the names of what `workloads` and `erasure` are about; all of it without.
    pub only: Option<String>,
}

impl Setup {
    /// States that are measured with FLIP and LPIPS where nothing is typed.
    pub const PERCEPTUAL_STATES: u16 = 32;

    /// A setup with the data folder typed, else `../shared/data` if it is there.
    pub fn new(data: Option<PathBuf>, quick: bool, quiet: Quiet) -> Self {
        let beside = PathBuf::from("../shared/data");
        Self {
            data: data.or_else(|| beside.is_dir().then_some(beside)),
            quick,
            quiet,
            out: None,
            lpips: None,
            perceptual_states: usize::from(Self::PERCEPTUAL_STATES),
            only: None,
        }
    }

    /// The weights of LPIPS that were given, else those in the data folder, if there are any.
    pub fn lpips_weights(&self) -> Option<PathBuf> {
        let found = self.data.as_ref().map(|data| data.join("lpips/alexnet.safetensors"));
        self.lpips.clone().or(found.filter(|path| path.is_file()))
    }

    /// Writes `text` as `name` in the folder for tables and drawings, where one was given.
    ///
    /// # Errors
    /// What the system says about the path.
    pub fn write(&self, name: &str, text: &str) -> Result<()> {
        let Some(folder) = &self.out else { return Ok(()) };
        let path = folder.join(name);
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot make", folder.display()))?;
        dgs::files::write(&path, text.as_bytes())
    }

    /// Shows the figures of `bench` from the `first` on, on standard error: a bench that takes long, and is
    /// broken off, has then said something.
    pub fn show(&self, bench: &Bench, first: usize) {
        if !self.quiet.0 {
            eprint!("{}", bench.rows(first));
        }
    }

    /// Those of `names` that hold what was chosen.
    ///
    /// # Errors
    /// None does.
    pub fn chosen<'n>(&self, names: &[&'n str]) -> Result<Vec<&'n str>> {
        let Some(part) = &self.only else { return Ok(names.to_vec()) };
        let chosen: Vec<_> = names.iter().copied().filter(|name| name.contains(part)).collect();
        if chosen.is_empty() {
            let with = if self.quick { " with --quick" } else { "" };
            bail!("--only is {part:?}; part of one of {} is allowed{with}", names.join(", "));
        }
        Ok(chosen)
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

/// The options of the command line with nothing typed.
#[derive(Debug, Parser)]
struct Untyped {
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    codec: CodecArgs,
    #[command(flatten)]
    link: LinkArgs,
}

fn untyped() -> Untyped {
    Untyped::parse_from(["dgs"])
}

/// How to read a scene: defaults, with `samples` Gaussians on a mesh.
pub fn scene_args(samples: usize) -> SceneArgs {
    // Figures are for pictures with y up, whatever the format.
    SceneArgs { samples, up: Some(Up::Y), ..untyped().scene }
}

/// How to encode: defaults of `profile`.
pub fn codec_args(profile: ProfileName) -> CodecArgs {
    CodecArgs { profile, ..untyped().codec }
}

/// The link: defaults over `trace`.
pub fn link_args(trace: Option<PathBuf>) -> LinkArgs {
    LinkArgs { trace, ..untyped().link }
}

/// A scene of the data folder, or a synthetic one.
pub fn load(path: &Path, samples: usize) -> Result<Scene> {
    Ok(pipeline::import(&path.to_string_lossy(), &scene_args(samples))?.scene)
}

/// A clip of an animated mesh of the data folder, by name or number.
pub(crate) fn load_clip(path: &Path, samples: usize, clip: &str) -> Result<Scene> {
    let args = SceneArgs { clip: Some(clip.to_owned()), ..scene_args(samples) };
    Ok(pipeline::import(&path.to_string_lossy(), &args)?.scene)
}

/// A synthetic scene.
pub fn synth(kind: &str, gaussians: usize, frames: usize) -> Result<Scene> {
    Ok(pipeline::import(&format!("synth:{kind}:{gaussians}:{frames}"), &scene_args(gaussians))?.scene)
}

/// Up to `count` frames spread over a clip of `frames`.
pub fn spread(frames: usize, count: usize) -> Vec<u32> {
    trainer_host::evaluator::spread(0, frames as u32, count as u32)
}
