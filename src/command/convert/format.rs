//! Names the formats that scenes are written in, and writes frames in them.

use std::{borrow::Borrow, path::Path};

use anyhow::{Result, bail};
use trainer_host::{
    Epoch, export,
    import::{self, usual_up},
    scene::Up,
};

use crate::{
    files::{self, FrameFolder},
    progress::Progress,
};

/// What a scene is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::command) enum SceneOutput {
    /// One frame.
    File(SceneFormat),
    /// All frames, a PLY each.
    Folder,
}

/// What one frame is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::command) enum SceneFormat {
    Ply,
    CompressedPly,
    Spz,
    Splat,
    Sog,
    Glb,
}

impl SceneOutput {
    /// By the ending of a name; a name without one is a folder's.
    pub(in crate::command) fn of(path: &Path) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        let ending = Path::new(&name).extension().map(|e| e.to_string_lossy().into_owned());
        Ok(Self::File(match ending.as_deref() {
            None => return Ok(Self::Folder),
            // A folder that is there may be called anything.
            Some(_) if path.is_dir() => return Ok(Self::Folder),
            Some("ply") if name.ends_with(".compressed.ply") => SceneFormat::CompressedPly,
            Some("ply") => SceneFormat::Ply,
            Some("spz") => SceneFormat::Spz,
            Some("splat") => SceneFormat::Splat,
            Some("sog") => SceneFormat::Sog,
            Some("glb") => SceneFormat::Glb,
            Some("dgs") => bail!("{}: a stream is written by dgs encode", path.display()),
            Some(other) => bail!(
                "{}: .{other} is no format that scenes are written in; .ply, .compressed.ply, .spz, .splat, \
                 .sog, .glb, or a folder without an ending for a PLY sequence are allowed",
                path.display()
            ),
        }))
    }

    /// Refuses an output that could not be written: asked before the work.
    pub(in crate::command) fn check(self, path: &Path, overwrite: bool) -> Result<()> {
        match self {
            Self::File(_) => files::check(path),
            Self::Folder => FrameFolder::create(path, overwrite).map(drop),
        }
    }

    /// Which way is up in it.
    pub(in crate::command) fn usual_up(self) -> Up {
        let format = match self {
            Self::Folder => SceneFormat::Ply,
            Self::File(format) => format,
        };
        usual_up(match format {
            SceneFormat::Ply => import::Format::Ply,
            SceneFormat::CompressedPly => import::Format::CompressedPly,
            SceneFormat::Spz => import::Format::Spz,
            SceneFormat::Splat => import::Format::Splat,
            SceneFormat::Sog => import::Format::Sog,
            SceneFormat::Glb => import::Format::GltfSplats,
        })
        .unwrap_or_default()
    }

    /// Writes frames: a folder gets all of `count`, a file frame `only`. `frame` gives one as an epoch and
    /// the frame in it; `progress` hears of each.
    pub(in crate::command) fn write<E: Borrow<Epoch>>(
        self,
        out: &Path,
        overwrite: bool,
        only: u32,
        count: u32,
        progress: &Progress,
        mut frame: impl FnMut(u32) -> Result<(E, usize)>,
    ) -> Result<String> {
        let format = match self {
            Self::File(format) => format,
            Self::Folder => {
                let mut folder = FrameFolder::create(out, overwrite)?;
                for number in 0..count {
                    progress.step("writing frame", number as usize, count as usize);
                    let (epoch, t) = frame(number)?;
                    let ply = SceneFormat::Ply.encode(epoch.borrow(), t)?;
                    folder.add(format!("frame_{number:05}.ply"), &ply)?;
                }
                let written = folder.finish(overwrite)?;
                return Ok(format!("wrote {written} PLY files to {}\n", out.display()));
            }
        };
        let (epoch, t) = frame(only)?;
        let bytes = format.encode(epoch.borrow(), t)?;
        files::write(out, &bytes)?;
        let gaussians = epoch.borrow().count();
        let one = if count > 1 { format!(", frame {only} of {count}") } else { String::new() };
        Ok(format!("wrote {}: {gaussians} Gaussians, {} bytes{one}\n", out.display(), bytes.len()))
    }
}

impl SceneFormat {
    fn encode(self, epoch: &Epoch, t: usize) -> Result<Vec<u8>> {
        Ok(match self {
            Self::Ply => export::ply::encode(epoch, t),
            Self::CompressedPly => export::compressed_ply::encode(epoch, t),
            Self::Spz => export::spz::encode(epoch, t, &export::spz::SpzOptions::default())?,
            Self::Splat => export::splat::encode(epoch, t),
            Self::Sog => export::sog::encode(epoch, t)?,
            Self::Glb => export::gltf::encode(epoch, t)?,
        })
    }

    /// What it cannot hold of `epoch`, for people.
    pub(in crate::command) fn loss(self, epoch: &Epoch) -> Option<&'static str> {
        let has_harmonics = epoch.attributes().sh_degree.get() > 0;
        (self == Self::Splat && has_harmonics)
            .then_some("harmonics above band 0 are left out: .splat has none")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endings_decide_and_others_are_refused() {
        let of = |name: &str| SceneOutput::of(Path::new(name));
        assert_eq!(of("a.PLY").unwrap(), SceneOutput::File(SceneFormat::Ply));
        assert_eq!(of("a.compressed.ply").unwrap(), SceneOutput::File(SceneFormat::CompressedPly));
        assert_eq!(of("frames").unwrap(), SceneOutput::Folder);
        assert_eq!(of("a.spz").unwrap().usual_up(), Up::Y);
        assert_eq!(of("a.sog").unwrap().usual_up(), Up::MinusY);
        assert!(of("a.dgs").unwrap_err().to_string().contains("dgs encode"));
        let error = of("x.obj").unwrap_err().to_string();
        assert!(error.contains("x.obj") && error.contains(".compressed.ply"), "{error}");
    }
}
