//! Reads SOG: `meta.json` and lossless WebP planes, in a folder or a zip.
//!
//! Gaussian `i` is pixel `i` of every plane, row by row. Positions are 16 bits in two planes, across
//! a range, after `sign(v)·ln(1 + |v|)`; scales and colours are bytes into codebooks; rotations are
//! the three smaller of wxyz; higher harmonics are labels into a palette of 64 entries a row. Planes
//! must be lossless: a lossy one decodes to other labels, and is not told apart here. Axes are kept.
//! Version 1, which does not name itself, has ranges per channel where version 2 has codebooks, and logits
//! as opacities. Absent: the streamed form (`lod-meta.json`), whose levels are SOG folders each.

use std::io::Cursor;

use codec_core::{Footprint, ShDegree};
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
/// Most entries of a palette.
const MAX_ENTRIES: u64 = 65_536;
/// Longest `meta.json`, bytes: three codebooks of 256 numbers and a few names are far below.
const META_BYTES: u64 = 1 << 20;

#[derive(Deserialize)]
struct Meta {
    version: Option<u32>,
    count: Option<u64>,
    antialias: Option<bool>,
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
    /// Version 1: the count is first.
    shape: Option<Vec<u64>>,
}

#[derive(Deserialize)]
struct Coded {
    codebook: Option<Vec<f32>>,
    /// Version 1: the range of each channel.
    mins: Option<Vec<f32>>,
    maxs: Option<Vec<f32>>,
    files: Vec<String>,
}

#[derive(Deserialize)]
struct Files {
    files: Vec<String>,
}

#[derive(Deserialize)]
struct Palette {
    count: Option<u64>,
    bands: Option<u8>,
    codebook: Option<Vec<f32>>,
    /// Version 1: the range of all values.
    mins: Option<f32>,
    maxs: Option<f32>,
    files: Vec<String>,
}

/// What a byte of a channel stands for.
type Codebook = [f32; 256];

#[derive(Clone, Copy, PartialEq)]
enum Version {
    One,
    Two,
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
/// Metadata that is not of version 1 or 2 or contradicts itself, planes that are missing, damaged or smaller
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
    let meta: Meta =
        serde_json::from_slice(meta).map_err(|e| FORMAT.malformed("meta.json", e, "metadata of SOG"))?;
    let means = meta.means.ok_or_else(|| missing("means"))?;
    let (version, count) = match meta.version {
        Some(2) => (Version::Two, meta.count.ok_or_else(|| missing("count"))?),
        Some(other) => return Err(FORMAT.unsupported("version", other, "2, or none for version 1")),
        None => (Version::One, *means.shape.iter().flatten().next().ok_or_else(|| missing("means.shape"))?),
    };
    let count = limits.gaussians(FORMAT, count)?;
    let footprint = (meta.antialias == Some(true)).then_some(Footprint::Compensated);
    let scales = meta.scales.ok_or_else(|| missing("scales"))?;
    let quats = meta.quats.ok_or_else(|| missing("quats"))?;
    let sh0 = meta.sh0.ok_or_else(|| missing("sh0"))?;

    let mut plane = |what: &str, files: &[String], index: usize, pixels: usize| {
        plane_between(what, files, index, pixels, pixels, &mut file, limits)
    };
    let low = plane("means", &means.files, 0, count)?;
    let high = plane("means", &means.files, 1, count)?;
    let scale = plane("scales", &scales.files, 0, count)?;
    let quat = plane("quats", &quats.files, 0, count)?;
    let colour = plane("sh0", &sh0.files, 0, count)?;
    let scale_books: [Codebook; 3] = scales.codebooks("scales", version)?;
    let (colour_books, opacity_book) = match version {
        Version::Two => {
            let opacities = std::array::from_fn(|byte| logit(byte as f32 / 255.0));
            (sh0.codebooks::<3>("sh0", version)?, opacities)
        }
        Version::One => {
            let [red, green, blue, opacities] = sh0.codebooks::<4>("sh0", version)?;
            ([red, green, blue], opacities)
        }
    };
    let mut palette_of = |p: &Palette| {
        let stated = p.shape(version)?;
        let pixels = stated.map_or(PALETTE_ROW, |(degree, entries)| {
            let rows = usize::try_from(entries).unwrap_or(usize::MAX).div_ceil(PALETTE_ROW);
            rows.saturating_mul(PALETTE_ROW * degree.rest_len() / 3)
        });
        // Version 1 states neither degree nor entries: the plane has as many as it has pixels.
        let most = if version == Version::One { MAX_ENTRIES as usize * 15 } else { pixels };
        let bytes_of = plane_between("shN", &p.files, 0, pixels, most, &mut file, limits)?;
        let (degree, entries) = stated.map_or_else(|| bytes_of.entries(), Ok)?;
        let width = PALETTE_ROW * degree.rest_len() / 3;
        if bytes_of.width != width {
            return Err(FORMAT.malformed("width of shN centroids", bytes_of.width, width));
        }
        let labels = plane_between("shN", &p.files, 1, count, count, &mut file, limits)?;
        Ok((degree, entries, p.values(version)?, bytes_of, labels))
    };
    let mut notes = Vec::new();
    let palette = match meta.harmonics.as_ref().map(&mut palette_of).transpose() {
        Err(error) if limits.keep_readable => {
            notes.push(format!("harmonics are left out: {error}"));
            None
        }
        palette => palette?,
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
        columns.log_scales.push([0, 1, 2].map(|axis| scale_books[axis][usize::from(s[axis])]));
        let three = [q[0], q[1], q[2]].map(|u| (f32::from(u) / 255.0 - 0.5) * std::f32::consts::SQRT_2);
        columns.rotations.push(match q[3].checked_sub(252) {
            Some(largest) => smallest_three(three, usize::from(largest)),
            // Left out with all that is not finite.
            None if limits.keep_readable => [f32::NAN; 4],
            None => {
                return Err(FORMAT.malformed(format!("rotation mode of Gaussian {i}"), q[3], "252 to 255"));
            }
        });
        columns.sh0.push([0, 1, 2].map(|channel| colour_books[channel][usize::from(c[channel])]));
        columns.opacity_logits.push(opacity_book[usize::from(c[3])]);
        if let Some((degree, entries, book, centroids, labels)) = &palette {
            let label = u16::from_le_bytes([labels.pixel(i)[0], labels.pixel(i)[1]]);
            if u64::from(label) >= *entries {
                if limits.keep_readable {
                    columns.sh_rest.extend(std::iter::repeat_n(f32::NAN, degree.rest_len()));
                    continue;
                }
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
    Ok(Snapshot { footprint, ..columns.finish(FORMAT, limits, notes)? })
}

/// Whether JSON bytes look like the metadata of this format.
pub(super) fn is_meta(bytes: &[u8]) -> bool {
    let short = bytes.len() as u64 <= META_BYTES;
    short && serde_json::from_slice::<Meta>(bytes).is_ok_and(|m| m.means.is_some() && m.quats.is_some())
}

fn missing(field: &str) -> ImportError {
    FORMAT.malformed(field, "nothing", "a value in meta.json")
}

fn codebook(what: &str, values: Option<&[f32]>) -> Result<Codebook, ImportError> {
    let values = values.unwrap_or_default();
    values.try_into().map_err(|_| FORMAT.malformed(format!("{what}.codebook"), values.len(), "256 values"))
}

/// The codebook of equal steps from `low` to `high`.
fn even(low: f32, high: f32) -> Codebook {
    std::array::from_fn(|byte| lerp(low, high, byte as f32 / 255.0))
}

impl Coded {
    /// What the bytes of the first `N` channels stand for.
    fn codebooks<const N: usize>(&self, what: &str, version: Version) -> Result<[Codebook; N], ImportError> {
        if version == Version::Two {
            return Ok([codebook(what, self.codebook.as_deref())?; N]);
        }
        let range = |field: &str, values: &Option<Vec<f32>>| -> Result<[f32; N], ImportError> {
            let values = values.as_deref().unwrap_or_default();
            let allowed = format!("{N} values");
            values.try_into().map_err(|_| FORMAT.malformed(format!("{what}.{field}"), values.len(), allowed))
        };
        let (low, high) = (range("mins", &self.mins)?, range("maxs", &self.maxs)?);
        Ok(std::array::from_fn(|channel| even(low[channel], high[channel])))
    }
}

impl Palette {
    /// Degree and entries, which version 1 does not state.
    fn shape(&self, version: Version) -> Result<Option<(ShDegree, u64)>, ImportError> {
        if version == Version::One {
            return Ok(None);
        }
        let bands = self.bands.ok_or_else(|| missing("shN.bands"))?;
        let degree = ShDegree::new(bands)
            .filter(|d| d.get() > 0)
            .ok_or_else(|| FORMAT.malformed("shN.bands", bands, "1 to 3"))?;
        let count = self.count.ok_or_else(|| missing("shN.count"))?;
        if count == 0 || count > MAX_ENTRIES {
            return Err(FORMAT.malformed("shN.count", count, "1 to 65536"));
        }
        Ok(Some((degree, count)))
    }

    /// What the bytes of its entries stand for.
    fn values(&self, version: Version) -> Result<Codebook, ImportError> {
        if version == Version::Two {
            return codebook("shN", self.codebook.as_deref());
        }
        let low = self.mins.ok_or_else(|| missing("shN.mins"))?;
        Ok(even(low, self.maxs.ok_or_else(|| missing("shN.maxs"))?))
    }
}

/// Plane `index` of `files`, of at least `pixels` pixels and about `most`.
fn plane_between(
    what: &str,
    files: &[String],
    index: usize,
    pixels: usize,
    most: usize,
    file: &mut impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
    limits: &Limits,
) -> Result<Plane, ImportError> {
    let name = files.get(index).ok_or_else(|| {
        FORMAT.malformed(format!("{what}.files"), files.len(), format_args!("{} names", index + 1))
    })?;
    if name.contains(['/', '\\']) || name.starts_with('.') {
        return Err(FORMAT.malformed(format!("{what}.files"), name, "a plain file name"));
    }
    Plane::decode(name, &file(name)?, pixels, most, limits)
}

/// A decoded plane: RGBA, `width` pixels a row.
struct Plane {
    width: usize,
    rgba: Vec<u8>,
}

impl Plane {
    fn decode(
        name: &str,
        bytes: &[u8],
        pixels: usize,
        most: usize,
        limits: &Limits,
    ) -> Result<Self, ImportError> {
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
        if area > 4 * most as u64 + 65_536 {
            let found = format_args!("{width}x{height} pixels").to_string();
            return Err(FORMAT.error(ErrorKind::TooLarge, name, found, format_args!("about {most} pixels")));
        }
        limits.bytes(FORMAT, name, area * 4)?;
        let rgb = !decoder.has_alpha();
        let mut raw = vec![0; decoder.output_buffer_size().unwrap_or(0)];
        decoder.read_image(&mut raw).map_err(damaged)?;
        let rgba =
            if rgb { raw.chunks_exact(3).flat_map(|p| [p[0], p[1], p[2], 255]).collect() } else { raw };
        Ok(Self { width: width as usize, rgba })
    }

    /// Degree and entries of a palette, by its size.
    fn entries(&self) -> Result<(ShDegree, u64), ImportError> {
        let degree = (1..=3).filter_map(ShDegree::new).find(|d| PALETTE_ROW * d.rest_len() / 3 == self.width);
        let degree = degree
            .ok_or_else(|| FORMAT.malformed("width of shN centroids", self.width, "192, 512 or 960"))?;
        Ok((degree, (self.rgba.len() / 4 / self.width * PALETTE_ROW) as u64))
    }

    fn pixel(&self, index: usize) -> [u8; 4] {
        let at = index * 4;
        self.rgba.get(at..at + 4).and_then(|p| p.try_into().ok()).unwrap_or([0; 4])
    }
}

#[cfg(test)]
#[path = "sog/tests.rs"]
pub(super) mod tests;
