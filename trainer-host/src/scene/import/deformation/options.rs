//! Reads the options of a training that its weights do not show, from `cfg_args` or JSON.

use serde::Deserialize;

use crate::scene::import::error::{Format, ImportError};

const FORMAT: Format = Format::Deformation;

/// What moves, and how. The default is that of the trainer.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(default)]
pub struct FieldOptions {
    /// Positions stay.
    pub no_dx: bool,
    /// Sizes stay.
    pub no_ds: bool,
    /// Rotations stay.
    pub no_dr: bool,
    /// Opacities stay.
    pub no_do: bool,
    /// Colours stay.
    pub no_dshs: bool,
    /// There are no planes.
    pub no_grid: bool,
    /// Rotations are multiplied, not added.
    pub apply_rotation: bool,
    /// Features are seen with their sines and cosines at this frequency, if above 1.
    pub grid_pe: u32,
}

impl Default for FieldOptions {
    fn default() -> Self {
        Self {
            no_dx: false,
            no_ds: false,
            no_dr: false,
            no_do: true,
            no_dshs: true,
            no_grid: false,
            apply_rotation: false,
            grid_pe: 0,
        }
    }
}

impl FieldOptions {
    /// From JSON, or from the `Namespace(NAME=VALUE, …)` that the trainer writes. Other names are skipped.
    ///
    /// # Errors
    /// Another text, or a value that is none of its option.
    pub fn parse(text: &[u8]) -> Result<Self, ImportError> {
        let malformed = |found: &dyn std::fmt::Display| {
            FORMAT.malformed("options", found, "JSON, or Namespace(...) as in cfg_args")
        };
        let text = str::from_utf8(text).map_err(|e| malformed(&e))?.trim();
        if text.starts_with('{') {
            return serde_json::from_str(text).map_err(|e| malformed(&e));
        }
        let inside = text.strip_prefix("Namespace(").and_then(|text| text.strip_suffix(')'));
        let inside = inside.ok_or_else(|| malformed(&"another text"))?;
        let mut options = Self::default();
        for entry in entries(inside) {
            let Some((name, value)) = entry.split_once('=') else { continue };
            let flag = match name.trim() {
                "no_dx" => &mut options.no_dx,
                "no_ds" => &mut options.no_ds,
                "no_dr" => &mut options.no_dr,
                "no_do" => &mut options.no_do,
                "no_dshs" => &mut options.no_dshs,
                "no_grid" => &mut options.no_grid,
                "apply_rotation" => &mut options.apply_rotation,
                "grid_pe" => {
                    let number = value.trim().parse();
                    options.grid_pe = number.map_err(|e| FORMAT.malformed("grid_pe", e, "a number"))?;
                    continue;
                }
                _ => continue,
            };
            *flag = match value.trim() {
                "True" => true,
                "False" => false,
                other => return Err(FORMAT.malformed(name.trim(), other, "True or False")),
            };
        }
        Ok(options)
    }
}

/// What commas separate that are in no quotes and no brackets.
fn entries(text: &str) -> Vec<&str> {
    let (mut entries, mut start, mut depth) = (Vec::new(), 0, 0i32);
    let (mut quote, mut escaped) = (None, false);
    for (at, c) in text.char_indices() {
        match (quote, c) {
            _ if escaped => escaped = false,
            (Some(_), '\\') => escaped = true,
            (Some(open), c) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '\'' | '"') => quote = Some(c),
            (None, '(' | '[' | '{') => depth += 1,
            (None, ')' | ']' | '}') => depth -= 1,
            (None, ',') if depth == 0 => {
                entries.push(&text[start..at]);
                start = at + 1;
            }
            (None, _) => {}
        }
    }
    entries.push(&text[start..]);
    entries
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_text_of_the_trainer_is_read() {
        let text = r"Namespace(bounds=1.6, source_path='it\'s, no_dx=True', multires=[1, 2], no_do=False,
            kplanes_config={'resolution': [64, 64], 'no_ds=True,': 1}, grid_pe=2, no_dshs=True)";
        let options = FieldOptions::parse(text.as_bytes()).unwrap();
        assert_eq!(options, FieldOptions { no_do: false, grid_pe: 2, ..FieldOptions::default() });
        let options = FieldOptions::parse(br#" {"no_dr": true, "bounds": 1.6} "#).unwrap();
        assert_eq!(options, FieldOptions { no_dr: true, ..FieldOptions::default() });
        for (text, says) in [
            (&b"Namespace(no_dx=1)"[..], "no_dx: found 1"),
            (b"Namespace(grid_pe=x)", "grid_pe"),
            (b"something", "another text"),
            (br#"{"no_dx": 3}"#, "options"),
            (b"\xff", "options"),
        ] {
            let error = FieldOptions::parse(text).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }
}
