//! Codes `.4dgs` through the public crate `fourdgs`: a peer. Clips of fixed identity as a keyframe and deltas
//! (one keyframe per second, each delta on the state before), snapshots as Gaussians that live in the
//! window of their epoch. Quality is one of the format's three profiles.

use anyhow::{Context, Result, bail, ensure};
use codec_core::{Gaussian, ShDegree};
use fourdgs::{
    GaussianSet, SceneExtras, WriteOptions,
    keyframe_delta::State,
    keyframe_delta_file::{DecodedSequence, KeyframeDeltaOptions, Sample, decode_streamed, write_sequence},
    opcode,
    quantization::{Profile, SH_QUANT_HI, SH_QUANT_LO, dequantize_rotation, rct_inverse, sh_coefficient},
};
use trainer_host::{Epoch, Instant, Scene, activation::SH_C0};

use super::{
    coded::{Coded, Timer},
    lattice::morton_order,
};

/// A lifetime, seconds, against which no clip here is long: opacity does not fade.
const LIFETIME: f32 = 1e6;
/// The smaller of the format's two codecs, at its highest level: bytes are compared, whatever they take.
const CODEC: u8 = fourdgs::codec::ZSTD;
const LEVEL: u32 = 19;

/// Codes `scene` in profile fine (0), default (1) or coarse (2).
pub fn code(scene: &Scene, profile: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    let profile = match profile as u32 {
        0 => Profile::Fine,
        1 => Profile::Default,
        _ => Profile::Coarse,
    };
    match scene.epochs() {
        [epoch] if epoch.frames() > 1 => sequence(scene, epoch, profile, shown),
        _ => snapshots(scene, profile, shown),
    }
}

fn set(epoch: &Epoch, t: usize, order: &[u32], degree: u8, window: (f64, f64)) -> GaussianSet {
    let instant = epoch.instant(t);
    let n = order.len();
    let mut out = GaussianSet {
        motions: vec![0.0; 3 * n],
        mu_t: vec![window.0 as f32; n],
        sigma_t: vec![LIFETIME; n],
        win_lo: vec![window.0 as f32; n],
        win_hi: vec![window.1 as f32; n],
        sh_degree: degree,
        ..GaussianSet::default()
    };
    let coefficients = (usize::from(degree) + 1).pow(2) - 1;
    let rest = instant.sh_degree.rest_len();
    let mut sh = Vec::with_capacity(3 * coefficients * n);
    for &i in order {
        let g = &instant.gaussians[i as usize];
        let [w, x, y, z] = g.rotation;
        out.positions.extend(g.position);
        out.scales.extend(g.scale);
        out.rotations.extend([x, y, z, w]);
        out.colors.extend(g.sh0.map(|c| 0.5 + SH_C0 * c));
        out.colors.push(g.opacity);
        let bands = &instant.sh_rest[i as usize * rest..(i as usize + 1) * rest];
        for channel in 0..3 {
            sh.extend((0..coefficients).map(|k| {
                let v = bands.get(3 * k + channel).copied().unwrap_or(0.0);
                let byte = (f64::from(v) - SH_QUANT_LO) / (SH_QUANT_HI - SH_QUANT_LO) * 255.0;
                byte.round().clamp(0.0, 255.0) as u8
            }));
        }
    }
    if coefficients > 0 {
        out.sh = Some(sh);
        out.sh_coefficients = coefficients;
    }
    out
}

fn order(epoch: &Epoch) -> Vec<u32> {
    let all: Vec<u32> = (0..epoch.count() as u32).collect();
    morton_order(&all, epoch.attributes().positions.frame(0, epoch.count()))
}

fn sequence(scene: &Scene, epoch: &Epoch, profile: Profile, shown: &[u32]) -> Result<Coded> {
    if epoch.attributes().sh_degree != ShDegree::ZERO {
        bail!("the format's deltas hold no harmonics above band 0");
    }
    let timer = Timer::start();
    let fps = scene.frames_per_second();
    let duration = epoch.frames() as f64 / fps;
    let order = order(epoch);
    let samples: Vec<Sample> = (0..epoch.frames())
        .map(|t| Sample {
            t0: t as f64 / fps,
            ids: (0..order.len() as i64).collect(),
            gaussians: set(epoch, t, &order, 0, (0.0, duration)),
        })
        .collect();
    let every = (fps.round() as usize).max(1);
    let options = KeyframeDeltaOptions {
        keyframe_every: every,
        profile,
        codec: CODEC,
        level: LEVEL,
        ..Default::default()
    };
    // Birth times that differ from their keyframe's would be coded as motion of the clock.
    let samples: Vec<Sample> = samples
        .into_iter()
        .enumerate()
        .map(|(t, mut s)| {
            let start = (t / every * every) as f64 / fps;
            s.gaussians.mu_t.fill(start as f32);
            s
        })
        .collect();
    let bytes = write_sequence(&samples, duration, &options).map_err(|e| anyhow::anyhow!("{e}"))?;
    drop(samples);
    let encode_s = timer.seconds();
    let timer = Timer::start();
    let decoded = decode_streamed(&bytes).map_err(|e| anyhow::anyhow!("{e}"))?;
    ensure!(decoded.chunks.len() == epoch.frames(), "{} chunks for the frames", decoded.chunks.len());
    let decode_s = timer.seconds();
    let frame = |&f: &u32| {
        let chunk = decoded.chunks.get(f as usize).context("no such frame")?;
        composed(&decoded, &chunk.state)
    };
    let shown: Result<Vec<Instant>> = shown.iter().map(frame).collect();
    Ok(Coded { bytes: bytes.len(), encode_s, decode_s, shown: shown? })
}

/// The population a state's bins stand for.
fn composed(sequence: &DecodedSequence, state: &State) -> Result<Instant> {
    let grids = sequence.grids();
    let steps = grids.steps;
    let row = |attribute: u8, i: usize| -> Result<&[i64]> {
        let bins = state.bins.get(&attribute).context("an attribute is missing")?;
        bins.values.get(i * bins.channels..(i + 1) * bins.channels).context("a row is missing")
    };
    let mut out = Instant::default();
    for i in 0..state.count() {
        let position = row(opcode::A_POSITION, i)?;
        let scale = row(opcode::A_SCALE, i)?;
        let largest = row(opcode::A_ROTATION_INDEX, i)?[0];
        let [x, y, z, w] = dequantize_rotation(largest, row(opcode::A_ROTATION, i)?, steps.rot);
        let colour = rct_inverse(row(opcode::A_COLOR, i)?);
        let opacity = row(opcode::A_OPACITY, i)?[0] as f64 * steps.alpha;
        out.gaussians.push(Gaussian {
            position: [0, 1, 2].map(|d| (position[d] as f64 * steps.pos + grids.origin[d]) as f32),
            scale: [0, 1, 2].map(|d| (scale[d] as f64 * steps.scale_log).exp() as f32),
            rotation: [w, x, y, z],
            opacity: opacity.clamp(0.0, 1.0) as f32,
            sh0: colour.map(|c| ((c as f64 * steps.rgb) as f32 - 0.5) / SH_C0),
        });
    }
    Ok(out)
}

fn snapshots(scene: &Scene, profile: Profile, shown: &[u32]) -> Result<Coded> {
    if scene.epochs().iter().any(|e| e.frames() > 1) {
        bail!("several epochs of several frames each: neither of the format's models holds them");
    }
    let timer = Timer::start();
    let fps = scene.frames_per_second();
    let degree = scene.epochs().iter().map(|e| e.attributes().sh_degree.get()).max().unwrap_or(0);
    let mut all = GaussianSet { sh_degree: degree, ..GaussianSet::default() };
    for (f, epoch) in scene.epochs().iter().enumerate() {
        let window = (f as f64 / fps, (f + 1) as f64 / fps);
        let part = set(epoch, 0, &order(epoch), degree, window);
        all.positions.extend(part.positions);
        all.scales.extend(part.scales);
        all.rotations.extend(part.rotations);
        all.colors.extend(part.colors);
        all.motions.extend(part.motions);
        all.mu_t.extend(part.mu_t);
        all.sigma_t.extend(part.sigma_t);
        all.win_lo.extend(part.win_lo);
        all.win_hi.extend(part.win_hi);
        all.sh_coefficients = part.sh_coefficients;
        if let Some(sh) = part.sh {
            all.sh.get_or_insert_with(Vec::new).extend(sh);
        }
    }
    let duration = scene.frames() as f64 / fps;
    let options = WriteOptions {
        profile,
        codec: CODEC,
        level: LEVEL,
        sh_bands: degree,
        verify: false,
        ..WriteOptions::default()
    };
    let failed = |e: fourdgs::Error| anyhow::anyhow!("{e}");
    let bytes = fourdgs::write_to_vec(&all, duration, &options, &SceneExtras::default()).map_err(failed)?;
    let encode_s = timer.seconds();
    let timer = Timer::start();
    let decoded = fourdgs::read_bytes(&bytes).map_err(failed)?;
    let set = &decoded.gaussians;
    let decode_s = timer.seconds();
    let frame = |&f: &u32| -> Result<Instant> {
        let middle = ((f64::from(f) + 0.5) / fps) as f32;
        let sh_degree = ShDegree::new(set.sh_degree).context("a degree above 3")?;
        let mut out = Instant { sh_degree, ..Instant::default() };
        let per = set.sh_coefficients;
        for i in (0..set.count()).filter(|&i| set.win_lo[i] <= middle && middle < set.win_hi[i]) {
            let three = |v: &[f32]| [v[3 * i], v[3 * i + 1], v[3 * i + 2]];
            let [x, y, z, w] = [0, 1, 2, 3].map(|k| set.rotations[4 * i + k]);
            out.gaussians.push(Gaussian {
                position: three(&set.positions),
                scale: three(&set.scales),
                rotation: [w, x, y, z],
                opacity: set.colors[4 * i + 3].clamp(0.0, 1.0),
                sh0: [0, 1, 2].map(|k| (set.colors[4 * i + k] - 0.5) / SH_C0),
            });
            if let Some(sh) = &set.sh {
                let row = &sh[3 * per * i..3 * per * (i + 1)];
                let value = |k: usize, channel: usize| sh_coefficient(row[channel * per + k]) as f32;
                out.sh_rest
                    .extend((0..per).flat_map(|k| (0..3).map(move |c| (k, c))).map(|(k, c)| value(k, c)));
            }
        }
        out.sh_rest.resize(out.gaussians.len() * sh_degree.rest_len(), 0.0);
        Ok(out)
    };
    let shown: Result<Vec<Instant>> = shown.iter().map(frame).collect();
    Ok(Coded { bytes: bytes.len(), encode_s, decode_s, shown: shown? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clips_come_back_within_the_bounds_of_their_profile() {
        let scene = crate::setup::synth("figure", 1000, 4).unwrap();
        let source = scene.instant(3).unwrap();
        let order = order(&scene.epochs()[0]);
        let mut sizes = Vec::new();
        for profile in [0.0, 1.0, 2.0] {
            let coded = code(&scene, profile, 0, &[0, 3]).unwrap();
            let far = coded.shown[1]
                .gaussians
                .iter()
                .zip(&order)
                .map(|(g, &i)| {
                    let s = &source.gaussians[i as usize];
                    (0..3)
                        .map(|d| (g.position[d] - s.position[d]).abs() / s.scale[0].max(s.scale[1]))
                        .fold(0.0, f32::max)
                })
                .fold(0.0, f32::max);
            assert!(far < 0.5, "{far} standard deviations off");
            sizes.push(coded.bytes);
        }
        assert!(sizes[0] > sizes[1] && sizes[1] > sizes[2], "{sizes:?}");
    }
}
