//! Reads `.4dgs`: Gaussians that live for a while and move in straight lines, as the crate `fourdgs` decodes
//! them.
//!
//! At time t a Gaussian is at `position + motion (t - mu)`, and its opacity is faded by
//! `exp(-((t - mu) / sigma)² / 2)`, within its window and above the file's cutoff; it does not turn. The clip
//! is sampled at the frame rate asked for. Frames in which the same windows are open become one epoch.
//! Colours are of the screen, or linear where the file says so, and are then encoded. Absent, and refused by
//! name: files of keyframes and deltas, and of objects that move.

use ::fourdgs::{
    Error, ReadOptions,
    keyframe_delta_file::peek_temporal_model,
    quantization::sh_coefficient,
    serialization::MAGIC,
    stream_reader::{Scene as Decoded, read_from},
};
use codec_core::ShDegree;

use super::{
    Limits,
    error::{ErrorKind, Format, ImportError},
    snapshot::{logit, scene_error, screen, sh0_of_colour},
};
use crate::scene::{Attributes, Epoch, Scene, Track, Up};

const FORMAT: Format = Format::FourDgs;
/// First bytes of a file.
pub(super) const START: [u8; 8] = MAGIC;
/// The motion that is read.
const MODEL: &str = "gaussian-birth";
/// Share of a frame by which the instant at which windows are looked at is later than the frame, at most
/// [`LATEST`]: they are stored in fewer digits than frames have.
const LATER: f64 = 0.01;
/// The same in seconds: where frames are far apart, a share of that is past the end of a window.
const LATEST: f64 = 1e-3;
/// Bytes that a Gaussian takes in one frame: its centre and its opacity.
const FRAME_BYTES: u64 = 12 + 4;
/// Most frames: ten hours at thirty a second.
const MAX_FRAMES: f64 = 1_080_000.0;

/// Reads a `.4dgs` file at `frames_per_second`.
///
/// # Errors
/// A file that the format's own reader refuses, another model of motion, or more than `limits` allow.
pub fn parse(bytes: &[u8], frames_per_second: f64, limits: &Limits) -> Result<Scene, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    let model = peek_temporal_model(bytes).map_err(|error| refused(&error))?;
    if model != MODEL {
        return Err(FORMAT.unsupported("temporal model", model, format_args!("{MODEL} alone")));
    }
    let options = ReadOptions { recover_truncated: limits.keep_readable, max_sh_band: 3 };
    let decoded = read_from(bytes, &options).map_err(|error| refused(&error))?;
    limits.gaussians(FORMAT, decoded.gaussians.count() as u64)?;
    if !decoded.objects.tracks.is_empty() {
        return Err(FORMAT.unsupported(
            "object layer",
            "objects that move",
            "files without tracks of objects",
        ));
    }
    let frames = (decoded.duration_sec * frames_per_second).round().max(1.0);
    if frames.is_nan() || frames > MAX_FRAMES {
        let allowed = format_args!("up to {MAX_FRAMES}").to_string();
        return Err(FORMAT.error(ErrorKind::TooLarge, "frames", frames, allowed));
    }
    let clip = Clip { decoded: &decoded, frames_per_second };
    let epochs = clip.epochs(frames as usize, limits)?;
    let is_parted = epochs.len() > 1;
    let mut scene = Scene::new(epochs, frames_per_second).map_err(|e| scene_error(FORMAT, &e))?;
    scene.default_up = up(&decoded);
    scene.notes.push(format!("{} s sampled at {frames_per_second} frames per second", decoded.duration_sec));
    if is_parted {
        scene.notes.push(
            "identity is not stored from one window of visibility to the next: each is an epoch of its own"
                .to_owned(),
        );
    }
    if decoded.truncated {
        scene.notes.push("the file is cut off: what came before is kept".to_owned());
    }
    Ok(scene)
}

/// Which way the file says is up, if it does.
fn up(decoded: &Decoded) -> Option<Up> {
    if let Some(frame) = decoded.provenance.frame() {
        return [Up::X, Up::Y, Up::Z, Up::MinusX, Up::MinusY, Up::MinusZ]
            .get(usize::from(frame.up_axis))
            .copied();
    }
    match entry(decoded, "coordinate_system")? {
        "y-up-right-handed" => Some(Up::Y),
        "z-up-right-handed" => Some(Up::Z),
        _ => None,
    }
}

/// The value of a key in the file's metadata.
fn entry<'d>(decoded: &'d Decoded, key: &str) -> Option<&'d str> {
    let mut entries = decoded.metadata.iter().filter_map(|metadata| metadata.entries.get(key));
    entries.next().or_else(|| decoded.header.attributes.get(key)).map(String::as_str)
}

/// What the format's reader says.
fn refused(error: &Error) -> ImportError {
    let kind = match error {
        Error::Truncated(_) => ErrorKind::Truncated,
        Error::UnsupportedVersion(_)
        | Error::UnsupportedCodec(_)
        | Error::UnsupportedModel(_)
        | Error::UnsupportedOperation(_) => ErrorKind::Unsupported,
        _ => ErrorKind::Malformed,
    };
    FORMAT.error(kind, "content", error, "an undamaged file of version 1")
}

/// A decoded file and the rate at which it is looked at.
struct Clip<'d> {
    decoded: &'d Decoded,
    frames_per_second: f64,
}

impl Clip<'_> {
    /// Seconds of a frame.
    fn time(&self, frame: usize) -> f64 {
        frame as f64 / self.frames_per_second
    }

    /// The instant at which windows are looked at for `frame`, seconds.
    fn looked_at(&self, frame: usize) -> f64 {
        self.time(frame) + (LATER / self.frames_per_second).min(LATEST)
    }

    /// Whether Gaussian `i` exists at `frame`.
    fn is_open(&self, i: usize, frame: usize) -> bool {
        let set = &self.decoded.gaussians;
        let at = self.looked_at(frame);
        f64::from(set.win_lo[i]) <= at && at < f64::from(set.win_hi[i])
    }

    /// How visible Gaussian `i` is at `frame`: the factor on its opacity.
    fn share(&self, i: usize, frame: usize) -> f64 {
        let set = &self.decoded.gaussians;
        let sigma = f64::from(set.sigma_t[i]);
        let far = (self.time(frame) - f64::from(set.mu_t[i])) / sigma.max(1e-30);
        let share = if sigma.is_finite() { (-0.5 * far * far).exp() } else { 1.0 };
        if self.is_open(i, frame) && share >= self.decoded.header.cutoff { share } else { 0.0 }
    }

    /// The first of `frames` frames that is not before `instant`, seconds.
    fn first_at(&self, instant: f64, frames: usize) -> usize {
        let (mut low, mut high) = (0, frames);
        while low < high {
            let middle = low + (high - low) / 2;
            let is_before = self.looked_at(middle) < instant;
            (low, high) = if is_before { (middle + 1, high) } else { (low, middle) };
        }
        low
    }

    /// The clip in epochs: frames in which the same windows are open. Where none is, an epoch has a Gaussian
    /// that does not show.
    fn epochs(&self, frames: usize, limits: &Limits) -> Result<Vec<Epoch>, ImportError> {
        let set = &self.decoded.gaussians;
        let (windows, _) = set.window_table();
        let ends = windows.iter().flat_map(|&(low, high)| [low, high]);
        let mut starts: Vec<usize> = ends.map(|instant| self.first_at(instant, frames)).collect();
        starts.extend([0, frames]);
        starts.sort_unstable();
        starts.dedup();
        let work = (starts.len() as u64).saturating_mul(set.count() as u64);
        limits.bytes(FORMAT, "Gaussians in all windows", work)?;
        let mut epochs = Vec::with_capacity(starts.len());
        let mut left = limits.max_bytes;
        for pair in starts.windows(2) {
            let (first, end) = (pair[0], pair[1]);
            let mut rows: Vec<usize> = (0..set.count()).filter(|&i| self.is_open(i, first)).collect();
            if rows.is_empty() {
                rows.push(0);
            }
            let bytes = (rows.len() as u64).saturating_mul((end - first) as u64).saturating_mul(FRAME_BYTES);
            left = left.checked_sub(bytes).ok_or_else(|| {
                let allowed = format!("up to {} bytes in all", limits.max_bytes);
                FORMAT.error(ErrorKind::TooLarge, "frames", "more", allowed)
            })?;
            epochs.push(self.epoch(&rows, first, end)?);
        }
        Ok(epochs)
    }

    /// The Gaussians `rows` from frame `first` up to `end`.
    fn epoch(&self, rows: &[usize], first: usize, end: usize) -> Result<Epoch, ImportError> {
        let set = &self.decoded.gaussians;
        let three = |values: &[f32], i: usize| [values[3 * i], values[3 * i + 1], values[3 * i + 2]];
        let place = |i: usize, frame: usize| {
            let since = self.time(frame) - f64::from(set.mu_t[i]);
            let (from, motion) = (three(&set.positions, i), three(&set.motions, i));
            [0, 1, 2].map(|axis| (f64::from(from[axis]) + f64::from(motion[axis]) * since) as f32)
        };
        let opacity = |i: usize, frame: usize| {
            logit((f64::from(set.colors[4 * i + 3]) * self.share(i, frame)).clamp(0.0, 1.0) as f32)
        };
        let is_linear = entry(self.decoded, "color_space") == Some("linear-rec709-display");
        let colour = |i: usize| {
            [0, 1, 2].map(|channel| {
                let value = set.colors[4 * i + channel];
                sh0_of_colour(if is_linear { screen(value) } else { value })
            })
        };
        let degree = set.sh.as_ref().and_then(|_| ShDegree::new(set.sh_degree)).unwrap_or_default();
        let each = degree.rest_len() / 3;
        let mut sh_rest = Vec::new();
        if let Some(sh) = set.sh.as_ref().filter(|_| each > 0) {
            if set.sh_coefficients < each {
                let (found, allowed) = (set.sh_coefficients, format!("{each} at least"));
                return Err(FORMAT.malformed("coefficients of harmonics", found, allowed));
            }
            for &i in rows {
                let row = &sh[3 * set.sh_coefficients * i..][..3 * set.sh_coefficients];
                let value = |k: usize, channel: usize| sh_coefficient(row[channel * set.sh_coefficients + k]);
                sh_rest.extend((0..3 * each).map(|at| value(at / 3, at % 3) as f32));
            }
        }
        let frames = first..end;
        let attributes = Attributes {
            positions: Track::PerFrame(
                frames.clone().flat_map(|frame| rows.iter().map(move |&i| place(i, frame))).collect(),
            ),
            rotations: Track::Constant(rows.iter().map(|&i| wxyz(&set.rotations, i)).collect()),
            log_scales: Track::Constant(rows.iter().map(|&i| three(&set.scales, i).map(f32::ln)).collect()),
            opacity_logits: Track::PerFrame(
                frames.clone().flat_map(|frame| rows.iter().map(move |&i| opacity(i, frame))).collect(),
            ),
            sh0: Track::Constant(rows.iter().map(|&i| colour(i)).collect()),
            sh_rest,
            sh_degree: degree,
        };
        Epoch::new(frames.len(), attributes).map_err(|e| scene_error(FORMAT, &e))
    }
}

/// Quaternion `i` of a list of xyzw.
fn wxyz(rotations: &[f32], i: usize) -> [f32; 4] {
    [3, 0, 1, 2].map(|at| rotations[4 * i + at])
}

#[cfg(test)]
pub(super) mod tests {
    use ::fourdgs::{GaussianSet, SceneExtras, WriteOptions, records::Metadata, write_to_vec};

    use super::*;

    /// A file of 8 frames at 4 a second: one that stays and fades, one that moves and lives half the time.
    pub fn sample(colour_space: &str) -> Vec<u8> {
        let set = GaussianSet {
            positions: vec![0.0, 1.0, 2.0, 1.0, 0.0, 0.0],
            scales: vec![0.1; 6],
            rotations: vec![0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0],
            colors: vec![0.5, 0.25, 0.75, 0.5, 0.9, 0.8, 0.7, 0.6],
            motions: vec![0.0, 0.0, 0.0, 2.0, 0.0, -1.0],
            mu_t: vec![1.0, 1.0],
            sigma_t: vec![0.5, f32::INFINITY],
            win_lo: vec![0.0, 1.0],
            win_hi: vec![2.0, 2.0],
            sh: Some((0..18).map(|v| 100 + v).collect()),
            sh_coefficients: 3,
            sh_degree: 1,
            ..GaussianSet::default()
        };
        let entries = [("color_space", colour_space), ("coordinate_system", "z-up-right-handed")];
        let entries = entries.map(|(key, value)| (key.to_owned(), value.to_owned())).into();
        let metadata = vec![Metadata { name: "scene".to_owned(), entries }];
        let options = WriteOptions { min_chunk_gaussians: 1, ..WriteOptions::default() };
        write_to_vec(&set, 2.0, &options, &SceneExtras { metadata, ..SceneExtras::default() }).unwrap()
    }

    #[test]
    fn gaussians_live_move_and_fade() {
        let bytes = sample("srgb-rec709-display");
        let scene = parse(&bytes, 4.0, &Limits::default()).unwrap();
        assert_eq!(scene.default_up, Some(Up::Z));
        assert_eq!((scene.frames(), scene.epochs().len(), scene.max_count()), (8, 2, 2));
        assert_eq!([scene.epochs()[0].count(), scene.epochs()[0].frames()], [1, 4]);
        let near = |a: f32, b: f32, by: f32| assert!((a - b).abs() <= by, "{a} and {b}");
        // Three frames before the middle of its time, at a sigma of two frames.
        near(scene.instant(1).unwrap().gaussians[0].opacity, 0.5 * (-1.125f32).exp(), 0.01);
        let last = scene.instant(6).unwrap();
        let moving = last.gaussians.iter().find(|g| g.position[0] > 1.5).unwrap();
        near(moving.position[0], 2.0, 0.02);
        near(moving.position[2], -0.5, 0.02);
        near(moving.opacity, 0.6, 0.01);
        near(moving.rotation[1].abs(), 1.0, 0.01);
        near(0.5 + 0.282_094_8 * moving.sh0[0], 0.9, 0.01);
        near(moving.scale[1], 0.1, 0.002);
        let still = last.gaussians.iter().position(|g| g.position[1] > 0.9).unwrap();
        // Component-major in the file, channel by channel here: green's first coefficient is its fourth.
        near(last.sh_rest[9 * still + 1], sh_coefficient(103) as f32, 0.05);
        assert!(
            scene.notes.iter().any(|note| note.starts_with("identity is not stored")),
            "{:?}",
            scene.notes
        );
        // Where frames are further apart than windows are long, the first is that of the first instant still.
        let slow = parse(&bytes, 0.004, &Limits::default()).unwrap().instant(0).unwrap();
        assert_eq!(slow.gaussians.len(), 1);
        near(slow.gaussians[0].opacity, 0.5 * (-2.0f32).exp(), 0.01);
    }

    #[test]
    fn linear_colours_are_encoded() {
        let scene = parse(&sample("linear-rec709-display"), 4.0, &Limits::default()).unwrap();
        let colours: Vec<f32> =
            scene.instant(4).unwrap().gaussians.iter().map(|g| 0.5 + 0.282_094_8 * g.sh0[0]).collect();
        assert!(colours.iter().any(|v| (v - 0.735_357).abs() < 0.01), "{colours:?}");
    }

    #[test]
    fn what_is_not_read_is_refused_by_name() {
        let good = sample("srgb-rec709-display");
        let limits = Limits { max_gaussians: 1, ..Limits::default() };
        assert_eq!(parse(&good, 4.0, &limits).unwrap_err().kind, ErrorKind::TooLarge);
        let limits = Limits { max_bytes: good.len() as u64, ..Limits::default() };
        assert_eq!(parse(&good, 4000.0, &limits).unwrap_err().kind, ErrorKind::TooLarge);
        let cut = parse(&good[..good.len() / 2], 4.0, &Limits::default()).unwrap_err();
        assert!(matches!(cut.kind, ErrorKind::Truncated | ErrorKind::Malformed), "{cut}");
        assert!(parse(b"\x894DGS", 4.0, &Limits::default()).is_err());
    }

    /// Written by the format's own encoder in Python (`fourdgs` 0.6.0 of PyPI): forty Gaussians at
    /// random, half of which live in the second of two seconds.
    const REFERENCE: &[u8] = include_bytes!("../../../tests/golden/reference.4dgs");

    #[test]
    fn a_file_of_another_writer_is_what_its_own_reader_says() {
        let scene = parse(REFERENCE, 4.0, &Limits::default()).unwrap();
        assert_eq!(scene.frames(), 8);
        // Frame, visible Gaussians, sums of their centres and opacities, by `state_at` of that package.
        for (frame, visible, centre, opacity) in [
            (0, 15, [7.4745, 7.3939, 6.7297], 4.7965),
            (2, 18, [3.7689, 6.6959, 7.9292], 7.0459),
            (4, 40, [10.7533, 5.925, 12.28], 15.1827),
            (7, 36, [11.4894, -3.2086, 11.5704], 10.5968),
        ] {
            let instant = scene.instant(frame).unwrap();
            let shown: Vec<_> = instant.gaussians.iter().filter(|g| g.opacity > 1e-4).collect();
            assert_eq!(shown.len(), visible, "frame {frame}");
            for (axis, wanted) in centre.into_iter().enumerate() {
                let sum: f32 = shown.iter().map(|g| g.position[axis]).sum();
                assert!((sum - wanted).abs() < 1e-3, "frame {frame}: {sum} and {wanted}");
            }
            let sum: f32 = shown.iter().map(|g| g.opacity).sum();
            assert!((sum - opacity).abs() < 1e-3, "frame {frame}: {sum} and {opacity}");
        }
    }
}
