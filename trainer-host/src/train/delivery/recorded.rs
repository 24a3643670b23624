//! Reads and writes the states that a delivery was displayed in: what `dgs stream --states` writes.
//!
//! A JSON file:
//!
//! ```json
//! {
//!   "stream": "9f3a60561c77ab02",
//!   "states": [{ "frame": 0, "arrived": "0f0301" }, { "frame": 1, "arrived": "0f0303" }]
//! }
//! ```
//!
//! `stream` is the identity of the stream: 16 hexadecimal digits of FNV-1a, 64 bits, over the records of the
//! manifest that blocks and levels get their meaning from (SPEC.md, section 5): its head with `packets`,
//! `tables` and `repairs` as 0, its epochs, windows and clusters. Parity does not change it. Each state is of
//! one frame that was displayed: two hexadecimal digits per block, bit `l` for level `l` (`00` to `0f`),
//! blocks in the order of the manifest's cells.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use codec_core::internals::{
    digest::Digest,
    error,
    ids::{ClusterId, EpochId, WindowId},
    wire::manifest::{Head, Manifest},
};
use serde::{Deserialize, Serialize};

use super::error::DeliveryError;
use crate::stream::{PacketMap, Stream};

/// The states of the frames that a delivery displayed, of one stream.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recording {
    stream: String,
    states: Vec<Displayed>,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Displayed {
    frame: u32,
    #[serde(with = "digits")]
    arrived: Vec<u8>,
}

impl Recording {
    /// What was displayed of `stream`: frames, each with its state, a byte per block.
    ///
    /// # Errors
    /// If the stream's manifest does not hold.
    pub fn of(stream: &Stream, displayed: impl Iterator<Item = (u32, Vec<u8>)>) -> error::Result<Self> {
        let stream = identity(&stream.manifest()?);
        let states = displayed.map(|(frame, arrived)| Displayed { frame, arrived }).collect();
        Ok(Self { stream, states })
    }

    /// Number of states.
    pub fn count(&self) -> usize {
        self.states.len()
    }

    /// The bytes of a file.
    pub fn to_json(&self) -> String {
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read or holds something else, by field, line and column.
    pub fn read(path: &Path) -> Result<Self, DeliveryError> {
        let content = |message: String| DeliveryError::Content { path: path.to_owned(), message };
        let text =
            std::fs::read(path).map_err(|error| DeliveryError::File { path: path.to_owned(), error })?;
        let read: Self = serde_json::from_slice(&text).map_err(|error| content(error.to_string()))?;
        if read.states.is_empty() {
            return Err(content("states is empty; at least 1 is needed".to_owned()));
        }
        Ok(read)
    }
}

/// Recorded states by the frames that they may be displayed at.
#[derive(Clone, Debug, Default)]
pub(super) struct RecordedStates {
    /// Frames of a motion window, or of an epoch without windows, and the states that were displayed there.
    spans: Vec<(Range<u32>, Vec<Vec<u8>>)>,
}

impl RecordedStates {
    /// Those of the file at `path`, which must be of `stream`.
    ///
    /// # Errors
    /// As [`Recording::read`]; states of another stream.
    pub(super) fn read(path: &Path, stream: &Stream) -> Result<Self, DeliveryError> {
        let Recording { stream: found, states } = Recording::read(path)?;
        let content = |message: String| DeliveryError::Content { path: PathBuf::from(path), message };
        let manifest = stream.manifest()?;
        let own = identity(&manifest);
        if found != own {
            return Err(content(format!(
                "stream is {found:?}; this scene with these options of the encoder is stream {own:?}: states \
                 of that one are needed, from dgs encode SCENE -o ck.dgs with the same options (of what was \
                 trained, SCENE is its checkpoint.dgst) and dgs stream ck.dgs --states FILE"
            )));
        }
        let (blocks, frames) = (PacketMap::of(stream)?.initial().len(), manifest.head().frames);
        let mut out = Self::default();
        for (index, Displayed { frame, arrived }) in states.into_iter().enumerate() {
            if arrived.len() != blocks {
                let found = arrived.len();
                return Err(content(format!(
                    "states[{index}].arrived has {found} blocks; the stream has {blocks}"
                )));
            }
            let span = span(&manifest, frame).filter(|_| frame < frames).ok_or_else(|| {
                content(format!("states[{index}].frame is {frame}; the stream has {frames} frames"))
            })?;
            match out.spans.iter_mut().find(|(of, _)| *of == span) {
                Some((_, states)) => states.push(arrived),
                None => out.spans.push((span, vec![arrived])),
            }
        }
        Ok(out)
    }

    /// States that were displayed in the motion window of `frame`; none if nothing was.
    pub(super) fn at(&self, frame: u32) -> &[Vec<u8>] {
        self.spans.iter().find(|(span, _)| span.contains(&frame)).map_or(&[], |(_, states)| states)
    }
}

/// The frames that show the same blocks as `frame`: of its window, or of its epoch.
fn span(manifest: &Manifest<'_>, frame: u32) -> Option<Range<u32>> {
    let window = manifest.window_at(frame).and_then(|id| manifest.window(id));
    if let Some(window) = window {
        return Some(window.first_frame..window.first_frame + u32::from(window.frames));
    }
    let epoch = manifest.epoch_at(frame).and_then(|id| manifest.epoch(id))?;
    Some(epoch.first_frame..epoch.first_frame + epoch.frames)
}

/// What tells the blocks of one stream from those of another, as the file has it.
fn identity(manifest: &Manifest<'_>) -> String {
    // Parity and entropy tables change nothing that a block means.
    let head = Head { packets: 0, tables: 0, repairs: 0, ..*manifest.head() };
    let mut digest = Digest::new().bytes(&head.to_bytes());
    for (index, epoch) in manifest.epochs().enumerate() {
        digest = digest.bytes(&epoch.to_bytes());
        let clusters = (0..epoch.clusters).map(|cluster| ClusterId(cluster as u16));
        let records = clusters.filter_map(|id| manifest.cluster(EpochId(index as u16), id));
        digest = records.fold(digest, |digest, cluster| digest.bytes(&cluster.to_bytes()));
    }
    let windows = (0..manifest.windows().len()).filter_map(|id| manifest.window(WindowId(id as u16)));
    digest = windows.fold(digest, |digest, window| digest.bytes(&window.to_bytes()));
    super::record::hex(digest.get())
}

/// A state as hexadecimal digits.
mod digits {
    use std::fmt::Write as _;

    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    pub(super) fn serialize<S: Serializer>(state: &[u8], to: S) -> Result<S::Ok, S::Error> {
        let mut digits = String::with_capacity(2 * state.len());
        state.iter().for_each(|mask| {
            let _ = write!(digits, "{mask:02x}");
        });
        to.serialize_str(&digits)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<u8>, D::Error> {
        let digits = String::deserialize(from)?;
        let (pairs, rest) = digits.as_bytes().as_chunks::<2>();
        let byte = |(index, pair): (usize, &[u8; 2])| {
            let byte = std::str::from_utf8(pair).ok().and_then(|pair| u8::from_str_radix(pair, 16).ok());
            byte.filter(|byte| *byte <= 0xf).ok_or_else(|| {
                let found = String::from_utf8_lossy(pair);
                D::Error::custom(format!("arrived has {found:?} for block {index}; 00 to 0f is allowed"))
            })
        };
        if !rest.is_empty() {
            let found = digits.len();
            return Err(D::Error::custom(format!("arrived has {found} digits; two per block are needed")));
        }
        pairs.iter().enumerate().map(byte).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::{self, EncodeOptions, Protection},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
    };

    fn stream(gaussians: usize, options: &EncodeOptions) -> Stream {
        let options_of_scene =
            SynthOptions { gaussians, frames: 6, kind: SynthKind::Balls, ..Default::default() };
        let scene = synth::make(&options_of_scene, &Limits::default()).unwrap();
        encode::encode(&scene, options, &encode::no_progress).unwrap().stream
    }

    #[test]
    fn states_come_back_for_the_frames_of_their_window_with_parity_or_without() {
        let options = EncodeOptions { window_frames: Some(3), pictures: 0, ..EncodeOptions::default() };
        let plain = stream(1000, &options);
        let protected = stream(1000, &EncodeOptions { repair: Protection::STANDARD, ..options });
        assert_ne!(plain.packets().len(), protected.packets().len());
        let blocks = PacketMap::of(&plain).unwrap().initial().len();
        let state = |mask: u8| vec![mask; blocks];
        let displayed = [(0, state(1)), (2, state(3)), (4, state(15))];
        let recording = Recording::of(&protected, displayed.into_iter()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.json");
        std::fs::write(&path, recording.to_json()).unwrap();
        assert_eq!(Recording::read(&path).unwrap(), recording);
        let found = RecordedStates::read(&path, &plain).unwrap();
        assert_eq!(found.at(1), [state(1), state(3)]);
        assert_eq!(found.at(5), [state(15)]);

        let late = Recording::of(&plain, [(0, state(1))].into_iter()).unwrap();
        std::fs::write(&path, late.to_json()).unwrap();
        assert!(RecordedStates::read(&path, &plain).unwrap().at(3).is_empty(), "nothing was displayed there");
    }

    #[test]
    fn states_of_another_stream_and_damaged_files_are_refused_by_name() {
        let options = EncodeOptions { pictures: 0, ..EncodeOptions::default() };
        let (own, other) = (stream(1000, &options), stream(1040, &options));
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.json");
        let refused = |text: String| {
            std::fs::write(&path, text).unwrap();
            let error = RecordedStates::read(&path, &own).unwrap_err().to_string();
            assert!(error.contains("states.json"), "{error}");
            error
        };
        let blocks = PacketMap::of(&own).unwrap().initial().len();
        let of = |stream: &Stream, frame, state: Vec<u8>| {
            Recording::of(stream, [(frame, state)].into_iter()).unwrap().to_json()
        };
        let error = refused(of(&other, 0, vec![15; blocks]));
        assert!(error.contains("stream is \"") && error.contains("this scene with these options"), "{error}");
        let error = refused(of(&own, 0, vec![15; blocks + 1]));
        assert!(error.contains(&format!("has {} blocks; the stream has {blocks}", blocks + 1)), "{error}");
        let error = refused(of(&own, 6, vec![15; blocks]));
        assert!(error.contains("states[0].frame is 6; the stream has 6 frames"), "{error}");
        let good = of(&own, 0, vec![15; blocks]);
        let error = refused(good.replacen("0f", "1f", 1));
        assert!(error.contains("\"1f\" for block 0; 00 to 0f is allowed"), "{error}");
        assert!(refused(good.replacen("0f", "f", 1)).contains("two per block"));
        assert!(refused(good.replace("frame", "fame")).contains("fame"));
        assert!(refused(good[..good.len() / 2].to_owned()).contains("EOF"));
        assert!(refused(String::new()).contains("EOF"));
        assert!(refused(r#"{"stream": "", "states": []}"#.to_owned()).contains("at least 1"));
        assert!(Recording::read(&folder.path().join("no")).unwrap_err().to_string().contains("no"));
    }
}
