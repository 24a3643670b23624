//! Reads lines and fields of untrusted text.

use std::{fs::File, io::Read, path::Path};

use super::{Limits, TraceError};

/// Reads a file for one of the loaders, no more of it than the limits allow.
///
/// # Errors
/// [`TraceError::Unreadable`] or [`TraceError::TooLarge`].
pub fn read(path: &Path, limits: &Limits) -> Result<Vec<u8>, TraceError> {
    let unreadable = |error: std::io::Error| TraceError::Unreadable { reason: error.to_string() };
    let mut bytes = Vec::new();
    let file = File::open(path).map_err(unreadable)?;
    file.take(limits.file_bytes.saturating_add(1)).read_to_end(&mut bytes).map_err(unreadable)?;
    check_size(&bytes, limits)?;
    Ok(bytes)
}

/// How files of gzip begin.
const GZIP: &[u8] = &[0x1f, 0x8b];

/// Refuses what is too large or packed, and JSON: Pantheon's own logs are JSON, and their traces are
/// mahimahi's.
pub(super) fn check_text(bytes: &[u8], limits: &Limits) -> Result<(), TraceError> {
    check_size(bytes, limits)?;
    if bytes.starts_with(GZIP) {
        return Err(TraceError::Gzip);
    }
    match unmarked(bytes).trim_ascii_start().first() {
        Some(b'{' | b'[') => Err(TraceError::Json),
        _ => Ok(()),
    }
}

fn check_size(bytes: &[u8], limits: &Limits) -> Result<(), TraceError> {
    let found = bytes.len() as u64;
    if found > limits.file_bytes {
        return Err(TraceError::TooLarge { what: "bytes of the file", found, allowed: limits.file_bytes });
    }
    Ok(())
}

/// Without the mark of UTF-8 that some programs begin a file with.
fn unmarked(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

/// The first line that is neither empty nor a comment, trimmed.
pub(super) fn first_line(bytes: &[u8]) -> &[u8] {
    let mut lines = unmarked(bytes).split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
    lines.find(|line| is_content(line)).unwrap_or_default()
}

fn is_content(line: &[u8]) -> bool {
    !line.trim_ascii().is_empty() && !line.trim_ascii().starts_with(b"#")
}

/// [`lines`] without the names of columns of a CSV file, if the first line is them.
pub(super) fn rows<'a>(
    bytes: &'a [u8],
    limits: &'a Limits,
) -> impl Iterator<Item = Result<(u32, &'a [u8]), TraceError>> {
    let names = is_header(first_line(bytes));
    lines(bytes, limits).skip(usize::from(names))
}

/// Whether a line has commas and no cell that is a number.
fn is_header(line: &[u8]) -> bool {
    let is_number = |cell: &[u8]| number(cell.trim_ascii()).is_some();
    line.contains(&b',') && !line.split(|byte| *byte == b',').any(is_number)
}

/// Non-empty lines that are no comments (`#`), with their number from 1, trimmed.
pub(super) fn lines<'a>(
    bytes: &'a [u8],
    limits: &'a Limits,
) -> impl Iterator<Item = Result<(u32, &'a [u8]), TraceError>> {
    let numbered = unmarked(bytes).split(|byte| *byte == b'\n').enumerate();
    numbered.filter(|(_, line)| is_content(line)).map(|(at, line)| {
        let number = u32::try_from(at + 1).unwrap_or(u32::MAX);
        if line.len() > limits.line_bytes {
            let (found, allowed) = (line.len() as u64, limits.line_bytes as u64);
            return Err(TraceError::TooLarge { what: "bytes of a line", found, allowed });
        }
        Ok((number, line.trim_ascii()))
    })
}

pub(super) fn field(line: u32, field: &'static str, found: &[u8], allowed: &'static str) -> TraceError {
    let found = String::from_utf8_lossy(found).chars().take(40).collect();
    TraceError::Field { line, field, found, allowed }
}

pub(super) fn integer(bytes: &[u8]) -> Option<u64> {
    let digits = !bytes.is_empty() && bytes.iter().all(u8::is_ascii_digit);
    if digits { std::str::from_utf8(bytes).ok()?.parse().ok() } else { None }
}

/// A number in Rust's notation, infinities and NaN included.
fn number(bytes: &[u8]) -> Option<f64> {
    std::str::from_utf8(bytes).ok()?.parse().ok()
}

/// A finite decimal number that is not negative.
pub(super) fn decimal(bytes: &[u8]) -> Option<f64> {
    let value = number(bytes)?;
    (value.is_finite() && value >= 0.0).then_some(value)
}

pub(super) fn check_points(found: usize, limits: &Limits) -> Result<(), TraceError> {
    if found > limits.points {
        let (found, allowed) = (found as u64, limits.points as u64);
        return Err(TraceError::TooLarge { what: "points", found, allowed });
    }
    Ok(())
}
