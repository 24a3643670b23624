//! Writes lossless WebP whose pixels are predicted from their left neighbours.
//!
//! The writer of `image-webp` predicts from above or not at all, and always takes green out of red and
//! blue. In planes along a Morton curve the pixel before tells more than the one above. So that writer is
//! given differences from the left, which it codes as they are, and the transform that undoes them is put
//! into its bits, behind the one for green.

use std::io;

use image_webp::{ColorType, EncoderParams, WebPEncoder};

/// Bytes of the container before the bits: `RIFF`, length, `WEBP`, `VP8L`, length.
const CONTAINER: usize = 20;
/// Bits before the place of a second transform: signature, sides, alpha, version, and the transform for
/// green.
const BEFORE: usize = 8 + 14 + 14 + 1 + 3 + 3;
/// A transform that predicts from the left, bits in their order: present, of kind 0, blocks of 512
/// pixels, no cache of colours, a code whose one word is 1 for green, and codes whose one word is 0 for
/// red, blue, alpha and distances. Each code: simple, one word, of one bit, the word.
const PREDICTS_LEFT: [u8; 27] =
    [1, 0, 0, 1, 1, 1, 0, 1, 0, 0, 1, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0];

/// The file of `pixels`, red, green, blue and alpha, in rows of `width`.
///
/// # Errors
/// What the writer of `image-webp` refuses.
pub fn encode(pixels: &[[u8; 4]], width: usize) -> io::Result<Vec<u8>> {
    let height = pixels.len() / width.max(1);
    let differences = differences(pixels, width);
    let mut file = Vec::new();
    let mut encoder = WebPEncoder::new(&mut file);
    let mut how = EncoderParams::default();
    how.use_predictor_transform = false;
    encoder.set_params(how);
    encoder
        .encode(differences.as_flattened(), width as u32, height as u32, ColorType::Rgba8)
        .map_err(io::Error::other)?;
    let bits = file.get(CONTAINER..).ok_or_else(|| io::Error::other("a file without bits"))?;
    let body = spliced(bits, BEFORE, &PREDICTS_LEFT);
    let mut out = b"RIFF".to_vec();
    let padded = body.len().next_multiple_of(2);
    out.extend(((padded + CONTAINER - 8) as u32).to_le_bytes());
    out.extend(b"WEBPVP8L");
    out.extend((body.len() as u32).to_le_bytes());
    out.extend(&body);
    out.resize(CONTAINER + padded, 0);
    Ok(out)
}

/// Differences from the left with green taken out of red and blue; what the writer takes out once more is
/// added.
fn differences(pixels: &[[u8; 4]], width: usize) -> Vec<[u8; 4]> {
    let without_green = |[r, g, b, a]: [u8; 4]| [r.wrapping_sub(g), g, b.wrapping_sub(g), a];
    let difference = |at: usize| {
        let from = match at {
            0 => [0, 0, 0, 255],
            // The first of a row is predicted from above.
            _ if at.is_multiple_of(width) => without_green(pixels[at - width]),
            _ => without_green(pixels[at - 1]),
        };
        let pixel = without_green(pixels[at]);
        let [r, g, b, a] = std::array::from_fn(|channel| pixel[channel].wrapping_sub(from[channel]));
        [r.wrapping_add(g), g, b.wrapping_add(g), a]
    };
    (0..pixels.len()).map(difference).collect()
}

/// `bytes`, whose bits count from the lowest, with `added` put in before bit `at`.
fn spliced(bytes: &[u8], at: usize, added: &[u8]) -> Vec<u8> {
    let bit = |i: usize| bytes[i / 8] >> (i % 8) & 1;
    let all = (0..at).map(bit).chain(added.iter().copied()).chain((at..8 * bytes.len()).map(bit));
    let mut out = vec![0u8; (8 * bytes.len() + added.len()).div_ceil(8)];
    for (i, bit) in all.enumerate() {
        out[i / 8] |= bit << (i % 8);
    }
    out
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    /// The pixels of a file.
    fn decoded(file: &[u8]) -> Vec<u8> {
        let mut decoder = image_webp::WebPDecoder::new(Cursor::new(file)).unwrap();
        let mut raw = vec![0; decoder.output_buffer_size().unwrap()];
        decoder.read_image(&mut raw).unwrap();
        if decoder.has_alpha() {
            return raw;
        }
        raw.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect()
    }

    #[test]
    fn pixels_come_back() {
        let value = |i: usize| [(i * 7) as u8, (i * i) as u8, (i / 3) as u8, 252 + (i % 4) as u8];
        for (width, height) in [(1, 1), (1, 9), (9, 1), (37, 29), (600, 3)] {
            let mut pixels: Vec<[u8; 4]> = (0..width * height).map(value).collect();
            let file = encode(&pixels, width).unwrap();
            assert_eq!(decoded(&file), pixels.as_flattened(), "{width} by {height}");
            pixels[width * height / 2][0] ^= 1;
            assert_ne!(decoded(&file), pixels.as_flattened(), "a difference is noticed");
        }
    }

    #[test]
    fn rows_that_change_slowly_are_short() {
        // A walk of small steps, by a generator of low quality.
        let (mut seed, mut value) = (1u32, [0u8; 3]);
        let along: Vec<[u8; 4]> = (0..64 * 64)
            .map(|_| {
                seed = seed.wrapping_mul(747_796_405).wrapping_add(1);
                let step = |channel: usize| (seed >> (20 + 3 * channel) & 3) as u8;
                value = std::array::from_fn(|channel| value[channel].wrapping_add(step(channel)));
                [value[0], value[1], value[2], 255]
            })
            .collect();
        let mut plain = Vec::new();
        WebPEncoder::new(&mut plain).encode(along.as_flattened(), 64, 64, ColorType::Rgba8).unwrap();
        assert!(encode(&along, 64).unwrap().len() < plain.len());
    }
}
