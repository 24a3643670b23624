//! Animated pictures are written one after another, as APNG (lossless) or GIF (256 colours a picture).
//!
//! Both play for ever. Pictures are of one size, 8 bits per channel as in [`Image`]'s own files.

use std::{fmt, io::Write};

use crate::image::{Image, ImageError};

/// A file of moving pictures that browsers show as they show a still one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnimationFormat {
    /// Animated PNG.
    Apng,
    /// GIF: a palette per picture, and times in hundredths of a second.
    Gif,
}

impl AnimationFormat {
    /// Fewest frames per second: a picture of a GIF stays for 65,535 hundredths of a second at most.
    pub fn slowest(self) -> f64 {
        match self {
            Self::Apng => 0.001,
            Self::Gif => 100.0 / f64::from(u16::MAX),
        }
    }

    /// The frames per second that it holds, for people.
    pub fn rates(self) -> &'static str {
        match self {
            Self::Apng => "0.001 to 10000",
            Self::Gif => "0.001526 to 10000",
        }
    }
}

/// An animation on its way to a file.
///
/// ```
/// use render_host::{Image, animation::{Animation, AnimationFormat}};
///
/// let mut file = Vec::new();
/// let mut animation = Animation::begin(&mut file, AnimationFormat::Apng, (4, 2), 2, 30.0)?;
/// animation.add(&Image::filled(4, 2, [1.0, 0.0, 0.0])?)?;
/// animation.add(&Image::filled(4, 2, [0.0, 0.0, 1.0])?)?;
/// animation.finish()?;
/// assert!(file.windows(4).any(|name| name == b"acTL"));
/// # Ok::<(), render_host::ImageError>(())
/// ```
pub struct Animation<W: Write> {
    encoder: Encoder<W>,
    size: (u32, u32),
    /// Pictures that are still to come.
    left: u32,
}

enum Encoder<W: Write> {
    Apng(Box<png::Writer<W>>),
    Gif { encoder: Box<gif::Encoder<W>>, clock: HundredthClock },
}

/// Rounds times to hundredths of a second so that the clip as a whole keeps its length.
struct HundredthClock {
    frames_per_second: f64,
    pictures: u32,
}

impl HundredthClock {
    /// How long the next picture stays.
    fn next(&mut self) -> u16 {
        let at = |pictures: u32| (100.0 * f64::from(pictures) / self.frames_per_second).round();
        let length = at(self.pictures + 1) - at(self.pictures);
        self.pictures += 1;
        length.clamp(0.0, 65_535.0) as u16
    }
}

impl<W: Write> fmt::Debug for Animation<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let format = match &self.encoder {
            Encoder::Apng(_) => "APNG",
            Encoder::Gif { .. } => "GIF",
        };
        let mut shown = f.debug_struct("Animation");
        shown.field("format", &format).field("size", &self.size).field("left", &self.left);
        shown.finish_non_exhaustive()
    }
}

impl<W: Write> Animation<W> {
    /// Begins an animation of `pictures` of `size` (width, height) at `frames_per_second`, into `file`.
    ///
    /// # Errors
    /// No pictures, a size or rate out of range, or what `file` says.
    pub fn begin(
        file: W,
        format: AnimationFormat,
        size: (u32, u32),
        pictures: u32,
        frames_per_second: f64,
    ) -> Result<Self, ImageError> {
        check(format, pictures, frames_per_second)?;
        let encoder = match format {
            AnimationFormat::Apng => {
                let colour = png::ColorType::Rgb;
                Encoder::Apng(Box::new(apng(file, colour, size, pictures, frames_per_second)?))
            }
            AnimationFormat::Gif => {
                let side = |side: u32| {
                    let (field, found) = ("side of a GIF", side.to_string());
                    u16::try_from(side).map_err(|_| ImageError::Range { field, found, allowed: "1 to 65535" })
                };
                let mut encoder =
                    gif::Encoder::new(file, side(size.0)?, side(size.1)?, &[]).map_err(codec)?;
                encoder.set_repeat(gif::Repeat::Infinite).map_err(codec)?;
                let clock = HundredthClock { frames_per_second, pictures: 0 };
                Encoder::Gif { encoder: Box::new(encoder), clock }
            }
        };
        Ok(Self { encoder, size, left: pictures })
    }

    /// As [`Animation::begin`], an APNG of pictures for [`Animation::add_transparent`].
    ///
    /// # Errors
    /// As [`Animation::begin`].
    pub fn begin_transparent(
        file: W,
        size: (u32, u32),
        pictures: u32,
        frames_per_second: f64,
    ) -> Result<Self, ImageError> {
        check(AnimationFormat::Apng, pictures, frames_per_second)?;
        let writer = apng(file, png::ColorType::Rgba, size, pictures, frames_per_second)?;
        Ok(Self { encoder: Encoder::Apng(Box::new(writer)), size, left: pictures })
    }

    /// Adds the next picture, over black, with alpha: see [`Image::to_rgba8`].
    ///
    /// # Errors
    /// As [`Animation::add`], and an animation that was not begun for such pictures.
    pub fn add_transparent(&mut self, picture: &Image, transmittance: &[f32]) -> Result<(), ImageError> {
        self.count(picture.size())?;
        let rgba = picture.to_rgba8(transmittance)?;
        match &mut self.encoder {
            Encoder::Apng(writer) => writer.write_image_data(&rgba).map_err(codec),
            Encoder::Gif { .. } => Err(codec("a GIF holds no transparency here")),
        }
    }

    /// Counts the next picture, of `size`.
    fn count(&mut self, size: (u32, u32)) -> Result<(), ImageError> {
        if size != self.size {
            return Err(ImageError::Mismatch { a: size, b: self.size });
        }
        self.left = self.left.checked_sub(1).ok_or_else(|| codec("more pictures than were announced"))?;
        Ok(())
    }

    /// Adds the next picture.
    ///
    /// # Errors
    /// Another size, more pictures than were announced, or what the file says.
    pub fn add(&mut self, picture: &Image) -> Result<(), ImageError> {
        self.count(picture.size())?;
        let rgb = picture.to_rgb8();
        match &mut self.encoder {
            Encoder::Apng(writer) => writer.write_image_data(&rgb).map_err(codec),
            Encoder::Gif { encoder, clock } => {
                // Sizes were checked to fit when the animation began.
                let mut frame = gif::Frame::from_rgb_speed(self.size.0 as u16, self.size.1 as u16, &rgb, 10);
                frame.delay = clock.next();
                encoder.write_frame(&frame).map_err(codec)
            }
        }
    }

    /// Ends the file.
    ///
    /// # Errors
    /// Fewer pictures than were announced, or what the file says.
    pub fn finish(self) -> Result<(), ImageError> {
        if self.left > 0 {
            return Err(codec(format_args!("{} pictures are missing", self.left)));
        }
        match self.encoder {
            Encoder::Apng(writer) => writer.finish().map_err(codec),
            Encoder::Gif { encoder, .. } => encoder.into_inner().map(drop).map_err(codec),
        }
    }
}

/// Refuses an animation of no pictures, or of a rate out of range.
fn check(format: AnimationFormat, pictures: u32, frames_per_second: f64) -> Result<(), ImageError> {
    if pictures == 0 {
        return Err(ImageError::Empty("the animation"));
    }
    if !(format.slowest()..=10_000.0).contains(&frames_per_second) {
        let (field, found) = ("frames_per_second", frames_per_second.to_string());
        return Err(ImageError::Range { field, found, allowed: format.rates() });
    }
    Ok(())
}

/// An APNG file whose header is written.
fn apng<W: Write>(
    file: W,
    colour: png::ColorType,
    size: (u32, u32),
    pictures: u32,
    frames_per_second: f64,
) -> Result<png::Writer<W>, ImageError> {
    let mut encoder = png::Encoder::new(file, size.0, size.1);
    encoder.set_color(colour);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_animated(pictures, 0).map_err(codec)?;
    let (numerator, denominator) = delay(frames_per_second);
    encoder.set_frame_delay(numerator, denominator).map_err(codec)?;
    encoder.write_header().map_err(codec)
}

/// How long a picture stays, as a fraction of a second in two 16-bit numbers.
fn delay(frames_per_second: f64) -> (u16, u16) {
    for numerator in [1u16, 1001, 1000] {
        let denominator = f64::from(numerator) * frames_per_second;
        if denominator.fract().abs() < 1e-6 && (1.0..=65_535.0).contains(&denominator) {
            return (numerator, denominator as u16);
        }
    }
    // Rates that are no short fraction are kept to a part in thousands; slow ones by whole milliseconds.
    let milliseconds = 1000.0 / frames_per_second;
    if milliseconds > 60_000.0 {
        return ((1.0 / frames_per_second).round().clamp(1.0, 65_535.0) as u16, 1);
    }
    let scale = (60_000.0 * frames_per_second).clamp(1.0, 60_000.0);
    ((scale / frames_per_second).round().clamp(1.0, 65_535.0) as u16, scale as u16)
}

fn codec(error: impl std::fmt::Display) -> ImageError {
    ImageError::Codec(error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pictures() -> Vec<Image> {
        let gradient = |frame: usize| {
            let values = (0..12 * 8).flat_map(|i| [i as f32 / 96.0, 0.25 * frame as f32, 0.5]).collect();
            Image::new(12, 8, values).unwrap()
        };
        (0..3).map(gradient).collect()
    }

    fn written(format: AnimationFormat, frames_per_second: f64) -> Vec<u8> {
        let mut file = Vec::new();
        let mut animation = Animation::begin(&mut file, format, (12, 8), 3, frames_per_second).unwrap();
        pictures().iter().for_each(|picture| animation.add(picture).unwrap());
        animation.finish().unwrap();
        file
    }

    #[test]
    fn every_picture_of_an_apng_reads_back() {
        let file = written(AnimationFormat::Apng, 25.0);
        let mut reader = png::Decoder::new(std::io::Cursor::new(&file)).read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 3);
        for picture in pictures() {
            let mut data = vec![0; reader.output_buffer_size().unwrap()];
            reader.next_frame(&mut data).unwrap();
            assert_eq!(data, picture.to_rgb8());
            let control = reader.info().frame_control().unwrap();
            assert_eq!((control.delay_num, control.delay_den), (1, 25));
        }
    }

    #[test]
    fn every_picture_of_a_gif_reads_back_in_its_own_palette() {
        let file = written(AnimationFormat::Gif, 30.0);
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut reader = options.read_info(&file[..]).unwrap();
        let mut delays = Vec::new();
        for picture in pictures() {
            let frame = reader.read_next_frame().unwrap().unwrap();
            delays.push(frame.delay);
            let wanted = picture.to_rgb8();
            let found: Vec<u8> = frame.buffer.chunks(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
            let furthest = found.iter().zip(&wanted).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
            assert!(furthest <= 12, "{furthest} of 255");
        }
        // 3.33 hundredths each: ten in all.
        assert_eq!(delays.iter().sum::<u16>(), 10, "{delays:?}");
        assert!(reader.read_next_frame().unwrap().is_none());
    }

    #[test]
    fn what_was_not_announced_is_refused() {
        let begin = || Animation::begin(Vec::new(), AnimationFormat::Gif, (12, 8), 1, 30.0).unwrap();
        assert!(begin().finish().is_err(), "a picture is missing");
        let mut animation = begin();
        let other = Image::filled(8, 8, [0.0; 3]).unwrap();
        assert!(matches!(animation.add(&other), Err(ImageError::Mismatch { .. })));
        animation.add(&pictures()[0]).unwrap();
        assert!(animation.add(&pictures()[1]).is_err(), "one too many");
        assert!(Animation::begin(Vec::new(), AnimationFormat::Gif, (12, 8), 0, 30.0).is_err());
        assert!(Animation::begin(Vec::new(), AnimationFormat::Apng, (12, 8), 1, f64::NAN).is_err());
    }

    /// A picture of a GIF that stayed longer would be cut short.
    #[test]
    fn a_gif_is_no_slower_than_its_delays_can_say() {
        let begin = |format, rate| Animation::begin(Vec::new(), format, (12, 8), 3, rate);
        let error = begin(AnimationFormat::Gif, 0.0015).err().unwrap().to_string();
        assert!(error.contains("0.0015") && error.contains("0.001526 to 10000"), "{error}");
        assert!(begin(AnimationFormat::Apng, 0.0015).is_ok());
        for rate in [AnimationFormat::Gif.slowest(), 0.001526] {
            let mut clock = HundredthClock { frames_per_second: rate, pictures: 0 };
            let length: u64 = (0..3).map(|_| u64::from(clock.next())).sum();
            assert_eq!(length, (300.0 / rate).round() as u64, "{rate}");
            assert!(begin(AnimationFormat::Gif, rate).is_ok(), "{rate}");
        }
    }

    /// A file with room for so many bytes.
    struct Disk(usize);

    impl Write for Disk {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            let fits = bytes.len().min(self.0);
            self.0 -= fits;
            if fits == 0 { Err(std::io::ErrorKind::StorageFull.into()) } else { Ok(fits) }
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    /// Also where the file is closed in the middle.
    #[test]
    fn a_full_disk_is_an_error_and_no_panic() {
        for format in [AnimationFormat::Gif, AnimationFormat::Apng] {
            for room in [0, 20, 100] {
                let whole =
                    Animation::begin(Disk(room), format, (12, 8), 3, 30.0).and_then(|mut animation| {
                        pictures().iter().try_for_each(|picture| animation.add(picture))?;
                        animation.finish()
                    });
                assert!(matches!(whole, Err(ImageError::Codec(_))), "{format:?}, {room} bytes");
            }
        }
    }

    #[test]
    fn times_are_fractions_of_sixteen_bits() {
        assert_eq!(delay(30.0), (1, 30));
        assert_eq!(delay(30_000.0 / 1001.0), (1001, 30_000));
        for rate in [0.001, 0.7, 12.345_678, 59.94, 9999.0] {
            let (numerator, denominator) = delay(rate);
            let found = f64::from(denominator) / f64::from(numerator);
            assert!((found / rate - 1.0).abs() < 0.02, "{rate}: {found}");
        }
    }
}
