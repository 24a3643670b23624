//! Writes SOG version 2: `meta.json` and lossless WebP planes in a zip, as `import::sog` reads it.
//!
//! Positions are 16 bits of their signed logarithm across the scene; scales and colours bytes into books of
//! 256 values that are fitted to the scene; rotations ten bits a component at most; harmonics labels into a
//! palette of up to 65,536 entries. Gaussians are put in Morton order, so that planes compress: rows are not
//! those of the scene.

mod lossless;
mod palette;

use std::io::{self, Cursor, Write};

use image_webp::{ColorType, EncoderParams, WebPEncoder};
use serde_json::json;
use zip::{CompressionMethod, ZipWriter, write::SimpleFileOptions};

use self::palette::{book, nearest, palette};
use super::{byte, morton_order, sigmoid, smallest_three};
use crate::scene::Epoch;

/// Palette entries in a row of the plane of centroids.
const PALETTE_ROW: usize = 64;
/// Most entries of a palette: labels have 16 bits.
const MAX_ENTRIES: usize = 65_536;

/// Frame `t` of `epoch` as a zipped SOG, which says whether its Gaussians are dimmed as much as they are
/// widened. `t` must be below the epoch's frame count.
///
/// # Errors
/// No Gaussians, more than planes of 16384 × 16384 hold, or a compressor's refusal.
pub fn encode(epoch: &Epoch, t: usize, antialiased: bool) -> io::Result<Vec<u8>> {
    let (n, a) = (epoch.count(), epoch.attributes());
    if n == 0 || n > 16_384 * 16_384 {
        let why = format!("{n} Gaussians; 1 to {} are allowed in SOG", 16_384 * 16_384);
        return Err(io::Error::new(io::ErrorKind::InvalidInput, why));
    }
    let order: Vec<usize> = morton_order(a.positions.frame(t, n)).into_iter().map(|i| i as usize).collect();
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let mut plane = |name: &str, pixels: Vec<[u8; 4]>, width: usize| add(&mut zip, name, pixels, width);
    let width = (n as f64).sqrt().ceil() as usize;

    let p = a.positions.frame(t, n);
    let logs = |i: usize| p[i].map(|v| v.signum() * v.abs().ln_1p());
    let (mut mins, mut maxs) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for i in 0..n {
        for (axis, v) in logs(i).into_iter().enumerate() {
            (mins[axis], maxs[axis]) = (mins[axis].min(v), maxs[axis].max(v));
        }
    }
    let place = |i: usize| -> [[u8; 2]; 3] {
        let v = logs(i);
        std::array::from_fn(|axis| {
            let range = maxs[axis] - mins[axis];
            let unit = if range > 0.0 { (v[axis] - mins[axis]) / range } else { 0.0 };
            ((unit * 65_535.0).round().clamp(0.0, 65_535.0) as u16).to_le_bytes()
        })
    };
    let half = |which: usize| -> Vec<[u8; 4]> {
        let pixel = |&i: &usize| {
            let [x, y, z] = place(i);
            [x[which], y[which], z[which], 255]
        };
        order.iter().map(pixel).collect()
    };
    plane("means_l.webp", half(0), width)?;
    plane("means_u.webp", half(1), width)?;

    let s = a.log_scales.frame(t, n);
    let scales = book(s.iter().flatten().copied());
    let label = |book: &[f32; 256], v: f32| nearest(book, v);
    let pixel = |&i: &usize| {
        let [x, y, z] = s[i].map(|v| label(&scales, v));
        [x, y, z, 255]
    };
    plane("scales.webp", order.iter().map(pixel).collect(), width)?;

    let q = a.rotations.frame(t, n);
    let pixel = |&i: &usize| {
        let (largest, three) = smallest_three(q[i]);
        let [x, y, z] = three.map(|v| byte(v / std::f32::consts::SQRT_2 + 0.5));
        [x, y, z, 252 + largest as u8]
    };
    plane("quats.webp", order.iter().map(pixel).collect(), width)?;

    let (c, o) = (a.sh0.frame(t, n), a.opacity_logits.frame(t, n));
    let colours = book(c.iter().flatten().copied());
    let pixel = |&i: &usize| {
        let [r, g, b] = c[i].map(|v| label(&colours, v));
        [r, g, b, byte(sigmoid(o[i]))]
    };
    plane("sh0.webp", order.iter().map(pixel).collect(), width)?;

    let mut meta = json!({
        "version": 2, "count": n, "antialias": antialiased,
        "means": { "mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scales.to_vec(), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": colours.to_vec(), "files": ["sh0.webp"] },
    });
    let rest = a.sh_degree.rest_len();
    if rest > 0 {
        let (entries, labels) = palette(&a.sh_rest, rest, entries(n));
        let values = book(entries.iter().copied());
        let pixel = |&i: &usize| {
            let [low, high] = (labels[i] as u16).to_le_bytes();
            [low, high, 0, 255]
        };
        plane("shN_labels.webp", order.iter().map(pixel).collect(), width)?;
        let mut centroids: Vec<[u8; 4]> = entries
            .as_chunks::<3>()
            .0
            .iter()
            .map(|&[r, g, b]| [label(&values, r), label(&values, g), label(&values, b), 255])
            .collect();
        let row = PALETTE_ROW * rest / 3;
        centroids.resize(centroids.len().div_ceil(row) * row, [0, 0, 0, 255]);
        plane("shN_centroids.webp", centroids, row)?;
        meta["shN"] = json!({
            "count": entries.len() / rest, "bands": a.sh_degree.get(), "codebook": values.to_vec(),
            "files": ["shN_centroids.webp", "shN_labels.webp"],
        });
    }
    start(&mut zip, "meta.json")?;
    zip.write_all(meta.to_string().as_bytes())?;
    Ok(zip.finish()?.into_inner())
}

/// Entries of the palette of `n` Gaussians: a quarter of them, in steps of a thousand or so.
fn entries(n: usize) -> usize {
    (n / 4).next_multiple_of(1024).clamp(1024, MAX_ENTRIES).min(n.max(1))
}

type Archive = ZipWriter<Cursor<Vec<u8>>>;

fn start(zip: &mut Archive, name: &str) -> io::Result<()> {
    // Planes are compressed already.
    let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    Ok(zip.start_file(name, options)?)
}

/// Adds a plane of `width` pixels a row.
fn add(zip: &mut Archive, name: &str, mut pixels: Vec<[u8; 4]>, width: usize) -> io::Result<()> {
    let height = pixels.len().div_ceil(width);
    pixels.resize(width * height, [0, 0, 0, 255]);
    // Labels of neighbours have little to do with each other, other values much: the shorter file wins.
    let predicted = lossless::encode(&pixels, width)?;
    let mut plain = Vec::new();
    let mut encoder = WebPEncoder::new(&mut plain);
    let mut how = EncoderParams::default();
    how.use_predictor_transform = false;
    encoder.set_params(how);
    let encoded = encoder.encode(pixels.as_flattened(), width as u32, height as u32, ColorType::Rgba8);
    encoded.map_err(io::Error::other)?;
    start(zip, name)?;
    zip.write_all(if predicted.len() < plain.len() { &predicted } else { &plain })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        export::tests::{assert_close, epoch, in_order},
        import::{self, Limits},
    };

    /// The same with harmonics of a hundred kinds, as materials have them, and a little of each row's own.
    fn patterned(epoch: &Epoch) -> Epoch {
        let a = epoch.attributes();
        let rest = a.sh_degree.rest_len();
        let value = |(i, v): (usize, &f32)| a.sh_rest[(i / rest % 100) * rest + i % rest] + 0.02 * v;
        let sh_rest = a.sh_rest.iter().enumerate().map(value).collect();
        Epoch::new(1, crate::Attributes { sh_rest, ..a.clone() }).unwrap()
    }

    #[test]
    fn archives_read_back_close_to_what_they_were() {
        for degree in [0, 3] {
            let epoch = patterned(&epoch(3000, degree));
            let bytes = encode(&epoch, 0, false).unwrap();
            assert_eq!(bytes, encode(&epoch, 0, false).unwrap(), "the same bytes every time");
            let again = import::sog::parse(&bytes, &Limits::default()).unwrap().epoch;
            let sorted = in_order(&epoch, &morton_order(epoch.attributes().positions.frame(0, 3000)));
            assert_close("position", &sorted, &again, 0.002, |a, n, i| a.positions.frame(0, n)[i].to_vec());
            assert_close("scale", &sorted, &again, 0.06, |a, n, i| a.log_scales.frame(0, n)[i].to_vec());
            assert_close("colour", &sorted, &again, 0.06, |a, n, i| a.sh0.frame(0, n)[i].to_vec());
            assert_close("rotation", &sorted, &again, 0.012, |a, n, i| a.rotations.frame(0, n)[i].to_vec());
            let rest = epoch.attributes().sh_degree.rest_len();
            assert_eq!(again.attributes().sh_degree.rest_len(), rest);
            if rest > 0 {
                let (a, b) = (&sorted.attributes().sh_rest, &again.attributes().sh_rest);
                let squares: f32 = a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum();
                let power: f32 = a.iter().map(|a| a.powi(2)).sum();
                assert!(squares < 0.02 * power, "{squares} of {power}");
            }
        }
        assert!(encode(&epoch(0, 0), 0, false).is_err());
    }
}
