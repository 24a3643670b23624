//! Compares schedulers over streams of many lengths and rates, on recordings that are held out: no constant
//! was chosen on them, but to scale gains was, on four of them and three of the streams.

use anyhow::Result;
use dgs::{args::SceneArgs, pipeline};
use trainer_host::Scene;

use super::{channels, pictures};
use crate::{
    experiment::delivery::trained,
    figures::{Bench, Figure},
    setup::{Setup, load_clip, scene_args, synth},
};

/// Where the scene of a workload comes from.
enum Source {
    /// A made scene: kind and frames.
    Made(&'static str, usize),
    /// The same at [`SLOW_FPS`], which leaves room for more Gaussians in as many seconds.
    MadeSlow(&'static str, usize),
    /// A clip of an animated mesh in the data folder: file and clip.
    Mesh(&'static str, &'static str),
    /// A dataset of photographs in the data folder, trained here.
    Trained(&'static str),
}

/// A stream to deliver.
struct Workload {
    name: &'static str,
    source: Source,
    gaussians: usize,
    quick: bool,
}

/// Frames per second of [`Source::MadeSlow`].
const SLOW_FPS: f64 = 10.0;

const FOX: &str = "scenes/gltf-fox/Fox.glb";

/// Streams of 0.7 s to 3 min. Their rates follow from what they show and are printed: 0.008 to 5 Mbit/s.
/// 5 Mbit/s for 30 s or more, and 0.5 Mbit/s for 3 min, are more than made scenes of 10 frames per second
/// reach at the encoder's own steps under the limit on their size.
static WORKLOADS: [Workload; 10] = [
    Workload { name: "fox_run", source: Source::Mesh(FOX, "Run"), gaussians: 20_000, quick: true },
    Workload { name: "fox_walk", source: Source::Mesh(FOX, "Walk"), gaussians: 20_000, quick: false },
    Workload {
        name: "cesium_man",
        source: Source::Mesh("scenes/gltf-cesium-man/CesiumMan.glb", "0"),
        gaussians: 30_000,
        quick: false,
    },
    Workload {
        name: "fox_survey_dense",
        source: Source::Mesh(FOX, "Survey"),
        gaussians: 100_000,
        quick: false,
    },
    Workload { name: "balls_dense", source: Source::Made("balls", 60), gaussians: 300_000, quick: false },
    Workload {
        name: "bouncingballs",
        source: Source::Trained("scenes/dnerf-bouncingballs"),
        gaussians: 0,
        quick: false,
    },
    Workload { name: "cloth_30s", source: Source::Made("cloth", 900), gaussians: 20_000, quick: false },
    Workload {
        name: "cloth_dense_30s",
        source: Source::MadeSlow("cloth", 300),
        gaussians: 125_000,
        quick: false,
    },
    Workload { name: "figure_30s", source: Source::Made("figure", 900), gaussians: 40_000, quick: false },
    Workload { name: "figure_3min", source: Source::Made("figure", 5400), gaussians: 7_000, quick: false },
];

/// Frames that are rated per run.
const PICTURES: usize = 12;

/// Runs the bench.
pub(in crate::experiment) fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "workloads",
        format!(
            "streams of many lengths and rates over held-out recordings (no constant was chosen on them; to \
             scale gains was, on four of them and three of the streams), one window of each; links, pictures \
             and bound as for the rows of pictures of `transport`, {PICTURES} rated frames; rate: bytes with \
             parity over the clip's length; trained: from its photographs at 200x200 in 4,000 steps"
        ),
    );
    let mut channels = channels::held_out(setup, &mut bench)?;
    if setup.quick {
        channels.truncate(4);
    }
    for workload in chosen(setup)? {
        let first = bench.figures.len();
        let Some(scene) = workload.scene(setup, &mut bench)? else { continue };
        let study = pictures::Study::make(&scene, setup, PICTURES)?;
        let key = format!("workloads.{}", workload.name);
        let (bytes, length) = study.extent();
        let rate = 8e-6 * bytes as f64 / length.as_s();
        bench.push(Figure::new(format!("{key}.rate"), rate, "Mbit/s"));
        bench.push(Figure::new(format!("{key}.length"), length.as_s(), "s"));
        pictures::push(&mut bench, &key, &study.compare(&channels, 1)?);
        // All of them take an hour: what is there is kept.
        setup.write("workloads.txt", &bench.table())?;
        setup.show(&bench, first);
    }
    Ok(bench)
}

/// The streams that `setup` is about.
///
/// # Errors
/// A name that none has.
fn chosen(setup: &Setup) -> Result<Vec<&'static Workload>> {
    let all: Vec<&Workload> = WORKLOADS.iter().filter(|workload| !setup.quick || workload.quick).collect();
    let names = setup.chosen(&all.iter().map(|workload| workload.name).collect::<Vec<_>>())?;
    Ok(all.into_iter().filter(|workload| names.contains(&workload.name)).collect())
}

impl Workload {
    /// Its scene, unless its data is not here.
    fn scene(&self, setup: &Setup, bench: &mut Bench) -> Result<Option<Scene>> {
        let path = match self.source {
            Source::Made(kind, frames) => return synth(kind, self.gaussians, frames).map(Some),
            Source::MadeSlow(kind, frames) => {
                let args = SceneArgs { fps: Some(SLOW_FPS), ..scene_args(self.gaussians) };
                let name = format!("synth:{kind}:{}:{frames}", self.gaussians);
                return Ok(Some(pipeline::import(&name, &args)?.scene));
            }
            Source::Mesh(file, _) | Source::Trained(file) => setup.data(file, bench)?,
        };
        let Some(path) = path else { return Ok(None) };
        match self.source {
            Source::Mesh(_, clip) => load_clip(&path, self.gaussians, clip).map(Some),
            _ => Ok(Some(trained(&path)?.1)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_chosen_by_part_of_a_name_and_a_name_of_none_is_refused() {
        let names = |quick, only: Option<&str>| {
            let mut setup = Setup::new(None, quick, dgs::pipeline::Quiet(true));
            setup.only = only.map(str::to_owned);
            Ok::<_, anyhow::Error>(chosen(&setup)?.iter().map(|workload| workload.name).collect::<Vec<_>>())
        };
        assert_eq!(names(false, Some("cloth")).unwrap(), ["cloth_30s", "cloth_dense_30s"]);
        assert_eq!((names(false, None).unwrap().len(), names(true, None).unwrap()), (10, vec!["fox_run"]));
        let refused = |quick, only| names(quick, Some(only)).unwrap_err().to_string();
        let expected = "--only is \"cloth\"; part of one of fox_run is allowed with --quick";
        assert_eq!(refused(true, "cloth"), expected);
        assert!(refused(false, "horse").contains("figure_3min"), "{}", refused(false, "horse"));
    }

    #[test]
    fn made_scenes_are_no_larger_than_scenes_may_be() {
        // What a Gaussian takes in a frame, and what a scene may: `trainer-host`'s limits.
        let bytes = |gaussians: usize, frames: usize| gaussians * frames * 56;
        assert!(bytes(60_000, 900) > 1 << 31 && synth("figure", 60_000, 900).is_err());
        for Workload { name, source, gaussians, .. } in &WORKLOADS {
            if let Source::Made(_, frames) | Source::MadeSlow(_, frames) = source {
                assert!(bytes(*gaussians, *frames) <= 1 << 31, "{name}");
            }
        }
    }
}
