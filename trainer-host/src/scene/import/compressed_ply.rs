//! Reads PlayCanvas compressed PLY: 256 Gaussians share a chunk of ranges, each packs into four words.
//!
//! `packed_position` and `packed_scale` are 11-10-11 bits (x in the high bits) across the chunk's
//! range, scales in natural logs. `packed_rotation` is two bits naming the largest of wxyz and three
//! ten-bit components. `packed_color` is r, g, b, a from the high byte; colour runs across the chunk's
//! range where it has one, alpha is linear opacity. Element `sh`, where present, has one byte per
//! coefficient, channel-major. Axes are kept as in the file.

use codec_core::ShDegree;

use super::{
    Limits,
    bytes::{lerp, unorm},
    error::{Format, ImportError},
    ply::{Harmonics, header::Header},
    snapshot::{Columns, Snapshot, logit, sh0_of_colour, smallest_three},
};

const CHUNK: usize = 256;
/// Properties of a chunk, in file order: least and greatest x, y, z of positions, then of log-scales.
pub(in crate::scene) const PLACES: [&str; 12] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
];
/// Those of colours, which older files do not have.
pub(in crate::scene) const COLOURS: [&str; 6] = ["min_r", "min_g", "min_b", "max_r", "max_g", "max_b"];
const FORMAT: Format = Format::CompressedPly;

/// Reads a compressed PLY.
///
/// # Errors
/// As [`ply::parse`](super::ply::parse), and fewer chunks than the Gaussians need.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    let header = Header::parse(bytes, FORMAT)?;
    let element = |name: &str| {
        header
            .rows(bytes, name, limits, FORMAT)?
            .ok_or_else(|| FORMAT.malformed("elements", format_args!("no {name}"), "chunk and vertex"))
    };
    let missing = |names: Vec<String>| {
        FORMAT.malformed("properties", format_args!("no {}", names.join(", ")), "the packed properties")
    };
    let (chunks, vertices) = (element("chunk")?, element("vertex")?);
    let packed = vertices
        .columns(["packed_position", "packed_rotation", "packed_scale", "packed_color"])
        .map_err(missing)?;
    let ranges = chunks.columns(PLACES).map_err(missing)?;
    let colours = chunks.columns(COLOURS).ok();

    let mut notes: Vec<String> = vertices.short(limits, FORMAT)?.into_iter().collect();
    let needed = vertices.declared.div_ceil(CHUNK as u64);
    if chunks.declared < needed {
        return Err(FORMAT.malformed("element chunk", chunks.declared, format_args!("at least {needed}")));
    }
    let mut count = vertices.count.min(chunks.count * CHUNK);

    let bands = header.rows(bytes, "sh", limits, FORMAT)?;
    let bands = match bands {
        None => None,
        Some(rows) if rows.declared != vertices.declared => {
            return Err(FORMAT.malformed("element sh", rows.declared, format_args!("{}", vertices.declared)));
        }
        Some(rows) => {
            notes.extend(rows.short(limits, FORMAT)?);
            count = count.min(rows.count);
            let harmonics = Harmonics::find(&rows, &mut notes, FORMAT)?;
            Some((rows, harmonics))
        }
    };

    let degree = bands.as_ref().map_or(ShDegree::ZERO, |(_, h)| h.degree);
    let mut columns = Columns::with_capacity(count, degree);
    let mut range = [0.0f32; 12];
    let mut colour = [0.0, 0.0, 0.0, 1.0, 1.0, 1.0];
    for row in 0..count {
        if row % CHUNK == 0 {
            range = ranges.map(|c| chunks.value(row / CHUNK, c) as f32);
            if let Some(c) = colours {
                colour = c.map(|c| chunks.value(row / CHUNK, c) as f32);
            }
        }
        let [position, rotation, scale, rgba] = packed.map(|column| vertices.word(row, column));
        columns.positions.push(across(&range[..6], eleven_ten_eleven(position)));
        columns.log_scales.push(across(&range[6..], eleven_ten_eleven(scale)));
        columns.rotations.push(quaternion(rotation));
        let rgb = [24, 16, 8].map(|shift| unorm(rgba, shift, 8));
        columns.sh0.push(across(&colour, rgb).map(sh0_of_colour));
        columns.opacity_logits.push(logit(unorm(rgba, 0, 8)));
        if let Some((rows, harmonics)) = &bands {
            harmonics.append(&mut columns.sh_rest, |column| coefficient(rows.value(row, column)));
        }
    }
    columns.finish(FORMAT, limits, notes)
}

/// Whether a PLY header is of this kind.
pub(super) fn is_compressed(bytes: &[u8]) -> bool {
    Header::parse(bytes, FORMAT).is_ok_and(|h| h.declares("vertex", "packed_position"))
}

fn eleven_ten_eleven(word: u32) -> [f32; 3] {
    [unorm(word, 21, 11), unorm(word, 11, 10), unorm(word, 0, 11)]
}

/// `t` across a range given as three minima and three maxima.
fn across(range: &[f32], t: [f32; 3]) -> [f32; 3] {
    [0, 1, 2].map(|i| lerp(range[i], range[3 + i], t[i]))
}

fn quaternion(word: u32) -> [f32; 4] {
    let three = [20, 10, 0].map(|shift| (unorm(word, shift, 10) - 0.5) * std::f32::consts::SQRT_2);
    smallest_three(three, (word >> 30) as usize)
}

/// A coefficient byte: 256 equal bins over -4..4, the outer two at the ends themselves.
fn coefficient(byte: f64) -> f32 {
    let unit = match byte as u8 {
        0 => 0.0,
        255 => 1.0,
        b => (f32::from(b) + 0.5) / 256.0,
    };
    (unit - 0.5) * 8.0
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    #[test]
    fn what_is_cut_off_is_said_in_bytes() {
        let bytes = sample(300);
        let body = bytes.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        let error = parse(&bytes[..body + 20], &Limits::default()).unwrap_err().to_string();
        assert!(error.contains("element chunk: found 20 bytes; allowed: 96 bytes"), "{error}");
    }

    /// `n` Gaussians in as many chunks as they need, with one harmonic band.
    pub fn sample(n: usize) -> Vec<u8> {
        let chunks = n.div_ceil(CHUNK);
        let mut out = format!("ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n");
        for kind in ["", "scale_"] {
            for end in ["min", "max"] {
                for axis in ["x", "y", "z"] {
                    out += &format!("property float {end}_{kind}{axis}\n");
                }
            }
        }
        out += &format!("element vertex {n}\n");
        for name in ["position", "rotation", "scale", "color"] {
            out += &format!("property uint packed_{name}\n");
        }
        out += &format!("element sh {n}\n");
        for i in 0..9 {
            out += &format!("property uchar f_rest_{i}\n");
        }
        let mut out = (out + "end_header\n").into_bytes();
        for _ in 0..chunks {
            for v in [-1.0f32, -2.0, -3.0, 1.0, 2.0, 3.0, -8.0, -8.0, -8.0, -2.0, -2.0, -2.0] {
                out.extend(v.to_le_bytes());
            }
        }
        for i in 0..n as u32 {
            let position = ((i * 37) % 2048) << 21 | ((i * 11) % 1024) << 11 | ((i * 5) % 2048);
            let rotation = (i % 4) << 30 | 512 << 20 | 600 << 10 | 400;
            for word in [position, rotation, u32::MAX, 0xff00_80ff] {
                out.extend(word.to_le_bytes());
            }
        }
        for i in 0..n {
            out.extend([0, 255, 128, 1, 2, 3, 4, 5, (i % 256) as u8]);
        }
        out
    }

    #[test]
    fn packed_values_unpack() {
        let s = parse(&sample(300), &Limits::default()).unwrap();
        let a = s.epoch.attributes();
        assert_eq!(s.epoch.count(), 300);
        assert_eq!(a.positions.frame(0, 300)[0], [-1.0, -2.0, -3.0]);
        assert_eq!(a.log_scales.frame(0, 300)[299], [-2.0; 3]);
        assert_eq!(a.opacity_logits.frame(0, 300)[0], 12.0, "alpha 255 is clamped");
        let q = a.rotations.frame(0, 300)[1];
        assert!(q[1] > 0.9 && q[2] > 0.0 && q[3] < 0.0, "component 1 is the missing one: {q:?}");
        assert_eq!(a.sh_rest[..3], [-4.0, (1.5 / 256.0 - 0.5) * 8.0, (4.5 / 256.0 - 0.5) * 8.0]);
    }

    #[test]
    fn too_few_chunks_are_refused() {
        let bytes = sample(300);
        let text = String::from_utf8_lossy(&bytes[..40]).replace("chunk 2", "chunk 1");
        assert!(!text.is_empty());
        let mut bytes = bytes;
        let at = bytes.windows(7).position(|w| w == b"chunk 2").unwrap();
        bytes[at + 6] = b'1';
        let error = parse(&bytes, &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("at least 2"), "{error}");
    }
}
