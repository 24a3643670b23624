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
/// Another magic or chunk, a length that contradicts the file's or that of a splat, negative scales, values
/// that are not numbers, or more than `limits` allow.
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
    let tail = chunk.size % RECORD;
    if tail > 0 {
        if !limits.keep_readable {
            let field = "size of the chunk in bytes";
            let allowed = format_args!("a multiple of {RECORD}, which a splat takes");
            return Err(FORMAT.malformed(field, chunk.size, allowed).at(8));
        }
        notes.push(format!("{tail} bytes after the last whole splat are ignored"));
    }
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
    let shown = records.map(MovingSplat::read).enumerate().filter(|(_, splat)| splat.alpha > 0.0);
    let mut splats = Vec::new();
    for (index, splat) in shown {
        if !limits.keep_readable {
            splat.check(index).map_err(|error| error.at(8 + length + index * RECORD))?;
        }
        splats.push(splat);
    }
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

    /// Refuses scales and widths of splat `index` that mean nothing.
    fn check(&self, index: usize) -> Result<(), ImportError> {
        // What is no number has no logarithm either, as is seen where all values are checked.
        if self.scale.iter().any(|&s| s < 0.0) {
            let found = format!("{:?}", self.scale);
            let allowed = "standard deviations, not negative";
            return Err(FORMAT.malformed(format!("scale of splat {index}"), found, allowed));
        }
        if self.width.is_nan() {
            let allowed = "a share of the clip";
            return Err(FORMAT.malformed(format!("width in time of splat {index}"), self.width, allowed));
        }
        Ok(())
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
        // A width that is no number makes opacities that are none, which leave the splat out.
        let width = if self.width < 1e-6 { 1e-6 } else { self.width };
        let share = self.distance(t) / width;
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
        log_scales: Track::Constant(splats.iter().map(|s| s.scale.map(f32::ln)).collect()),
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

    /// The sample with these bytes at `at` of its second splat.
    fn with(at: usize, bytes: &[u8]) -> Vec<u8> {
        let mut out = sample(3);
        let start = out.len() - 2 * RECORD + at;
        out[start..start + bytes.len()].copy_from_slice(bytes);
        out
    }

    #[test]
    fn scales_and_widths_that_mean_nothing_are_refused_or_leave_their_splat_out() {
        let half = |value: f32| f16::from_f32(value).to_bits().to_le_bytes();
        let keep = Limits { keep_readable: true, ..Limits::default() };
        for (at, value, says) in [
            (22, -0.5, "scale of splat 1"),
            (20, f32::NAN, "log-scale of Gaussian 1"),
            (62, f32::NAN, "width in time of splat 1"),
        ] {
            let bytes = with(at, &half(value));
            let error = parse(&bytes, 30.0, &Limits::default()).unwrap_err();
            assert!(error.to_string().contains(says), "{error}");
            let place = (bytes.len() - 2 * RECORD) as u64;
            assert!(error.offset.is_none_or(|offset| offset == place), "{error}");
            assert_eq!(parse(&bytes, 30.0, &keep).unwrap().max_count(), 2, "{says}");
        }
        // A scale of 0 is as small as there is, and what never shows may hold anything.
        assert!(parse(&with(20, &half(0.0)), 30.0, &Limits::default()).is_ok());
        let mut hidden = with(22, &half(-0.5));
        let alpha = hidden.len() - 2 * RECORD + 31;
        hidden[alpha] = 0;
        assert_eq!(parse(&hidden, 30.0, &Limits::default()).unwrap().max_count(), 2);
    }

    #[test]
    fn a_size_that_cuts_a_splat_is_refused_or_ignored() {
        let text = String::from_utf8_lossy(&sample(3)[8..]).into_owned();
        let at = 8 + text.find("192").unwrap();
        let mut cut = sample(3);
        cut[at..at + 3].copy_from_slice(b"150");
        let error = parse(&cut, 30.0, &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("size of the chunk") && error.contains("150"), "{error}");
        let scene = parse(&cut, 30.0, &Limits { keep_readable: true, ..Limits::default() }).unwrap();
        assert_eq!(scene.max_count(), 2);
        assert!(scene.notes[0].starts_with("22 bytes after the last whole splat"), "{:?}", scene.notes);
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
