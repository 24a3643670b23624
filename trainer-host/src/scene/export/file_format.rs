//! Names the formats that one frame is written in, by the endings of files.

use std::{
    io,
    path::{Path, PathBuf},
};

use codec_core::{Footprint, ShDegree};

use super::{clamped, compressed_ply, fourdgs, gltf, nothing_to_write, ply, sog, splat, spz};
use crate::scene::{
    Epoch, Scene, Up,
    import::{
        Format, default_up,
        spz::{COLOUR_SCALE, LEAST_LOG_SCALE, LOG_SCALE_STEP},
    },
};

/// What one frame is written as.
///
/// ```
/// use trainer_host::export::FileFormat;
///
/// assert_eq!(FileFormat::of("a.compressed.ply".as_ref()), Some(FileFormat::CompressedPly));
/// assert_eq!(FileFormat::of("a.obj".as_ref()), None);
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileFormat {
    /// 3DGS PLY.
    Ply,
    /// PlayCanvas compressed PLY.
    CompressedPly,
    /// Niantic SPZ.
    Spz,
    /// Records of 32 bytes.
    Splat,
    /// SOG version 2, zipped.
    Sog,
    /// glTF with `KHR_gaussian_splatting`, binary.
    Glb,
    /// The same as JSON, with its buffer in a file beside it.
    Gltf,
}

/// One frame as files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FrameFiles {
    /// The file that is named.
    pub bytes: Vec<u8>,
    /// The file at [`FileFormat::buffer_path`], where the format has one.
    pub buffer: Option<Vec<u8>>,
}

impl FileFormat {
    /// The endings of names, for people.
    pub const ENDINGS: &str = ".ply, .compressed.ply, .spz, .splat, .sog, .glb, .gltf";

    /// The format whose ending `path` has.
    pub fn of(path: &Path) -> Option<Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_lowercase();
        Some(match Path::new(&name).extension()?.to_str()? {
            "ply" if name.ends_with(".compressed.ply") => Self::CompressedPly,
            "ply" => Self::Ply,
            "spz" => Self::Spz,
            "splat" => Self::Splat,
            "sog" => Self::Sog,
            "glb" => Self::Glb,
            "gltf" => Self::Gltf,
            _ => return None,
        })
    }

    /// Which way is up in it.
    pub fn default_up(self) -> Up {
        default_up(match self {
            Self::Ply => Format::Ply,
            Self::CompressedPly => Format::CompressedPly,
            Self::Spz => Format::Spz,
            Self::Splat => Format::Splat,
            Self::Sog => Format::Sog,
            Self::Glb | Self::Gltf => Format::GltfSplats,
        })
        .unwrap_or_default()
    }

    /// Where the second file of the frame at `path` lies: the buffer of glTF as JSON.
    pub fn buffer_path(self, path: &Path) -> Option<PathBuf> {
        (self == Self::Gltf).then(|| path.with_extension("bin"))
    }

    /// Frame `t` of `epoch`, which must be below its frame count, as the files at `path` of Gaussians that
    /// are drawn with `footprint`, as far as the format can say.
    ///
    /// # Errors
    /// No Gaussian; more of them, or values further apart, than the format holds; a name of a buffer that is
    /// no Unicode.
    pub fn encode(
        self,
        epoch: &Epoch,
        t: usize,
        footprint: Footprint,
        path: &Path,
    ) -> io::Result<FrameFiles> {
        if epoch.count() == 0 {
            return Err(nothing_to_write());
        }
        let antialiased = footprint.compensates_opacity();
        let bytes = match self {
            Self::Ply => ply::encode(epoch, t),
            Self::CompressedPly => compressed_ply::encode(epoch, t),
            Self::Spz => {
                let (version, fraction_bits) = (spz::Version::default(), spz::fine_fraction_bits(epoch, t));
                spz::encode(epoch, t, &spz::SpzOptions { version, fraction_bits, antialiased })?
            }
            Self::Splat => splat::encode(epoch, t),
            Self::Sog => sog::encode(epoch, t, antialiased)?,
            Self::Glb => gltf::encode(epoch, t)?,
            Self::Gltf => {
                let buffer = self.buffer_path(path).unwrap_or_default();
                let name = buffer.file_name().and_then(|name| name.to_str()).ok_or_else(|| {
                    let why = "the file names its buffer in JSON: a name in Unicode is needed";
                    io::Error::new(io::ErrorKind::InvalidInput, why)
                })?;
                let (bytes, buffer) = gltf::encode_apart(epoch, t, name);
                return Ok(FrameFiles { bytes, buffer: Some(buffer) });
            }
        };
        Ok(FrameFiles { bytes, buffer: None })
    }

    /// What it holds of frame `t` of `epoch`, which must be below its frame count, otherwise than it is,
    /// beyond rounding: sentences for people.
    pub fn notes(self, epoch: &Epoch, t: usize) -> Vec<String> {
        let (colour_range, harmonic_range) = match self {
            Self::Spz => ("-0.44 to 1.44", "-1 to 0.992"),
            _ => ("0 to 1", "-4 to 4"),
        };
        let harmonics = match self {
            Self::Spz => spz::beyond_in_harmonics(epoch),
            Self::CompressedPly => compressed_ply::beyond_in_harmonics(epoch),
            Self::Ply | Self::Splat | Self::Sog | Self::Glb | Self::Gltf => 0,
        };
        let said = [
            clamped("colours", self.clamped_colours(epoch, t), colour_range),
            clamped("scales", self.clamped_scales(epoch, t), "0.000045 to 379 scene units"),
            clamped("harmonics", harmonics, harmonic_range),
            if self == Self::Spz { spz::coarse_positions(epoch, t) } else { None },
        ];
        said.into_iter().flatten().collect()
    }

    /// As [`FileFormat::notes`], of all of `scene` in a `.4dgs` file, which holds every frame.
    pub fn notes_of_clip(scene: &Scene) -> Vec<String> {
        fourdgs::notes(scene)
    }

    /// Gaussians of frame `t` of `epoch` whose colours of band 0 are beyond what it holds, and are clamped.
    fn clamped_colours(self, epoch: &Epoch, t: usize) -> usize {
        let unit: fn(f32) -> f32 = match self {
            Self::Splat => super::display_colour,
            Self::Spz => |sh0| sh0 * COLOUR_SCALE + 0.5,
            Self::Ply | Self::CompressedPly | Self::Sog | Self::Glb | Self::Gltf => return 0,
        };
        // Half a step beyond is still the nearest byte.
        let is_within = |sh0: &f32| (-0.5..=255.5).contains(&(255.0 * unit(*sh0)));
        let colours = epoch.attributes().sh0.frame(t, epoch.count());
        colours.iter().filter(|colour| !colour.iter().all(is_within)).count()
    }

    /// Gaussians of frame `t` of `epoch` that have a scale beyond what it holds, which is clamped.
    fn clamped_scales(self, epoch: &Epoch, t: usize) -> usize {
        if self != Self::Spz {
            return 0;
        }
        // Half a step beyond is still the nearest.
        let (low, high) = (LEAST_LOG_SCALE - 0.5 * LOG_SCALE_STEP, LEAST_LOG_SCALE + 255.5 * LOG_SCALE_STEP);
        let scales = epoch.attributes().log_scales.frame(t, epoch.count());
        scales.iter().filter(|scale| !scale.iter().all(|s| (low..=high).contains(s))).count()
    }

    /// What it cannot hold of Gaussians of degree `degree` that are drawn with `footprint`, for people.
    pub fn losses(self, degree: ShDegree, footprint: Footprint) -> Vec<String> {
        let mut losses = Vec::new();
        if self == Self::Splat && degree.get() > 0 {
            losses.push("harmonics above band 0 are left out: .splat has none".to_owned());
        }
        let drawn = match (self, footprint) {
            (_, Footprint::Dilated) | (Self::Spz | Self::Sog, Footprint::Compensated) => return losses,
            (Self::Spz | Self::Sog, _) => Footprint::Compensated,
            _ => Footprint::Dilated,
        };
        let (name, drawn) = (footprint.name(), drawn.name());
        losses.push(format!("the format cannot say footprint {name}: viewers will draw as {drawn}"));
        losses
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_that_are_clamped_are_counted() {
        let mut attributes = crate::scene::export::tests::epoch(3, 0).attributes().clone();
        attributes.sh0 = crate::scene::Track::Constant(vec![[0.0; 3], [2.5, 0.0, 0.0], [0.0, -9.0, 0.0]]);
        let epoch = Epoch::new(1, attributes).unwrap();
        let clamped = [FileFormat::Splat, FileFormat::Spz, FileFormat::Ply]
            .map(|format| format.clamped_colours(&epoch, 0));
        assert_eq!(clamped, [2, 1, 0]);
    }

    #[test]
    fn scales_that_are_clamped_are_counted() {
        let mut attributes = crate::scene::export::tests::epoch(4, 0).attributes().clone();
        let scales = vec![[-10.02, 0.0, 5.96], [-10.1, 0.0, 0.0], [0.0, 6.0, 0.0], [-3.0; 3]];
        attributes.log_scales = crate::scene::Track::Constant(scales);
        let epoch = Epoch::new(1, attributes).unwrap();
        let clamped = [FileFormat::Spz, FileFormat::Splat].map(|format| format.clamped_scales(&epoch, 0));
        assert_eq!(clamped, [2, 0]);
    }

    #[test]
    fn harmonics_that_are_clamped_are_counted() {
        let mut attributes = crate::scene::export::tests::epoch(4, 2).attributes().clone();
        attributes.log_scales = crate::scene::Track::Constant(vec![[-3.0; 3]; 4]);
        // Within half a step of what each holds, beyond -1 to 0.992, and beyond -4 to 4.
        (attributes.sh_rest[0], attributes.sh_rest[23]) = (1.02, 1.05);
        (attributes.sh_rest[24], attributes.sh_rest[48]) = (1.06, 4.5);
        (attributes.sh_rest[72], attributes.sh_rest[73]) = (-1.02, 0.0);
        let epoch = Epoch::new(1, attributes).unwrap();
        let said = "were clamped to what the format holds";
        assert_eq!(
            FileFormat::Spz.notes(&epoch, 0),
            [format!("harmonics of 2 Gaussians {said}, -1 to 0.992")]
        );
        let notes = FileFormat::CompressedPly.notes(&epoch, 0);
        assert_eq!(notes, [format!("harmonics of 1 Gaussian {said}, -4 to 4")]);
        for format in [FileFormat::Ply, FileFormat::Splat, FileFormat::Sog, FileFormat::Glb] {
            assert!(format.notes(&epoch, 0).is_empty(), "{format:?}");
        }
    }

    #[test]
    fn a_frame_without_gaussians_is_refused() {
        let epoch = crate::scene::export::tests::epoch(0, 0);
        for ending in FileFormat::ENDINGS.split(", ") {
            let path = PathBuf::from(format!("a{ending}"));
            let format = FileFormat::of(&path).unwrap();
            let error = format.encode(&epoch, 0, Footprint::default(), &path).unwrap_err().to_string();
            assert!(error.contains("no Gaussian is left"), "{ending}: {error}");
        }
        let scene = crate::Scene::new(vec![epoch], 30.0).unwrap();
        assert!(super::super::fourdgs::encode(&scene).unwrap_err().to_string().contains("no Gaussian"));
    }

    #[test]
    fn endings_decide() {
        let of = |name: &str| FileFormat::of(Path::new(name));
        assert_eq!(of("a.PLY"), Some(FileFormat::Ply));
        assert_eq!(of("b/a.x.sog"), Some(FileFormat::Sog));
        assert_eq!((of("frames"), of("a.dgs"), of(".ply")), (None, None, None));
        assert_eq!(FileFormat::Spz.default_up(), Up::Y);
        assert_eq!(FileFormat::Sog.default_up(), Up::MinusY);
    }
}
