//! Numbered files as frames: which files of a folder belong together, and how they become epochs.
//!
//! A frame file is a prefix, a trailing integer and a known ending; files that share prefix and ending
//! are one sequence, in order of the integer. Trained sequences rarely say whether row `i` of one
//! frame is row `i` of the next, so by default each frame is its own epoch; a caller who knows better
//! says so with [`Identity::Stored`](super::Identity).

use std::path::{Path, PathBuf};

use super::{
    Identity, Options,
    error::{Format, ImportError},
    snapshot::{Snapshot, scene_error},
};
use crate::scene::{Attributes, Epoch, Scene, Track};

const FORMAT: Format = Format::Sequence;
const ENDINGS: [&str; 6] = [".compressed.ply", ".ply", ".spz", ".splat", ".sog", ".asset"];

/// The frames of a folder: the one sequence in it, in order, with a note on numbers left out.
pub(super) fn files(folder: &Path) -> Result<(Vec<PathBuf>, Vec<String>), ImportError> {
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
pub(super) fn assemble(frames: Vec<(PathBuf, Snapshot)>, options: &Options) -> Result<Scene, ImportError> {
    let mut notes = gathered(&frames);
    let epochs = match options.identity {
        Identity::PerFrame => {
            if frames.len() > 1 {
                notes.push("identity is not stored: each frame is an epoch of its own".to_owned());
            }
            frames.into_iter().map(|(_, f)| f.epoch).collect()
        }
        Identity::Stored => vec![joined(&frames, &mut notes)?],
    };
    let mut scene = Scene::new(epochs, options.frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes = notes;
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
    use crate::import::{Limits, import, ply, splat};

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
        let scene = import(folder.path(), &Options::default()).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (3, 3));
        assert!(scene.notes.iter().any(|n| n.contains("identity")), "{:?}", scene.notes);
        assert!(scene.notes.iter().any(|n| n.contains("6 frame numbers")), "{:?}", scene.notes);

        let stored = Options { identity: Identity::Stored, ..Options::default() };
        let scene = import(folder.path(), &stored).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (1, 3));
        assert!(scene.epochs()[0].attributes().positions.is_constant());

        std::fs::write(folder.path().join("f11.ply"), ply::tests::sample("ascii", 9, 2)).unwrap();
        let error = import(folder.path(), &stored).unwrap_err();
        assert!(error.to_string().contains("f11.ply"), "{error}");
        assert!(error.to_string().contains("found 2"), "{error}");
    }

    #[test]
    fn two_sequences_in_a_folder_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a1.splat", "b1.splat"] {
            std::fs::write(folder.path().join(name), splat::tests::sample(2)).unwrap();
        }
        assert!(splat::parse(&splat::tests::sample(2), &Limits::default()).is_ok());
        let error = import(folder.path(), &Options::default()).unwrap_err();
        assert!(error.to_string().contains("one prefix"), "{error}");
    }
}
