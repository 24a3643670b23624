//! Codes SPZ, a peer, one file per frame as our exporter writes it: alone, and its unpacked planes over all
//! frames in one zstd stream, as they are and as differences to the frame before.
//!
//! Attributes other than position have the format's fixed bytes; the knob is the step of positions.

use anyhow::{Context, Result, ensure};
use trainer_host::{
    Epoch, Instant, Scene,
    encode::QuantiserSteps,
    export::spz::{SpzOptions, Version, encode, unpacked},
    import::{self, spz::parse},
};

use super::{
    coded::{Coded, Timer},
    plain::pack,
};

/// One SPZ file (version 3, gzip) per frame.
pub fn code_frames(scene: &Scene, coarseness: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    let timer = Timer::start();
    let mut files = Vec::new();
    for epoch in scene.epochs() {
        let options = SpzOptions {
            version: Version::V3,
            fraction_bits: fraction_bits(epoch, coarseness),
            antialiased: false,
        };
        for t in 0..epoch.frames() {
            files.push(encode(epoch, t, &options).context("SPZ")?);
        }
    }
    let bytes = files.iter().map(Vec::len).sum();
    let encode_s = timer.seconds();
    let timer = Timer::start();
    let decoded: Result<Vec<Instant>> = files.iter().map(|f| read(f)).collect();
    let decode_s = timer.seconds();
    let decoded = decoded?;
    let shown = shown.iter().filter_map(|&f| decoded.get(f as usize).cloned()).collect();
    Ok(Coded { bytes, encode_s, decode_s, shown })
}

/// The planes of all frames in one zstd stream.
pub fn code(scene: &Scene, coarseness: f32, level: i32, shown: &[u32]) -> Result<Coded> {
    over_frames(scene, coarseness, level, shown, false)
}

/// The planes of all frames, less the frame before where it has as many Gaussians, in one zstd stream.
pub fn code_delta(scene: &Scene, coarseness: f32, level: i32, shown: &[u32]) -> Result<Coded> {
    over_frames(scene, coarseness, level, shown, true)
}

/// Fraction bits whose step is the default position step times `coarseness`, or the next finer.
fn fraction_bits(epoch: &Epoch, coarseness: f32) -> u8 {
    let n = epoch.count();
    let mut sizes: Vec<f32> =
        epoch.attributes().log_scales.frame(0, n).iter().map(|s| s.iter().sum::<f32>() / 3.0).collect();
    sizes.sort_unstable_by(f32::total_cmp);
    let size = sizes.get(n / 2).map_or(1.0, |s| s.exp());
    (-(QuantiserSteps::default().position * coarseness * size).log2()).ceil().clamp(0.0, 23.0) as u8
}

fn read(file: &[u8]) -> Result<Instant> {
    Ok(parse(file, &import::Limits::default())?.epoch.instant(0))
}

/// A version-4 file taken apart: header, then planes, unpacked.
struct Unpacked {
    header: Vec<u8>,
    planes: Vec<Vec<u8>>,
}

/// Bytes of the header.
const HEADER: usize = 32;

impl Unpacked {
    fn of(epoch: &Epoch, t: usize, fraction_bits: u8) -> Result<Self> {
        let options = SpzOptions { version: Version::V4, fraction_bits, antialiased: false };
        let (fraction_bits, planes) = unpacked(epoch, t, &options)?;
        let present = planes.iter().filter(|p| !p.is_empty()).count().max(5);
        let mut header = b"NGSP".to_vec();
        header.extend(4u32.to_le_bytes());
        header.extend((epoch.count() as u32).to_le_bytes());
        header.extend([epoch.attributes().sh_degree.get(), fraction_bits, 0, present as u8]);
        header.extend((HEADER as u32).to_le_bytes());
        header.resize(HEADER, 0);
        Ok(Self { header, planes: planes.into_iter().take(present).collect() })
    }

    /// A file with these planes, packed as little as zstd can.
    fn file(&self) -> Result<Vec<u8>> {
        let packed: std::io::Result<Vec<Vec<u8>>> =
            self.planes.iter().map(|p| zstd::stream::encode_all(p.as_slice(), 1)).collect();
        let packed = packed?;
        let mut out = self.header.clone();
        for (packed, plane) in packed.iter().zip(&self.planes) {
            out.extend((packed.len() as u64).to_le_bytes());
            out.extend((plane.len() as u64).to_le_bytes());
        }
        packed.iter().for_each(|p| out.extend(p));
        Ok(out)
    }

    /// The planes less those of `before` (or plus, to undo it): positions as 24-bit integers, their bytes
    /// then parted by significance; all else byte by byte.
    fn turned(&self, before: Option<&Self>, undo: bool) -> Vec<Vec<u8>> {
        let n = self.planes.first().map_or(0, |p| p.len() / 3);
        let same = before.filter(|b| b.planes.iter().map(Vec::len).eq(self.planes.iter().map(Vec::len)));
        self.planes
            .iter()
            .enumerate()
            .map(|(i, plane)| {
                let zeros = vec![0; plane.len()];
                let old = same.map_or(&zeros, |b| &b.planes[i]);
                if i > 0 {
                    let turn =
                        |(a, b): (&u8, &u8)| if undo { a.wrapping_add(*b) } else { a.wrapping_sub(*b) };
                    return plane.iter().zip(old).map(turn).collect();
                }
                let whole =
                    |p: &[u8], k: usize| u32::from_le_bytes([p[3 * k], p[3 * k + 1], p[3 * k + 2], 0]);
                let mut out = vec![0; plane.len()];
                for k in 0..n {
                    if undo {
                        let parted = [plane[k], plane[n + k], plane[2 * n + k], 0];
                        let value = unzigzag(u32::from_le_bytes(parted)).wrapping_add(whole(old, k));
                        out[3 * k..3 * k + 3].copy_from_slice(&value.to_le_bytes()[..3]);
                    } else {
                        let value = zigzag(whole(plane, k).wrapping_sub(whole(old, k)));
                        value.to_le_bytes().iter().take(3).enumerate().for_each(|(b, v)| out[b * n + k] = *v);
                    }
                }
                out
            })
            .collect()
    }
}

/// A difference modulo 2^24 with its sign in the lowest bit.
fn zigzag(v: u32) -> u32 {
    let signed = ((v << 8) as i32) >> 8;
    ((signed << 1) ^ (signed >> 31)) as u32 & 0xff_ffff
}

fn unzigzag(v: u32) -> u32 {
    (v >> 1) ^ 0u32.wrapping_sub(v & 1)
}

fn over_frames(scene: &Scene, coarseness: f32, level: i32, shown: &[u32], delta: bool) -> Result<Coded> {
    let timer = Timer::start();
    let mut frames = Vec::new();
    for epoch in scene.epochs() {
        let bits = fraction_bits(epoch, coarseness);
        for t in 0..epoch.frames() {
            frames.push(Unpacked::of(epoch, t, bits)?);
        }
    }
    let mut raw = Vec::new();
    for (t, frame) in frames.iter().enumerate() {
        raw.extend(&frame.header);
        match delta {
            true => {
                frame.turned(t.checked_sub(1).map(|b| &frames[b]), false).iter().for_each(|p| raw.extend(p))
            }
            false => frame.planes.iter().for_each(|p| raw.extend(p)),
        }
    }
    let packed = pack(&raw, level)?;
    let encode_s = timer.seconds();
    let timer = Timer::start();
    let back = zstd::stream::decode_all(packed.as_slice())?;
    ensure!(back == raw, "what was decoded is not what was coded");
    let mut decoded: Vec<Unpacked> = Vec::new();
    let mut rest = back.as_slice();
    for frame in &frames {
        let (header, mut tail) = rest.split_at(HEADER);
        let mut planes = Vec::new();
        for plane in &frame.planes {
            let (head, next) = tail.split_at(plane.len());
            planes.push(head.to_vec());
            tail = next;
        }
        rest = tail;
        let mut unpacked = Unpacked { header: header.to_vec(), planes };
        if delta {
            unpacked.planes = unpacked.turned(decoded.last(), true);
        }
        decoded.push(unpacked);
    }
    let decode_s = timer.seconds();
    let frame = |&f: &u32| read(&decoded.get(f as usize).context("no such frame")?.file()?);
    let shown: Result<Vec<Instant>> = shown.iter().map(frame).collect();
    Ok(Coded { bytes: packed.len(), encode_s, decode_s, shown: shown? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_way_gives_the_same_frames() {
        let scene = crate::setup::synth("cloth", 1000, 5).unwrap();
        let alone = code_frames(&scene, 1.0, 3, &[0, 4]).unwrap();
        for code in [code, code_delta] {
            let other = code(&scene, 1.0, 3, &[0, 4]).unwrap();
            assert!(other.shown == alone.shown, "frames differ");
            assert!(other.bytes < alone.bytes, "{} and {}", other.bytes, alone.bytes);
        }
        assert_ne!(alone.shown[0], alone.shown[1]);
    }

    #[test]
    fn differences_wrap_and_come_back() {
        for (a, b) in [(0u32, 0xff_ffff), (5, 3), (0x80_0000, 0), (0x7f_ffff, 0x80_0001)] {
            let difference = a.wrapping_sub(b);
            assert_eq!(unzigzag(zigzag(difference)).wrapping_add(b) & 0xff_ffff, a);
        }
    }
}
