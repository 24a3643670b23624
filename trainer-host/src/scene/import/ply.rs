//! Reads 3DGS PLY: one row per Gaussian, properties found by name.
//!
//! Exporters differ in order, leave out normals, and add columns of their own, so nothing is read by
//! place. `f_rest_*` is channel-major in the file (all red, all green, all blue) and
//! coefficient-major in a scene. Scales are natural logs and opacity is a logit; exporters that
//! write activated values are the most common fault, so values that can only be activated ones are
//! noted (never changed). Frames: COLMAP axes (x right, y down, z forward) are right-handed and are
//! kept as they are. Text and both byte orders are read.
//!
//! A numbered sequence of such files is read by [`import`](super::import) on its folder.

pub(super) mod header;

use codec_core::ShDegree;

use self::header::{Column, Header, Rows};
use super::{
    Limits,
    error::{Format, ImportError},
    snapshot::{Columns, Snapshot},
};

/// Reads a 3DGS PLY.
///
/// # Errors
/// A header that is not PLY, missing or contradictory properties, fewer rows than declared (unless
/// `keep_readable`), more than `limits` allow, or values that are not numbers.
pub fn parse(bytes: &[u8], limits: &Limits) -> Result<Snapshot, ImportError> {
    let (columns, notes) = columns(bytes, limits)?;
    columns.finish(Format::Ply, limits, notes)
}

/// The columns as they are in the file, quaternions of any length, and notes on them.
pub(super) fn columns(bytes: &[u8], limits: &Limits) -> Result<(Columns, Vec<String>), ImportError> {
    limits.bytes(Format::Ply, "file", bytes.len() as u64)?;
    let header = Header::parse(bytes, Format::Ply)?;
    let rows = header
        .rows(bytes, "vertex", limits, Format::Ply)?
        .ok_or_else(|| Format::Ply.malformed("elements", "no vertex element", "element vertex"))?;
    let mut notes: Vec<String> = rows.short(limits, Format::Ply)?.into_iter().collect();

    let required = rows
        .columns([
            "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2", "rot_0",
            "rot_1", "rot_2", "rot_3",
        ])
        .map_err(|missing| {
            Format::Ply.malformed(
                "properties",
                format_args!("no {}", missing.join(", ")),
                "x y z f_dc_0..2 opacity scale_0..2 rot_0..3",
            )
        })?;
    let harmonics = Harmonics::find(&rows, &mut notes, Format::Ply)?;

    let mut columns = Columns::with_capacity(rows.count, harmonics.degree);
    for row in 0..rows.count {
        let v = required.map(|column| rows.value(row, column) as f32);
        columns.positions.push([v[0], v[1], v[2]]);
        columns.sh0.push([v[3], v[4], v[5]]);
        columns.opacity_logits.push(v[6]);
        columns.log_scales.push([v[7], v[8], v[9]]);
        columns.rotations.push([v[10], v[11], v[12], v[13]]);
        harmonics.append(&mut columns.sh_rest, |column| rows.value(row, column) as f32);
    }
    notes.extend(activation_notes(&columns));
    Ok((columns, notes))
}

/// The columns of the higher bands: channel-major as PLY has them.
pub(super) struct Harmonics {
    columns: Vec<Column>,
    per_channel: usize,
    pub degree: ShDegree,
}

impl Harmonics {
    /// Finds `f_rest_0` and onwards; a degree above 3 is cut to 3 with a note.
    pub fn find(rows: &Rows<'_>, notes: &mut Vec<String>, format: Format) -> Result<Self, ImportError> {
        let columns: Vec<Column> = (0..73).map_while(|i| rows.column(&format!("f_rest_{i}"))).collect();
        let declared = match columns.len() {
            0 => 0,
            9 => 1,
            24 => 2,
            45 => 3,
            72 => 4,
            other => return Err(format.malformed("f_rest_* properties", other, "0, 9, 24, 45 or 72")),
        };
        if declared > 3 {
            notes.push("harmonics of degree 4 are cut to degree 3".to_owned());
        }
        let degree = ShDegree::new(declared.min(3)).unwrap_or(ShDegree::MAX);
        Ok(Self { per_channel: columns.len() / 3, columns, degree })
    }

    /// Appends one Gaussian's coefficients, coefficient-major.
    pub fn append(&self, out: &mut Vec<f32>, value: impl Fn(Column) -> f32) {
        for coefficient in 0..self.degree.rest_len() / 3 {
            out.extend((0..3).map(|channel| value(self.columns[channel * self.per_channel + coefficient])));
        }
    }
}

/// Notes on values that look activated. Only patterns that a scene in logs and logits does not show:
/// every scale positive means that no Gaussian is smaller than one unit; every opacity within 0..=1
/// means that none is fainter than one half or stronger than 0.73.
fn activation_notes(columns: &Columns) -> Vec<String> {
    const ENOUGH: usize = 16;
    let mut notes = Vec::new();
    if columns.positions.len() < ENOUGH {
        return notes;
    }
    if columns.log_scales.iter().flatten().all(|&s| s > 0.0) {
        notes.push("scales are all positive: they look linear, and are read as natural logs".to_owned());
    }
    if columns.opacity_logits.iter().all(|o| (0.0..=1.0).contains(o)) {
        notes.push("opacities are all within 0..1: they look activated, and are read as logits".to_owned());
    }
    notes
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::scene::import::error::ErrorKind;

    /// A PLY of `n` Gaussians whose property `k` of row `r` is `r + k / 100`.
    pub fn sample(format: &str, rest: usize, n: usize) -> Vec<u8> {
        let mut names: Vec<String> =
            ["opacity", "x", "label", "y", "z", "nx", "rot_3", "rot_2", "rot_1", "rot_0"]
                .map(String::from)
                .into();
        names.extend((0..3).map(|i| format!("scale_{i}")));
        names.extend((0..3).map(|i| format!("f_dc_{i}")));
        names.extend((0..rest).map(|i| format!("f_rest_{i}")));
        let mut out =
            format!("ply\nformat {format} 1.0\ncomment made here\nelement vertex {n}\n").into_bytes();
        for name in &names {
            let kind = if name == "label" { "uchar" } else { "float" };
            out.extend(format!("property {kind} {name}\n").bytes());
        }
        out.extend(b"end_header\n");
        for row in 0..n {
            for (k, name) in names.iter().enumerate() {
                let value = row as f32 + k as f32 / 100.0;
                match (format, name.as_str()) {
                    ("ascii", "label") => out.extend(b"7 "),
                    ("ascii", _) => out.extend(format!("{value} ").bytes()),
                    (_, "label") => out.push(7),
                    ("binary_big_endian", _) => out.extend(value.to_be_bytes()),
                    _ => out.extend(value.to_le_bytes()),
                }
            }
            if format == "ascii" {
                out.push(b'\n');
            }
        }
        out
    }

    #[test]
    fn every_encoding_reads_the_same_by_name() {
        let limits = Limits::default();
        let little = parse(&sample("binary_little_endian", 9, 3), &limits).unwrap();
        assert_eq!(little, parse(&sample("binary_big_endian", 9, 3), &limits).unwrap());
        assert_eq!(little, parse(&sample("ascii", 9, 3), &limits).unwrap());
        let a = little.epoch.attributes();
        assert_eq!(a.positions.frame(0, 3)[1], [1.01, 1.03, 1.04]);
        assert_eq!(a.opacity_logits.frame(0, 3)[2], 2.0);
        // f_rest_0..8 are columns 16..24; coefficient 0 is R f_rest_0, G f_rest_3, B f_rest_6.
        assert_eq!(a.sh_rest[..6], [0.16, 0.19, 0.22, 0.17, 0.20, 0.23]);
    }

    #[test]
    fn missing_properties_are_named() {
        let text = String::from_utf8(sample("ascii", 0, 1)).unwrap().replace("rot_2", "rot_x");
        let error = parse(text.as_bytes(), &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("no rot_2"), "{error}");
    }

    #[test]
    fn counts_larger_than_the_file_are_refused_or_cut() {
        let bytes = sample("binary_little_endian", 0, 4);
        let cut = &bytes[..bytes.len() - 10];
        let error = parse(cut, &Limits::default()).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Truncated);
        let limits = Limits { keep_readable: true, ..Limits::default() };
        let readable = parse(cut, &limits).unwrap();
        assert_eq!(readable.epoch.count(), 3);
        assert!(readable.notes[0].contains("3 of 4"), "{:?}", readable.notes);
        let huge = String::from_utf8_lossy(&sample("ascii", 0, 1)).replace("vertex 1", "vertex 99999999999");
        assert_eq!(parse(huge.as_bytes(), &Limits::default()).unwrap_err().kind, ErrorKind::TooLarge);
    }

    #[test]
    fn activated_values_are_noted() {
        let mut text = String::from("ply\nformat ascii 1.0\nelement vertex 20\n");
        for name in
            "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3".split(' ')
        {
            text += &format!("property float {name}\n");
        }
        text += "end_header\n";
        let row = |o: &str, s: &str| format!("0 0 0 0 0 0 {o} {s} {s} {s} 1 0 0 0\n");
        let honest = text.clone() + &row("2.5", "-4").repeat(20);
        assert!(parse(honest.as_bytes(), &Limits::default()).unwrap().notes.is_empty());
        let activated = text + &row("0.9", "0.02").repeat(20);
        assert_eq!(parse(activated.as_bytes(), &Limits::default()).unwrap().notes.len(), 2);
    }
}
