//! Gives the frames of a scene or a stream, one at a time: memory is that of one frame.

use anyhow::{Context, Result, bail};
use codec_core::{
    Footprint,
    internals::{closure::Arrived, ids::Level},
};
use render_host::Camera;
use trainer_host::{
    Instant, Scene,
    scene::Up,
    stream::{Player, decoded::Snapshot},
    viewpoint::Framing,
};

use super::{import, is_stream, read_stream};
use crate::args::SceneArgs;

/// Frames to look at: of a scene, or decoded one by one from a stream.
pub enum Frames {
    /// Of a scene.
    Scene(Box<Scene>),
    /// Of what has arrived of a stream.
    Stream {
        /// What has arrived.
        received: Box<dgs_player::Player>,
        /// Levels to use, per block.
        state: Vec<u8>,
        /// What decodes it.
        player: Box<Player>,
        /// Which way is up.
        up: Up,
        /// What a person should know.
        notes: Vec<String>,
    },
}

/// Gaussians of a stream's frames that are not written, since nothing of them is drawn.
#[derive(Default)]
pub(crate) struct LeftOut {
    /// Frames that lack some.
    frames: usize,
    /// The frame that lacks most: how many of how many.
    most: (usize, usize),
}

impl LeftOut {
    /// Counts a frame of `of` Gaussians that lacks so many.
    pub(crate) fn add(&mut self, left_out: usize, of: usize) {
        self.frames += usize::from(left_out > 0);
        if left_out > self.most.0 {
            self.most = (left_out, of);
        }
    }

    /// What was left out of `frames` and why, for people.
    pub(crate) fn sentence(&self, frames: &Frames) -> Option<String> {
        Snapshot::left_out_in_words(self.frames, self.most, frames.has_all_bases())
    }
}

/// A note on `input` that says so.
pub(crate) fn note_of(input: &str, note: &str) -> String {
    if note.starts_with(input) { note.to_owned() } else { format!("{input}: {note}") }
}

impl Frames {
    /// The frames of `input`: of a `.dgs` stream, what has arrived up to `level`; else of a scene. Damage is
    /// passed to `warn`.
    ///
    /// # Errors
    /// An input that cannot be read.
    pub fn open(input: &str, args: &SceneArgs, level: Level, warn: &mut dyn FnMut(String)) -> Result<Self> {
        if !is_stream(input) {
            let loaded = import(input, args)?;
            loaded.damage.into_iter().for_each(&mut *warn);
            return Ok(Frames::Scene(Box::new(loaded.scene)));
        }
        let stream = read_stream(input.as_ref(), warn)?;
        let absent = stream.packets().iter().filter(|packet| packet.is_empty()).count();
        let mut frames = Self::of_stream(stream.receive()?, level, args.up.map(Into::into));
        let said = frames.footprint();
        let Frames::Stream { notes, .. } = &mut frames else { return Ok(frames) };
        if absent > 0 {
            notes.push(format!("{absent} of {} packets are not in {input}", stream.packets().len()));
        }
        let typed = args.footprint.map(Footprint::from);
        if typed.is_some_and(|typed| typed != said) {
            notes.push(format!("{input} is drawn with its own footprint, {}, not --footprint", said.name()));
        }
        notes.extend(super::unused_options(input, args, None));
        Ok(frames)
    }

    /// The frames of what has arrived of a stream, up to `level`; `up` instead of what the stream says.
    pub fn of_stream(received: dgs_player::Player, level: Level, up: Option<Up>) -> Self {
        let up = up.unwrap_or(received.info().up);
        let content = received.content();
        let below = (1u8 << (level.get() + 1)) - 1;
        let state = content.blocks.iter().map(|mask| Arrived(mask & below).0).collect();
        let player = Box::new(Player::new(content.manifest));
        Frames::Stream { received: Box::new(received), state, player, up, notes: Vec::new() }
    }

    /// Which way is up.
    pub fn up(&self) -> Up {
        match self {
            Frames::Scene(scene) => scene.up,
            Frames::Stream { up, .. } => *up,
        }
    }

    /// How Gaussians are drawn.
    pub fn footprint(&self) -> Footprint {
        match self {
            Frames::Scene(scene) => scene.footprint,
            Frames::Stream { received, .. } => received.info().footprint,
        }
    }

    /// What a person should know.
    pub fn notes(&self) -> &[String] {
        match self {
            Frames::Scene(scene) => &scene.notes,
            Frames::Stream { notes, .. } => notes,
        }
    }

    /// Frames per second.
    pub fn frames_per_second(&self) -> f64 {
        match self {
            Frames::Scene(scene) => scene.frames_per_second(),
            Frames::Stream { received, .. } => received.content().manifest.frames_per_second(),
        }
    }

    /// The cameras that the scene came with.
    pub fn cameras(&self) -> &[Camera] {
        match self {
            Frames::Scene(scene) => &scene.cameras,
            Frames::Stream { .. } => &[],
        }
    }

    /// Number of frames, at least one.
    pub fn count(&self) -> u32 {
        match self {
            Frames::Scene(scene) => scene.frames() as u32,
            Frames::Stream { received, .. } => received.content().manifest.head().frames,
        }
    }

    /// The Gaussians of a frame; those that have not arrived have opacity 0.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn instant(&mut self, frame: u32) -> Result<Instant> {
        let last = self.count().saturating_sub(1);
        if frame > last {
            bail!("--frame is {frame}; 0 to {last} are allowed");
        }
        let failed = || format!("frame {frame}");
        match self {
            Frames::Scene(scene) => scene.instant(frame as usize).with_context(failed),
            Frames::Stream { received, state, player, .. } => {
                let content = received.content().with_state(state);
                player.instant(&content, frame).with_context(failed)
            }
        }
    }

    /// Whether the base of every block of the stream is there, so that what is not drawn is transparent.
    pub(crate) fn has_all_bases(&self) -> bool {
        match self {
            Frames::Scene(_) => true,
            Frames::Stream { state, .. } => state.iter().all(|&mask| Arrived(mask).has(Level::BASE)),
        }
    }

    /// Where cameras around these frames go.
    ///
    /// # Errors
    /// A frame that does not decode.
    pub fn framing(&mut self) -> Result<Framing> {
        let up = match self {
            Frames::Scene(scene) => return Ok(Framing::of(scene)),
            Frames::Stream { up, .. } => *up,
        };
        let mut positions = Vec::new();
        for frame in Framing::sampled(self.count() as usize) {
            let instant = self.instant(frame as u32)?;
            let present = instant.gaussians.iter().filter(|g| !g.is_absent());
            positions.push(present.map(|g| g.position).collect::<Vec<_>>());
        }
        let positions: Vec<&[[f32; 3]]> = positions.iter().map(Vec::as_slice).collect();
        Ok(Framing::of_positions(&positions, up))
    }
}
