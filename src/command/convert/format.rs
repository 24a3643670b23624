//! Names the formats that scenes are written in, and writes frames in them.

use std::{
    borrow::Borrow,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use codec_core::{Footprint, ShDegree};
use trainer_host::{
    Epoch, Scene,
    export::{self, FileFormat},
    scene::Up,
};

use crate::{
    figures::counted,
    files::{self, FrameFolder, FrameKind},
    progress::Progress,
};

/// What a scene is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::command) enum SceneOutput {
    /// One frame.
    File(FileFormat),
    /// All frames, a PLY each.
    Folder,
    /// All frames in one `.4dgs` file.
    FourDgs,
}

/// Which frames are written, and how they are drawn.
#[derive(Clone, Copy, Debug)]
pub(in crate::command) struct FrameRun {
    /// Replaces a folder that is there, or a buffer of something else where that of a glTF goes.
    pub(in crate::command) overwrite: bool,
    /// The frame that a file gets.
    pub(in crate::command) only: u32,
    /// Frames that a folder gets.
    pub(in crate::command) count: u32,
    pub(in crate::command) footprint: Footprint,
    pub(in crate::command) frames_per_second: f64,
}

/// A frame of a run.
#[derive(Clone, Copy, Debug)]
pub(in crate::command) struct FrameToWrite<E> {
    pub(in crate::command) epoch: E,
    /// The frame in it.
    pub(in crate::command) t: usize,
    /// Whether its row `i` is row `i` of the frame before.
    pub(in crate::command) has_rows_of_last: bool,
}

/// What was written.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(in crate::command) struct WrittenScene {
    /// What and where, a line for people.
    pub(in crate::command) text: String,
    /// What a person should know of it, sentences.
    pub(in crate::command) notes: Vec<String>,
}

impl SceneOutput {
    /// By the ending of a name; a name without one is a folder's.
    pub(in crate::command) fn of(path: &Path) -> Result<Self> {
        Self::named(path, ", .4dgs")
    }

    /// As [`SceneOutput::of`], of what a stream is decoded to.
    pub(in crate::command) fn of_decoded(path: &Path) -> Result<Self> {
        match Self::named(path, "")? {
            Self::FourDgs => bail!("{}: .4dgs is written by dgs convert", path.display()),
            output => Ok(output),
        }
    }

    /// By the ending of a name, of `FileFormat::ENDINGS` and `others`.
    fn named(path: &Path, others: &str) -> Result<Self> {
        // A folder that is there may be called anything.
        let endings = FileFormat::ENDINGS.split(", ").chain([".4dgs", ".dgs"]);
        files::check_no_bare_ending(path, endings)?;
        let Some(ending) = path.extension().filter(|_| !path.is_dir()) else { return Ok(Self::Folder) };
        files::check_no_pattern(path)?;
        if let Some(format) = FileFormat::of(path) {
            return Ok(Self::File(format));
        }
        if ending.eq_ignore_ascii_case("4dgs") {
            return Ok(Self::FourDgs);
        }
        if ending.eq_ignore_ascii_case("dgs") {
            bail!("{}: a stream is written by dgs encode", path.display());
        }
        bail!(
            "{}: .{} is no format that scenes are written in; {}{others}, or a folder without an ending for \
             a PLY sequence are allowed",
            path.display(),
            ending.to_string_lossy(),
            FileFormat::ENDINGS
        )
    }

    /// Refuses an output that could not be written, or that is one of `inputs`: asked before the work.
    pub(in crate::command) fn check(self, path: &Path, overwrite: bool, inputs: &[&Path]) -> Result<()> {
        match self {
            Self::File(_) | Self::FourDgs => files::check(path)?,
            Self::Folder => FrameFolder::check(path, FrameKind::Scene, overwrite)?,
        }
        files::check_apart(path, inputs)?;
        let Some(buffer) = self.buffer_path(path) else { return Ok(()) };
        files::check_beside(path, &buffer, overwrite)?;
        files::check_apart(&buffer, inputs)
    }

    /// Where its second file lies, if it has one.
    pub(in crate::command) fn buffer_path(self, path: &Path) -> Option<PathBuf> {
        let Self::File(format) = self else { return None };
        format.buffer_path(path)
    }

    /// The frame that a single file holds: the one typed, else the first.
    ///
    /// # Errors
    /// A frame typed for what holds all of them.
    pub(in crate::command) fn only(self, typed: Option<u32>) -> Result<u32> {
        match (self, typed) {
            (Self::Folder | Self::FourDgs, Some(frame)) => {
                bail!("--frame is {frame}; every frame is written there: a single file holds one")
            }
            (_, typed) => Ok(typed.unwrap_or(0)),
        }
    }

    /// Which way is up in it.
    pub(in crate::command) fn default_up(self) -> Up {
        match self {
            Self::Folder => FileFormat::Ply,
            Self::File(format) => format,
            Self::FourDgs => return Up::Y,
        }
        .default_up()
    }

    /// What it cannot hold of Gaussians of degree `degree` that are drawn with `footprint`, for people.
    pub(in crate::command) fn losses(self, degree: ShDegree, footprint: Footprint) -> Vec<String> {
        let format = match self {
            Self::File(format) => format,
            // A .4dgs holds what a PLY does.
            Self::Folder | Self::FourDgs => FileFormat::Ply,
        };
        format.losses(degree, footprint)
    }

    /// Writes frames, except as `.4dgs`. `frame` gives one; `progress` hears of each.
    pub(in crate::command) fn write<E: Borrow<Epoch>>(
        self,
        out: &Path,
        run: FrameRun,
        progress: &Progress,
        mut frame: impl FnMut(u32) -> Result<FrameToWrite<E>>,
    ) -> Result<WrittenScene> {
        let FrameRun { overwrite, only, count, footprint, .. } = run;
        let format = match self {
            Self::File(format) => format,
            Self::FourDgs => bail!("{}: .4dgs is written by dgs convert", out.display()),
            Self::Folder => {
                let mut folder = FrameFolder::create(out, FrameKind::Scene, overwrite)?;
                let mut identity_stored = true;
                for number in 0..count {
                    progress.step("writing frame", number as usize, count as usize);
                    let FrameToWrite { epoch, t, has_rows_of_last } = frame(number)?;
                    identity_stored &= has_rows_of_last || number == 0;
                    // Without a Gaussian, too: of a clip a frame may show nothing.
                    let ply = export::ply::encode(epoch.borrow(), t);
                    folder.add(format!("frame_{number:05}.ply"), &ply)?;
                }
                folder.name_clip(run.frames_per_second, identity_stored);
                let written = folder.finish(overwrite)?;
                let text = format!("wrote {} to {}\n", counted(written, "PLY file"), out.display());
                return Ok(WrittenScene { text, notes: Vec::new() });
            }
        };
        let FrameToWrite { epoch, t, .. } = frame(only)?;
        let failed = || out.display().to_string();
        let written = format.encode(epoch.borrow(), t, footprint, out).with_context(failed)?;
        let mut len = written.bytes.len();
        let mut name = out.display().to_string();
        match format.buffer_path(out).zip(written.buffer) {
            Some((path, buffer)) => {
                files::write_pair(out, &written.bytes, (&path, &buffer))?;
                len += buffer.len();
                name += &format!(" and {}", path.display());
            }
            None => files::write(out, &written.bytes)?,
        }
        let gaussians = epoch.borrow().count();
        let one = if count > 1 { format!(", frame {only} of {count}") } else { String::new() };
        let text = format!("wrote {name}: {gaussians} Gaussians, {len} bytes{one}\n");
        Ok(WrittenScene { text, notes: format.notes(epoch.borrow(), t) })
    }
}

/// Writes all frames of `scene` as `.4dgs`.
pub(in crate::command) fn write_clip(scene: &Scene, out: &Path) -> Result<WrittenScene> {
    let bytes = export::fourdgs::encode(scene).with_context(|| {
        format!(
            "{}: not written; a folder, named without an ending, holds the same frames as PLY",
            out.display()
        )
    })?;
    files::write(out, &bytes)?;
    let text = format!(
        "wrote {}: {}, {} bytes, {}\n",
        out.display(),
        counted(scene.max_count(), "Gaussian"),
        bytes.len(),
        counted(scene.frames(), "frame")
    );
    Ok(WrittenScene { text, notes: FileFormat::notes_of_clip(scene) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endings_decide_and_others_are_refused() {
        let of = |name: &str| SceneOutput::of(Path::new(name));
        assert_eq!(of("a.PLY").unwrap(), SceneOutput::File(FileFormat::Ply));
        assert_eq!(of("a.compressed.ply").unwrap(), SceneOutput::File(FileFormat::CompressedPly));
        assert_eq!(of("frames").unwrap(), SceneOutput::Folder);
        let gltf = of("b.c.GLTF").unwrap();
        assert_eq!(gltf.buffer_path(Path::new("b.c.GLTF")), Some(PathBuf::from("b.c.bin")));
        assert_eq!(of("a.glb").unwrap().buffer_path(Path::new("a.glb")), None);
        assert_eq!(of("a.spz").unwrap().default_up(), Up::Y);
        assert_eq!(of("a.sog").unwrap().default_up(), Up::MinusY);
        assert!(of("a.dgs").unwrap_err().to_string().contains("dgs encode"));
        for name in ["seq_%04d.ply", "%d.spz"] {
            assert!(of(name).unwrap_err().to_string().contains("name a folder"), "{name}");
        }
        for name in ["50%.ply", "my%20dog.ply"] {
            assert_eq!(of(name).unwrap(), SceneOutput::File(FileFormat::Ply));
        }
        for name in [".ply", "out/.SPZ", ".compressed.ply", ".4dgs", ".dgs"] {
            let error = of(name).unwrap_err().to_string();
            assert!(error.contains("is an ending without a name"), "{name}: {error}");
        }
        assert_eq!(of(".frames").unwrap(), SceneOutput::Folder);
        let error = of("x.obj").unwrap_err().to_string();
        assert!(error.contains("x.obj") && error.contains(".compressed.ply"), "{error}");
    }
}
