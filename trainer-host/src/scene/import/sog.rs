//! Reads SOG version 2: `meta.json` and lossless WebP planes, in a folder or a zip.
//!
//! Gaussian `i` is pixel `i` of every plane, row by row. Positions are 16 bits in two planes, across
//! a range, after `sign(v)·ln(1 + |v|)`; scales and colours are bytes into codebooks; rotations are
//! the three smaller of wxyz; higher harmonics are labels into a palette of 64 entries a row. Planes
//! must be lossless: a lossy one decodes to other labels, and is not told apart here. Axes are kept.
//! Absent: version 1, and the streamed form (`lod-meta.json`), whose levels are SOG folders each.

use std::io::Cursor;

use codec_core::ShDegree;
use image_webp::WebPDecoder;
use serde::Deserialize;

use super::{
    Limits,
    archive::Archive,
    bytes::lerp,
    error::{ErrorKind, Format, ImportError},
    snapshot::{Columns, Snapshot, logit, smallest_three},
};

const FORMAT: Format = Format::Sog;
const PALETTE_ROW: usize = 64;
/// Longest `meta.json`, bytes: three codebooks of 256 numbers and a few names are far below.
const META_BYTES: u64 = 1 << 20;

#[derive(Deserialize)]
struct Meta {
    version: Option<u32>,
    count: Option<u64>,
    means: Option<Means>,
    scales: Option<Coded>,
    quats: Option<Files>,
    sh0: Option<Coded>,
    #[serde(rename = "shN")]
    harmonics: Option<Palette>,
}

#[derive(Deserialize)]
struct Means {
    mins: [f32; 3],
    maxs: [f32; 3],
    files: Vec<String>,
}

#[derive(Deserialize)]
struct Coded {
    codebook: Vec<f32>,
    files: Vec<String>,
}

#[derive(Deserialize)]
struct Files {
    files: Vec<String>,
}

#[derive(Deserialize)]
struct Palette {
    count: u64,
    bands: u8,
    codebook: Vec<f32>,
    files: Vec<String>,
}

/// Reads a zipped SOG.
///
/// # Errors
/// A damaged archive, or as [`parse_files`].
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    let mut archive = Archive::new(bytes, limits, FORMAT)?;
    let meta = archive.read("meta.json", META_BYTES)?;
    parse_files(&meta, |name| archive.read(name, limits.max_bytes), limits)
}

/// Reads a SOG given its `meta.json` and a way to read the files it names.
///
/// # Errors
/// Metadata that is not version 2 or contradicts itself, planes that are missing, damaged or smaller
/// than the count, or more than `limits` allow.
pub fn parse_files(
    meta: &[u8],
    mut file: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
    limits: &Limits,
) -> Result<Snapshot, ImportError> {
    if meta.len() as u64 > META_BYTES {
        let (found, allowed) = (format!("{} bytes", meta.len()), format!("up to {META_BYTES} bytes"));
        return Err(FORMAT.error(ErrorKind::TooLarge, "meta.json", found, allowed));
    }
    let meta: Meta = serde_json::from_slice(meta)
        .map_err(|e| FORMAT.malformed("meta.json", e, "metadata of SOG version 2"))?;
    match meta.version {
        Some(2) => {}
        Some(other) => return Err(FORMAT.unsupported("version", other, "2")),
        None => return Err(FORMAT.unsupported("version", "none", "2")),
    }
    let count = limits.gaussians(FORMAT, meta.count.ok_or_else(|| missing("count"))?)?;
    let means = meta.means.ok_or_else(|| missing("means"))?;
    let scales = meta.scales.ok_or_else(|| missing("scales"))?;
    let quats = meta.quats.ok_or_else(|| missing("quats"))?;
    let sh0 = meta.sh0.ok_or_else(|| missing("sh0"))?;

    let mut plane = |what: &str, files: &[String], index: usize, pixels: usize| {
        let name = files.get(index).ok_or_else(|| {
            FORMAT.malformed(format!("{what}.files"), files.len(), format_args!("{} names", index + 1))
        })?;
        if name.contains(['/', '\\']) || name.starts_with('.') {
            return Err(FORMAT.malformed(format!("{what}.files"), name, "a plain file name"));
        }
        Plane::decode(name, &file(name)?, pixels, limits)
    };
    let low = plane("means", &means.files, 0, count)?;
    let high = plane("means", &means.files, 1, count)?;
    let scale = plane("scales", &scales.files, 0, count)?;
    let quat = plane("quats", &quats.files, 0, count)?;
    let colour = plane("sh0", &sh0.files, 0, count)?;
    let scale_book = codebook("scales", &scales.codebook)?;
    let colour_book = codebook("sh0", &sh0.codebook)?;
    let palette = match &meta.harmonics {
        None => None,
        Some(p) => {
            let (degree, coefficients) = p.shape()?;
            let rows = usize::try_from(p.count).unwrap_or(usize::MAX).div_ceil(PALETTE_ROW);
            let centroids = plane("shN", &p.files, 0, rows.saturating_mul(PALETTE_ROW * coefficients))?;
            if centroids.width != PALETTE_ROW * coefficients {
                let (found, allowed) = (centroids.width, PALETTE_ROW * coefficients);
                return Err(FORMAT.malformed("width of shN centroids", found, allowed));
            }
            Some((
                degree,
                p.count,
                codebook("shN", &p.codebook)?,
                centroids,
                plane("shN", &p.files, 1, count)?,
            ))
        }
    };

    let mut columns = Columns::with_capacity(count, palette.as_ref().map_or(ShDegree::ZERO, |p| p.0));
    for i in 0..count {
        let (l, h, q, c) = (low.pixel(i), high.pixel(i), quat.pixel(i), colour.pixel(i));
        columns.positions.push([0, 1, 2].map(|axis| {
            let unit = f32::from(u16::from_le_bytes([l[axis], h[axis]])) / 65_535.0;
            let v = lerp(means.mins[axis], means.maxs[axis], unit);
            v.signum() * v.abs().exp_m1()
        }));
        let s = scale.pixel(i);
        columns.log_scales.push([0, 1, 2].map(|axis| scale_book[usize::from(s[axis])]));
        let Some(largest) = q[3].checked_sub(252) else {
            return Err(FORMAT.malformed(format!("rotation mode of Gaussian {i}"), q[3], "252 to 255"));
        };
        let three = [q[0], q[1], q[2]].map(|u| (f32::from(u) / 255.0 - 0.5) * std::f32::consts::SQRT_2);
        columns.rotations.push(smallest_three(three, usize::from(largest)));
        columns.sh0.push([0, 1, 2].map(|channel| colour_book[usize::from(c[channel])]));
        columns.opacity_logits.push(logit(f32::from(c[3]) / 255.0));
        if let Some((degree, entries, book, centroids, labels)) = &palette {
            let label = u16::from_le_bytes([labels.pixel(i)[0], labels.pixel(i)[1]]);
            if u64::from(label) >= *entries {
                return Err(FORMAT.malformed(
                    format!("palette label of Gaussian {i}"),
                    label,
                    format_args!("below {entries}"),
                ));
            }
            let (row, column) = (usize::from(label) / PALETTE_ROW, usize::from(label) % PALETTE_ROW);
            let coefficients = degree.rest_len() / 3;
            let start = row * centroids.width + column * coefficients;
            for pixel in start..start + coefficients {
                columns.sh_rest.extend(centroids.pixel(pixel)[..3].iter().map(|&u| book[usize::from(u)]));
            }
        }
    }
    columns.finish(FORMAT, limits, Vec::new())
}

/// Whether JSON bytes look like the metadata of this format.
pub(super) fn is_meta(bytes: &[u8]) -> bool {
    let short = bytes.len() as u64 <= META_BYTES;
    short && serde_json::from_slice::<Meta>(bytes).is_ok_and(|m| m.means.is_some() && m.quats.is_some())
}

fn missing(field: &str) -> ImportError {
    FORMAT.malformed(field, "nothing", "a value in meta.json")
}

fn codebook(what: &str, values: &[f32]) -> Result<[f32; 256], ImportError> {
    values.try_into().map_err(|_| FORMAT.malformed(format!("{what}.codebook"), values.len(), "256 values"))
}

impl Palette {
    fn shape(&self) -> Result<(ShDegree, usize), ImportError> {
        let degree = ShDegree::new(self.bands)
            .filter(|d| d.get() > 0)
            .ok_or_else(|| FORMAT.malformed("shN.bands", self.bands, "1 to 3"))?;
        if self.count == 0 || self.count > 65_536 {
            return Err(FORMAT.malformed("shN.count", self.count, "1 to 65536"));
        }
        Ok((degree, degree.rest_len() / 3))
    }
}

/// A decoded plane: RGBA, `width` pixels a row.
struct Plane {
    width: usize,
    rgba: Vec<u8>,
}

impl Plane {
    fn decode(name: &str, bytes: &[u8], pixels: usize, limits: &Limits) -> Result<Self, ImportError> {
        let damaged = |e: image_webp::DecodingError| FORMAT.malformed(name, e, "an undamaged lossless WebP");
        let mut decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(damaged)?;
        let (width, height) = decoder.dimensions();
        let area = u64::from(width) * u64::from(height);
        if area < pixels as u64 {
            return Err(FORMAT.error(
                ErrorKind::Truncated,
                name,
                format_args!("{width}x{height} pixels"),
                format_args!("{pixels} pixels"),
            ));
        }
        // Rows may be padded, by far less than this.
        if area > 4 * pixels as u64 + 65_536 {
            let found = format_args!("{width}x{height} pixels").to_string();
            return Err(FORMAT.error(
                ErrorKind::TooLarge,
                name,
                found,
                format_args!("about {pixels} pixels"),
            ));
        }
        limits.bytes(FORMAT, name, area * 4)?;
        let rgb = !decoder.has_alpha();
        let mut raw = vec![0; decoder.output_buffer_size().unwrap_or(0)];
        decoder.read_image(&mut raw).map_err(damaged)?;
        let rgba =
            if rgb { raw.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect() } else { raw };
        Ok(Self { width: width as usize, rgba })
    }

    fn pixel(&self, index: usize) -> [u8; 4] {
        let at = index * 4;
        self.rgba.get(at..at + 4).and_then(|p| p.try_into().ok()).unwrap_or([0; 4])
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use std::io::Write;

    fn webp(width: u32, height: u32, pixel: impl Fn(u32) -> [u8; 4]) -> Vec<u8> {
        let raw: Vec<u8> = (0..width * height).flat_map(pixel).collect();
        let mut out = Vec::new();
        image_webp::WebPEncoder::new(&mut out)
            .encode(&raw, width, height, image_webp::ColorType::Rgba8)
            .unwrap();
        out
    }

    /// Six Gaussians with a palette of two: metadata and planes.
    pub fn files() -> Vec<(&'static str, Vec<u8>)> {
        let book: Vec<f32> = (0..256).map(|i| (i as f32 - 128.0) / 64.0).collect();
        let meta = serde_json::json!({
            "version": 2, "count": 6,
            "means": {"mins": [-1.0, -1.0, -1.0], "maxs": [1.0, 1.0, 1.0], "files": ["l.webp", "u.webp"]},
            "scales": {"codebook": book, "files": ["s.webp"]},
            "quats": {"files": ["q.webp"]},
            "sh0": {"codebook": book, "files": ["c.webp"]},
            "shN": {"count": 2, "bands": 1, "codebook": book, "files": ["p.webp", "n.webp"]},
        });
        vec![
            ("meta.json", meta.to_string().into_bytes()),
            ("l.webp", webp(3, 2, |i| [i as u8, 255, 0, 255])),
            ("u.webp", webp(3, 2, |_| [0, 255, 128, 255])),
            ("s.webp", webp(3, 2, |i| [i as u8, 0, 128, 255])),
            ("q.webp", webp(3, 2, |i| [128, 128, 128, 252 + (i % 4) as u8])),
            ("c.webp", webp(3, 2, |i| [128, 64, 192, 50 * i as u8])),
            ("p.webp", webp(192, 1, |i| [i as u8, 128, 0, 255])),
            ("n.webp", webp(3, 2, |i| [(i % 2) as u8, 0, 0, 255])),
        ]
    }

    /// The same, zipped.
    pub fn sample() -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, bytes) in files() {
            let options = zip::write::SimpleFileOptions::default();
            zip.start_file(name, options.compression_method(zip::CompressionMethod::Stored)).unwrap();
            zip.write_all(&bytes).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn planes_read_back() {
        let s = parse(&sample(), &Limits::default()).unwrap();
        let a = s.epoch.attributes();
        assert_eq!(a.log_scales.frame(0, 6)[5], [-123.0 / 64.0, -2.0, 0.0]);
        assert!((a.positions.frame(0, 6)[0][1] - (1f32.exp() - 1.0)).abs() < 1e-6);
        assert!(a.rotations.frame(0, 6)[2][2] > 0.99);
        assert_eq!(a.sh_rest[9], (3.0 - 128.0) / 64.0, "second entry starts at pixel 3");
    }

    #[test]
    fn metadata_is_read_up_to_a_bound() {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        zip.start_file("meta.json", zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&vec![b' '; META_BYTES as usize + 1]).unwrap();
        let bomb = zip.finish().unwrap().into_inner();
        assert!(bomb.len() < 10_000);
        let error = parse(&bomb, &Limits::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::TooLarge, "{error}");
        assert!(error.to_string().contains("meta.json: found more bytes; allowed: up to 1048576"), "{error}");
        let spaces = vec![b' '; META_BYTES as usize + 1];
        let error = parse_files(&spaces, |_| Ok(Vec::new()), &Limits::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::TooLarge, "{error}");
    }

    #[test]
    fn names_that_leave_the_folder_are_refused() {
        let meta = br#"{"version":2,"count":1,"means":{"mins":[0,0,0],"maxs":[0,0,0],"files":["../a"]},
            "scales":{"codebook":[],"files":[]},"quats":{"files":[]},"sh0":{"codebook":[],"files":[]}}"#;
        let error = parse_files(meta, |_| Ok(Vec::new()), &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("plain file name"), "{error}");
    }
}
