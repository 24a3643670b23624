//! Codes PLY and zstd, a peer: the first frame of an epoch with every property, later frames with those that
//! change, all in one zstd stream; as floats, and with every property cut to half precision.

use anyhow::{Result, ensure};
use codec_core::ShDegree;
use half::f16;
use trainer_host::{Attributes, Epoch, Instant, Scene, Track};

use super::coded::{Coded, Timer};

/// Codes `scene` as PLY of `bits` (32 or 16) per property and zstd at `level`.
pub fn code(scene: &Scene, bits: f32, level: i32, shown: &[u32]) -> Result<Coded> {
    let halved = bits < 32.0;
    let timer = Timer::start();
    let mut raw = Vec::new();
    for epoch in scene.epochs() {
        for t in 0..epoch.frames() {
            frame(epoch, t, halved, &mut raw);
        }
    }
    let packed = pack(&raw, level)?;
    let encode_s = timer.seconds();
    let timer = Timer::start();
    let back = zstd::stream::decode_all(packed.as_slice())?;
    ensure!(back == raw, "what was decoded is not what was coded");
    let mut decoded = Vec::new();
    let mut rest = back.as_slice();
    let mut frame = 0;
    for epoch in scene.epochs() {
        let mut columns = Columns::of(epoch);
        for t in 0..epoch.frames() {
            rest = columns.read(epoch, t, halved, rest)?;
            if shown.contains(&frame) {
                decoded.push((frame, columns.instant(epoch)?));
            }
            frame += 1;
        }
    }
    ensure!(rest.is_empty(), "bytes are left over");
    let decode_s = timer.seconds();
    let find = |f: &u32| decoded.iter().find(|(at, _)| at == f).map(|(_, i)| i.clone());
    let shown = shown.iter().filter_map(find).collect();
    Ok(Coded { bytes: packed.len(), encode_s, decode_s, shown })
}

/// `raw` as one zstd stream whose window holds several frames.
pub fn pack(raw: &[u8], level: i32) -> Result<Vec<u8>> {
    let mut encoder = zstd::stream::Encoder::new(Vec::new(), level)?;
    encoder.window_log(25)?;
    encoder.long_distance_matching(true)?;
    std::io::Write::write_all(&mut encoder, raw)?;
    Ok(encoder.finish()?)
}

/// The attributes as lists of columns: which of them frame `t` holds, in the usual order of properties.
const NAMES: [(&str, usize); 5] = [("position", 3), ("f_dc", 3), ("opacity", 1), ("scale", 3), ("rot", 4)];

fn varies(epoch: &Epoch) -> [bool; 5] {
    let a = epoch.attributes();
    [
        a.positions.is_constant(),
        a.sh0.is_constant(),
        a.opacity_logits.is_constant(),
        a.log_scales.is_constant(),
        a.rotations.is_constant(),
    ]
    .map(|constant| !constant)
}

fn header(epoch: &Epoch, t: usize, halved: bool) -> String {
    let kind = if halved { "ushort" } else { "float" };
    let mut head = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", epoch.count());
    for ((name, columns), varies) in NAMES.into_iter().zip(varies(epoch)) {
        if t == 0 || varies {
            (0..columns).for_each(|i| head += &format!("property {kind} {name}_{i}\n"));
        }
    }
    if t == 0 {
        let rest = epoch.attributes().sh_degree.rest_len();
        (0..rest).for_each(|i| head += &format!("property {kind} f_rest_{i}\n"));
    }
    head + "end_header\n"
}

fn frame(epoch: &Epoch, t: usize, halved: bool, out: &mut Vec<u8>) {
    out.extend(header(epoch, t, halved).bytes());
    let (n, a, varies) = (epoch.count(), epoch.attributes(), varies(epoch));
    let mut put = |v: f32| match halved {
        true => out.extend(f16::from_f32(v).to_le_bytes()),
        false => out.extend(v.to_le_bytes()),
    };
    let (p, q) = (a.positions.frame(t, n), a.rotations.frame(t, n));
    let (s, o, c) = (a.log_scales.frame(t, n), a.opacity_logits.frame(t, n), a.sh0.frame(t, n));
    let rest = a.sh_degree.rest_len();
    for i in 0..n {
        let columns: [&[f32]; 5] = [&p[i], &c[i], &o[i..=i], &s[i], &q[i]];
        for (values, varies) in columns.into_iter().zip(varies) {
            if t == 0 || varies {
                values.iter().for_each(|&v| put(v));
            }
        }
        if t == 0 {
            a.sh_rest[i * rest..(i + 1) * rest].iter().for_each(|&v| put(v));
        }
    }
}

/// What a reader holds between frames.
struct Columns {
    values: [Vec<f32>; 5],
    rest: Vec<f32>,
    degree: ShDegree,
}

impl Columns {
    fn of(epoch: &Epoch) -> Self {
        let n = epoch.count();
        let degree = epoch.attributes().sh_degree;
        Self { values: NAMES.map(|(_, k)| vec![0.0; n * k]), rest: vec![0.0; n * degree.rest_len()], degree }
    }

    fn read<'b>(&mut self, epoch: &Epoch, t: usize, halved: bool, bytes: &'b [u8]) -> Result<&'b [u8]> {
        let head = header(epoch, t, halved);
        let Some(mut rest) = bytes.strip_prefix(head.as_bytes()) else {
            anyhow::bail!("not the header that was written");
        };
        let mut take = || -> Result<f32> {
            let short = || anyhow::anyhow!("a PLY frame ends early");
            if halved {
                let (head, tail) = rest.split_first_chunk::<2>().ok_or_else(short)?;
                rest = tail;
                return Ok(f16::from_le_bytes(*head).to_f32());
            }
            let (head, tail) = rest.split_first_chunk::<4>().ok_or_else(short)?;
            rest = tail;
            Ok(f32::from_le_bytes(*head))
        };
        let varies = varies(epoch);
        let bands = self.degree.rest_len();
        for i in 0..epoch.count() {
            for ((column, (_, k)), varies) in self.values.iter_mut().zip(NAMES).zip(varies) {
                if t == 0 || varies {
                    for value in &mut column[i * k..(i + 1) * k] {
                        *value = take()?;
                    }
                }
            }
            if t == 0 {
                for value in &mut self.rest[i * bands..(i + 1) * bands] {
                    *value = take()?;
                }
            }
        }
        Ok(rest)
    }

    fn instant(&self, epoch: &Epoch) -> Result<Instant> {
        let three = |values: &[f32]| -> Vec<[f32; 3]> { values.as_chunks::<3>().0.to_vec() };
        let attributes = Attributes {
            positions: Track::Constant(three(&self.values[0])),
            rotations: Track::Constant(self.values[4].as_chunks::<4>().0.to_vec()),
            log_scales: Track::Constant(three(&self.values[3])),
            opacity_logits: Track::Constant(self.values[2].clone()),
            sh0: Track::Constant(three(&self.values[1])),
            sh_rest: self.rest.clone(),
            sh_degree: self.degree,
        };
        debug_assert_eq!(epoch.count(), self.values[2].len());
        Ok(Epoch::new(1, attributes)?.instant(0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floats_come_back_bit_for_bit_and_halves_nearly() {
        let scene = crate::setup::synth("figure", 1000, 4).unwrap();
        let whole = code(&scene, 32.0, 3, &[0, 3]).unwrap();
        let source = scene.instant(3).unwrap();
        for (a, b) in whole.shown[1].gaussians.iter().zip(&source.gaussians) {
            assert_eq!((a.position, a.sh0), (b.position, b.sh0));
            assert!((a.rotation[0] - b.rotation[0]).abs() < 1e-6);
        }
        let halved = code(&scene, 16.0, 3, &[0, 3]).unwrap();
        assert!(halved.bytes < whole.bytes);
        let apart = |a: &Instant| -> f32 {
            let pairs = a.gaussians.iter().zip(&source.gaussians);
            pairs.map(|(a, b)| (a.position[0] - b.position[0]).abs()).fold(0.0, f32::max)
        };
        let found = apart(&halved.shown[1]);
        assert!(found > 0.0 && found < 0.01, "{found}");
    }
}
