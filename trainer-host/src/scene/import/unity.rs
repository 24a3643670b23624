//! Reads the Unity Gaussian Splatting asset, version 20231020, in its medium-quality layout.
//!
//! A frame is `NAME.asset` (YAML) and planes `NAME_{chk,pos,oth,col}.bytes`, with `_shs` where
//! harmonics are kept. 256 Gaussians share a chunk of 64 bytes of ranges:
//!
//! ```text
//! chk  4 x half pair r g b a | 3 x (f32 min, f32 max) position | 3 x half pair scale | 3 x half pair sh
//! pos  u32: 11-10-11 bits, x lowest
//! oth  u32: 10-10-10-2 rotation, three smaller of xyzw | u32: 11-10-11 scale, to be raised to the 8th
//! col  RGBA8, 2048 wide, 16x16 tile per chunk, Morton order inside it
//! shs  15 x u16 of 5-6-5 bits, r lowest, 2 bytes unused
//! ```
//!
//! The planes hold the axes of the PLY the asset was made from; the engine mirrors the object, not the
//! data, so they are kept. Other layouts of the same asset (float, BC7, palettes) are refused by name.

use codec_core::ShDegree;
use half::f16;

use super::{
    Limits,
    bytes::{array, f32_at, lerp, u16_at, u32_at, unorm},
    error::{Format, ImportError},
    snapshot::{Columns, Snapshot, logit, sh0_of_colour, smallest_three},
};

const FORMAT: Format = Format::Unity;
const CHUNK: usize = 256;
const CHUNK_BYTES: usize = 64;
const TEXTURE_WIDTH: usize = 2048;
const TILE: usize = 16;

/// The files of one frame.
#[derive(Clone, Copy, Debug)]
pub struct Asset<'a> {
    /// `NAME.asset`
    pub description: &'a [u8],
    /// `NAME_chk.bytes`
    pub chunks: &'a [u8],
    /// `NAME_pos.bytes`
    pub positions: &'a [u8],
    /// `NAME_oth.bytes`
    pub others: &'a [u8],
    /// `NAME_col.bytes`
    pub colours: &'a [u8],
    /// `NAME_shs.bytes`, where there is one.
    pub harmonics: Option<&'a [u8]>,
}

impl Asset<'_> {
    /// How many of the first `count` Gaussians are in all planes but that of harmonics, and how many of those
    /// in that one too.
    fn whole(&self, count: usize) -> (usize, usize) {
        let chunks = self.chunks.len() / CHUNK_BYTES * CHUNK;
        let count = count.min(chunks).min(self.positions.len() / 4).min(self.others.len() / 8);
        let has_texel = |index: &usize| (texel_of(*index) + 1) * 4 <= self.colours.len();
        let count = (0..count).take_while(has_texel).count();
        (count, self.harmonics.map_or(count, |plane| count.min(plane.len() / 32)))
    }
}

/// Reads one frame.
///
/// # Errors
/// A description of another version or layout, planes shorter than the count needs (with `keep_readable`:
/// than one Gaussian needs), or more than `limits` allow.
pub fn parse(asset: &Asset<'_>, limits: &Limits) -> Result<Snapshot, ImportError> {
    let described = described_count(asset.description, limits)?;
    let count = described;
    let chunks = count.div_ceil(CHUNK);
    let rows = chunks.div_ceil(TEXTURE_WIDTH / TILE) * TILE;
    for (name, plane, needed) in [
        ("_chk", asset.chunks, chunks * CHUNK_BYTES),
        ("_pos", asset.positions, count * 4),
        ("_oth", asset.others, count * 8),
        ("_col", asset.colours, rows * TEXTURE_WIDTH * 4),
        ("_shs", asset.harmonics.unwrap_or(&[]), asset.harmonics.map_or(0, |_| count * 32)),
    ] {
        limits.bytes(FORMAT, name, plane.len() as u64)?;
        if plane.len() < needed && !limits.keep_readable {
            return Err(FORMAT.truncated(name, plane.len() as u64, needed as u64));
        }
    }
    let mut notes = Vec::new();
    let (count, with_harmonics) = asset.whole(count);
    if count < described {
        notes.push(format!("of {described} Gaussians the first {count} are whole; the rest is left out"));
    }
    if with_harmonics < count {
        notes.push(format!("{} Gaussians lack harmonics, which are left out", count - with_harmonics));
    }

    let degree = if asset.harmonics.is_some() { ShDegree::MAX } else { ShDegree::ZERO };
    let mut columns = Columns::with_capacity(count, degree);
    for index in 0..count {
        let chunk = Ranges::read(&asset.chunks[index / CHUNK * CHUNK_BYTES..]);
        let word = |plane: &[u8], at: usize| u32_at(plane, at).unwrap_or(0);
        let position = eleven_ten_eleven(word(asset.positions, index * 4));
        columns.positions.push([0, 1, 2].map(|i| chunk.position[i].at(position[i])));
        columns.rotations.push(quaternion(word(asset.others, index * 8)));
        let scale = eleven_ten_eleven(word(asset.others, index * 8 + 4));
        columns.log_scales.push([0, 1, 2].map(|i| 8.0 * chunk.scale[i].at(scale[i]).ln()));
        let texel: [u8; 4] = array(asset.colours, texel_of(index) * 4).unwrap_or_default();
        let rgba = [0, 1, 2, 3].map(|i| chunk.colour[i].at(f32::from(texel[i]) / 255.0));
        columns.sh0.push([0, 1, 2].map(|i| sh0_of_colour(rgba[i])));
        columns.opacity_logits.push(logit(opacity(rgba[3])));
        if let Some(plane) = asset.harmonics {
            for coefficient in 0..degree.rest_len() / 3 {
                if index >= with_harmonics {
                    columns.sh_rest.extend([0.0; 3]);
                    continue;
                }
                let packed = u32::from(u16_at(plane, index * 32 + coefficient * 2).unwrap_or(0));
                let rgb = [unorm(packed, 0, 5), unorm(packed, 5, 6), unorm(packed, 11, 5)];
                columns.sh_rest.extend([0, 1, 2].map(|i| chunk.harmonics[i].at(rgb[i])));
            }
        }
    }
    columns.finish(FORMAT, limits, notes)
}

/// How many Gaussians a description promises, if it is of the version and layout read here.
pub(super) fn described_count(description: &[u8], limits: &Limits) -> Result<usize, ImportError> {
    let text = std::str::from_utf8(description)
        .map_err(|e| FORMAT.malformed(".asset", "bytes that are not text", "YAML").at(e.valid_up_to()))?;
    for (field, allowed) in [
        ("m_FormatVersion", 20_231_020),
        ("m_PosFormat", 2),
        ("m_ScaleFormat", 2),
        ("m_SHFormat", 3),
        ("m_ColorFormat", 2),
    ] {
        let found = number(text, field)?;
        if found != allowed {
            return Err(FORMAT.unsupported(field, found, allowed));
        }
    }
    limits.gaussians(FORMAT, number(text, "m_SplatCount")?)
}

/// The number after `field:` in the description.
fn number(text: &str, field: &str) -> Result<u64, ImportError> {
    let line = text.lines().find_map(|l| l.trim_start().strip_prefix(field)?.strip_prefix(':'));
    let value = line.ok_or_else(|| FORMAT.malformed(field, "nothing", "a line in the .asset file"))?.trim();
    value.parse().map_err(|_| FORMAT.malformed(field, value, "a number"))
}

#[derive(Clone, Copy)]
struct Range(f32, f32);

impl Range {
    fn halves(bytes: &[u8], offset: usize) -> Self {
        let half = |at| f16::from_bits(u16_at(bytes, at).unwrap_or(0)).to_f32();
        Self(half(offset), half(offset + 2))
    }

    fn floats(bytes: &[u8], offset: usize) -> Self {
        let float = |at| f32_at(bytes, at).unwrap_or(0.0);
        Self(float(offset), float(offset + 4))
    }

    fn at(self, t: f32) -> f32 {
        lerp(self.0, self.1, t)
    }
}

struct Ranges {
    colour: [Range; 4],
    position: [Range; 3],
    scale: [Range; 3],
    harmonics: [Range; 3],
}

impl Ranges {
    fn read(bytes: &[u8]) -> Self {
        Self {
            colour: [0, 4, 8, 12].map(|o| Range::halves(bytes, o)),
            position: [16, 24, 32].map(|o| Range::floats(bytes, o)),
            scale: [40, 44, 48].map(|o| Range::halves(bytes, o)),
            harmonics: [52, 56, 60].map(|o| Range::halves(bytes, o)),
        }
    }
}

fn eleven_ten_eleven(word: u32) -> [f32; 3] {
    [unorm(word, 0, 11), unorm(word, 11, 10), unorm(word, 21, 11)]
}

fn quaternion(word: u32) -> [f32; 4] {
    let three =
        [0, 10, 20].map(|s| unorm(word, s, 10) * std::f32::consts::SQRT_2 - std::f32::consts::FRAC_1_SQRT_2);
    let [x, y, z, w] = smallest_three(three, (word >> 30) as usize);
    [w, x, y, z]
}

/// Stored alpha spends its steps around 0.5; this undoes it.
fn opacity(stored: f32) -> f32 {
    let v = (stored - 0.5) / 2.0;
    (0.5 + v.signum() * v.abs().sqrt()).clamp(0.0, 1.0)
}

/// The texel of a Gaussian: its chunk's tile, then even bits across and odd bits down.
fn texel_of(index: usize) -> usize {
    let (tile, inside) = (index / CHUNK, index % CHUNK);
    let even = |v: usize| (0..4).fold(0, |sum, bit| sum | (v >> (2 * bit) & 1) << bit);
    let tiles = TEXTURE_WIDTH / TILE;
    let x = tile % tiles * TILE + even(inside);
    let y = tile / tiles * TILE + even(inside >> 1);
    y * TEXTURE_WIDTH + x
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::import::error::ErrorKind;

    pub struct Sample {
        pub description: String,
        pub planes: [Vec<u8>; 5],
    }

    impl Sample {
        pub fn asset(&self) -> Asset<'_> {
            Asset {
                description: self.description.as_bytes(),
                chunks: &self.planes[0],
                positions: &self.planes[1],
                others: &self.planes[2],
                colours: &self.planes[3],
                harmonics: Some(&self.planes[4]),
            }
        }
    }

    pub fn sample(n: usize) -> Sample {
        let description = format!(
            "%YAML 1.1\nMonoBehaviour:\n  m_FormatVersion: 20231020\n  m_SplatCount: {n}\n  m_PosFormat: \
             2\n  \
             m_ScaleFormat: 2\n  m_SHFormat: 3\n  m_ColorFormat: 2\n"
        );
        let mut chunk = Vec::new();
        let pair = |lo: f32, hi: f32| {
            let mut out = f16::from_f32(lo).to_le_bytes().to_vec();
            out.extend(f16::from_f32(hi).to_le_bytes());
            out
        };
        for _ in 0..4 {
            chunk.extend(pair(0.0, 1.0));
        }
        for v in [-1.0f32, 1.0, -2.0, 2.0, 0.0, 4.0] {
            chunk.extend(v.to_le_bytes());
        }
        for _ in 0..3 {
            chunk.extend(pair(0.25, 0.5));
        }
        for _ in 0..3 {
            chunk.extend(pair(-1.0, 1.0));
        }
        let others = (0..n)
            .flat_map(|i| [(3u32 << 30 | 0x1ff << 20 | 0x1ff << 10 | 0x1ff), i as u32 % 2048])
            .flat_map(u32::to_le_bytes);
        Sample {
            description,
            planes: [
                chunk.repeat(n.div_ceil(CHUNK)),
                (0..n).flat_map(|i| (i as u32).to_le_bytes()).collect(),
                others.collect(),
                (0..TEXTURE_WIDTH * TILE).flat_map(|i| [i as u8, 0, 255, 128]).collect(),
                vec![0xff; n * 32],
            ],
        }
    }

    #[test]
    fn planes_unpack() {
        let s = parse(&sample(300).asset(), &Limits::default()).unwrap();
        let a = s.epoch.attributes();
        assert_eq!(a.positions.frame(0, 300)[0], [-1.0, -2.0, 0.0]);
        assert!((a.log_scales.frame(0, 300)[0][0] - 8.0 * 0.25f32.ln()).abs() < 1e-5);
        assert!(a.rotations.frame(0, 300)[0][0] > 0.7);
        assert_eq!(a.sh_rest.len(), 300 * 45);
        assert!(a.sh_rest.iter().all(|&v| v == 1.0));
    }

    #[test]
    fn what_is_whole_is_read() {
        let keep = Limits { keep_readable: true, ..Limits::default() };
        let whole = parse(&sample(300).asset(), &keep).unwrap();
        assert!(whole.notes.is_empty());
        // Of colours a whole row of texels goes, which the second Gaussian of its tile is the first to need.
        for (plane, cut, count, bands) in [
            (0, 1, 256, 256),
            (1, 4 * 10 + 1, 289, 289),
            (2, 8, 299, 299),
            (3, 4 * 15 * 2048, 2, 2),
            (4, 33, 300, 298),
        ] {
            let mut s = sample(300);
            let left = s.planes[plane].len() - cut;
            s.planes[plane].truncate(left);
            assert_eq!(parse(&s.asset(), &Limits::default()).unwrap_err().kind, ErrorKind::Truncated);
            let part = parse(&s.asset(), &keep).unwrap();
            let (a, b) = (part.epoch.attributes(), whole.epoch.attributes());
            assert_eq!((part.epoch.count(), part.notes.len()), (count, 1), "plane {plane}");
            assert_eq!(a.positions.frame(0, count), &b.positions.frame(0, 300)[..count]);
            assert_eq!(a.sh_rest[..bands * 45], b.sh_rest[..bands * 45]);
            assert!(a.sh_rest[bands * 45..].iter().all(|&v| v == 0.0), "plane {plane}");
        }
        let mut s = sample(300);
        s.planes[2].clear();
        assert_eq!(parse(&s.asset(), &keep).unwrap_err().kind, ErrorKind::Empty);
    }

    #[test]
    fn texels_follow_tiles_and_morton_order() {
        assert_eq!([0, 1, 2, 3, 4].map(texel_of), [0, 1, 2048, 2049, 2]);
        assert_eq!(texel_of(256), 16);
        assert_eq!(texel_of(128 * 256), 16 * 2048);
    }

    #[test]
    fn other_layouts_and_short_planes_are_refused_by_name() {
        let mut s = sample(4);
        s.planes[1].pop();
        let error = parse(&s.asset(), &Limits::default()).unwrap_err();
        assert_eq!((error.kind, &*error.field), (ErrorKind::Truncated, "_pos"));
        s.description = s.description.replace("m_ColorFormat: 2", "m_ColorFormat: 3");
        let error = parse(&s.asset(), &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("m_ColorFormat"), "{error}");
    }
}
