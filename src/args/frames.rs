//! Parses a range of frames.

use std::{fmt, ops::Range, str::FromStr};

use anyhow::{Result, bail};

/// Frames of a clip, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRange {
    first: u32,
    /// `None` is the clip's last.
    last: Option<u32>,
}

impl FrameRange {
    /// The frames, of `count`, that it names.
    ///
    /// # Errors
    /// One beyond the clip's end.
    pub fn within(self, count: u32) -> Result<Range<u32>> {
        let end = self.last.map_or(count, |last| last.saturating_add(1));
        if self.first >= count || end > count {
            bail!("--frames is {self}; frames 0 to {} are there", count.saturating_sub(1));
        }
        Ok(self.first..end)
    }
}

impl fmt::Display for FrameRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.last {
            Some(last) => write!(f, "{}..{last}", self.first),
            None => write!(f, "{}..", self.first),
        }
    }
}

impl FromStr for FrameRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || "a frame, FIRST..LAST or FIRST.. is allowed".to_owned();
        let number = |text: &str| text.trim().parse::<u32>().map_err(|_| refused());
        let (first, last) = match text.split_once("..") {
            None => (number(text)?, Some(number(text)?)),
            Some((first, "")) => (number(first)?, None),
            Some(("", last)) => (0, Some(number(last)?)),
            Some((first, last)) => (number(first)?, Some(number(last)?)),
        };
        if last.is_some_and(|last| last < first) {
            return Err("a last frame that is no less than the first is allowed".to_owned());
        }
        Ok(Self { first, last })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_include_both_ends() {
        let range = |text: &str| text.parse::<FrameRange>().unwrap().within(10).unwrap();
        assert_eq!((range("3"), range("2..4"), range("7.."), range("..1")), (3..4, 2..5, 7..10, 0..2));
        for text in ["", "a", "4..2", "1..2..3", "-1"] {
            assert!(text.parse::<FrameRange>().is_err(), "{text}");
        }
        let beyond = "5..10".parse::<FrameRange>().unwrap().within(10).unwrap_err().to_string();
        assert!(beyond.contains("5..10") && beyond.contains("0 to 9"), "{beyond}");
    }
}
