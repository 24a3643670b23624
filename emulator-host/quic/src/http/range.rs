//! Parses which bytes of a file a request wants (RFC 9110, section 14).

use std::ops::Range;

/// What a Range field asks for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Wanted {
    /// All of it: the field is none that is served, and is ignored as the standard allows.
    Whole,
    /// These bytes, at least one, all of which there are.
    Part(Range<u64>),
    /// Bytes of which there is none.
    Nothing,
}

/// What the Range field `text` wants of a file of `len` bytes. Several ranges at once are served whole.
pub(super) fn wanted(text: &str, len: u64) -> Wanted {
    let Some((unit, spec)) = text.split_once('=') else { return Wanted::Whole };
    if !unit.trim().eq_ignore_ascii_case("bytes") {
        return Wanted::Whole;
    }
    let Some((first, last)) = spec.trim().split_once('-') else { return Wanted::Whole };
    match (number(first), number(last)) {
        (Some(first), Some(last)) if last < first => Wanted::Whole,
        (Some(first), Some(last)) => part(first, last.saturating_add(1), len),
        (Some(first), None) if last.is_empty() => part(first, len, len),
        (None, Some(count)) if first.is_empty() => part(len.saturating_sub(count), len, len),
        _ => Wanted::Whole,
    }
}

fn part(first: u64, end: u64, len: u64) -> Wanted {
    let part = first..end.min(len);
    if part.is_empty() { Wanted::Nothing } else { Wanted::Part(part) }
}

/// A number of digits alone; one too large for any file is as good as the largest.
fn number(text: &str) -> Option<u64> {
    let legal = !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    legal.then(|| text.parse().unwrap_or(u64::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_as_the_standard_says() {
        for (text, part) in [
            ("bytes=0-0", 0..1),
            ("bytes=0-99", 0..100),
            ("bytes=10-", 10..100),
            ("bytes=99-99999999999999999999999", 99..100),
            ("bytes=0-18446744073709551615", 0..100),
            ("bytes=-1", 99..100),
            ("bytes=-100", 0..100),
            ("bytes=-500", 0..100),
            ("BYTES=5-6", 5..7),
            ("bytes= 5-6 ", 5..7),
        ] {
            assert_eq!(wanted(text, 100), Wanted::Part(part), "{text}");
        }
        for text in ["bytes=100-", "bytes=100-200", "bytes=-0", "bytes=99999999999999999999999-"] {
            assert_eq!(wanted(text, 100), Wanted::Nothing, "{text}");
        }
        for text in ["", "bytes", "bytes=", "bytes=-", "bytes=5", "bytes=6-5", "bytes=0-1,3-4", "lines=0-1"] {
            assert_eq!(wanted(text, 100), Wanted::Whole, "{text}");
        }
        for text in ["bytes=a-b", "bytes=+1-2", "bytes=1--2", "bytes=1-2-3", "bytes=٣-٤", "bytes=1-x"] {
            assert_eq!(wanted(text, 100), Wanted::Whole, "{text}");
        }
        assert_eq!(wanted("bytes=0-", 0), Wanted::Nothing);
        assert_eq!(wanted("bytes=-5", 0), Wanted::Nothing);
    }

    /// Byte by byte: whether the range has it.
    #[test]
    fn a_part_has_the_bytes_that_its_ends_enclose() {
        for (first, last) in (0..6u64).flat_map(|first| (first..9).map(move |last| (first, last))) {
            let has: Vec<u64> = (0..5).filter(|at| (first..=last).contains(at)).collect();
            let found = match wanted(&format!("bytes={first}-{last}"), 5) {
                Wanted::Part(part) => part.collect(),
                Wanted::Nothing => Vec::new(),
                Wanted::Whole => panic!("{first}-{last}"),
            };
            assert_eq!(found, has, "{first}-{last}");
        }
    }
}
