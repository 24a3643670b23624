//! Renders what viewers saw who reported where they are, beside the same viewers unheard.

use anyhow::{Context, Result};
use dgs::{
    args::ProfileName,
    delivery::{ShownState, WireEndpoint},
    pipeline,
};
use emulator_host::{
    PacketGraph, SessionConfig,
    policy::{DeadlineUtility, DeadlineUtilityConfig},
    session::ViewerPath,
};
use rayon::prelude::*;
use render_host::{Backend, Camera, Image, Settings};
use trainer_host::{
    Scene, Stream,
    encode::Protection,
    evaluator,
    stream::PacketMap,
    viewpoint::{FIELD_OF_VIEW, Framing, Ring},
};

use super::{
    channels::Channel,
    paired::{Window, clustered},
    pictures::{Size, size},
    schedulers,
};
use crate::{
    figures::{Bench, Figure},
    setup::{Setup, codec_args, load, spread, synth},
};

/// Families of traces that are used, all measured, and windows of each trace.
const FAMILIES: [&str; 5] = ["ucc5g", "mahimahi", "starlink", "wifi", "hsdpa"];
/// Side of the pictures, pixels.
const SIDE: u32 = 96;
/// Share of datagrams that the links lose.
const LOSS: f64 = 0.01;
/// Degrees per second of the viewer who walks around the scene.
const ORBIT: f64 = 30.0;
/// Distance from the middle of the scene, in radii, of viewers who are close to it.
const CLOSE: f64 = 1.1;

/// Who looks: named as in the rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Viewer {
    /// Close to the scene, at its upper part: the rest is out of the picture.
    Close,
    /// Close to the scene and walking around it.
    Orbit,
    /// Where cameras of the scene stand: all of it is in the picture.
    Whole,
}

impl Viewer {
    const ALL: [Self; 3] = [Self::Close, Self::Orbit, Self::Whole];

    fn name(self) -> &'static str {
        match self {
            Self::Close => "close",
            Self::Orbit => "orbit",
            Self::Whole => "whole",
        }
    }

    /// Its camera at each frame.
    fn cameras(self, scene: &Scene) -> Result<Vec<Camera>> {
        let framing = Framing::of(scene);
        let size = (SIDE, SIDE);
        let near = Framing { radius: framing.radius * CLOSE / 2.6, ..framing };
        Ok(match self {
            Self::Whole => framing.ring(Ring::HeldOut, 1, size)?,
            Self::Close => {
                let eye = near.ring(Ring::HeldOut, 1, size)?.remove(0).centre();
                let above = |k: usize| framing.target[k] + 0.7 * framing.radius * framing.up[k];
                let target = [above(0), above(1), above(2)];
                let fov = FIELD_OF_VIEW.to_radians();
                vec![Camera::look_at(eye, target, framing.up, fov, size.0, size.1)?]
            }
            Self::Orbit => {
                let turn = (360.0 / ORBIT * scene.frames_per_second()).round() as usize;
                near.turntable(turn, size, FIELD_OF_VIEW)?
            }
        })
    }
}

/// How it is measured.
pub(super) fn protocol(setup: &Setup) -> String {
    let Size { windows, gaussians, frames, pictures } = size(setup);
    format!(
        "rows of viewport: encoded streams of {gaussians} Gaussians (figure, cloth, {frames} frames; fox) \
         through the real receiver over {windows} windows of the measured traces of {} families, links \
         as for the bound with 1 % loss; viewers: close at {CLOSE} radii, looking at the upper part; \
         walking around at that distance, {ORBIT} degrees a second; whole, a held-out camera; each says \
         its pose in its receipts, which the sender takes (with) or not (without), all else alike; PSNR \
         of {pictures} frames at {SIDE}x{SIDE} as that viewer saw them against the source's own render",
        FAMILIES.len()
    )
}

/// Adds the rows.
pub(super) fn run(bench: &mut Bench, setup: &Setup, channels: &[Channel]) -> Result<()> {
    let Size { gaussians, frames, .. } = size(setup);
    for kind in ["figure", "cloth"] {
        measure(bench, setup, channels, kind, &synth(kind, gaussians, frames)?)?;
    }
    if let Some(path) = setup.data("scenes/gltf-fox/Fox.glb", bench)? {
        measure(bench, setup, channels, "fox", &load(&path, gaussians)?)?;
    }
    Ok(())
}

/// What one run showed.
#[derive(Clone, Copy, Debug)]
struct Seen {
    psnr_db: f64,
    worst_tenth_db: f64,
}

/// A stream that can be sent.
struct Study<'s> {
    scene: &'s Scene,
    stream: Stream,
    map: PacketMap,
    graph: PacketGraph,
    frames: Vec<u32>,
}

/// A viewer of it: poses, cameras by frame, and what they should see.
struct Watching {
    path: ViewerPath,
    cameras: Vec<Camera>,
    references: Vec<Image>,
}

impl<'s> Study<'s> {
    fn make(scene: &'s Scene, setup: &Setup) -> Result<Self> {
        let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::STANDARD);
        let stream = pipeline::encode(scene, &options, setup.quiet)?.stream;
        let map = PacketMap::of(&stream)?;
        let table = schedulers::utilities(scene, &stream, setup)?;
        let graph = pipeline::graph(&stream, &map, Some(&table))?;
        let frames = spread(scene.frames(), size(setup).pictures);
        Ok(Self { scene, stream, map, graph, frames })
    }

    fn watching(&self, viewer: Viewer) -> Result<Watching> {
        let cameras = viewer.cameras(self.scene)?;
        let poses: Vec<_> = cameras.iter().map(Camera::pose).collect();
        let path = ViewerPath::new(&poses).context("a viewer looks from somewhere")?;
        let mut references = Vec::new();
        for frame in &self.frames {
            let camera = &cameras[*frame as usize % cameras.len()];
            let frames = [*frame];
            let settings = Settings::default();
            references.append(&mut evaluator::references(
                self.scene,
                &frames,
                camera,
                &settings,
                &Backend::Cpu,
            )?);
        }
        Ok(Watching { path, cameras, references })
    }

    /// Delivers over one link to `viewer` and renders what it saw.
    fn see(&self, session: &SessionConfig, viewer: &Watching, config: DeadlineUtilityConfig) -> Result<Seen> {
        let session = SessionConfig { viewer: Some(viewer.path.clone()), ..session.clone() };
        let early_bytes = session.buffer_limit * codec_core::internals::limits::MAX_PACKET_BYTES;
        let mut endpoint = WireEndpoint::new(early_bytes, &self.stream, &self.map, &self.graph)?;
        let mut scheduler = DeadlineUtility::new(&self.graph, config);
        emulator_host::run(&self.graph, &session, &mut scheduler, &mut endpoint)?;
        let psnr = self.pictures(viewer, &endpoint.shown)?;
        Ok(Seen { psnr_db: dgs::figures::mean(&psnr), worst_tenth_db: evaluator::worst_tenth(&psnr) })
    }

    fn pictures(&self, viewer: &Watching, states: &[ShownState]) -> Result<Vec<f64>> {
        let received = self.stream.receive()?;
        let mut psnr = Vec::new();
        for (frame, reference) in self.frames.iter().zip(&viewer.references) {
            let state = states.iter().find(|state| state.frame == *frame);
            let shown = [(*frame, state.map(|state| state.state.as_slice()))];
            let camera = &viewer.cameras[*frame as usize % viewer.cameras.len()];
            let settings = Settings::default();
            let images = evaluator::renders(&received.content(), &shown, camera, &settings, &Backend::Cpu)?;
            for image in &images {
                psnr.push(evaluator::score(image, reference)?.psnr_db);
            }
        }
        Ok(psnr)
    }
}

fn measure(bench: &mut Bench, setup: &Setup, channels: &[Channel], name: &str, scene: &Scene) -> Result<()> {
    let study = Study::make(scene, setup)?;
    let windows = size(setup).windows;
    let used = (0..channels.len()).filter(|trace| FAMILIES.contains(&channels[*trace].family));
    let jobs: Vec<(usize, usize)> = used.flat_map(|trace| (0..windows).map(move |w| (trace, w))).collect();
    let with = DeadlineUtilityConfig::default();
    let configs = [with, DeadlineUtilityConfig { viewport: None, ..with }];
    for viewer in Viewer::ALL {
        let watching = study.watching(viewer)?;
        let results: Result<Vec<Option<Window<Seen>>>> = jobs
            .par_iter()
            .map(|(trace, window)| {
                let seed = 91_000 + 1000 * *trace as u64 + *window as u64;
                let channel = &channels[*trace];
                let Some(session) = channel.session(&study.graph, (*window, windows), seed, LOSS)? else {
                    return Ok(None);
                };
                let runs: Result<Vec<Seen>> =
                    configs.iter().map(|config| study.see(&session, &watching, *config)).collect();
                Ok(Some(Window { family: channel.family, trace: *trace, runs: runs? }))
            })
            .collect();
        let results: Vec<Window<Seen>> = results?.into_iter().flatten().collect();
        push_rows(bench, &format!("viewport.{name}.{}", viewer.name()), &results);
    }
    Ok(())
}

fn push_rows(bench: &mut Bench, key: &str, windows: &[Window<Seen>]) {
    // Without measured traces there is nothing to compare over.
    if windows.is_empty() {
        return;
    }
    let mut push = |what: &str, unit: &str, of: &dyn Fn(&Window<Seen>) -> f64| {
        let mean =
            |all: &[&Window<Seen>]| all.iter().map(|window| of(window)).sum::<f64>() / all.len() as f64;
        let (value, ci) = clustered(windows, &mean);
        let mut figure = Figure::new(format!("{key}.{what}"), value, unit).runs(windows.len());
        figure.ci95 = Some(ci);
        bench.push(figure);
    };
    push("with.psnr", "dB", &|window| window.runs[0].psnr_db);
    push("without.psnr", "dB", &|window| window.runs[1].psnr_db);
    push("gain.psnr", "dB, paired", &|window| window.runs[0].psnr_db - window.runs[1].psnr_db);
    push("with.worst_tenth", "dB", &|window| window.runs[0].worst_tenth_db);
    push("without.worst_tenth", "dB", &|window| window.runs[1].worst_tenth_db);
    let gain = |window: &Window<Seen>| window.runs[0].worst_tenth_db - window.runs[1].worst_tenth_db;
    push("gain.worst_tenth", "dB, paired", &gain);
}
