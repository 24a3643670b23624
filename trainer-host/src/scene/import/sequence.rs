//! Reads numbered files as frames: which files of a folder belong together, and how they become epochs.
//!
//! A folder that this project wrote has an index, `sequence.json`, which names its frames and says that all
//! of them are there. In any other folder a frame file is a prefix, a trailing integer and a known ending;
//! files that share prefix and ending are one sequence, in order of the integer. Trained sequences rarely
//! say whether row `i` of one frame is row `i` of the next, so by default each frame is its own epoch; a
//! caller who knows better says so with [`Identity::Stored`].

use std::path::{Path, PathBuf};

use super::{
    Limits,
    error::{Format, ImportError},
    snapshot::{Snapshot, scene_error},
};
use crate::scene::{Attributes, Epoch, Scene, Track};

const FORMAT: Format = Format::Sequence;
/// Name of the index of a folder of frames.
pub const SEQUENCE_INDEX: &str = "sequence.json";
const ENDINGS: [&str; 6] = [".compressed.ply", ".ply", ".spz", ".splat", ".sog", ".asset"];

/// Whether row `i` of one frame of a numbered sequence is row `i` of the next.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Identity {
    /// Nobody knows: each frame is an epoch of its own.
    #[default]
    PerFrame,
    /// The caller knows that rows correspond: all frames are one epoch.
    Stored,
}

/// What `sequence.json` says of the folder it is in. It is written last: a folder without all of its
/// frames has one that is not complete.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SequenceIndex {
    /// Number of frames.
    pub frames: usize,
    /// Their files in order.
    pub files: Vec<String>,
    /// Whether all of them were written.
    pub complete: bool,
    /// Of pictures, for people: the cameras that they were rendered from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cameras: Option<String>,
    /// Of scenes: the frame rate, above 0.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub frames_per_second: Option<f64>,
    /// Of scenes: whether row `i` of each frame is row `i` of the next ([`Identity::Stored`]).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub identity_stored: bool,
}

/// The frames of a folder.
pub(super) struct Files {
    /// In display order.
    pub(super) files: Vec<PathBuf>,
    /// On numbers left out.
    pub(super) notes: Vec<String>,
    /// What the folder says of itself.
    pub(super) index: Option<SequenceIndex>,
}

impl SequenceIndex {
    /// Reads the index of `folder`.
    fn read(folder: &Path, limits: &Limits) -> Result<Self, ImportError> {
        let path = folder.join(SEQUENCE_INDEX);
        let length = std::fs::metadata(&path).map_err(|e| FORMAT.io(&e, &path))?.len();
        limits.bytes(FORMAT, SEQUENCE_INDEX, length).map_err(|e| e.in_file(&path))?;
        let bytes = std::fs::read(&path).map_err(|e| FORMAT.io(&e, &path))?;
        let index: Self = serde_json::from_slice(&bytes)
            .map_err(|e| FORMAT.malformed("index", e, "frames, files and complete").in_file(&path))?;
        index.check().map_err(|e| e.in_file(&path))?;
        Ok(index)
    }

    fn check(&self) -> Result<(), ImportError> {
        if !self.complete {
            let found = "false: not all frames were written";
            return Err(FORMAT.malformed("complete", found, "true"));
        }
        if self.frames != self.files.len() || self.files.is_empty() {
            let found = format!("{} frames and {} files", self.frames, self.files.len());
            return Err(FORMAT.malformed("frames", found, "a file for each, at least one"));
        }
        let plain = |name: &&String| {
            let mut parts = Path::new(name).components();
            matches!((parts.next(), parts.next()), (Some(std::path::Component::Normal(_)), None))
        };
        if let Some(rate) = self.frames_per_second.filter(|rate| !(rate.is_finite() && *rate > 0.0)) {
            return Err(FORMAT.malformed("frames_per_second", rate, "above 0"));
        }
        match self.files.iter().find(|name| !plain(name)) {
            Some(name) => Err(FORMAT.malformed("files", name, "plain file names")),
            None => Ok(()),
        }
    }
}

/// The frames of a folder: those of its index, or the one sequence in it, in order.
pub(super) fn files(folder: &Path, limits: &Limits) -> Result<Files, ImportError> {
    if folder.join(SEQUENCE_INDEX).exists() {
        let index = SequenceIndex::read(folder, limits)?;
        let files = index.files.iter().map(|name| folder.join(name)).collect();
        return Ok(Files { files, notes: Vec::new(), index: Some(index) });
    }
    let (files, notes) = numbered_files(folder)?;
    Ok(Files { files, notes, index: None })
}

/// The one numbered sequence of a folder, in order, with a note on numbers left out.
fn numbered_files(folder: &Path) -> Result<(Vec<PathBuf>, Vec<String>), ImportError> {
    let mut found: Vec<(String, u64, PathBuf)> = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(|e| FORMAT.io(&e, folder))? {
        let path = entry.map_err(|e| FORMAT.io(&e, folder))?.path();
        if let Some((family, number)) = path.file_name().and_then(|n| n.to_str()).and_then(numbered) {
            found.push((family, number, path));
        }
    }
    // A Unity sequence may come with a decoded sample beside it; its own files decide.
    if found.iter().any(|f| f.0.ends_with(".asset")) {
        found.retain(|f| f.0.ends_with(".asset"));
    }
    found.sort();
    let Some((family, first, _)) = found.first().cloned() else {
        let what = "no meta.json and no numbered .ply, .spz, .splat, .sog or .asset";
        return Err(FORMAT.malformed("folder", what, "a SOG folder or numbered frames").in_file(folder));
    };
    if let Some((other, ..)) = found.iter().find(|f| f.0 != family) {
        let names = format!("{family:?} and {other:?}");
        return Err(FORMAT
            .malformed("file names", names, "one prefix and ending per folder")
            .in_file(folder));
    }
    if let Some(pair) = found.windows(2).find(|p| p[0].1 == p[1].1) {
        let names = format!("{} and {}", pair[0].2.display(), pair[1].2.display());
        return Err(FORMAT.malformed("frame number", names, "each number once").in_file(folder));
    }
    let last = found.last().map_or(first, |f| f.1);
    let gaps = (last - first + 1).saturating_sub(found.len() as u64);
    let notes = if gaps == 0 {
        Vec::new()
    } else {
        vec![format!(
            "{gaps} frame numbers between {first} and {last} have no file; the frames there are joined"
        )]
    };
    Ok((found.into_iter().map(|f| f.2).collect(), notes))
}

/// The scene of frames in display order.
pub(super) fn assemble(
    frames: Vec<(PathBuf, Snapshot)>,
    identity: Identity,
    frames_per_second: f64,
) -> Result<Scene, ImportError> {
    let mut notes = gathered(&frames);
    // What shows nothing says nothing of how it is drawn.
    let mut footprints =
        frames.iter().filter(|(_, f)| f.epoch.count() > 0).map(|(_, f)| f.footprint.unwrap_or_default());
    let footprint = footprints.next().unwrap_or_default();
    if footprints.any(|other| other != footprint) {
        notes.push(format!(
            "frames say different footprints; all are drawn as the first, {}",
            footprint.name()
        ));
    }
    let epochs = match identity {
        Identity::PerFrame => {
            if frames.len() > 1 {
                notes.push("identity is not stored: each frame is an epoch of its own".to_owned());
            }
            frames.into_iter().map(|(_, f)| f.epoch).collect()
        }
        Identity::Stored => vec![joined(&frames, &mut notes)?],
    };
    let mut scene = Scene::new(epochs, frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    (scene.footprint, scene.notes) = (footprint, notes);
    Ok(scene)
}

/// The notes of all frames: each once, with the file it is about or the number of files.
fn gathered(frames: &[(PathBuf, Snapshot)]) -> Vec<String> {
    let mut notes: Vec<(&str, &Path, usize)> = Vec::new();
    for (path, frame) in frames {
        for note in &frame.notes {
            match notes.iter_mut().find(|n| n.0 == note) {
                Some(known) => known.2 += 1,
                None => notes.push((note, path, 1)),
            }
        }
    }
    let shown = |(note, path, count): (&str, &Path, usize)| match count {
        _ if frames.len() == 1 => note.to_owned(),
        1 => format!("{}: {note}", path.file_name().unwrap_or_default().to_string_lossy()),
        _ => format!("{note} (in {count} of {} frames)", frames.len()),
    };
    notes.into_iter().map(shown).collect()
}

/// One epoch of frames whose rows correspond.
fn joined(frames: &[(PathBuf, Snapshot)], notes: &mut Vec<String>) -> Result<Epoch, ImportError> {
    let Some((_, first)) = frames.first() else { return Err(FORMAT.empty("frames")) };
    let (n, head) = (first.epoch.count(), first.epoch.attributes());
    let mut harmonics_change = false;
    for (path, frame) in frames {
        let a = frame.epoch.attributes();
        if frame.epoch.count() != n {
            let allowed = format!("{n}, as in the first frame, for identity to be stored");
            return Err(FORMAT.malformed("Gaussian count", frame.epoch.count(), allowed).in_file(path));
        }
        if a.sh_degree != head.sh_degree {
            let (found, allowed) = (a.sh_degree.get(), head.sh_degree.get());
            return Err(FORMAT.malformed("harmonic degree", found, allowed).in_file(path));
        }
        harmonics_change |= a.sh_rest != head.sh_rest;
    }
    if harmonics_change {
        notes.push("higher harmonics change over the frames; those of the first frame are kept".to_owned());
    }
    fn track<T: Copy + PartialEq>(
        frames: &[(PathBuf, Snapshot)],
        n: usize,
        of: impl Fn(&Attributes) -> &Track<T>,
    ) -> Track<T> {
        Track::PerFrame(
            frames.iter().flat_map(|(_, f)| of(f.epoch.attributes()).frame(0, n)).copied().collect(),
        )
    }
    Epoch::new(
        frames.len(),
        Attributes {
            positions: track(frames, n, |a| &a.positions),
            rotations: continuous(track(frames, n, |a| &a.rotations), n),
            log_scales: track(frames, n, |a| &a.log_scales),
            opacity_logits: track(frames, n, |a| &a.opacity_logits),
            sh0: track(frames, n, |a| &a.sh0),
            sh_rest: head.sh_rest.clone(),
            sh_degree: head.sh_degree,
        },
    )
    .map_err(|e| scene_error(FORMAT, &e))
}

/// The same rotations with signs chosen so that no quaternion jumps to its negative between frames.
fn continuous(track: Track<[f32; 4]>, n: usize) -> Track<[f32; 4]> {
    let Track::PerFrame(mut values) = track else { return track };
    for i in n..values.len() {
        let previous = values[i - n];
        if (0..4).map(|c| previous[c] * values[i][c]).sum::<f32>() < 0.0 {
            values[i] = values[i].map(|v| -v);
        }
    }
    Track::PerFrame(values)
}

/// Prefix and ending (as one key) and the trailing integer of a frame file's name.
fn numbered(name: &str) -> Option<(String, u64)> {
    let lower = name.to_ascii_lowercase();
    let ending = ENDINGS.iter().find(|e| lower.ends_with(**e))?;
    let stem = name.get(..name.len() - ending.len())?;
    let digits = stem.bytes().rev().take_while(u8::is_ascii_digit).count();
    let (prefix, number) = stem.split_at(stem.len() - digits);
    Some((format!("{prefix}*{ending}"), number.parse().ok()?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::{ImportOptions, import, ply, splat};

    #[test]
    fn names_split_into_prefix_and_number() {
        assert_eq!(numbered("time_00012.ply"), Some(("time_*.ply".into(), 12)));
        assert_eq!(numbered("7.compressed.PLY"), Some(("*.compressed.ply".into(), 7)));
        assert_eq!(numbered("000020_first256_decoded.ply"), None);
        assert_eq!(numbered("cover.png"), None);
        assert_eq!(numbered("a99999999999999999999999.ply"), None);
    }

    #[test]
    fn frames_are_epochs_unless_the_caller_knows_better() {
        let folder = tempfile::tempdir().unwrap();
        for (name, n) in [("f2.ply", 3), ("f10.ply", 3), ("f3.ply", 3)] {
            std::fs::write(folder.path().join(name), ply::tests::sample("binary_little_endian", 9, n))
                .unwrap();
        }
        let scene = import(folder.path(), &ImportOptions::default()).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (3, 3));
        assert!(scene.notes.iter().any(|n| n.contains("identity")), "{:?}", scene.notes);
        assert!(scene.notes.iter().any(|n| n.contains("6 frame numbers")), "{:?}", scene.notes);

        let stored = ImportOptions { identity: Identity::Stored, ..ImportOptions::default() };
        let scene = import(folder.path(), &stored).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (1, 3));
        assert!(scene.epochs()[0].attributes().positions.is_constant());

        std::fs::write(folder.path().join("f11.ply"), ply::tests::sample("ascii", 9, 2)).unwrap();
        let error = import(folder.path(), &stored).unwrap_err();
        assert!(error.to_string().contains("f11.ply"), "{error}");
        assert!(error.to_string().contains("found 2"), "{error}");
    }

    #[test]
    fn a_frame_may_show_nothing_but_not_all_may() {
        let folder = tempfile::tempdir().unwrap();
        let read = |counts: [usize; 3], options: &ImportOptions| {
            for (i, n) in counts.into_iter().enumerate() {
                let bytes = ply::tests::sample("binary_little_endian", 0, n);
                std::fs::write(folder.path().join(format!("f{i}.ply")), bytes).unwrap();
            }
            import(folder.path(), options)
        };
        let scene = read([3, 0, 2], &ImportOptions::default()).unwrap();
        assert_eq!(scene.epochs().iter().map(Epoch::count).collect::<Vec<_>>(), [3, 0, 2]);
        assert!(scene.instant(1).unwrap().gaussians.is_empty());
        let stored = ImportOptions { identity: Identity::Stored, ..ImportOptions::default() };
        assert!(read([3, 0, 2], &stored).unwrap_err().to_string().contains("f1.ply"));
        let error = read([0; 3], &ImportOptions::default()).unwrap_err();
        assert!(error.to_string().contains("Gaussians in all frames: found nothing"), "{error}");
        // A file alone is nothing without Gaussians.
        assert!(import(&folder.path().join("f0.ply"), &ImportOptions::default()).is_err());
    }

    #[test]
    fn an_index_decides_which_frames_there_are() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a0.splat", "a1.splat", "other7.splat"] {
            std::fs::write(folder.path().join(name), splat::tests::sample(2)).unwrap();
        }
        let with = |frames: usize, files: &[&str], complete: bool| {
            let files = files.iter().map(|&f| f.to_owned()).collect();
            let index =
                serde_json::to_vec(&SequenceIndex { frames, files, complete, ..SequenceIndex::default() })
                    .unwrap();
            std::fs::write(folder.path().join(SEQUENCE_INDEX), index).unwrap();
            import(folder.path(), &ImportOptions::default())
        };
        let scene = with(2, &["a1.splat", "a0.splat"], true).unwrap();
        assert_eq!((scene.frames(), scene.epochs().len(), scene.frames_per_second()), (2, 2, 30.0));
        // Whoever wrote the folder knew more; whoever reads it may say another rate.
        let files = vec!["a0.splat".to_owned(), "a1.splat".to_owned()];
        let (frames_per_second, identity_stored) = (Some(25.0), true);
        let known = SequenceIndex {
            frames: 2,
            files,
            complete: true,
            frames_per_second,
            identity_stored,
            cameras: None,
        };
        let index = folder.path().join(SEQUENCE_INDEX);
        std::fs::write(&index, serde_json::to_vec(&known).unwrap()).unwrap();
        let read = |rate| {
            let options = ImportOptions { frames_per_second: rate, ..ImportOptions::default() };
            let scene = import(folder.path(), &options).unwrap();
            (scene.frames(), scene.epochs().len(), scene.frames_per_second())
        };
        assert_eq!((read(None), read(Some(50.0))), ((2, 1, 25.0), (2, 1, 50.0)));
        let bad = SequenceIndex { frames_per_second: Some(0.0), ..known };
        std::fs::write(&index, serde_json::to_vec(&bad).unwrap()).unwrap();
        let error = import(folder.path(), &ImportOptions::default()).unwrap_err().to_string();
        assert!(error.contains("frames_per_second"), "{error}");
        for (frames, files, complete, says) in [
            (2, vec!["a0.splat", "a1.splat"], false, "complete: found false"),
            (3, vec!["a0.splat", "a1.splat"], true, "found 3 frames and 2 files"),
            (0, vec![], true, "found 0 frames and 0 files"),
            (2, vec!["a0.splat", "a2.splat"], true, "a2.splat"),
            (1, vec!["../a0.splat"], true, "plain file names"),
        ] {
            let error = with(frames, &files, complete).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn two_sequences_in_a_folder_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a1.splat", "b1.splat"] {
            std::fs::write(folder.path().join(name), splat::tests::sample(2)).unwrap();
        }
        assert!(splat::parse(&splat::tests::sample(2), &Limits::default()).is_ok());
        let error = import(folder.path(), &ImportOptions::default()).unwrap_err();
        assert!(error.to_string().contains("one prefix"), "{error}");
    }
}
