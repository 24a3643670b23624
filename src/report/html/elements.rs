//! Writes the elements that several sections of the page share.

use std::fmt::Write as _;

use crate::report::plot::number;

/// Bytes as KiB.
pub(super) fn kib(bytes: u64) -> f64 {
    bytes as f64 / 1024.0
}

/// A whole number with its thousands apart.
pub(super) fn count(n: u64) -> String {
    number(n as f64, 0)
}

/// A drawing under its heading and a note that says how to read it.
pub(super) fn figure(out: &mut String, heading: &str, says: &str, svg: &str) {
    let _ = writeln!(
        out,
        "<figure class=\"figure\"><h3>{heading}</h3><p class=\"note\">{says}</p>{svg}</figure>"
    );
}
