//! Reads `.splatv` of splaTV: splats whose positions are cubic in time and that fade in and out.
//!
//! ```text
//! u32 0x674b | u32 length of JSON | JSON: [{ type: "splat", size, texwidth, … }] | 64 bytes a splat
//! f32 x y z | half wxyz | half scales (linear), one unused | u8 r g b a | half 9 of motion, one unused
//! half 4 of turning | half centre, half width of the time that it shows
//! ```
//!
//! Time runs from 0 to 1 over the clip, whose length the file does not tell: it becomes [`FRAMES`] frames. At
//! `d` from the centre a splat is at `p + m₀ d + m₁ d² + m₂ d³`, turned to `q + ω d`, its opacity times
//! `exp(-(d / width)²)`. Axes are kept.

use codec_core::ShDegree;
use half::f16;
use serde::Deserialize;

use super::{
    Limits,
    bytes::{array, f32_at, u16_at, u32_at},
    error::{Format, ImportError},
    snapshot::{finished, logit, scene_error, sh0_of_colour},
};
use crate::scene::{Attributes, Scene, Track};

const FORMAT: Format = Format::Splatv;
/// First four bytes of a file.
pub(super) const MAGIC: [u8; 4] = 0x674bu32.to_le_bytes();
/// Bytes of a splat.
const RECORD: usize = 64;
/// Longest JSON, bytes: a few numbers and cameras.
const MAX_JSON: usize = 16 << 20;
/// Frames that the clip becomes.
pub const FRAMES: usize = 60;
/// Bytes that a splat takes in one frame.
const FRAME_BYTES: u64 = 12 + 16 + 4;

#[derive(Deserialize)]
struct Chunk {
    #[serde(rename = "type")]
    kind: String,
    size: usize,
}

/// Reads a `.splatv` file as a clip of [`FRAMES`] frames.
///
/// # Errors
/// Another magic or chunk, a length that contradicts the file's, values that are not numbers, or more than
/// `limits` allow.
pub fn parse(bytes: &[u8], frames_per_second: f64, limits: &Limits) -> Result<Scene, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    if array(bytes, 0) != Some(MAGIC) {
        return Err(FORMAT.malformed("magic", "other bytes", "0x674b"));
    }
    let length = u32_at(bytes, 4).ok_or_else(|| FORMAT.truncated("header", bytes.len() as u64, 8))? as usize;
    if length > MAX_JSON {
        return Err(FORMAT.malformed("JSON length", length, format_args!("up to {MAX_JSON} bytes")).at(4));
    }
    let text = bytes.get(8..8 + length);
    let text = text.ok_or_else(|| FORMAT.truncated("JSON", (bytes.len() - 8) as u64, length as u64).at(8))?;
    let chunks: Vec<Chunk> = serde_json::from_slice(text)
        .map_err(|e| FORMAT.malformed("JSON", e, "a list of chunks with type and size").at(8))?;
    let chunk = chunks.first().filter(|chunk| chunk.kind == "splat");
    let chunk = chunk.ok_or_else(|| FORMAT.malformed("chunk", "another type", "splat").at(8))?;
    let data = &bytes[8 + length..];
    let mut notes = Vec::new();
    let size = if chunk.size <= data.len() {
        chunk.size
    } else if limits.keep_readable {
        notes.push(format!("{} of {} bytes of splats are missing", chunk.size - data.len(), chunk.size));
        data.len()
    } else {
        return Err(FORMAT.truncated("splats", data.len() as u64, chunk.size as u64).at(8 + length));
    };
    let records = data[..size].chunks_exact(RECORD);
    limits.gaussians(FORMAT, records.len() as u64)?;
    limits.bytes(FORMAT, "frames", records.len() as u64 * FRAME_BYTES * FRAMES as u64)?;
    // Textures are padded with splats that never show.
    let splats: Vec<MovingSplat> = records.map(MovingSplat::read).filter(|splat| splat.alpha > 0.0).collect();
    limits.gaussians(FORMAT, splats.len() as u64)?;
    let epoch = finished(FRAMES, splats.len(), attributes(&splats), FORMAT, limits, &mut notes)?;
    let mut scene = Scene::new(vec![epoch], frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    notes.push(format!("the file does not tell how long the clip is: it is read as {FRAMES} frames"));
    scene.notes = notes;
    Ok(scene)
}

/// A splat and how it moves.
struct MovingSplat {
    position: [f32; 3],
    rotation: [f32; 4],
    scale: [f32; 3],
    colour: [f32; 3],
    alpha: f32,
    /// Linear, quadratic and cubic motion.
    motion: [[f32; 3]; 3],
    turning: [f32; 4],
    centre: f32,
    width: f32,
}

impl MovingSplat {
    fn read(record: &[u8]) -> Self {
        let float = |i: usize| f32_at(record, 4 * i).unwrap_or(f32::NAN);
        let half = |i: usize| u16_at(record, 2 * i).map_or(f32::NAN, |bits| f16::from_bits(bits).to_f32());
        let byte = |i: usize| record.get(i).map_or(0.0, |&v| f32::from(v) / 255.0);
        Self {
            position: [float(0), float(1), float(2)],
            rotation: [6, 7, 8, 9].map(half),
            scale: [10, 11, 12].map(half),
            colour: [28, 29, 30].map(byte),
            alpha: byte(31),
            motion: [[16, 17, 18], [19, 20, 21], [22, 23, 24]].map(|term| term.map(half)),
            turning: [26, 27, 28, 29].map(half),
            centre: half(30),
            width: half(31),
        }
    }

    /// How far frame `t` is from the centre of its time.
    fn distance(&self, t: usize) -> f32 {
        t as f32 / (FRAMES - 1) as f32 - self.centre
    }

    fn position(&self, t: usize) -> [f32; 3] {
        let d = self.distance(t);
        let [linear, square, cubic] = &self.motion;
        [0, 1, 2].map(|axis| self.position[axis] + d * (linear[axis] + d * (square[axis] + d * cubic[axis])))
    }

    fn rotation(&self, t: usize) -> [f32; 4] {
        let d = self.distance(t);
        [0, 1, 2, 3].map(|i| self.rotation[i] + d * self.turning[i])
    }

    fn opacity(&self, t: usize) -> f32 {
        let share = self.distance(t) / self.width.max(1e-6);
        self.alpha * (-share * share).exp()
    }
}

fn attributes(splats: &[MovingSplat]) -> Attributes {
    fn frames<T>(splats: &[MovingSplat], of: impl Fn(&MovingSplat, usize) -> T) -> Track<T> {
        let frame = |t: usize| splats.iter().map(move |splat| (splat, t));
        Track::PerFrame((0..FRAMES).flat_map(frame).map(|(splat, t)| of(splat, t)).collect())
    }
    Attributes {
        positions: frames(splats, MovingSplat::position),
        rotations: frames(splats, MovingSplat::rotation),
        log_scales: Track::Constant(splats.iter().map(|s| s.scale.map(|v| v.max(0.0).ln())).collect()),
        opacity_logits: frames(splats, |splat, t| logit(splat.opacity(t))),
        sh0: Track::Constant(splats.iter().map(|s| s.colour.map(sh0_of_colour)).collect()),
        sh_rest: Vec::new(),
        sh_degree: ShDegree::ZERO,
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::import::error::ErrorKind;

    pub fn sample(n: usize) -> Vec<u8> {
        let text = format!(r#"[{{"type":"splat","size":{},"texwidth":4,"texheight":{n}}}]"#, n * RECORD);
        let mut out = MAGIC.to_vec();
        out.extend((text.len() as u32).to_le_bytes());
        out.extend(text.as_bytes());
        for i in 0..n {
            for v in [i as f32, 0.0, 2.0] {
                out.extend(v.to_le_bytes());
            }
            let mut halves = |values: &[f32]| {
                out.extend(values.iter().flat_map(|&v| f16::from_f32(v).to_bits().to_le_bytes()));
            };
            halves(&[1.0, 0.0, 0.0, 0.0, 0.25, 0.5, 0.125, 0.0]);
            out.extend([255, 0, 128, 204]);
            let mut halves = |values: &[f32]| {
                out.extend(values.iter().flat_map(|&v| f16::from_f32(v).to_bits().to_le_bytes()));
            };
            halves(&[1.0, 0.0, 0.0, 2.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0]);
            halves(&[0.0, 1.0, 0.0, 0.0]);
            halves(&[0.0, 0.5]);
        }
        out
    }

    #[test]
    fn splats_move_turn_and_fade() {
        let scene = parse(&sample(3), 30.0, &Limits::default()).unwrap();
        assert_eq!((scene.frames(), scene.max_count()), (FRAMES, 3));
        let (first, last) = (scene.instant(0).unwrap(), scene.instant(FRAMES - 1).unwrap());
        assert_eq!(first.gaussians[2].position, [2.0, 0.0, 2.0]);
        // 1 + 2 + 4 at the end of the clip.
        assert_eq!(last.gaussians[2].position, [9.0, 0.0, 2.0]);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        assert!((last.gaussians[0].rotation[1] - half).abs() < 1e-6);
        assert!((first.gaussians[0].opacity - 0.8).abs() < 1e-5);
        assert!((last.gaussians[0].opacity - 0.8 * (-4.0f32).exp()).abs() < 1e-4);
        assert!((first.gaussians[0].scale[1] - 0.5).abs() < 1e-6);
    }

    #[test]
    fn splats_that_are_no_numbers_are_left_out() {
        let mut bad = sample(3);
        let second = bad.len() - 2 * RECORD;
        bad[second..second + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        assert!(parse(&bad, 30.0, &Limits::default()).unwrap_err().to_string().contains("Gaussian 1"));
        let keep = Limits { keep_readable: true, ..Limits::default() };
        let scene = parse(&bad, 30.0, &keep).unwrap();
        assert_eq!((scene.frames(), scene.max_count()), (FRAMES, 2));
        assert_eq!(scene.instant(FRAMES - 1).unwrap().gaussians[1].position, [9.0, 0.0, 2.0]);
        assert!(scene.notes[0].starts_with("1 Gaussians left out"), "{:?}", scene.notes);
    }

    #[test]
    fn lies_are_named() {
        let good = sample(3);
        let error = parse(&good[..good.len() - 1], 30.0, &Limits::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Truncated, "{error}");
        let limits = Limits { keep_readable: true, ..Limits::default() };
        assert_eq!(parse(&good[..good.len() - 1], 30.0, &limits).unwrap().max_count(), 2);
        let mut long = good.clone();
        long[4..8].copy_from_slice(&u32::MAX.to_le_bytes());
        assert!(parse(&long, 30.0, &limits).unwrap_err().to_string().contains("JSON length"));
        let few = Limits { max_bytes: 10_000, ..Limits::default() };
        assert!(parse(&sample(100), 30.0, &few).unwrap_err().to_string().contains("frames"));
        assert!(parse(b"none", 30.0, &limits).unwrap_err().to_string().contains("magic"));
        assert!(parse(&good, f64::NAN, &limits).is_err());
    }
}
