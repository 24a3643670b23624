//! How many pixels a file can hold by its length, whatever its header claims: memory follows what is there.
//!
//! The bounds are what each format spends on a picture of one colour, so that no true file is refused.

use super::{FileError, codec};

/// Bytes that a byte of deflate becomes at most: a match of 258 bytes takes a bit for its length and a bit for
/// its distance.
const PER_DEFLATED_BYTE: u64 = 1032;

/// Pixels for each byte of a JPEG file, at most: each block of 8 × 8 values takes a bit or more, the Huffman
/// code of its mean, also in a progressive file; and where no component has a value for each pixel (one is
/// half as wide, the other half as high), a block stands for 128 pixels or fewer.
const PER_JPEG_BYTE: u64 = 8 * 128;

/// Pixels for each byte of a lossy WebP file, at most: each block of 16 × 16 pixels says how its brightness and
/// how its colours are predicted, by probabilities that no file changes. The likeliest choices (145 and 142 of
/// 256) take 0.82 and 0.85 bits.
const PER_LOSSY_WEBP_BYTE: u64 = 8 * 256 * 10 / 16;

/// Pixels for each byte of a lossless WebP file of which more is wanted than is always allowed: a symbol that
/// stands alone in its table takes no bits, so that a picture of one colour is a handful of bytes at any size,
/// and no bound is true. A photograph has a hundredth of this.
const PER_LOSSLESS_WEBP_BYTE: u64 = 1024;

/// Refuses a PNG file of `length` bytes that claims more than it can hold, at `bits` per pixel. Each row has a
/// byte for its filter, and each row of an interlaced picture has one in the pass or passes that it is in.
pub(super) fn check_png((width, height): (u32, u32), bits: usize, length: usize) -> Result<(), FileError> {
    let values = (u64::from(width) * u64::from(height) * bits as u64).div_ceil(8);
    let (found, most) = (values + u64::from(height), length as u64 * PER_DEFLATED_BYTE);
    if found > most {
        return Err(codec(format_args!(
            "{width} x {height} pixels, {found} bytes unpacked; a file of {length} bytes holds at most {most}"
        )));
    }
    Ok(())
}

/// As [`check_png`], of a JPEG file.
pub(super) fn check_jpeg(size: (u32, u32), length: usize) -> Result<(), FileError> {
    check(size, length, length as u64 * PER_JPEG_BYTE)
}

/// As [`check_png`], of the WebP file `bytes`; one of `always` bytes as RGBA may be of any length where length
/// says nothing.
pub(super) fn check_webp(size: (u32, u32), bytes: &[u8], always: u64) -> Result<(), FileError> {
    let length = bytes.len() as u64;
    // What has more than one chunk may hold a lossless picture, or a picture smaller than its canvas.
    let most = match bytes.get(12..16) {
        Some(b"VP8 ") => length * PER_LOSSY_WEBP_BYTE,
        _ => (length * PER_LOSSLESS_WEBP_BYTE).max(always / 4),
    };
    check(size, bytes.len(), most)
}

fn check((width, height): (u32, u32), length: usize, most: u64) -> Result<(), FileError> {
    if u64::from(width) * u64::from(height) > most {
        return Err(codec(format_args!(
            "{width} x {height} pixels; a file of {length} bytes holds at most {most}"
        )));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::{Bounds, Rgba8, jpeg_of_rgb8, png_of_rgb8, webp_of_rgb8};

    const BOUNDS: Bounds = Bounds { side: 16_384, bytes: 1 << 30, flat_bytes: 64 << 20 };
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
            let decoded = Rgba8::decode(bytes, BOUNDS).unwrap();
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
            let said = Rgba8::decode(&bytes, BOUNDS).unwrap_err().to_string();
            let length = format!("a file of {} bytes holds at most", bytes.len());
            assert!(said.contains("16000 x 12000") && said.contains(&length), "{name}: {said}");
        }
    }
}
