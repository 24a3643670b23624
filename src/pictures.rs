//! Writes pictures as the ending of a name says: still, animated, as video, or one by one into a folder.

mod video;

use std::path::Path;

use anyhow::{Context, Result, bail};
use render_host::{
    Image,
    animation::{Animation, AnimationFormat},
};

pub use self::video::VideoCodec;
use self::video::{Container, Video, VideoFormat};
use crate::files::{self, FrameFolder, FrameKind, PendingFile};

/// Quality of JPEG where none is chosen, 1 to 100.
const JPEG_QUALITY: u8 = 92;

/// Endings of files of pictures.
const ENDINGS: [&str; 8] = [".png", ".jpg", ".jpeg", ".webp", ".apng", ".gif", ".mp4", ".webm"];

/// What pictures become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PictureOutput {
    /// One picture.
    Still(StillFormat),
    /// Moving pictures that a browser shows as it shows a still one.
    Animation(AnimationFormat),
    /// A video.
    Video(VideoFormat),
    /// A folder of PNG files.
    Folder,
}

/// A file of one picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StillFormat {
    /// Lossless.
    Png,
    /// Lossy.
    Jpeg,
    /// Lossless.
    Webp,
}

impl StillFormat {
    fn encode_transparent(self, path: &Path, picture: &Image, transmittance: &[f32]) -> Result<Vec<u8>> {
        Ok(match self {
            Self::Png => picture.to_transparent_png(transmittance)?,
            Self::Webp => picture.to_transparent_webp(transmittance)?,
            Self::Jpeg => bail!("{}: JPEG holds no transparency", path.display()),
        })
    }

    fn encode(self, picture: &Image, quality: Option<u8>) -> Result<Vec<u8>> {
        Ok(match self {
            Self::Png => picture.to_png()?,
            Self::Jpeg => picture.to_jpeg(quality.unwrap_or(JPEG_QUALITY))?,
            Self::Webp => picture.to_webp()?,
        })
    }
}

impl PictureOutput {
    /// By the ending of a name; a name without one is a folder's. `codec` is of a video.
    ///
    /// # Errors
    /// Another ending, or a codec that does not go with it.
    pub fn of(path: &Path, codec: Option<VideoCodec>) -> Result<Self> {
        let output = Self::of_name(path, codec)?;
        match codec {
            Some(_) if !matches!(output, Self::Video(_)) => {
                bail!("--video-codec: {} is no video; .mp4 and .webm are", path.display())
            }
            _ => Ok(output),
        }
    }

    fn of_name(path: &Path, codec: Option<VideoCodec>) -> Result<Self> {
        files::check_no_bare_ending(path, ENDINGS)?;
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if ending.is_some() {
            files::check_no_pattern(path)?;
        }
        Ok(match ending.as_deref() {
            None if files::is_standard_output(path) => Self::Still(StillFormat::Png),
            None => Self::Folder,
            // A folder that is there may be called anything.
            Some(_) if path.is_dir() => Self::Folder,
            Some("png") => Self::Still(StillFormat::Png),
            Some("jpg" | "jpeg") => Self::Still(StillFormat::Jpeg),
            Some("webp") => Self::Still(StillFormat::Webp),
            Some("apng") => Self::Animation(AnimationFormat::Apng),
            Some("gif") => Self::Animation(AnimationFormat::Gif),
            Some("mp4") => Self::Video(VideoFormat::of(Container::Mp4, codec)?),
            Some("webm") => Self::Video(VideoFormat::of(Container::WebM, codec)?),
            Some(other) => bail!(
                "{}: .{other} is no format of pictures; .png, .jpg, .webp, .apng, .gif, .mp4, .webm, or a \
                 folder without an ending are allowed",
                path.display()
            ),
        })
    }

    /// Whether it is of one picture.
    pub fn is_still(self) -> bool {
        matches!(self, Self::Still(_))
    }

    /// Refuses what is written to `path` if it cannot hold transparent pictures.
    ///
    /// # Errors
    /// JPEG, GIF and videos.
    pub fn check_transparent(self, path: &Path) -> Result<()> {
        match self {
            Self::Still(StillFormat::Png | StillFormat::Webp) => Ok(()),
            Self::Animation(AnimationFormat::Apng) | Self::Folder => Ok(()),
            _ => bail!(
                "--background transparent: {} cannot be; .png, .webp, .apng and a folder of PNG are allowed",
                path.display()
            ),
        }
    }

    /// What a person should know of pictures of `width` × `height` pixels whose size it cannot hold.
    pub fn rounded_up(self, width: u32, height: u32) -> Option<String> {
        let even = [width, height].map(|side| side.next_multiple_of(2));
        (matches!(self, Self::Video(_)) && even != [width, height]).then(|| {
            let [wide, high] = even;
            format!("videos have even sides: {width} × {height} pixels were rounded up to {wide} × {high}")
        })
    }

    /// What a person should know of `frames_per_second` that it cannot hold.
    pub fn rounded_rate(self, frames_per_second: f64) -> Option<String> {
        let stays = 100.0 / frames_per_second;
        let rounded = (stays - stays.round()).abs() > 1e-6;
        (matches!(self, Self::Animation(AnimationFormat::Gif)) && rounded).then(|| {
            let (least, most) = (stays.floor(), stays.ceil());
            let slow = if least < 2.0 { "; most browsers show what stays less than 2 for 10" } else { "" };
            format!(
                "GIF counts hundredths of a second: at {frames_per_second} frames per second pictures stay \
                 for {least} or {most} of them, and the clip keeps its length{slow}"
            )
        })
    }

    /// Refuses a rate that it cannot say, of pictures that move.
    fn check_rate(self, path: &Path, frames_per_second: f64) -> Result<()> {
        let Self::Animation(format) = self else { return Ok(()) };
        if frames_per_second < format.slowest() {
            let (path, rates) = (path.display(), format.rates());
            bail!("{path}: found {frames_per_second} frames per second; {rates} are allowed in this format");
        }
        Ok(())
    }

    /// Whether it loses something that `PictureRun::quality` says how much of.
    pub fn is_lossy(self) -> bool {
        matches!(self, Self::Still(StillFormat::Jpeg) | Self::Video(_))
    }

    /// Whether its pictures follow one another in time.
    pub fn is_moving(self) -> bool {
        matches!(self, Self::Animation(_) | Self::Video(_))
    }

    /// Refuses an output that could not be written: asked before the work that makes the pictures.
    ///
    /// # Errors
    /// A name that cannot be written, or a video that cannot be made here.
    pub fn check(self, path: &Path, overwrite: bool) -> Result<()> {
        match self {
            Self::Folder => FrameFolder::check(path, FrameKind::Pictures, overwrite),
            Self::Still(_) if files::is_standard_output(path) => Ok(()),
            Self::Still(_) => files::check(path),
            Self::Animation(_) => PendingFile::begin(path).map(drop),
            Self::Video(format) => {
                PendingFile::begin(path)?;
                format.check()
            }
        }
    }
}

/// What the pictures of one run have in common.
#[derive(Clone, Copy, Debug)]
pub struct PictureRun {
    /// How many there are.
    pub pictures: usize,
    /// Frames per second, where they move.
    pub frames_per_second: f64,
    /// 1 to 100, of what is lossy; by default that of the format.
    pub quality: Option<u8>,
    /// Whether a folder may replace one of frames alone.
    pub overwrite: bool,
}

/// Pictures on their way to a file or folder, which appears whole at the end or not at all.
pub struct PictureWriter<'a> {
    path: &'a Path,
    run: PictureRun,
    sink: Sink,
}

enum Sink {
    Still(StillFormat),
    Folder(FrameFolder),
    /// Begins with the first picture, whose size counts.
    Unbegun(PictureOutput),
    Animation(PendingFile, Box<Animation<std::fs::File>>),
    Video(Box<Video>),
}

impl<'a> PictureWriter<'a> {
    /// Begins `path`.
    ///
    /// # Errors
    /// A name that cannot be written, or a rate that the format cannot hold.
    pub fn begin(path: &'a Path, output: PictureOutput, run: PictureRun) -> Result<Self> {
        output.check_rate(path, run.frames_per_second)?;
        let sink = match output {
            PictureOutput::Still(format) => Sink::Still(format),
            PictureOutput::Folder => {
                Sink::Folder(FrameFolder::create(path, FrameKind::Pictures, run.overwrite)?)
            }
            moving => Sink::Unbegun(moving),
        };
        Ok(Self { path, run, sink })
    }

    /// Says in a folder, for people, which cameras its pictures are rendered from.
    pub fn name_cameras(&mut self, description: &str) {
        if let Sink::Folder(folder) = &mut self.sink {
            folder.name_cameras(description.to_owned());
        }
    }

    /// Adds the next picture; in a folder its file is called `name` and an ending.
    ///
    /// # Errors
    /// A picture of another size than those before, where they move, or what the system says.
    pub fn add(&mut self, name: &str, picture: &Image) -> Result<()> {
        if let Sink::Unbegun(output) = self.sink {
            self.sink = self.moving(output, picture.size())?;
        }
        let failed = || format!("{}: picture {name}", self.path.display());
        match &mut self.sink {
            Sink::Still(format) => files::write(self.path, &format.encode(picture, self.run.quality)?),
            Sink::Folder(folder) => folder.add(format!("{name}.png"), &picture.to_png()?),
            Sink::Animation(_, animation) => animation.add(picture).with_context(failed),
            Sink::Video(video) => video.add(picture).with_context(failed),
            Sink::Unbegun(_) => Ok(()),
        }
    }

    /// As [`PictureWriter::add`], of a picture over black with the share of the background that shows at each
    /// pixel: of all pictures, or of none.
    ///
    /// # Errors
    /// As [`PictureWriter::add`]; what [`PictureOutput::check_transparent`] refuses.
    pub fn add_transparent(&mut self, name: &str, picture: &Image, transmittance: &[f32]) -> Result<()> {
        let failed = || format!("{}: picture {name}", self.path.display());
        if let Sink::Unbegun(output) = self.sink {
            output.check_transparent(self.path)?;
            let mut pending = PendingFile::begin(self.path)?;
            let (file, pictures) = (pending.file().try_clone()?, u32::try_from(self.run.pictures)?);
            let rate = self.run.frames_per_second;
            let animation = Animation::begin_transparent(file, picture.size(), pictures, rate)?;
            self.sink = Sink::Animation(pending, Box::new(animation));
        }
        match &mut self.sink {
            Sink::Still(format) => {
                files::write(self.path, &format.encode_transparent(self.path, picture, transmittance)?)
            }
            Sink::Folder(folder) => {
                folder.add(format!("{name}.png"), &picture.to_transparent_png(transmittance)?)
            }
            Sink::Animation(_, animation) => {
                animation.add_transparent(picture, transmittance).with_context(failed)
            }
            Sink::Video(_) | Sink::Unbegun(_) => bail!("{}: holds no transparency", self.path.display()),
        }
    }

    /// Begins moving pictures of `size`.
    fn moving(&self, output: PictureOutput, size: (u32, u32)) -> Result<Sink> {
        let rate = self.run.frames_per_second;
        Ok(match output {
            PictureOutput::Animation(format) => {
                let mut pending = PendingFile::begin(self.path)?;
                let file = pending.file().try_clone()?;
                let pictures = u32::try_from(self.run.pictures)?;
                Sink::Animation(pending, Box::new(Animation::begin(file, format, size, pictures, rate)?))
            }
            PictureOutput::Video(format) => {
                let PictureRun { pictures, quality, .. } = self.run;
                Sink::Video(Box::new(Video::begin(self.path, format, size, rate, pictures, quality)?))
            }
            other => Sink::Unbegun(other),
        })
    }

    /// Gives the file or folder its name.
    ///
    /// # Errors
    /// What the system says, with the path.
    pub fn finish(self) -> Result<()> {
        match self.sink {
            Sink::Still(_) => Ok(()),
            Sink::Folder(folder) => folder.finish(self.run.overwrite).map(drop),
            Sink::Unbegun(_) => bail!("{}: no pictures", self.path.display()),
            Sink::Animation(pending, animation) => {
                animation.finish().with_context(|| self.path.display().to_string())?;
                pending.finish()
            }
            Sink::Video(video) => video.finish().with_context(|| self.path.display().to_string()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endings_decide_and_others_are_refused() {
        let of = |name: &str| PictureOutput::of(Path::new(name), None);
        assert_eq!(of("a.PNG").unwrap(), PictureOutput::Still(StillFormat::Png));
        assert!(of("f_%03d.png").unwrap_err().to_string().contains("f_%03d.png: is one file; for one per"));
        assert_eq!(of("a.jpeg").unwrap(), PictureOutput::Still(StillFormat::Jpeg));
        assert_eq!(of("a.gif").unwrap(), PictureOutput::Animation(AnimationFormat::Gif));
        assert_eq!(of("a.mp4").unwrap(), PictureOutput::Video(VideoFormat::Av1(Container::Mp4)));
        assert_eq!(of("a.webm").unwrap(), PictureOutput::Video(VideoFormat::Av1(Container::WebM)));
        assert_eq!(of("folder/frames").unwrap(), PictureOutput::Folder);
        let error = of("x.bmp").unwrap_err().to_string();
        assert!(error.contains("x.bmp") && error.contains(".webp"), "{error}");
        for name in ENDINGS {
            let error = of(name).unwrap_err().to_string();
            assert!(error.starts_with(&format!("{name}: is an ending without a name")), "{error}");
            assert_ne!(of(&format!("a{name}")).unwrap(), PictureOutput::Folder, "{name}");
        }
        assert_eq!(of(".frames").unwrap(), PictureOutput::Folder);
        let folder = tempfile::tempdir().unwrap();
        let dotted = folder.path().join("frames.v2");
        std::fs::create_dir(&dotted).unwrap();
        assert_eq!(PictureOutput::of(&dotted, None).unwrap(), PictureOutput::Folder);
    }

    #[test]
    fn a_codec_is_of_a_video_that_holds_it() {
        let of = |name: &str, codec| PictureOutput::of(Path::new(name), Some(codec));
        assert_eq!(of("a.mp4", VideoCodec::H264).unwrap(), PictureOutput::Video(VideoFormat::H264));
        let av1 = of("a.mp4", VideoCodec::Av1).unwrap();
        assert_eq!(av1, PictureOutput::Video(VideoFormat::Av1(Container::Mp4)));
        for (name, says) in [("a.webm", ".mp4 does"), ("a.gif", "a.gif is no video"), ("frames", "no video")]
        {
            let error = of(name, VideoCodec::H264).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }

    #[test]
    fn a_rate_that_hundredths_do_not_hold_is_said_of_gif_alone() {
        let gif = PictureOutput::Animation(AnimationFormat::Gif);
        let said = gif.rounded_rate(30.0).unwrap();
        assert!(said.contains("3 or 4") && !said.contains("browsers"), "{said}");
        assert!(
            gif.rounded_rate(60.0).unwrap().contains("1 or 2 of them") && gif.rounded_rate(25.0).is_none()
        );
        assert!(PictureOutput::Animation(AnimationFormat::Apng).rounded_rate(30.0).is_none());
    }

    /// Before any picture is rendered.
    #[test]
    fn a_rate_that_a_gif_cannot_hold_is_refused_as_it_begins() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let begin = |format, frames_per_second| {
            let run = PictureRun { pictures: 2, frames_per_second, quality: None, overwrite: false };
            PictureWriter::begin(&path, PictureOutput::Animation(format), run).map(drop)
        };
        let error = begin(AnimationFormat::Gif, 0.001).unwrap_err().to_string();
        assert!(error.contains("a.gif: found 0.001 frames per second; 0.001526 to 10000 are"), "{error}");
        begin(AnimationFormat::Gif, 0.0016).unwrap();
        begin(AnimationFormat::Apng, 0.001).unwrap();
    }

    #[test]
    fn a_lower_quality_takes_fewer_bytes() {
        let rgb = (0..64 * 64 * 3).map(|i| (i as f32 * 0.7).sin() * 0.5 + 0.5).collect();
        let picture = Image::new(64, 64, rgb).unwrap();
        let bytes = |quality| StillFormat::Jpeg.encode(&picture, quality).unwrap().len();
        assert!(bytes(Some(20)) < bytes(None) && bytes(None) < bytes(Some(100)));
        assert_eq!(bytes(None), bytes(Some(JPEG_QUALITY)));
    }

    #[test]
    fn pictures_of_two_sizes_do_not_move() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.gif");
        let run = PictureRun { pictures: 2, frames_per_second: 10.0, quality: None, overwrite: false };
        let mut writer =
            PictureWriter::begin(&path, PictureOutput::Animation(AnimationFormat::Gif), run).unwrap();
        writer.add("one", &Image::filled(4, 4, [0.5; 3]).unwrap()).unwrap();
        let error = writer.add("two", &Image::filled(5, 4, [0.5; 3]).unwrap()).unwrap_err();
        assert!(format!("{error:#}").contains("two"), "{error:#}");
        drop(writer);
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "nothing is left");
    }
}
