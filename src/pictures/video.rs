//! Makes a video of pictures: AV1 by crates alone, H.264 through an installed ffmpeg.

mod ffmpeg;

#[cfg(feature = "video")]
use std::fs::File;
use std::path::Path;

use anyhow::{Result, bail};
#[cfg(feature = "video")]
use dgs_video::Video as Av1Video;
use render_host::Image;

use self::ffmpeg::FfmpegVideo;
#[cfg(feature = "video")]
use crate::files::PendingFile;

/// How pictures of a video are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum VideoCodec {
    /// In .mp4 or .webm, without any tool.
    Av1,
    /// In .mp4, by an installed ffmpeg.
    H264,
}

/// What a video is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// ISO base media, `.mp4`.
    Mp4,
    /// The part of Matroska that browsers play, `.webm`.
    WebM,
}

/// A video and its container.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum VideoFormat {
    /// AV1.
    Av1(Container),
    /// H.264 in MP4.
    H264,
}

impl VideoFormat {
    /// The one of `codec` in `container`; AV1 where none is chosen.
    ///
    /// # Errors
    /// H.264 in WebM.
    pub(super) fn of(container: Container, codec: Option<VideoCodec>) -> Result<Self> {
        match (codec.unwrap_or(VideoCodec::Av1), container) {
            (VideoCodec::Av1, container) => Ok(Self::Av1(container)),
            (VideoCodec::H264, Container::Mp4) => Ok(Self::H264),
            (VideoCodec::H264, Container::WebM) => {
                bail!("--video-codec h264: .webm does not hold H.264; .mp4 does")
            }
        }
    }

    /// Refuses a video that cannot be made here.
    ///
    /// # Errors
    /// H.264 without an ffmpeg that can make it; AV1 in a build without feature `video`.
    pub(super) fn check(self) -> Result<()> {
        match self {
            Self::H264 => ffmpeg::find().map(drop),
            Self::Av1(_) if cfg!(feature = "video") => Ok(()),
            Self::Av1(_) => bail!(
                "this build makes no AV1 (feature `video` of dgs is off); --video-codec h264 in an .mp4, \
                 .apng, .gif or a folder are allowed"
            ),
        }
    }
}

/// A video on its way to a file, which has its name at the end or not at all.
pub(super) enum Video {
    #[cfg(feature = "video")]
    Av1 {
        pending: PendingFile,
        video: Box<Av1Video<File>>,
    },
    H264(Box<FfmpegVideo>),
}

impl Video {
    /// Begins a video of about `pictures` of `size` (width, height), at a quality of 1 to 100 or the usual.
    pub(super) fn begin(
        target: &Path,
        format: VideoFormat,
        size: (u32, u32),
        frames_per_second: f64,
        pictures: usize,
        quality: Option<u8>,
    ) -> Result<Self> {
        match format {
            VideoFormat::H264 => {
                Ok(Self::H264(Box::new(FfmpegVideo::begin(target, size, frames_per_second, quality)?)))
            }
            #[cfg(feature = "video")]
            VideoFormat::Av1(container) => {
                let container = match container {
                    Container::Mp4 => dgs_video::Container::Mp4,
                    Container::WebM => dgs_video::Container::WebM,
                };
                let mut pending = PendingFile::begin(target)?;
                let file = pending.file().try_clone()?;
                let mut video = Av1Video::begin(file, container, size, frames_per_second, pictures)?;
                if let Some(quality) = quality {
                    video = video.with_quality(quality)?;
                }
                Ok(Self::Av1 { pending, video: Box::new(video) })
            }
            #[cfg(not(feature = "video"))]
            VideoFormat::Av1(_) => {
                // Only pictures of a known number leave room for their times.
                let _ = (pictures, quality);
                format.check()?;
                bail!("this build makes no AV1")
            }
        }
    }

    /// Adds the next picture.
    pub(super) fn add(&mut self, picture: &Image) -> Result<()> {
        match self {
            #[cfg(feature = "video")]
            Self::Av1 { video, .. } => Ok(video.add(picture)?),
            Self::H264(video) => video.add(picture),
        }
    }

    /// Ends the video and gives it its name.
    pub(super) fn finish(self) -> Result<()> {
        match self {
            #[cfg(feature = "video")]
            Self::Av1 { pending, video } => {
                video.finish()?;
                pending.finish()
            }
            Self::H264(video) => video.finish(),
        }
    }
}
