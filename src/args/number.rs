//! Parses numbers of the command line, and says in their own unit which ones are allowed.

use std::{fmt::Display, ops::RangeInclusive, str::FromStr};

use clap::builder::{OsStringValueParser, TypedValueParser};

/// Parses a whole number within `range`, in `unit`.
pub(super) fn whole<N>(
    range: RangeInclusive<N>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<N, String> + Clone
where
    N: FromStr + PartialOrd + Display + Clone,
{
    move |text| {
        text.parse().ok().filter(|value| range.contains(value)).ok_or_else(|| {
            format!("a whole number of {unit} from {} to {} is allowed", range.start(), range.end())
        })
    }
}

/// Parses the name of a scene or stream. Scenes are also built in and served by name, so that names of those
/// are Unicode.
pub(super) fn name() -> impl TypedValueParser<Value = String> {
    OsStringValueParser::new().try_map(|typed| {
        typed.into_string().map_err(|_| "a name in Unicode (UTF-8) is allowed; rename the file")
    })
}

/// Parses a number within `range`, in `unit`; never NaN.
pub(super) fn real(
    range: RangeInclusive<f64>,
    unit: &'static str,
) -> impl Fn(&str) -> Result<f64, String> + Clone {
    move |text| {
        let value = text.parse::<f64>().ok().filter(|value| range.contains(value));
        value.ok_or_else(|| format!("{unit} from {} to {} is allowed", range.start(), range.end()))
    }
}

/// Parses a finite number above 0.
pub(super) fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value.is_finite() => Ok(value),
        _ => Err("a finite number above 0 is allowed".to_owned()),
    }
}

/// Parses a finite number of at least 0.
pub(super) fn not_negative(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value >= 0.0 && value.is_finite() => Ok(value),
        _ => Err("a finite number of at least 0 is allowed".to_owned()),
    }
}

/// Parses a factor on the visually lossless quantiser steps.
pub(super) fn coarseness(text: &str) -> Result<f32, String> {
    real(0.001..=1000.0, "a factor on the default steps")(text).map(|factor| factor as f32)
}

/// Parses the number of packets in an XOR repair set, or 0 for none.
pub(super) fn repair_set(text: &str) -> Result<u8, String> {
    match text.parse::<u8>() {
        Ok(set @ (0 | 2..=64)) => Ok(set),
        _ => Err("2 to 64 packets per set, or 0 for no parity, is allowed".to_owned()),
    }
}

/// Parses a background: a grey level or r,g,b, each 0 to 1, or #rrggbb.
pub(super) fn background(text: &str) -> Result<[f32; 3], String> {
    if let Some(digits) = text.trim().strip_prefix('#') {
        let byte = |at: usize| digits.get(at..at + 2).and_then(|pair| u8::from_str_radix(pair, 16).ok());
        let bytes = (digits.len() == 6 && !digits.contains('+')).then(|| [byte(0), byte(2), byte(4)]);
        return match bytes {
            Some([Some(r), Some(g), Some(b)]) => Ok([r, g, b].map(|channel| f32::from(channel) / 255.0)),
            _ => Err("# and six digits of base 16 are allowed, such as #8040ff".to_owned()),
        };
    }
    let values: Result<Vec<f32>, _> = text.split(',').map(|v| v.trim().parse::<f32>()).collect();
    let values = values.map_err(|e| format!("{e}; a grey level such as 0.5, r,g,b or #rrggbb is allowed"))?;
    let rgb = match values[..] {
        [grey] => [grey; 3],
        [r, g, b] => [r, g, b],
        _ => return Err(format!("found {} numbers; 1 or 3 are allowed", values.len())),
    };
    match rgb.iter().all(|channel| (0.0..=1.0).contains(channel)) {
        true => Ok(rgb),
        false => Err("each channel from 0 to 1 is allowed".to_owned()),
    }
}

/// Parses a point: x,y,z, each finite.
pub(super) fn point(text: &str) -> Result<[f64; 3], String> {
    let values: Option<Vec<f64>> = text.split(',').map(|v| v.trim().parse().ok()).collect();
    let values = values.filter(|values| values.iter().all(|v: &f64| v.is_finite()));
    values
        .and_then(|values| values.try_into().ok())
        .ok_or_else(|| "x,y,z, each finite, is allowed".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is no number, or outside its range, is refused with the range in its unit.
    #[test]
    fn numbers_out_of_range_are_refused_with_their_range() {
        for text in ["nan", "NaN", "inf", "-inf", "0", "-1", "1e-9", "1e9", "", "one"] {
            let refused = coarseness(text).unwrap_err();
            assert_eq!(refused, "a factor on the default steps from 0.001 to 1000 is allowed", "{text}");
        }
        for text in ["nan", "inf", "-1", "x"] {
            assert!(positive(text).is_err() && not_negative(text).is_err(), "{text}");
        }
        assert!(positive("0").is_err() && not_negative("0").is_ok());
        let bytes = whole(200usize..=1226, "bytes");
        assert_eq!(bytes("199").unwrap_err(), "a whole number of bytes from 200 to 1226 is allowed");
        assert!(bytes("1227").is_err() && bytes("-5").is_err() && bytes("1e3").is_err());
        assert!(repair_set("1").is_err() && repair_set("65").is_err() && repair_set("256").is_err());
        assert!(background("0.1,nan,0").is_err() && background("0,0").is_err() && background("2").is_err());
    }

    #[test]
    fn the_ends_of_each_range_are_taken() {
        assert_eq!((coarseness("0.001"), coarseness("1000")), (Ok(0.001), Ok(1000.0)));
        let bytes = whole(200usize..=1226, "bytes");
        assert_eq!((bytes("200"), bytes("1226")), (Ok(200), Ok(1226)));
        assert_eq!((repair_set("0"), repair_set("2"), repair_set("64")), (Ok(0), Ok(2), Ok(64)));
        assert_eq!(background("0.5"), Ok([0.5; 3]));
        assert_eq!(background("0, 0.5,1"), Ok([0.0, 0.5, 1.0]));
        assert_eq!(background("#ff0033"), Ok([1.0, 0.0, 0.2]));
        for text in ["#ff003", "#ff00333", "#gg0000", "#+f+f+f", "#ü000é"] {
            assert!(background(text).unwrap_err().contains("#8040ff"), "{text}");
        }
    }
}
