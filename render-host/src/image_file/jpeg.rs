//! Encodes baseline JPEG: YCbCr at full resolution, the standard's example tables (ITU-T T.81, annex K).
//!
//! A block is transformed in floating point by the plain definition along rows and columns, quantised,
//! and coded by run lengths and Huffman codes. Chroma shares the codes of luma, which costs a few per cent of
//! the bytes and half of the tables.

/// Natural place of the coefficient at each place of the zigzag.
const ZIGZAG: [usize; 64] = [
    0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6, 7,
    14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29, 22, 15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39,
    46, 53, 60, 61, 54, 47, 55, 62, 63,
];
/// Steps of luma at quality 50, in natural order.
const LUMA: [u16; 64] = [
    16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17,
    22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78,
    87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];
/// Steps of chroma at quality 50, in natural order.
const CHROMA: [u16; 64] = [
    17, 18, 24, 47, 99, 99, 99, 99, 18, 21, 26, 66, 99, 99, 99, 99, 24, 26, 56, 99, 99, 99, 99, 99, 47, 66,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
    99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99, 99,
];
/// Codes of each length from 1 to 16, of the first coefficients.
const FIRST_LENGTHS: [u8; 16] = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
/// Codes of each length from 1 to 16, of the other coefficients.
const OTHER_LENGTHS: [u8; 16] = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125];
/// The first symbols of the other coefficients; those that follow go by rows.
const OTHER_SYMBOLS: [u8; 43] = [
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07, 0x22,
    0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0, 0x24, 0x33,
    0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19,
];

/// A JPEG file of a picture of `size` (width, height), at least 1 × 1, of r g b per pixel; `rgb` holds
/// exactly `3 · width · height` values. `quality` is 1 to 100.
pub(super) fn encode(size: [u16; 2], rgb: &[u8], quality: u8) -> Vec<u8> {
    let quality = u16::from(quality.clamp(1, 100));
    let tables = [LUMA, CHROMA].map(|table| steps(&table, quality));
    let (first, other) = (HuffmanTable::new(FIRST_LENGTHS, (0..12).collect()), other_table());
    let mut out = header(size, &tables, [&first, &other]);

    let planes = planes(size, rgb);
    let cosines = cosines();
    let [width, height] = size.map(usize::from);
    let mut bits = BitWriter { out: &mut out, word: 0, count: 0 };
    let mut before = [0i32; 3];
    for block_y in 0..height.div_ceil(8) {
        for block_x in 0..width.div_ceil(8) {
            for (component, plane) in planes.iter().enumerate() {
                let block = block(plane, [width, height], [block_x, block_y]);
                let table = &tables[component.min(1)];
                let coefficients = quantised(&transformed(&block, &cosines), table);
                write_block(&mut bits, &coefficients, before[component], &first, &other);
                before[component] = coefficients[0];
            }
        }
    }
    bits.finish();
    out.extend([0xff, 0xd9]);
    out
}

/// The table of `quality`, from that of quality 50.
fn steps(table: &[u16; 64], quality: u16) -> [u8; 64] {
    let scale = if quality < 50 { 5000 / quality } else { 200 - 2 * quality };
    table.map(|step| ((u32::from(step) * u32::from(scale) + 50) / 100).clamp(1, 255) as u8)
}

/// Symbols and the codes that stand for them.
struct HuffmanTable {
    lengths: [u8; 16],
    symbols: Vec<u8>,
    /// Code and its length of every symbol.
    codes: [(u16, u8); 256],
}

impl HuffmanTable {
    fn new(lengths: [u8; 16], symbols: Vec<u8>) -> Self {
        let mut codes = [(0, 0); 256];
        let (mut code, mut next) = (0u16, symbols.iter());
        for (length, &count) in (1u8..).zip(&lengths) {
            for &symbol in next.by_ref().take(count.into()) {
                codes[usize::from(symbol)] = (code, length);
                code += 1;
            }
            code <<= 1;
        }
        Self { lengths, symbols, codes }
    }
}

/// The table of the standard for all coefficients but the first.
fn other_table() -> HuffmanTable {
    let mut symbols = OTHER_SYMBOLS.to_vec();
    // Run lengths 1 to 15 with the sizes that are left of each, up to 10.
    let left = [(1, 10), (2, 5), (3, 4), (4, 3), (5, 3), (6, 3), (7, 3), (8, 3)];
    let left = left.into_iter().chain((9..14).map(|run| (run, 2))).chain([(14, 1), (15, 1)]);
    symbols.extend(left.flat_map(|(run, from)| (from..=10).map(move |size| run << 4 | size)));
    HuffmanTable::new(OTHER_LENGTHS, symbols)
}

/// Everything before the coded blocks.
fn header(size: [u16; 2], tables: &[[u8; 64]; 2], codes: [&HuffmanTable; 2]) -> Vec<u8> {
    let mut out = vec![0xff, 0xd8];
    let mut segment = |marker: u8, content: &[u8]| {
        out.extend([0xff, marker]);
        out.extend((content.len() as u16 + 2).to_be_bytes());
        out.extend(content);
    };
    segment(0xe0, b"JFIF\0\x01\x01\0\0\x01\0\x01\0\0");
    for (id, table) in (0u8..).zip(tables) {
        let content: Vec<u8> = std::iter::once(id).chain(ZIGZAG.map(|place| table[place])).collect();
        segment(0xdb, &content);
    }
    let [[w1, w0], [h1, h0]] = size.map(u16::to_be_bytes);
    segment(0xc0, &[8, h1, h0, w1, w0, 3, 1, 0x11, 0, 2, 0x11, 1, 3, 0x11, 1]);
    for (class, table) in [0x00, 0x10].into_iter().zip(codes) {
        let content: Vec<u8> =
            std::iter::once(class).chain(table.lengths).chain(table.symbols.iter().copied()).collect();
        segment(0xc4, &content);
    }
    segment(0xda, &[3, 1, 0, 2, 0, 3, 0, 0, 63, 0]);
    out
}

/// Luma and the two chroma planes, around 0.
fn planes([width, height]: [u16; 2], rgb: &[u8]) -> [Vec<f32>; 3] {
    let pixels = usize::from(width) * usize::from(height);
    let mut planes = [(); 3].map(|()| Vec::with_capacity(pixels));
    for pixel in rgb.as_chunks::<3>().0 {
        let [r, g, b] = pixel.map(f32::from);
        planes[0].push(0.299 * r + 0.587 * g + 0.114 * b - 128.0);
        planes[1].push(-0.168_736 * r - 0.331_264 * g + 0.5 * b);
        planes[2].push(0.5 * r - 0.418_688 * g - 0.081_312 * b);
    }
    planes
}

/// Eight rows of eight values; beyond the picture its last row and column are repeated.
fn block(plane: &[f32], [width, height]: [usize; 2], [x, y]: [usize; 2]) -> [f32; 64] {
    std::array::from_fn(|i| {
        let (x, y) = ((8 * x + i % 8).min(width - 1), (8 * y + i / 8).min(height - 1));
        plane[y * width + x]
    })
}

/// Row `u` is the basis of frequency `u`.
fn cosines() -> [[f32; 8]; 8] {
    std::array::from_fn(|u| {
        let scale = if u == 0 { 0.125f64.sqrt() } else { 0.5 };
        let angle = |x: usize| (2 * x + 1) as f64 * u as f64 * std::f64::consts::PI / 16.0;
        std::array::from_fn(|x| (scale * angle(x).cos()) as f32)
    })
}

/// The discrete cosine transform of a block.
fn transformed(block: &[f32; 64], cosines: &[[f32; 8]; 8]) -> [f32; 64] {
    let along: [f32; 64] =
        std::array::from_fn(|i| (0..8).map(|x| cosines[i % 8][x] * block[i / 8 * 8 + x]).sum());
    std::array::from_fn(|i| (0..8).map(|y| cosines[i / 8][y] * along[8 * y + i % 8]).sum())
}

/// Coefficients in steps, in zigzag order.
fn quantised(coefficients: &[f32; 64], steps: &[u8; 64]) -> [i32; 64] {
    ZIGZAG.map(|place| (coefficients[place] / f32::from(steps[place])).round() as i32)
}

/// Codes a block whose predecessor had first coefficient `before`.
fn write_block(
    bits: &mut BitWriter<'_>,
    coefficients: &[i32; 64],
    before: i32,
    first: &HuffmanTable,
    other: &HuffmanTable,
) {
    let difference = coefficients[0] - before;
    bits.write(first.codes[size_of(difference) as usize]);
    bits.value(difference);
    let mut zeros = 0u32;
    for &value in &coefficients[1..] {
        if value == 0 {
            zeros += 1;
            continue;
        }
        for _ in 0..zeros / 16 {
            bits.write(other.codes[0xf0]);
        }
        bits.write(other.codes[((zeros % 16) << 4 | size_of(value)) as usize]);
        bits.value(value);
        zeros = 0;
    }
    if zeros > 0 {
        bits.write(other.codes[0]);
    }
}

/// Bits of the magnitude of `value`.
fn size_of(value: i32) -> u32 {
    32 - value.unsigned_abs().leading_zeros()
}

/// Bits on their way to bytes; a byte of ones is followed by zeros, so that it is no marker.
struct BitWriter<'a> {
    out: &'a mut Vec<u8>,
    word: u32,
    count: u32,
}

impl BitWriter<'_> {
    fn write(&mut self, (code, length): (u16, u8)) {
        self.word = self.word << length | u32::from(code);
        self.count += u32::from(length);
        while self.count >= 8 {
            self.count -= 8;
            let byte = (self.word >> self.count) as u8;
            self.out.push(byte);
            if byte == 0xff {
                self.out.push(0);
            }
        }
        self.word &= (1 << self.count) - 1;
    }

    /// The bits that tell `value` from others of its size.
    fn value(&mut self, value: i32) {
        let size = size_of(value);
        let offset = if value < 0 { (1 << size) - 1 } else { 0 };
        self.write(((value + offset) as u16, size as u8));
    }

    /// Fills the last byte with ones.
    fn finish(&mut self) {
        let missing = (8 - self.count % 8) % 8;
        self.write(((1u16 << missing) - 1, missing as u8));
    }
}

#[cfg(test)]
mod tests {
    use std::{
        io::Write,
        process::{Command, Stdio},
    };

    use super::*;
    use crate::Image;

    fn picture(width: u32, height: u32) -> Image {
        let colour = |i: u32| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            [0.5 + 0.5 * (0.21 * x).sin(), 0.5 + 0.5 * (0.13 * y + 0.1 * x).cos(), x / width as f32]
        };
        Image::new(width, height, (0..width * height).flat_map(colour).collect()).unwrap()
    }

    fn psnr(width: u32, height: u32, quality: u8) -> (f64, usize) {
        let picture = picture(width, height);
        let file = picture.to_jpeg(quality).unwrap();
        let again = Image::decode(&file, [0.0; 3]).unwrap();
        assert_eq!(again.size(), (width, height));
        (crate::metric::psnr(&again, &picture).unwrap(), file.len())
    }

    #[test]
    fn pictures_of_any_size_read_back_close_to_what_they_were() {
        for (width, height) in [(1, 1), (7, 3), (8, 8), (17, 65), (200, 120)] {
            let (found, bytes) = psnr(width, height, 92);
            assert!(found > 36.0, "{width} x {height}: {found} dB, {bytes} bytes");
        }
        let (best, (coarse, small)) = (psnr(200, 120, 100), psnr(200, 120, 10));
        assert!(best.0 > 45.0 && coarse < 34.0 && small < best.1 / 4, "{best:?} {coarse} {small}");
    }

    /// Bytes red, green, blue per pixel that an installed ffmpeg reads from `file`; none without one.
    fn by_ffmpeg(file: &[u8]) -> Option<Vec<u8>> {
        let mut ffmpeg = Command::new("ffmpeg")
            .args(["-hide_banner", "-loglevel", "error", "-f", "mjpeg", "-i", "pipe:0"])
            .args([
                "-sws_flags",
                "accurate_rnd+full_chroma_int",
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
                "pipe:1",
            ])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .ok()?;
        // Small enough for the pipe: it need not be read meanwhile.
        ffmpeg.stdin.take().unwrap().write_all(file).unwrap();
        let output = ffmpeg.wait_with_output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.is_empty(), "{said}");
        Some(output.stdout)
    }

    #[test]
    fn another_decoder_shows_the_picture() {
        let picture = picture(61, 43);
        let Some(read) = by_ffmpeg(&picture.to_jpeg(92).unwrap()) else {
            assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "ffmpeg is missing");
            eprintln!("skipped: no ffmpeg is installed");
            return;
        };
        let read = Image::new(61, 43, read.iter().map(|&byte| f32::from(byte) / 255.0).collect()).unwrap();
        let found = crate::metric::psnr(&read, &picture).unwrap();
        assert!(found > 36.0, "{found} dB");
    }

    #[test]
    fn noise_of_full_range_overflows_nothing() {
        let mut state = 7u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            if state >> 31 == 1 { 1.0 } else { 0.0 }
        };
        let noise = Image::new(40, 24, (0..40 * 24 * 3).map(|_| next()).collect()).unwrap();
        let again = Image::decode(&noise.to_jpeg(100).unwrap(), [0.0; 3]).unwrap();
        assert!(crate::metric::psnr(&again, &noise).unwrap() > 30.0);
    }

    #[test]
    fn codes_are_all_that_the_standard_has() {
        let table = other_table();
        assert_eq!(table.symbols.len(), 162);
        let mut symbols = table.symbols.clone();
        symbols.sort_unstable();
        symbols.dedup();
        assert_eq!(symbols.len(), 162, "each symbol once");
        assert_eq!(table.codes[0x00], (0b1010, 4), "end of block, table K.5");
        assert_eq!(table.codes[0xf0], (0b111_1111_1001, 11), "sixteen zeros, table K.5");
        assert_eq!(table.codes[0xfa], (0xfffe, 16), "the last one, table K.5");
    }
}
