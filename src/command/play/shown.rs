//! Remembers what was shown, and draws it once nothing has to be on time.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Result, bail};
use render_host::metric;
use serde::Serialize;
use trainer_host::{
    Stream,
    evaluator::{self, PSNR_CAP_DB},
};

use crate::{
    args::Play,
    figures::mean,
    pictures::{PictureOutput, PictureRun, PictureWriter},
    pipeline::{self, Frames, Quiet, Watching},
    progress::Progress,
};

/// Pictures that are in memory at once.
const PICTURES_AT_ONCE: usize = 16;

/// Every frame as it was shown, in the order of showing.
#[derive(Debug, Default)]
pub(super) struct Shown {
    /// What had arrived of the stream; frames between which nothing new did share one state.
    states: Vec<Box<[u8]>>,
    /// Frames, each with the place of its state.
    frames: Vec<(u32, usize)>,
}

/// What was shown against the complete frames of a file.
#[derive(Debug, Serialize)]
pub(super) struct Quality {
    pub(super) mean_psnr_db: f64,
    pub(super) worst_tenth_psnr_db: f64,
    /// By the numbers that pictures have.
    psnr_db: BTreeMap<u32, f64>,
}

impl Quality {
    fn of(psnr_db: BTreeMap<u32, f64>) -> Self {
        let all: Vec<f64> = psnr_db.values().copied().collect();
        Self { mean_psnr_db: mean(&all), worst_tenth_psnr_db: evaluator::worst_tenth(&all), psnr_db }
    }
}

impl Shown {
    /// Frame `frame` is shown in `state`.
    pub(super) fn add(&mut self, frame: u32, state: &[u8]) {
        if self.states.last().is_none_or(|newest| **newest != *state) {
            self.states.push(state.into());
        }
        self.frames.push((frame, self.states.len() - 1));
    }

    /// Whether a later round showed frames again, or earlier ones: their numbers do not say in which order.
    pub(super) fn repeats(&self) -> bool {
        !self.frames.is_sorted_by(|before, after| before.0 < after.0)
    }

    /// What each picture is called: the number of its frame, or where that repeats its own.
    fn numbers(&self) -> Vec<u32> {
        if self.repeats() {
            return (0..self.frames.len() as u32).collect();
        }
        self.frames.iter().map(|(frame, _)| *frame).collect()
    }

    /// For each frame, by index, the first that is the same one in the same state.
    fn alike(&self) -> Vec<usize> {
        let mut first = BTreeMap::new();
        self.frames.iter().enumerate().map(|(at, shown)| *first.entry(*shown).or_insert(at)).collect()
    }

    /// Draws every frame of `frames` in the state in which it was shown: writes it, and compares it with the
    /// complete frame.
    ///
    /// # Errors
    /// A frame past the end; what cannot be written.
    pub(super) fn draw(
        &self,
        args: &Play,
        frames: &Frames,
        watching: &Watching,
        (output, reference): (Option<(&Path, PictureOutput)>, Option<&Stream>),
        quiet: Quiet,
    ) -> Result<Option<Quality>> {
        let settings = pipeline::settings(&args.view);
        let Frames::Stream { received, .. } = frames else { bail!("a stream has frames of a stream") };
        let content = received.content();
        let whole = reference.map(Stream::receive).transpose()?;
        let complete = whole.as_ref().map(|whole| whole.content());
        let run = PictureRun {
            pictures: self.frames.len(),
            frames_per_second: frames.frames_per_second(),
            quality: None,
            overwrite: args.overwrite,
        };
        let writer = output.filter(|_| !self.frames.is_empty());
        let mut writer = writer.map(|(out, output)| PictureWriter::begin(out, output, run)).transpose()?;
        if let Some(writer) = &mut writer {
            writer.name_cameras(watching.description());
        }
        let (numbers, alike) = (self.numbers(), self.alike());
        let is_first = |at: usize| alike[at] == at;
        // A clip may repeat for hours: the same frame in the same state is compared once, and drawn again
        // only to be written.
        let is_written = writer.is_some();
        let drawn: Vec<usize> = (0..self.frames.len()).filter(|at| is_written || is_first(*at)).collect();
        let mut psnr_db = vec![0.0; self.frames.len()];
        let progress = Progress::new("play", quiet.0);
        for (at, part) in drawn.chunks(PICTURES_AT_ONCE).enumerate() {
            progress.step("drawing", at * PICTURES_AT_ONCE, drawn.len());
            let shown: Vec<(u32, Option<&[u8]>)> = part
                .iter()
                .map(|at| self.frames[*at])
                .map(|(frame, state)| (frame, Some(&*self.states[state])))
                .collect();
            let images = watching.pictures(&content, &shown, &settings)?;
            if let Some(writer) = &mut writer {
                for (at, image) in part.iter().zip(&images) {
                    writer.add(&format!("{:05}", numbers[*at]), image)?;
                }
            }
            let Some(complete) = &complete else { continue };
            let compared: Vec<_> = part.iter().zip(&images).filter(|(at, _)| is_first(**at)).collect();
            let all: Vec<_> =
                compared.iter().map(|(at, _)| (self.frames[**at].0, Some(complete.blocks))).collect();
            let references = watching.pictures(complete, &all, &settings)?;
            for ((at, image), reference) in compared.into_iter().zip(&references) {
                psnr_db[*at] = metric::psnr(image, reference)?.min(PSNR_CAP_DB);
            }
        }
        progress.stage("finishing", 1.0);
        if let Some(writer) = writer {
            writer.finish()?;
        }
        let psnr_db = numbers.into_iter().zip(alike.iter().map(|first| psnr_db[*first])).collect();
        Ok(complete.map(|_| Quality::of(psnr_db)))
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser as _;
    use codec_core::internals::ids::Level;
    use trainer_host::encode::Protection;

    use super::*;
    use crate::args::{Cli, Verb};

    fn parsed(typed: &[&str]) -> Verb {
        match Cli::try_parse_from(typed) {
            Ok(Cli { verb, .. }) => verb,
            Err(error) => panic!("{typed:?}: {error}"),
        }
    }

    /// A clip of three frames.
    fn stream() -> Stream {
        let typed = ["dgs", "demo", "--pictures", "2"];
        let Verb::Demo(args) = parsed(&typed) else { panic!("{typed:?}") };
        let scene = pipeline::import("synth:figure:1000:3", &args.source).unwrap().scene;
        let options = pipeline::encode_options(&args.codec, Protection::NONE);
        pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream
    }

    #[test]
    fn what_is_shown_once_is_called_by_its_frames_and_what_repeats_by_its_place() {
        let numbers = |frames: &[u32]| {
            let mut shown = Shown::default();
            frames.iter().for_each(|frame| shown.add(*frame, &[1]));
            shown.numbers()
        };
        assert!(numbers(&[]).is_empty());
        assert_eq!(numbers(&[4, 5, 9]), [4, 5, 9]);
        assert_eq!(numbers(&[4, 5, 4, 5]), [0, 1, 2, 3]);
        // Begun in the middle of the clip, and stopped before that came again.
        assert_eq!(numbers(&[4, 5, 0]), [0, 1, 2]);
    }

    #[test]
    fn states_in_which_nothing_is_new_are_remembered_once() {
        let mut shown = Shown::default();
        for (frame, state) in [(0, [0, 1]), (1, [1, 1]), (2, [1, 1]), (0, [1, 1]), (1, [1, 1]), (2, [1, 1])] {
            shown.add(frame, &state);
        }
        assert_eq!((shown.states.len(), shown.frames.len()), (2, 6));
        assert_eq!(shown.alike(), [0, 1, 2, 3, 1, 2]);
    }

    #[test]
    fn every_round_is_written_and_compared_as_it_was_shown() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("seen");
        let stream = stream();
        let player = stream.receive().unwrap();
        let all = player.content().blocks.to_vec();
        let nothing = vec![0; all.len()];
        let mut shown = Shown::default();
        for state in [&nothing, &all, &all] {
            (0..3).for_each(|frame| shown.add(frame, state));
        }
        let typed = ["dgs", "play", "dgs://host", "--width", "32", "--height", "32"];
        let Verb::Play(args) = parsed(&typed) else { panic!("{typed:?}") };
        let mut frames = Frames::of_stream(player, Level::HIGHEST, None);
        let watching = Watching::of(&args.cameras, &args.view, &mut frames).unwrap();
        let draw = |output: Option<(&Path, PictureOutput)>| {
            let with = (output, Some(&stream));
            shown.draw(&args, &frames, &watching, with, Quiet(true)).unwrap().unwrap()
        };
        let quality = draw(Some((out.as_path(), PictureOutput::Folder)));
        assert_eq!(quality.psnr_db.keys().copied().collect::<Vec<_>>(), (0..9).collect::<Vec<_>>());
        let psnr_db: Vec<f64> = quality.psnr_db.values().copied().collect();
        assert!(psnr_db[..3].iter().all(|found| *found < 60.0), "{psnr_db:?}");
        assert!(psnr_db[3..].iter().all(|found| *found >= PSNR_CAP_DB), "{psnr_db:?}");
        assert!(quality.mean_psnr_db < PSNR_CAP_DB - 10.0 && quality.worst_tenth_psnr_db < 60.0);
        // Compared and not written: what repeats is not drawn again.
        assert_eq!(draw(None).psnr_db, quality.psnr_db);
        let picture = |number: u32| std::fs::read(out.join(format!("{number:05}.png"))).unwrap();
        assert!((0..3).all(|frame| picture(frame) != picture(3 + frame)));
        assert!((0..3).all(|frame| picture(3 + frame) == picture(6 + frame)));
        assert!(!out.join("00009.png").exists());
    }
}
