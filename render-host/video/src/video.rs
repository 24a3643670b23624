//! A video takes pictures one after the other and writes them to a file as they are coded.

use std::io::{Seek, Write};

use render_host::Image;

use crate::{
    encoder::{self, Encoder},
    error::VideoError,
    mp4::Mp4,
    obu::{self, Av1Configuration},
    planes::{self, Planes},
    rate::FrameRate,
    track::{Sample, Track},
    webm::WebM,
};

/// What a video is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Container {
    /// ISO base media, `.mp4`.
    Mp4,
    /// The part of Matroska that browsers play, `.webm`.
    WebM,
}

/// A video on its way into `W`.
pub struct Video<W: Write + Seek> {
    encoder: Encoder,
    rate: FrameRate,
    size: (u32, u32),
    pictures: usize,
    stage: Stage<W>,
}

/// A file begins with the first coded picture, which says what stands in its head.
enum Stage<W: Write + Seek> {
    Unbegun(W, Container),
    Mp4(Box<Mp4<W>>),
    WebM(WebM<W>),
    /// The head could not be written.
    Failed,
}

impl<W: Write + Seek> Video<W> {
    /// Begins a video of `size` (width, height, pixels) into `file`, which is empty. Odd sides are padded by
    /// a row or column. `pictures` is how many are expected: it sizes the space that MP4 reserves before
    /// them for its sample table.
    ///
    /// # Errors
    /// A size or rate out of range.
    pub fn begin(
        file: W,
        container: Container,
        size: (u32, u32),
        frames_per_second: f64,
        pictures: usize,
    ) -> Result<Self, VideoError> {
        encoder::check_size(size)?;
        let rate = FrameRate::of(frames_per_second)?;
        let encoder = Encoder::new(planes::even(size), rate, None)?;
        Ok(Self { encoder, rate, size, pictures, stage: Stage::Unbegun(file, container) })
    }

    /// The same at a quality of 1 to 100: the share of the range of quantisers, of which 76 is usual. Asked
    /// before the first picture.
    ///
    /// # Errors
    /// What the encoder says.
    pub fn with_quality(self, quality: u8) -> Result<Self, VideoError> {
        let encoder = Encoder::new(planes::even(self.size), self.rate, Some(quality))?;
        Ok(Self { encoder, ..self })
    }

    /// Adds the next picture.
    ///
    /// # Errors
    /// Another size, or what the file says.
    pub fn add(&mut self, picture: &Image) -> Result<(), VideoError> {
        if picture.size() != self.size {
            return Err(VideoError::Mismatch { found: picture.size(), first: self.size });
        }
        let coded = self.encoder.add(&Planes::of(picture))?;
        coded.into_iter().try_for_each(|sample| self.stage.add(sample, (self.size, self.rate, self.pictures)))
    }

    /// Ends the video and gives its file back.
    ///
    /// # Errors
    /// No pictures, or what the file says.
    pub fn finish(self) -> Result<W, VideoError> {
        let Self { encoder, rate, size, pictures, mut stage } = self;
        let coded = encoder.finish()?;
        coded.into_iter().try_for_each(|sample| stage.add(sample, (size, rate, pictures)))?;
        match stage {
            Stage::Mp4(file) => file.finish(),
            Stage::WebM(file) => file.finish(),
            Stage::Unbegun(..) | Stage::Failed => Err(VideoError::Empty),
        }
    }
}

/// Size, rate and number of the pictures.
type Pictures = ((u32, u32), FrameRate, usize);

impl<W: Write + Seek> Stage<W> {
    /// Writes what the encoder gave.
    fn add(&mut self, coded: Sample, pictures: Pictures) -> Result<(), VideoError> {
        if matches!(self, Self::Unbegun(..)) {
            self.begin(&coded.bytes, pictures)?;
        }
        let sample = Sample { bytes: obu::sample(&coded.bytes)?, key: coded.key };
        match self {
            Self::Mp4(file) => file.add(&sample),
            Self::WebM(file) => file.add(&sample),
            Self::Unbegun(..) | Self::Failed => Err(VideoError::Empty),
        }
    }

    fn begin(&mut self, first: &[u8], (size, rate, pictures): Pictures) -> Result<(), VideoError> {
        let configuration = Av1Configuration::of(first)?;
        // Both fit: the encoder has taken them.
        let (width, height) = planes::even(size);
        let track = Track { size: (width as u16, height as u16), rate, pictures, configuration };
        *self = match std::mem::replace(self, Self::Failed) {
            Self::Unbegun(file, Container::Mp4) => Self::Mp4(Box::new(Mp4::begin(file, &track)?)),
            Self::Unbegun(file, Container::WebM) => Self::WebM(WebM::begin(file, &track)?),
            begun => begun,
        };
        Ok(())
    }
}
