//! This module reads PNG, JPEG and WebP files as 8-bit RGBA and writes 8-bit RGB as any of them.
//!
//! The decoders stand alone: together with colour management, animation and a dozen other formats they would
//! be a third of what has to be compiled.

mod capacity;
mod jpeg;
mod jpeg_end;

use std::io::{BufRead, Cursor, Seek};

use image_webp::WebPDecoder;
use png::{BitDepth, ColorType, Transformations};
use zune_jpeg::{
    JpegDecoder,
    zune_core::{bytestream::ZCursor, colorspace::ColorSpace, options::DecoderOptions},
};

/// A decoded file; row 0 is at the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rgba8 {
    width: u32,
    height: u32,
    /// Exactly `4 · width · height` values, alpha not multiplied in.
    data: Vec<u8>,
}

/// A file that cannot be read as an image, and why.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct FileError(String);

/// What a file may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    /// The longest side, pixels.
    pub side: u32,
    /// The most that the decoded image may take, bytes.
    pub bytes: u64,
    /// The most that a lossless WebP file may take whatever its length, bytes: a picture of one colour is a
    /// handful of bytes at any size.
    pub flat_bytes: u64,
}

/// What a file is, by its first bytes.
enum Format {
    Png,
    Jpeg,
    WebP,
}

impl Format {
    fn of(first: &[u8]) -> Result<Self, FileError> {
        match first {
            [0x89, b'P', b'N', b'G', 0x0d, 0x0a, 0x1a, 0x0a, ..] => Ok(Self::Png),
            [0xff, 0xd8, 0xff, ..] => Ok(Self::Jpeg),
            [b'R', b'I', b'F', b'F', _, _, _, _, b'W', b'E', b'B', b'P', ..] => Ok(Self::WebP),
            _ => Err(codec("not a PNG, JPEG or WebP file")),
        }
    }
}

/// Width and height, pixels, that the header of a PNG, JPEG or WebP file claims. Pixels are not read.
///
/// # Errors
/// [`FileError`]: another format, a header that is damaged, or a file that the system does not give.
pub fn claimed_size(mut file: impl BufRead + Seek) -> Result<(u32, u32), FileError> {
    match Format::of(file.fill_buf().map_err(codec)?)? {
        Format::Png => {
            let mut decoder = png::Decoder::new(file);
            let info = decoder.read_header_info().map_err(codec)?;
            Ok((info.width, info.height))
        }
        Format::Jpeg => {
            let mut decoder = JpegDecoder::new_with_options(file, jpeg_options(u16::MAX.into()));
            decoder.decode_headers().map_err(codec)?;
            let (width, height) = decoder.dimensions().ok_or_else(|| codec("no size"))?;
            Ok((width as u32, height as u32))
        }
        Format::WebP => Ok(WebPDecoder::new(file).map_err(codec)?.dimensions()),
    }
}

impl Rgba8 {
    /// Decodes PNG, JPEG or WebP bytes; the format is detected from the first bytes.
    ///
    /// # Errors
    /// [`FileError`]: another format, damage, a file that is cut off, or a picture beyond `bounds`, or larger
    /// than a file of this length can hold.
    pub fn decode(bytes: &[u8], bounds: Bounds) -> Result<Self, FileError> {
        match Format::of(bytes)? {
            Format::Png => decode_png(bytes, bounds),
            Format::Jpeg => decode_jpeg(bytes, bounds),
            Format::WebP => decode_webp(bytes, bounds),
        }
    }

    /// Width and height, pixels.
    pub fn size(&self) -> (u32, u32) {
        (self.width, self.height)
    }

    /// Values r g b a per pixel.
    pub fn data(&self) -> &[u8] {
        &self.data
    }

    /// The same, to keep.
    pub fn into_data(self) -> Vec<u8> {
        self.data
    }

    /// The values r g b a of pixel `(x, y)`; `None` outside.
    pub fn pixel(&self, x: u32, y: u32) -> Option<[u8; 4]> {
        if x >= self.width {
            return None;
        }
        let at = y as usize * self.width as usize + x as usize;
        self.data.as_chunks::<4>().0.get(at).copied()
    }

    fn new(size: (u32, u32), data: Vec<u8>) -> Result<Self, FileError> {
        let (width, height) = size;
        if data.len() as u64 != 4 * u64::from(width) * u64::from(height) {
            return Err(codec(format_args!("{} bytes for {width} x {height} pixels", data.len())));
        }
        Ok(Self { width, height, data })
    }
}

impl Bounds {
    fn check(self, (width, height): (u32, u32)) -> Result<(), FileError> {
        let bytes = 4 * u64::from(width) * u64::from(height);
        if width == 0 || height == 0 || width > self.side || height > self.side || bytes > self.bytes {
            let Self { side, bytes, .. } = self;
            return Err(codec(format_args!(
                "{width} x {height} pixels; sides of 1 to {side} and {bytes} bytes are allowed"
            )));
        }
        Ok(())
    }
}

/// The PNG file of a picture of `width` × `height`, r g b per pixel.
///
/// # Errors
/// [`FileError`]: a length that is not `3 · width · height`.
pub(crate) fn png_of_rgb8(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>, FileError> {
    png_of(width, height, rgb, ColorType::Rgb)
}

/// As [`png_of_rgb8`], r g b a per pixel.
///
/// # Errors
/// [`FileError`]: a length that is not `4 · width · height`.
pub(crate) fn png_of_rgba8(width: u32, height: u32, rgba: &[u8]) -> Result<Vec<u8>, FileError> {
    png_of(width, height, rgba, ColorType::Rgba)
}

fn png_of(width: u32, height: u32, pixels: &[u8], colour: ColorType) -> Result<Vec<u8>, FileError> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, width, height);
    encoder.set_color(colour);
    encoder.set_depth(BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_filter(png::Filter::Adaptive);
    let mut writer = encoder.write_header().map_err(codec)?;
    writer.write_image_data(pixels).map_err(codec)?;
    writer.finish().map_err(codec)?;
    Ok(out)
}

/// The JPEG file of a picture of `width` × `height`, r g b per pixel, at `quality` 1 to 100; no colour is
/// stored at a lower resolution.
///
/// # Errors
/// [`FileError`]: a length that is not `3 · width · height`, a side above 65535.
pub(crate) fn jpeg_of_rgb8(width: u32, height: u32, rgb: &[u8], quality: u8) -> Result<Vec<u8>, FileError> {
    let side = |side: u32| {
        let short = u16::try_from(side).ok().filter(|&side| side > 0);
        short.ok_or_else(|| codec(format_args!("a side of {side} pixels; 1 to 65535 are allowed")))
    };
    let size = [side(width)?, side(height)?];
    if rgb.len() as u64 != 3 * u64::from(width) * u64::from(height) {
        return Err(codec(format_args!("{} bytes for {width} x {height} pixels", rgb.len())));
    }
    Ok(jpeg::encode(size, rgb, quality))
}

/// The lossless WebP file of a picture of `width` × `height`, r g b per pixel.
///
/// # Errors
/// [`FileError`]: a length that is not `3 · width · height`, a side above 16384.
pub(crate) fn webp_of_rgb8(width: u32, height: u32, rgb: &[u8]) -> Result<Vec<u8>, FileError> {
    webp_of(width, height, rgb, image_webp::ColorType::Rgb8, 3)
}

/// As [`webp_of_rgb8`], r g b a per pixel.
///
/// # Errors
/// [`FileError`]: a length that is not `4 · width · height`, a side above 16384.
pub(crate) fn webp_of_rgba8(width: u32, height: u32, rgba: &[u8]) -> Result<Vec<u8>, FileError> {
    webp_of(width, height, rgba, image_webp::ColorType::Rgba8, 4)
}

fn webp_of(
    width: u32,
    height: u32,
    pixels: &[u8],
    colour: image_webp::ColorType,
    channels: u64,
) -> Result<Vec<u8>, FileError> {
    // The encoder panics on another length.
    if pixels.len() as u64 != channels * u64::from(width) * u64::from(height) {
        return Err(codec(format_args!("{} bytes for {width} x {height} pixels", pixels.len())));
    }
    let mut out = Vec::new();
    let encoder = image_webp::WebPEncoder::new(&mut out);
    encoder.encode(pixels, width, height, colour).map_err(codec)?;
    Ok(out)
}

fn decode_png(bytes: &[u8], bounds: Bounds) -> Result<Rgba8, FileError> {
    let limits = png::Limits { bytes: usize::try_from(bounds.bytes).unwrap_or(usize::MAX) };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), limits);
    let info = decoder.read_header_info().map_err(codec)?;
    let size = (info.width, info.height);
    bounds.check(size)?;
    capacity::check_png(size, info.bits_per_pixel(), bytes.len()).map_err(codec)?;
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(codec)?;
    let len = reader.output_buffer_size().ok_or_else(|| codec("larger than the memory"))?;
    let mut data = vec![0; len];
    reader.next_frame(&mut data).map_err(codec)?;
    let (colour, depth) = reader.output_color_type();
    if depth == BitDepth::Sixteen {
        let narrow = |v: &[u8; 2]| ((u32::from(u16::from_be_bytes(*v)) + 128) / 257) as u8;
        data = data.as_chunks::<2>().0.iter().map(narrow).collect();
    }
    let rgba = match colour {
        ColorType::Grayscale => grey_to_rgba(&data),
        ColorType::GrayscaleAlpha => {
            data.as_chunks::<2>().0.iter().flat_map(|&[v, a]| [v, v, v, a]).collect()
        }
        ColorType::Rgb => rgb_to_rgba(&data),
        ColorType::Rgba => data,
        ColorType::Indexed => return Err(codec("a palette that was not resolved")),
    };
    Rgba8::new(size, rgba)
}

fn decode_jpeg(bytes: &[u8], bounds: Bounds) -> Result<Rgba8, FileError> {
    let options = jpeg_options(bounds.side);
    let mut decoder = JpegDecoder::new_with_options(ZCursor::new(bytes), options);
    decoder.decode_headers().map_err(codec)?;
    let (width, height) = decoder.dimensions().ok_or_else(|| codec("no size"))?;
    let size = (width as u32, height as u32);
    bounds.check(size)?;
    capacity::check_jpeg(size, bytes.len()).map_err(codec)?;
    jpeg_end::check(bytes).map_err(codec)?;
    let grey = decoder.input_colorspace() == Some(ColorSpace::Luma);
    let colours = if grey { ColorSpace::Luma } else { ColorSpace::RGB };
    decoder.set_options(options.jpeg_set_out_colorspace(colours));
    let data = decoder.decode().map_err(codec)?;
    Rgba8::new(size, if grey { grey_to_rgba(&data) } else { rgb_to_rgba(&data) })
}

/// How JPEG files are read whose sides are at most so many pixels. Strictness would refuse bytes between
/// headers, which some programs leave there, and not every file that is cut off.
fn jpeg_options(side: u32) -> DecoderOptions {
    let options = DecoderOptions::default().set_strict_mode(false);
    options.set_max_width(side as usize).set_max_height(side as usize)
}

fn decode_webp(bytes: &[u8], bounds: Bounds) -> Result<Rgba8, FileError> {
    let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(codec)?;
    let size = decoder.dimensions();
    bounds.check(size)?;
    capacity::check_webp(size, bytes, bounds.flat_bytes).map_err(codec)?;
    let mut data = vec![0; decoder.output_buffer_size().ok_or_else(|| codec("larger than the memory"))?];
    decoder.read_image(&mut data).map_err(codec)?;
    Rgba8::new(size, if decoder.has_alpha() { data } else { rgb_to_rgba(&data) })
}

fn grey_to_rgba(data: &[u8]) -> Vec<u8> {
    data.iter().flat_map(|&v| [v, v, v, 255]).collect()
}

fn rgb_to_rgba(data: &[u8]) -> Vec<u8> {
    data.as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| [r, g, b, 255]).collect()
}

fn codec(error: impl std::fmt::Display) -> FileError {
    FileError(error.to_string())
}

#[cfg(test)]
mod tests {
    use image::{DynamicImage, ImageFormat, Rgba, RgbaImage};

    use super::*;

    const BOUNDS: Bounds = Bounds { side: 64, bytes: 1 << 20, flat_bytes: 1 << 20 };

    fn picture() -> DynamicImage {
        let of = |x: u32, y: u32| Rgba([x as u8 * 9, y as u8 * 17, (x * y) as u8, 255 - x as u8 * 4]);
        DynamicImage::ImageRgba8(RgbaImage::from_fn(29, 13, of))
    }

    fn file(picture: &DynamicImage, format: ImageFormat) -> Vec<u8> {
        let mut out = Cursor::new(Vec::new());
        picture.write_to(&mut out, format).unwrap();
        out.into_inner()
    }

    /// Every kind of pixel in every format becomes the red, green, blue and opacity that the crate `image`
    /// makes of it. That reads files by the same crates: what is tested is what happens to pixels.
    #[test]
    fn every_kind_of_pixel_becomes_what_the_crate_image_makes_of_it() {
        let p = picture();
        let kinds = [
            p.clone(),
            DynamicImage::ImageLuma8(p.to_luma8()),
            DynamicImage::ImageLumaA8(p.to_luma_alpha8()),
            DynamicImage::ImageRgb8(p.to_rgb8()),
            DynamicImage::ImageLuma16(p.to_luma16()),
            DynamicImage::ImageLumaA16(p.to_luma_alpha16()),
            DynamicImage::ImageRgb16(p.to_rgb16()),
            DynamicImage::ImageRgba16(p.to_rgba16()),
        ];
        let mut files = Vec::new();
        for (i, kind) in kinds.iter().enumerate() {
            files.push(file(kind, ImageFormat::Png));
            if i < 4 {
                files.push(file(kind, ImageFormat::WebP));
            }
            if i == 1 || i == 3 {
                files.push(file(kind, ImageFormat::Jpeg));
            }
        }
        assert_eq!(files.len(), 14);
        for bytes in files {
            let twin = image::load_from_memory(&bytes).unwrap().into_rgba8();
            let decoded = Rgba8::decode(&bytes, BOUNDS).unwrap();
            assert_eq!((decoded.size(), decoded.data()), (twin.dimensions(), twin.as_raw().as_slice()));
            assert_eq!(claimed_size(Cursor::new(&bytes)), Ok(twin.dimensions()));
            assert_eq!(decoded.pixel(28, 12), Some(twin.get_pixel(28, 12).0));
            assert_eq!((decoded.pixel(29, 0), decoded.pixel(0, 13)), (None, None));
        }
    }

    #[test]
    fn png_files_are_made_with_the_settings_of_the_crate_image() {
        let p = picture().to_rgb8();
        let twin = file(&DynamicImage::ImageRgb8(p.clone()), ImageFormat::Png);
        assert_eq!(png_of_rgb8(29, 13, p.as_raw()).unwrap(), twin);
        assert!(png_of_rgb8(29, 12, p.as_raw()).is_err());
    }

    #[test]
    fn what_is_damaged_or_beyond_the_bounds_is_refused() {
        for format in [ImageFormat::Png, ImageFormat::Jpeg, ImageFormat::WebP] {
            let bytes = file(&DynamicImage::ImageRgb8(picture().to_rgb8()), format);
            let refused = |bounds| Rgba8::decode(&bytes, bounds).unwrap_err().to_string();
            assert!(refused(Bounds { side: 28, ..BOUNDS }).contains("28"), "{format:?}");
            assert!(
                refused(Bounds { bytes: 29 * 13 * 4 - 1, ..BOUNDS }).contains("1507 bytes"),
                "{format:?}"
            );
            let cut = bytes.get(..20).unwrap();
            assert!(matches!(Rgba8::decode(cut, BOUNDS), Err(FileError(_))), "{format:?}");
            assert!(matches!(claimed_size(Cursor::new(cut)), Err(FileError(_))), "{format:?}");
        }
        assert!(Rgba8::decode(b"not an image", BOUNDS).is_err());
        assert!(claimed_size(Cursor::new(b"not an image")).is_err());
    }

    const LARGE: Bounds = Bounds { side: 16_384, bytes: 1 << 30, flat_bytes: 64 << 20 };
    const SIDE: u32 = 2048;

    /// A PNG of one colour, black or white per pixel.
    fn png_of_bits() -> Vec<u8> {
        let mut out = Vec::new();
        let mut encoder = png::Encoder::new(&mut out, SIDE, SIDE);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::One);
        encoder.set_compression(png::Compression::High);
        let mut writer = encoder.write_header().unwrap();
        writer.write_image_data(&vec![0; (SIDE * SIDE / 8) as usize]).unwrap();
        writer.finish().unwrap();
        out
    }

    /// A grey JPEG of `side` × `side` pixels of one colour with codes of one bit: two bits a block, or one in
    /// a progressive file, of which only the means are there.
    fn jpeg_of_bits(side: u16, progressive: bool) -> Vec<u8> {
        let [high, low] = side.to_be_bytes();
        let table = |of: u8| [&[0xff, 0xc4, 0, 20, of, 1][..], &[0; 15], &[0]].concat();
        let frame = if progressive { 0xc2 } else { 0xc0 };
        let blocks = usize::from(side / 8).pow(2);
        let scan = vec![0; blocks * if progressive { 1 } else { 2 } / 8];
        let last = if progressive { 0 } else { 63 };
        [
            &[0xff, 0xd8, 0xff, 0xdb, 0, 67, 0][..],
            &[1; 64],
            &[0xff, frame, 0, 11, 8, high, low, high, low, 1, 1, 0x11, 0],
            &table(0x00),
            &table(0x10),
            &[0xff, 0xda, 0, 8, 1, 1, 0, 0, last, 0],
            &scan,
            &[0xff, 0xd9],
        ]
        .concat()
    }

    /// Files that hold as many pixels for their length as their format can, or nearly, are read.
    #[test]
    fn pictures_of_one_colour_are_read() {
        let rgb = vec![90; (3 * SIDE * SIDE) as usize];
        let files = [
            (png_of_bits(), 1700, 0),
            (png_of_rgb8(SIDE, SIDE, &rgb).unwrap(), 40, 90),
            (jpeg_of_rgb8(SIDE, SIDE, &rgb, 1).unwrap(), 25, 90),
            (jpeg_of_bits(2048, false), 250, 128),
            (jpeg_of_bits(2048, true), 500, 128),
            (webp_of_rgb8(SIDE, SIDE, &rgb).unwrap(), 100, 90),
        ];
        for (at, (bytes, per_byte, grey)) in files.iter().enumerate() {
            let found = u64::from(SIDE).pow(2) / bytes.len() as u64;
            assert!(found >= *per_byte, "file {at} has {found} pixels per byte");
            let decoded = Rgba8::decode(bytes, LARGE).unwrap();
            assert_eq!(decoded.size(), (SIDE, SIDE), "file {at}");
            let [r, _, _, a] = decoded.pixel(SIDE - 1, SIDE - 1).unwrap();
            assert!(r.abs_diff(*grey) < 12 && a == 255, "file {at}: {r}");
        }
    }

    /// Headers that claim 16000 × 12000 pixels in front of what small files hold.
    #[test]
    fn claims_beyond_the_length_are_refused() {
        let (wide, high) = (16_000u32, 12_000u32);
        let rgb = vec![90; 3 * 64 * 64];
        let mut png = Vec::new();
        drop(png::Encoder::new(&mut png, wide, high).write_header().unwrap());

        let mut jpeg = jpeg_of_rgb8(64, 64, &rgb, 50).unwrap();
        let frame = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
        jpeg[frame + 5..frame + 7].copy_from_slice(&(high as u16).to_be_bytes());
        jpeg[frame + 7..frame + 9].copy_from_slice(&(wide as u16).to_be_bytes());

        let mut lossless = webp_of_rgb8(64, 64, &rgb).unwrap();
        let header = lossless.windows(4).position(|name| name == b"VP8L").unwrap() + 9;
        let sizes = (wide - 1) | ((high - 1) << 14);
        lossless[header..header + 4].copy_from_slice(&sizes.to_le_bytes());

        let mut lossy = b"RIFF\x2c\0\0\0WEBPVP8 \x20\0\0\0\x10\0\0\x9d\x01\x2a".to_vec();
        lossy.extend([wide as u16, high as u16].map(u16::to_le_bytes).concat());
        lossy.resize(52, 0);

        for (name, bytes) in [("PNG", png), ("JPEG", jpeg), ("VP8L", lossless), ("VP8", lossy)] {
            let said = Rgba8::decode(&bytes, LARGE).unwrap_err().to_string();
            let length = format!("a file of {} bytes holds at most", bytes.len());
            assert!(said.contains("16000 x 12000") && said.contains(&length), "{name}: {said}");
        }
    }
}
