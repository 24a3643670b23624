//! Writes SPZ, version 3 (one gzip stream) and version 4 (a zstd stream per plane).
//!
//! Lossy: positions to `2^-fraction_bits` units (12 by default: a quarter of a millimetre in metres; more
//! where Gaussians are so small that it would show), scales to 1/16 of a natural log from e^-10 to e^5.9,
//! opacity and colour to a byte, rotations to ten bits a component, harmonics to a byte on a grid of five
//! bits (degree 1) and four (above). Positions beyond what 24 bits hold at the requested fraction get fewer
//! fraction bits, chosen per frame, so nothing wraps.

use std::io::{self, Write};

use crate::{
    import::{
        snapshot::SH_C0,
        spz::{COLOUR_SCALE, LEAST_LOG_SCALE, LOG_SCALE_STEP, MAGIC},
    },
    scene::Epoch,
};

/// Which version to write.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Version {
    /// One gzip stream; the most widely read.
    #[default]
    V3,
    /// A zstd stream per plane: smaller, and planes can be read alone.
    V4,
}

/// How to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SpzOptions {
    /// Which version.
    pub version: Version,
    /// Fraction bits of positions, at most 23; fewer are used where positions would not fit.
    pub fraction_bits: u8,
    /// Whether Gaussians are dimmed as much as they are widened.
    pub antialiased: bool,
}

impl Default for SpzOptions {
    fn default() -> Self {
        Self { version: Version::V3, fraction_bits: USUAL_FRACTION_BITS, antialiased: false }
    }
}

/// Fraction bits that the format's own writer uses.
const USUAL_FRACTION_BITS: u8 = 12;
/// Most fraction bits: those of 24 bits but the sign.
const MOST_FRACTION_BITS: u8 = 23;
/// Steps of positions that a small Gaussian is wide, at least.
const STEPS_PER_SIZE: f32 = 8.0;

/// Fraction bits at which positions in frame `t` of `epoch` are fine beside the Gaussians: the step is an
/// eighth, or less, of the size that nine of ten Gaussians exceed, and at most the usual one.
pub(super) fn fine_fraction_bits(epoch: &Epoch, t: usize) -> u8 {
    let scales = epoch.attributes().log_scales.frame(t, epoch.count());
    // The format has none that are smaller.
    let size = |s: &[f32; 3]| ((s[0] + s[1] + s[2]) / 3.0).max(LEAST_LOG_SCALE);
    let mut sizes: Vec<f32> = scales.iter().map(size).collect();
    let tenth = sizes.len() / 10;
    if sizes.is_empty() {
        return USUAL_FRACTION_BITS;
    }
    let (_, small, _) = sizes.select_nth_unstable_by(tenth, f32::total_cmp);
    let needed = (STEPS_PER_SIZE / small.exp()).log2().ceil();
    needed.clamp(f32::from(USUAL_FRACTION_BITS), f32::from(MOST_FRACTION_BITS)) as u8
}

/// Frame `t` of `epoch` as SPZ. `t` must be below the epoch's frame count.
///
/// # Errors
/// More Gaussians than the format counts, positions beyond ±8388607 units, or a compressor's refusal.
pub fn encode(epoch: &Epoch, t: usize, options: &SpzOptions) -> io::Result<Vec<u8>> {
    let count = u32::try_from(epoch.count()).map_err(|_| refused("more Gaussians than SPZ counts"))?;
    let fraction_bits = fraction_bits(epoch, t, options.fraction_bits)?;
    let planes = planes(epoch, t, fraction_bits);
    let degree = epoch.attributes().sh_degree.get();
    let (mut header, flags) = (MAGIC.to_vec(), u8::from(options.antialiased));
    let version: u32 = if options.version == Version::V3 { 3 } else { 4 };
    header.extend(version.to_le_bytes());
    header.extend(count.to_le_bytes());
    match options.version {
        Version::V3 => {
            header.extend([degree, fraction_bits, flags, 0]);
            let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
            gzip.write_all(&header)?;
            for plane in &planes {
                gzip.write_all(plane)?;
            }
            gzip.finish()
        }
        Version::V4 => {
            let streams = planes.iter().filter(|p| !p.is_empty()).count().max(5);
            header.extend([degree, fraction_bits, flags, streams as u8]);
            header.extend(32u32.to_le_bytes());
            header.extend([0; 12]);
            let packed = planes[..streams]
                .iter()
                .map(|plane| zstd::stream::encode_all(&plane[..], 12))
                .collect::<io::Result<Vec<_>>>()?;
            for (packed, plane) in packed.iter().zip(&planes) {
                header.extend((packed.len() as u64).to_le_bytes());
                header.extend((plane.len() as u64).to_le_bytes());
            }
            packed.iter().for_each(|p| header.extend(p));
            Ok(header)
        }
    }
}

/// The planes of frame `t` of `epoch` before compression, in the order in which a file holds them, and the
/// fraction bits of positions.
///
/// # Errors
/// Positions beyond ±8388607 units.
pub fn unpacked(epoch: &Epoch, t: usize, options: &SpzOptions) -> io::Result<(u8, [Vec<u8>; 6])> {
    let fraction_bits = fraction_bits(epoch, t, options.fraction_bits)?;
    Ok((fraction_bits, planes(epoch, t, fraction_bits)))
}

fn refused(why: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, why)
}

/// The Gaussian with the largest coordinate in frame `t` of `epoch`, its position, and the magnitude of that
/// coordinate, scene units.
fn furthest(epoch: &Epoch, t: usize) -> (usize, [f32; 3], f32) {
    let positions = epoch.attributes().positions.frame(t, epoch.count());
    let mut found = (0, positions.first().copied().unwrap_or_default(), 0.0);
    for (i, position) in positions.iter().enumerate() {
        let reach = position.iter().fold(0.0f32, |m, v| m.max(v.abs()));
        if reach > found.2 {
            found = (i, *position, reach);
        }
    }
    found
}

/// What is said where positions in frame `t` of `epoch` are rounded more coarsely than the sizes of its
/// Gaussians call for, since one is so far away.
pub(super) fn coarse_positions(epoch: &Epoch, t: usize) -> Option<String> {
    let called_for = fine_fraction_bits(epoch, t);
    // What does not fit at all is refused when it is written.
    let written = fraction_bits(epoch, t, called_for).ok().filter(|written| *written < called_for)?;
    let (at, position, _) = furthest(epoch, t);
    let step = |bits: u8| 1.0 / (1u32 << bits) as f32;
    Some(format!(
        "positions are rounded to {} scene units, where the sizes of the Gaussians call for {}: the \
         furthest, Gaussian {at}, is at {position:?}, and the format has one step for all",
        step(written),
        step(called_for)
    ))
}

/// Gaussians of `epoch` that have a harmonic above band 0 which the format does not hold.
pub(super) fn beyond_in_harmonics(epoch: &Epoch) -> usize {
    super::beyond_in_harmonics(epoch, |place, value| {
        // Half a bucket beyond is still the nearest byte.
        let half = 0.5 * bucket(place);
        (-half..=255.0 + half).contains(&(value * 128.0 + 128.0))
    })
}

/// Width of the grid of the harmonic at `place` in its row: the nine values of degree 1 come first, on the
/// finer one.
fn bucket(place: usize) -> f32 {
    if place < 9 { 8.0 } else { 16.0 }
}

/// Fraction bits, at most `requested`, at which the furthest position fits in 24 bits.
fn fraction_bits(epoch: &Epoch, t: usize, requested: u8) -> io::Result<u8> {
    let (at, found, furthest) = furthest(epoch, t);
    (0..=requested.min(MOST_FRACTION_BITS))
        .rev()
        .find(|&bits| f64::from(furthest) * f64::from(1u32 << bits) + 0.5 < 8_388_607.0)
        .ok_or_else(|| {
            refused(format!("SPZ: position of Gaussian {at} is {found:?}; up to 8388607 units are allowed"))
        })
}

fn planes(epoch: &Epoch, t: usize, fraction_bits: u8) -> [Vec<u8>; 6] {
    let (n, a) = (epoch.count(), epoch.attributes());
    let step = (1u32 << fraction_bits) as f32;
    let fixed = |v: f32| ((v * step).round() as i32).to_le_bytes();
    let byte = |v: f32| v.round().clamp(0.0, 255.0) as u8;
    let positions = a.positions.frame(t, n).iter().flatten().flat_map(|&v| {
        let [low, middle, high, _] = fixed(v);
        [low, middle, high]
    });
    let alphas = a.opacity_logits.frame(t, n).iter().map(|o| byte(255.0 / (1.0 + (-o).exp())));
    let colours = a.sh0.frame(t, n).iter().flatten().map(|c| byte((c * COLOUR_SCALE + 0.5) * 255.0));
    let scales =
        a.log_scales.frame(t, n).iter().flatten().map(|s| byte((s - LEAST_LOG_SCALE) / LOG_SCALE_STEP));
    let rotations = a.rotations.frame(t, n).iter().flat_map(|q| pack_rotation(*q).to_le_bytes());
    let rest = a.sh_degree.rest_len().max(1);
    let harmonics = a.sh_rest.iter().enumerate().map(|(i, &v)| {
        let bucket = bucket(i % rest);
        byte(((v * 128.0 + 128.0) / bucket).round() * bucket)
    });
    [
        positions.collect(),
        alphas.collect(),
        colours.collect(),
        scales.collect(),
        rotations.collect(),
        harmonics.collect(),
    ]
}

/// The word `import::spz` unpacks: two bits for the largest of xyzw, then sign and nine bits of
/// magnitude for each of the others.
fn pack_rotation([w, x, y, z]: [f32; 4]) -> u32 {
    let q = [x, y, z, w];
    let largest = (1..4).fold(0, |best, i| if q[i].abs() > q[best].abs() { i } else { best });
    let flip = q[largest] < 0.0;
    let mut word = largest as u32;
    for (_, v) in q.iter().enumerate().filter(|(i, _)| *i != largest) {
        let magnitude = (511.0 * (v.abs() / std::f32::consts::FRAC_1_SQRT_2)).round().min(511.0) as u32;
        word = word << 10 | u32::from((*v < 0.0) != flip) << 9 | magnitude;
    }
    word
}

/// Largest error of each attribute after a round trip at `fraction_bits`, by construction.
///
/// Positions and scales: half a step. Opacity and colour: half of 1/255, colour divided by its scale
/// (in `sh0`). Rotation components: half of `1/√2 / 511`, and what the derived one adds. Harmonics:
/// half a bucket of 128ths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Scene units.
    pub position: f32,
    /// Natural logs.
    pub log_scale: f32,
    /// Of 0..=1.
    pub opacity: f32,
    /// Display colour, of 0..=1.
    pub colour: f32,
    /// Of each quaternion component.
    pub rotation: f32,
    /// Of each coefficient of degree 1, and above.
    pub harmonics: (f32, f32),
}

impl Tolerance {
    /// The tolerance at `fraction_bits`.
    pub fn new(fraction_bits: u8) -> Self {
        Self {
            position: 0.5 / (1u32 << fraction_bits) as f32,
            log_scale: 0.5 / 16.0,
            opacity: 0.5 / 255.0,
            colour: 0.5 / 255.0 / COLOUR_SCALE * SH_C0,
            rotation: 3.0 * 0.5 * std::f32::consts::FRAC_1_SQRT_2 / 511.0,
            harmonics: (4.0 / 128.0, 8.0 / 128.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::{self, Identity, Limits, synth};
    use codec_core::ShDegree;
    use rand::RngExt;
    use rand_pcg::rand_core::SeedableRng;

    fn random(n: usize, extent: f32) -> Epoch {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(3);
        let mut within = |low: f32, high: f32| low + (high - low) * rng.random::<f32>();
        let mut vectors = |low, high| (0..n).map(|_| [0; 3].map(|_| within(low, high))).collect::<Vec<_>>();
        let (positions, log_scales, sh0) = (vectors(-extent, extent), vectors(-9.9, 5.9), vectors(-1.7, 1.7));
        let rotations = (0..n).map(|_| [0; 4].map(|_| within(-1.0, 1.0))).collect();
        let opacity_logits = (0..n).map(|_| within(-8.0, 8.0)).collect();
        let sh_rest = (0..n * 45).map(|_| within(-0.9, 0.8)).collect();
        Epoch::new(
            1,
            crate::Attributes {
                positions: crate::Track::Constant(positions),
                rotations: crate::Track::Constant(rotations),
                log_scales: crate::Track::Constant(log_scales),
                opacity_logits: crate::Track::Constant(opacity_logits),
                sh0: crate::Track::Constant(sh0),
                sh_rest,
                sh_degree: ShDegree::MAX,
            },
        )
        .unwrap()
    }

    fn agree(epoch: &Epoch, back: &Epoch, fraction_bits: u8) {
        let tolerance = Tolerance::new(fraction_bits);
        let slack = 1.0 + 1e-3;
        let (a, b) = (epoch.instant(0), back.instant(0));
        assert_eq!(a.gaussians.len(), b.gaussians.len());
        for (x, y) in a.gaussians.iter().zip(&b.gaussians) {
            let dot: f32 = x.rotation.iter().zip(y.rotation).map(|(p, q)| p * q).sum();
            let within = |p: &[f32], q: &[f32], limit: f32, what: &str| {
                for (p, q) in p.iter().zip(q) {
                    assert!((p - q).abs() <= limit * slack, "{what}: {p} and {q}, at most {limit}");
                }
            };
            within(&x.position, &y.position, tolerance.position, "position");
            within(&x.scale.map(f32::ln), &y.scale.map(f32::ln), tolerance.log_scale, "scale");
            within(&[x.opacity], &[y.opacity], tolerance.opacity, "opacity");
            within(&x.sh0.map(|c| c * SH_C0), &y.sh0.map(|c| c * SH_C0), tolerance.colour, "colour");
            within(&x.rotation, &y.rotation.map(|v| v * dot.signum()), tolerance.rotation, "rotation");
        }
        for (i, (x, y)) in a.sh_rest.iter().zip(&b.sh_rest).enumerate() {
            let limit = if i % 45 < 9 { tolerance.harmonics.0 } else { tolerance.harmonics.1 };
            assert!((x - y).abs() <= limit * slack, "harmonic {}: {x} and {y}", i % 45);
        }
    }

    #[test]
    fn both_versions_read_back_within_quantisation() {
        let epoch = random(500, 20.0);
        for version in [Version::V3, Version::V4] {
            let options = SpzOptions { version, ..SpzOptions::default() };
            let bytes = encode(&epoch, 0, &options).unwrap();
            let back = import::spz::parse(&bytes, &Limits::default()).unwrap();
            agree(&epoch, &back.epoch, 12);
        }
    }

    #[test]
    fn far_positions_get_fewer_fraction_bits_and_never_wrap() {
        let epoch = random(50, 100_000.0);
        let bytes = encode(&epoch, 0, &SpzOptions { version: Version::V4, ..SpzOptions::default() }).unwrap();
        assert_eq!(bytes[13], 6);
        let back = import::spz::parse(&bytes, &Limits::default()).unwrap();
        agree(&epoch, &back.epoch, 6);
    }

    /// One Gaussian far from all others takes the bits of their positions, which is said.
    #[test]
    fn positions_that_one_gaussian_coarsens_are_said() {
        let mut attributes = random(500, 2.0).attributes().clone();
        attributes.log_scales = crate::Track::Constant(vec![[-4.0; 3]; 500]);
        let near = Epoch::new(1, attributes.clone()).unwrap();
        assert_eq!(coarse_positions(&near, 0), None);
        let crate::Track::Constant(positions) = &mut attributes.positions else { panic!("one frame") };
        positions[17] = [1.0, -50_000.0, 2.0];
        let said = coarse_positions(&Epoch::new(1, attributes).unwrap(), 0).unwrap();
        // Of 23 bits 50,000 takes 16, so that 7 are left of the usual 12.
        let steps = [7, 12].map(|bits| 1.0 / (1u32 << bits) as f32);
        let wanted = [
            format!("rounded to {} scene units", steps[0]),
            format!("call for {}: the furthest, Gaussian 17, is at [1.0, -50000.0, 2.0]", steps[1]),
        ];
        assert!(wanted.iter().all(|wanted| said.contains(wanted)), "{said}");
    }

    #[test]
    fn small_scenes_get_finer_positions() {
        let with = |extent: f32, log_scale: f32| {
            let mut attributes = random(500, extent).attributes().clone();
            attributes.log_scales = crate::Track::Constant(vec![[log_scale; 3]; 500]);
            Epoch::new(1, attributes).unwrap()
        };
        assert_eq!(fine_fraction_bits(&with(2.0, -4.0), 0), 12);
        // Of small Gaussians far apart positions get as many bits as are left.
        for (extent, log_scale, wanted, written) in
            [(0.003, -9.5, 17, 17), (0.003, -30.0, 18, 18), (20.0, -9.5, 17, 17), (2000.0, -9.5, 17, 12)]
        {
            let epoch = with(extent, log_scale);
            let fraction_bits = fine_fraction_bits(&epoch, 0);
            assert_eq!(fraction_bits, wanted, "{extent} {log_scale}");
            let bytes = encode(&epoch, 0, &SpzOptions { fraction_bits, ..SpzOptions::default() }).unwrap();
            let back = import::spz::parse(&bytes, &Limits::default()).unwrap().epoch;
            let tolerance = Tolerance::new(written).position;
            let (a, b) = (epoch.attributes(), back.attributes());
            for (a, b) in a.positions.frame(0, 500).iter().zip(b.positions.frame(0, 500)) {
                assert!((0..3).all(|d| (a[d] - b[d]).abs() <= 1.001 * tolerance), "{a:?} and {b:?}");
            }
        }
    }

    #[test]
    fn sequences_read_back_as_frames() {
        let make = synth::SynthOptions { gaussians: 1_000, frames: 3, ..synth::SynthOptions::default() };
        let scene = synth::make(&make, &Limits::default()).unwrap();
        let folder = tempfile::tempdir().unwrap();
        for t in 0..3 {
            let bytes = encode(&scene.epochs()[0], t, &SpzOptions::default()).unwrap();
            std::fs::write(folder.path().join(format!("ball_{t}.spz")), bytes).unwrap();
        }
        let options =
            import::ImportOptions { identity: Identity::Stored, ..import::ImportOptions::default() };
        let back = import::import(folder.path(), &options).unwrap();
        assert_eq!((back.epochs().len(), back.frames(), back.max_count()), (1, 3, 1_000));
    }
}
