//! Reads `.splat`: headerless records of 32 bytes.
//!
//! ```text
//! f32 x y z | f32 sx sy sz (linear) | u8 r g b a | u8 w x y z ((u - 128) / 128)
//! ```
//!
//! Colour is display colour, alpha linear opacity. With neither magic nor count, all that can be
//! checked is that the length is a multiple of 32 and that the numbers are numbers. Axes are kept.

use codec_core::ShDegree;

use super::{
    Limits,
    bytes::f32_at,
    error::{Format, ImportError},
    snapshot::{Columns, Snapshot, logit, sh0_of_colour},
};

const RECORD: usize = 32;
const FORMAT: Format = Format::Splat;

/// Reads `.splat` records.
///
/// # Errors
/// Empty, a length that is not a multiple of 32 (unless `keep_readable`), too many records, negative
/// scales or values that are not numbers.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    let (count, tail) = (bytes.len() / RECORD, bytes.len() % RECORD);
    let mut notes = Vec::new();
    if tail > 0 {
        if !limits.keep_readable {
            let error = FORMAT.truncated("last record", tail as u64, RECORD as u64);
            return Err(error.at(count * RECORD));
        }
        notes.push(format!("{tail} bytes after the last whole record are ignored"));
    }
    let count = limits.gaussians(FORMAT, count as u64)?;
    let mut columns = Columns::with_capacity(count, ShDegree::ZERO);
    for (index, record) in bytes.chunks_exact(RECORD).enumerate() {
        let float = |i: usize| f32_at(record, i * 4).unwrap_or(f32::NAN);
        let scale = [float(3), float(4), float(5)];
        if scale.iter().any(|&s| s < 0.0) && !limits.keep_readable {
            let error =
                FORMAT.malformed("scale", format_args!("{scale:?}"), "standard deviations, not negative");
            return Err(error.at(index * RECORD + 12));
        }
        columns.positions.push([float(0), float(1), float(2)]);
        columns.log_scales.push(scale.map(f32::ln));
        columns.sh0.push([24, 25, 26].map(|i| sh0_of_colour(f32::from(record[i]) / 255.0)));
        columns.opacity_logits.push(logit(f32::from(record[27]) / 255.0));
        columns.rotations.push([28, 29, 30, 31].map(|i| (f32::from(record[i]) - 128.0) / 128.0));
    }
    columns.finish(FORMAT, limits, notes)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::import::error::ErrorKind;

    pub fn sample(n: usize) -> Vec<u8> {
        let mut out = Vec::new();
        for i in 0..n {
            for v in [i as f32, 0.5, -0.5, 0.01, 0.02, 0.03] {
                out.extend(v.to_le_bytes());
            }
            out.extend([255, 128, 0, 204, 255, 128, 128, 128]);
        }
        out
    }

    #[test]
    fn records_read_back() {
        let s = parse(&sample(3), &Limits::default()).unwrap();
        let g = s.epoch.instant(0).gaussians[2];
        assert_eq!(g.position, [2.0, 0.5, -0.5]);
        assert_eq!(g.rotation, [1.0, 0.0, 0.0, 0.0]);
        assert!((g.scale[1] - 0.02).abs() < 1e-6 && (g.opacity - 0.8).abs() < 1e-6);
        assert!((0.5 + SH_C0 * g.sh0[0] - 1.0).abs() < 1e-6);
    }
    use crate::scene::import::snapshot::SH_C0;

    #[test]
    fn a_cut_record_is_an_error_or_ignored() {
        let bytes = sample(3);
        let error = parse(&bytes[..70], &Limits::default()).unwrap_err();
        assert_eq!((error.kind, error.offset), (ErrorKind::Truncated, Some(64)));
        let limits = Limits { keep_readable: true, ..Limits::default() };
        assert_eq!(parse(&bytes[..70], &limits).unwrap().epoch.count(), 2);
        assert_eq!(parse(&[], &limits).unwrap_err().kind, ErrorKind::Empty);
    }

    #[test]
    fn negative_scales_are_refused_in_place() {
        let mut bytes = sample(2);
        bytes[32 + 12..32 + 16].copy_from_slice(&(-1.0f32).to_le_bytes());
        assert_eq!(parse(&bytes, &Limits::default()).unwrap_err().offset, Some(44));
    }
}
