//! How many pixels a file can hold by its length, whatever its header claims: memory follows what is there.
//!
//! The bounds are what each format spends on a picture of one colour, so that no true file is refused.

/// Bytes that a byte of deflate becomes at most: a match of 258 bytes takes a bit for its length and a bit
/// for its distance.
const PER_DEFLATED_BYTE: u64 = 1032;

/// Pixels for each byte of a JPEG file, at most: each block of 8 × 8 values takes a bit or more, the Huffman
/// code of its mean, also in a progressive file; and where no component has a value for each pixel (one is
/// half as wide, the other half as high), a block stands for 128 pixels or fewer.
const PER_JPEG_BYTE: u64 = 8 * 128;

/// Pixels for each byte of a lossy WebP file, at most: each block of 16 × 16 pixels says how its brightness
/// and how its colours are predicted, by probabilities that no file changes. The likeliest choices (145 and
/// 142 of 256) take 0.82 and 0.85 bits.
const PER_LOSSY_WEBP_BYTE: u64 = 8 * 256 * 10 / 16;

/// Pixels for each byte of a lossless WebP file that has more of them than are always allowed: a symbol that
/// stands alone in its table takes no bits, so that a picture of one colour is a handful of bytes at any
/// size, and no bound is true. A photograph has a hundredth of this.
const PER_LOSSLESS_WEBP_BYTE: u64 = 1024;

/// Refuses a PNG file of `length` bytes that claims more than it can hold, at `bits` per pixel. Each row has
/// a byte for its filter, and each row of an interlaced picture has one in every pass that it is in.
pub(super) fn check_png((width, height): (u32, u32), bits: usize, length: usize) -> Result<(), String> {
    let values = (u64::from(width) * u64::from(height) * bits as u64).div_ceil(8);
    let (found, most) = (values + u64::from(height), length as u64 * PER_DEFLATED_BYTE);
    if found > most {
        return Err(format!(
            "{width} x {height} pixels, {found} bytes unpacked; a file of {length} bytes holds at most {most}"
        ));
    }
    Ok(())
}

/// As [`check_png`], of a JPEG file.
pub(super) fn check_jpeg(size: (u32, u32), length: usize) -> Result<(), String> {
    check(size, length, length as u64 * PER_JPEG_BYTE)
}

/// As [`check_png`], of the WebP file `bytes`; one of `always` bytes as RGBA may be of any length where
/// length says nothing.
pub(super) fn check_webp(size: (u32, u32), bytes: &[u8], always: u64) -> Result<(), String> {
    let length = bytes.len() as u64;
    // What has more than one chunk may hold a lossless picture, or a picture smaller than its canvas.
    let most = match bytes.get(12..16) {
        Some(b"VP8 ") => length * PER_LOSSY_WEBP_BYTE,
        _ => (length * PER_LOSSLESS_WEBP_BYTE).max(always / 4),
    };
    check(size, bytes.len(), most)
}

fn check((width, height): (u32, u32), length: usize, most: u64) -> Result<(), String> {
    if u64::from(width) * u64::from(height) > most {
        return Err(format!("{width} x {height} pixels; a file of {length} bytes holds at most {most}"));
    }
    Ok(())
}
