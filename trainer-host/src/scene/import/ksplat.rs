//! Reads `.ksplat`: a header of 4096 bytes, headers of 1024 bytes for sections, then splats in buckets.
//!
//! Compression level 0 holds floats; levels 1 and 2 hold 16-bit offsets from the centre of a bucket, half
//! floats, and harmonics as half floats or bytes. Scales are linear, rotations wxyz, colours display bytes
//! with linear opacity. Harmonics go band by band, in each channel by channel. Axes are kept.

use codec_core::ShDegree;
use half::f16;

use super::{
    Limits,
    bytes::{f32_at, u16_at, u32_at},
    error::{Format, ImportError},
    snapshot::{Columns, Snapshot, logit, sh0_of_colour},
};

const FORMAT: Format = Format::Ksplat;
const HEADER: usize = 4096;
const SECTION: usize = 1024;
/// Harmonics of a file that does not say, in 8 bits, span this on both sides of 0.
const DEFAULT_RANGE: f32 = 1.5;

/// What a section's header says.
struct Section {
    splats: usize,
    /// Splats that the section has room for.
    room: usize,
    bucket_splats: usize,
    buckets: usize,
    block: f32,
    bucket_bytes: usize,
    range: f32,
    full_buckets: usize,
    partial_buckets: usize,
    degree: ShDegree,
}

/// What the file's header says of values.
struct Coding {
    level: u16,
    /// Least and greatest harmonic of level 2.
    harmonics: (f32, f32),
}

/// Reads a `.ksplat` file.
///
/// # Errors
/// Another version or level, sections that contradict their lengths, values that are not numbers, or more
/// than `limits` allow.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    if bytes.len() < HEADER {
        return Err(FORMAT.truncated("header", bytes.len() as u64, HEADER as u64));
    }
    if (bytes[0], bytes[1]) < (0, 1) || bytes[0] != 0 {
        let found = format!("{}.{}", bytes[0], bytes[1]);
        return Err(FORMAT.unsupported("version", found, "0.1 and later minor versions").at(0));
    }
    let word = |at: usize| u32_at(bytes, at).unwrap_or(0) as usize;
    let level = u16_at(bytes, 20).unwrap_or(u16::MAX);
    if level > 2 {
        return Err(FORMAT.unsupported("compression level", level, "0 to 2").at(20));
    }
    let range = (f32_at(bytes, 36).unwrap_or(0.0), f32_at(bytes, 40).unwrap_or(0.0));
    let is_said = range.0 < range.1;
    let harmonics = if is_said { range } else { (-DEFAULT_RANGE, DEFAULT_RANGE) };
    let coding = Coding { level, harmonics };
    let most = word(4);
    let data = most.checked_mul(SECTION).and_then(|bytes| bytes.checked_add(HEADER));
    let mut at = data.filter(|&data| data <= bytes.len()).ok_or_else(|| {
        FORMAT.truncated("section headers", (bytes.len() - HEADER) as u64, most as u64 * SECTION as u64).at(4)
    })?;
    let sections: Vec<(usize, Section)> = (0..most)
        .map(|i| Ok((HEADER + i * SECTION, section(bytes, HEADER + i * SECTION)?)))
        .collect::<Result<_, ImportError>>()?;
    let sections: Vec<_> = sections.into_iter().filter(|(_, section)| section.splats > 0).collect();
    let total: u64 = sections.iter().map(|(_, section)| section.splats as u64).sum();
    let degree = sections.iter().map(|(_, section)| section.degree.get()).max().unwrap_or(0);
    let degree = ShDegree::new(degree).unwrap_or(ShDegree::ZERO);
    // Splats take bytes of the file, so that what is reserved is bounded by it.
    let each = coding.splat_bytes(ShDegree::ZERO) as u64;
    let fit = (bytes.len() - at) as u64 / each;
    let total = limits.gaussians(FORMAT, total)?;
    if total as u64 > fit && !limits.keep_readable {
        return Err(FORMAT.truncated("splats", (bytes.len() - at) as u64, total as u64 * each).at(at));
    }
    let mut notes = Vec::new();
    let mut columns = Columns::with_capacity(total.min(fit as usize), degree);
    for (place, section) in &sections {
        let capacity =
            read_section(bytes, &mut at, section, &coding, degree, limits, &mut columns, &mut notes)
                .map_err(|error| if error.offset.is_some() { error } else { error.at(*place) })?;
        if capacity < section.splats {
            break;
        }
    }
    columns.finish(FORMAT, limits, notes)
}

fn section(bytes: &[u8], at: usize) -> Result<Section, ImportError> {
    let word = |offset: usize| u32_at(bytes, at + offset).unwrap_or(0) as usize;
    let degree = u16_at(bytes, at + 40).unwrap_or(0);
    let degree = u8::try_from(degree).ok().and_then(ShDegree::new).filter(|degree| degree.get() <= 2);
    Ok(Section {
        splats: word(0),
        room: word(4),
        bucket_splats: word(8),
        buckets: word(12),
        block: f32_at(bytes, at + 16).unwrap_or(0.0),
        bucket_bytes: u16_at(bytes, at + 20).unwrap_or(0).into(),
        range: word(24) as f32,
        full_buckets: word(32),
        partial_buckets: word(36),
        degree: degree.ok_or_else(|| {
            let found = u16_at(bytes, at + 40).unwrap_or(0);
            FORMAT.unsupported("harmonic degree", found, "0 to 2").at(at + 40)
        })?,
    })
}

impl Coding {
    /// Bytes of a splat.
    fn splat_bytes(&self, degree: ShDegree) -> usize {
        let rest = degree.rest_len();
        match self.level {
            0 => 12 + 12 + 16 + 4 + 4 * rest,
            1 => 6 + 6 + 8 + 4 + 2 * rest,
            _ => 6 + 6 + 8 + 4 + rest,
        }
    }

    /// The `i`-th number after the position: three scales, then four of the rotation.
    fn number(&self, splat: &[u8], i: usize) -> f32 {
        match self.level {
            0 => f32_at(splat, 12 + 4 * i).unwrap_or(f32::NAN),
            _ => u16_at(splat, 6 + 2 * i).map_or(f32::NAN, |bits| f16::from_bits(bits).to_f32()),
        }
    }

    /// Where the colour of a splat is.
    fn colour(&self) -> usize {
        if self.level == 0 { 40 } else { 20 }
    }

    /// Harmonic `i` of a splat.
    fn harmonic(&self, splat: &[u8], i: usize) -> f32 {
        let at = self.colour() + 4;
        match self.level {
            0 => f32_at(splat, at + 4 * i).unwrap_or(f32::NAN),
            1 => u16_at(splat, at + 2 * i).map_or(f32::NAN, |bits| f16::from_bits(bits).to_f32()),
            _ => {
                let unit = f32::from(splat.get(at + i).copied().unwrap_or(0)) / 255.0;
                self.harmonics.0 + unit * (self.harmonics.1 - self.harmonics.0)
            }
        }
    }
}

/// Reads the splats of a section from `at`, and says how many there were.
#[allow(clippy::too_many_arguments, reason = "each is another thing that a section is read with")]
fn read_section(
    bytes: &[u8],
    at: &mut usize,
    section: &Section,
    coding: &Coding,
    degree: ShDegree,
    limits: &Limits,
    columns: &mut Columns,
    notes: &mut Vec<String>,
) -> Result<usize, ImportError> {
    let short = |needed: u64| FORMAT.truncated("section", (bytes.len() - *at) as u64, needed).at(*at);
    let lengths_bytes = 4u64 * section.partial_buckets as u64;
    let centres_bytes = section.bucket_bytes as u64 * section.buckets as u64;
    let head = lengths_bytes.saturating_add(centres_bytes);
    if head > (bytes.len() - *at) as u64 {
        return Err(short(head));
    }
    let is_packed = coding.level > 0;
    if is_packed && section.buckets > 0 && section.bucket_bytes < 12 {
        return Err(FORMAT.malformed("bucket", section.bucket_bytes, "at least 12 bytes"));
    }
    let lengths = *at;
    let centres = *at + lengths_bytes as usize;
    let first = centres + centres_bytes as usize;
    let (rest, each) = (section.degree.rest_len(), coding.splat_bytes(section.degree));
    let there = (bytes.len() - first) / each;
    if there < section.splats {
        if !limits.keep_readable {
            return Err(FORMAT
                .truncated("splats", (bytes.len() - first) as u64, section.splats as u64 * each as u64)
                .at(first));
        }
        notes.push(format!(
            "{} of {} splats of a section are missing",
            section.splats - there,
            section.splats
        ));
    }
    let mut bucket = Bucket { index: 0, left: 0 };
    for i in 0..there.min(section.splats) {
        let splat = &bytes[first + i * each..first + (i + 1) * each];
        let position = if is_packed {
            let index = bucket.next(bytes, lengths, section)?;
            let centre = |axis: usize| f32_at(bytes, centres + index * section.bucket_bytes + 4 * axis);
            let scale = section.block / 2.0 / if section.range > 0.0 { section.range } else { 32_767.0 };
            let range = if section.range > 0.0 { section.range } else { 32_767.0 };
            [0, 1, 2].map(|axis| {
                let offset = f32::from(u16_at(splat, 2 * axis).unwrap_or(0)) - range;
                offset * scale + centre(axis).unwrap_or(f32::NAN)
            })
        } else {
            [0, 1, 2].map(|axis| f32_at(splat, 4 * axis).unwrap_or(f32::NAN))
        };
        let scale = [0, 1, 2].map(|axis| coding.number(splat, axis));
        if scale.iter().any(|&s| s < 0.0) && !limits.keep_readable {
            let found = format!("{scale:?}");
            let error = FORMAT.malformed("scale", found, "standard deviations, not negative");
            return Err(error.at(first + i * each));
        }
        columns.positions.push(position);
        columns.log_scales.push(scale.map(f32::ln));
        columns.rotations.push([3, 4, 5, 6].map(|k| coding.number(splat, k)));
        let colour = &splat[coding.colour()..coding.colour() + 4];
        columns.sh0.push([0, 1, 2].map(|c| sh0_of_colour(f32::from(colour[c]) / 255.0)));
        columns.opacity_logits.push(logit(f32::from(colour[3]) / 255.0));
        let before = columns.sh_rest.len();
        // In each band a channel's coefficients lie together.
        for (start, len) in [(0, 3), (9, 5)].into_iter().filter(|(start, _)| *start < rest) {
            for k in 0..len {
                columns.sh_rest.extend((0..3).map(|c| coding.harmonic(splat, start + c * len + k)));
            }
        }
        columns.sh_rest.resize(before + degree.rest_len(), 0.0);
    }
    // A section takes the room that it has, whatever is in it.
    *at = first.saturating_add(section.room.max(section.splats).saturating_mul(each)).min(bytes.len());
    Ok(there)
}

/// The bucket that splats are in, one after another.
struct Bucket {
    index: usize,
    /// Splats that are still in it.
    left: usize,
}

impl Bucket {
    /// The bucket of the next splat.
    fn next(&mut self, bytes: &[u8], lengths: usize, section: &Section) -> Result<usize, ImportError> {
        while self.left == 0 {
            if self.index >= section.buckets {
                return Err(FORMAT.malformed("buckets", "fewer splats than the section", section.splats));
            }
            self.left = match self.index.checked_sub(section.full_buckets) {
                None => section.bucket_splats,
                Some(partial) if partial < section.partial_buckets => {
                    u32_at(bytes, lengths + 4 * partial).unwrap_or(0) as usize
                }
                Some(_) => section.bucket_splats,
            };
            self.index += 1;
        }
        self.left -= 1;
        Ok(self.index - 1)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::import::error::ErrorKind;

    /// `n` splats in one section of compression `level` with harmonics of degree 1.
    pub fn sample(n: usize, level: u16) -> Vec<u8> {
        let mut out = vec![0u8; HEADER + SECTION];
        let put =
            |out: &mut Vec<u8>, at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
        put(&mut out, 0, &[0, 1]);
        for at in [4, 8] {
            put(&mut out, at, &1u32.to_le_bytes());
        }
        put(&mut out, 16, &(n as u32).to_le_bytes());
        put(&mut out, 20, &level.to_le_bytes());
        for (offset, value) in [(0, n), (4, n), (8, 256), (12, 1), (24, 32_767), (36, 1)] {
            put(&mut out, HEADER + offset, &(value as u32).to_le_bytes());
        }
        put(&mut out, HEADER + 16, &5.0f32.to_le_bytes());
        put(&mut out, HEADER + 20, &12u16.to_le_bytes());
        put(&mut out, HEADER + 40, &1u16.to_le_bytes());
        out.extend((n as u32).to_le_bytes());
        for centre in [1.0f32, 2.0, 3.0] {
            out.extend(centre.to_le_bytes());
        }
        for i in 0..n {
            let number = |out: &mut Vec<u8>, v: f32| match level {
                0 => out.extend(v.to_le_bytes()),
                _ => out.extend(f16::from_f32(v).to_bits().to_le_bytes()),
            };
            match level {
                0 => [1.0 + 0.25 * i as f32, 2.0, 3.0].map(|v: f32| out.extend(v.to_le_bytes())),
                _ => {
                    let offset = (0.25 * i as f32 / 2.5 * 32_767.0).round() as u16;
                    [32_767 + offset, 32_767, 32_767].map(|v| out.extend(v.to_le_bytes()))
                }
            };
            for v in [0.125, 0.25, 0.5, 0.5, -0.5, 0.5, 0.5] {
                number(&mut out, v);
            }
            out.extend([255, 128, 0, 204]);
            for k in 0..9 {
                match level {
                    2 => out.push(k * 20),
                    _ => number(&mut out, f32::from(k) * 0.125),
                }
            }
        }
        out
    }

    #[test]
    fn all_levels_hold_the_same() {
        for level in 0..3 {
            let s = parse(&sample(4, level), &Limits::default()).unwrap();
            let a = s.epoch.attributes();
            let g = s.epoch.instant(0).gaussians[3];
            assert!((g.position[0] - 1.75).abs() < 1e-3 && (g.position[2] - 3.0).abs() < 1e-3, "{g:?}");
            assert!((g.scale[2] - 0.5).abs() < 1e-4 && (g.opacity - 0.8).abs() < 1e-6);
            assert_eq!(g.rotation, [0.5, -0.5, 0.5, 0.5]);
            // Coefficient 1 of red is number 1, of green number 4.
            let wanted = |k: f32| if level == 2 { -1.5 + 3.0 * k * 20.0 / 255.0 } else { k * 0.125 };
            assert!((a.sh_rest[27 + 3] - wanted(1.0)).abs() < 1e-6, "{:?}", &a.sh_rest[27..]);
            assert!((a.sh_rest[27 + 4] - wanted(4.0)).abs() < 1e-6);
        }
    }

    #[test]
    fn lies_are_named() {
        let good = sample(4, 1);
        let put = |at: usize, with: &[u8]| {
            let mut out = good.clone();
            out[at..at + with.len()].copy_from_slice(with);
            out
        };
        for (bytes, says) in [
            (put(0, &[3]), "version"),
            (put(20, &[9]), "compression level"),
            (put(4, &u32::MAX.to_le_bytes()), "section headers"),
            (put(HEADER, &u32::MAX.to_le_bytes()), "Gaussian count"),
            (put(HEADER, &99u32.to_le_bytes()), "splats"),
            (put(HEADER + 12, &0u32.to_le_bytes()), "buckets"),
            (put(HEADER + 40, &[7]), "harmonic degree"),
            (good[..good.len() - 5].to_vec(), "splats"),
        ] {
            let error = parse(&bytes, &Limits::default()).unwrap_err();
            assert!(error.to_string().contains(says), "{says}: {error}");
        }
        let limits = Limits { keep_readable: true, ..Limits::default() };
        let s = parse(&good[..good.len() - 5], &limits).unwrap();
        assert_eq!((s.epoch.count(), s.notes.len()), (3, 1));
        assert_eq!(parse(&[0; 9], &limits).unwrap_err().kind, ErrorKind::Truncated);
    }
}
