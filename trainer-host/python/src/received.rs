//! Makes scenes of what has arrived of streams, and says what has not.

use std::path::Path;

use codec_core::internals::{closure::Arrived, ids::Level};
use pyo3::prelude::*;
use trainer_host::{
    Instant, Scene,
    stream::{
        Stream,
        decoded::{self, Snapshot},
    },
};

use crate::error::{damaged, of_file, refused};

/// The frames of the stream at `path`, as far as they have arrived, and what a caller is warned of: damage,
/// packets that are missing, and Gaussians of which nothing has arrived. All but damage is in the notes of
/// the scene too.
pub fn received_scene(path: &Path) -> PyResult<(Scene, Vec<String>)> {
    let bytes = std::fs::read(path).map_err(|error| of_file(path, &error))?;
    let (stream, damage) = Stream::from_bytes(&bytes).map_err(damaged)?;
    let mut player = stream.receive().map_err(damaged)?;
    let has_all_bases = player.content().blocks.iter().all(|&mask| Arrived(mask).has(Level::BASE));
    let (mut frames, mut left_out) = (Vec::new(), LeftOut::default());
    for number in 0..player.info().frames {
        let shown = player.frame(number).map_err(damaged)?;
        let instant = Instant {
            gaussians: shown.gaussians.to_vec(),
            sh_rest: shown.sh_rest.to_vec(),
            sh_degree: shown.sh_degree,
        };
        let snapshot = decoded::snapshot(&instant).map_err(refused)?;
        left_out.add(instant.gaussians.len() - snapshot.rows.len(), instant.gaussians.len());
        frames.push(snapshot);
    }
    let manifest = player.manifest();
    let starts = decoded::epoch_starts(manifest);
    let mut scene = decoded::joined(frames, &starts, manifest.frames_per_second()).map_err(refused)?;
    scene.footprint = player.info().footprint;
    scene.up = manifest.up();

    let mut warnings = Vec::new();
    if !damage.is_none() {
        warnings.push(format!("{}: {damage}; the rest is used", path.display()));
    }
    let absent = stream.packets().iter().filter(|packet| packet.is_empty()).count();
    if absent > 0 {
        let said = format!("{absent} of {} packets are not in {}", stream.packets().len(), path.display());
        scene.notes.push(said.clone());
        warnings.push(said);
    }
    if let Some(said) = Snapshot::left_out_in_words(left_out.frames, left_out.most, has_all_bases) {
        scene.notes.push(said.clone());
        // What is transparent has arrived, and nothing is amiss.
        warnings.extend((!has_all_bases).then_some(said));
    }
    Ok((scene, warnings))
}

/// Gaussians of frames that a scene does not have, since nothing of them is drawn.
#[derive(Default)]
struct LeftOut {
    /// Frames that lack some.
    frames: usize,
    /// The frame that lacks most: how many of how many.
    most: (usize, usize),
}

impl LeftOut {
    /// Counts a frame of `of` Gaussians that lacks so many.
    fn add(&mut self, left_out: usize, of: usize) {
        self.frames += usize::from(left_out > 0);
        if left_out > self.most.0 {
            self.most = (left_out, of);
        }
    }
}
