//! Open bitstream units are the pieces of an AV1 stream; containers hold some of them and describe the rest.
//!
//! AV1 Bitstream and Decoding Process, sections 5.3 and 5.5; AV1 in ISO Base Media, sections 2.3 and 2.4.

use crate::error::VideoError;

/// What units are refused with.
type Result<T> = std::result::Result<T, VideoError>;

/// `obu_type` of a sequence header.
const SEQUENCE_HEADER: u8 = 1;
/// `obu_type` of a temporal delimiter, which containers leave out: each sample is one temporal unit.
const TEMPORAL_DELIMITER: u8 = 2;

/// What players must know of an AV1 stream before its first picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Av1Configuration {
    /// `seq_level_idx[0]`.
    pub level: u8,
    /// `seq_tier[0]`.
    pub tier: u8,
    /// The sequence header, as it stands in the stream.
    pub sequence_header: Vec<u8>,
}

impl Av1Configuration {
    /// Of a stream of 8 bits and 4:2:0 that begins with `unit`.
    ///
    /// # Errors
    /// No sequence header, or one of another kind of stream.
    pub fn of(unit: &[u8]) -> Result<Self> {
        let found = pieces(unit)?.into_iter().find(|piece| piece.kind == SEQUENCE_HEADER);
        let header = found.ok_or_else(|| refused("the stream does not begin with a sequence header"))?;
        let mut bits = Bits { bytes: header.body, at: 0 };
        let profile = bits.read(3)?;
        if profile != 0 {
            return Err(refused(format_args!("found profile {profile}; 0 is allowed")));
        }
        // Still picture, reduced header, timing information, initial delay: none of them is there.
        let flags = bits.read(4)?;
        if flags != 0 {
            return Err(refused(format_args!("found flags {flags:04b} of the sequence; 0000 is allowed")));
        }
        let points = bits.read(5)? + 1;
        if points != 1 {
            return Err(refused(format_args!("found {points} operating points; 1 is allowed")));
        }
        bits.read(12)?;
        let level = bits.read(5)? as u8;
        let tier = if level > 7 { bits.read(1)? as u8 } else { 0 };
        Ok(Self { level, tier, sequence_header: header.whole.to_vec() })
    }

    /// `AV1CodecConfigurationRecord`: four bytes and the sequence header.
    pub fn record(&self) -> Vec<u8> {
        // Marker, version; profile, level; tier, 8 bits, 4:2:0 with chroma on the left; no initial delay.
        let head = [0x81, self.level, self.tier << 7 | 0b1101, 0];
        [&head, self.sequence_header.as_slice()].concat()
    }
}

/// What a container holds of a temporal unit.
///
/// # Errors
/// Bytes that are no units.
pub fn sample(unit: &[u8]) -> Result<Vec<u8>> {
    let mut sample = Vec::with_capacity(unit.len());
    for piece in pieces(unit)?.iter().filter(|piece| piece.kind != TEMPORAL_DELIMITER) {
        sample.extend_from_slice(piece.whole);
    }
    Ok(sample)
}

fn refused(why: impl std::fmt::Display) -> VideoError {
    VideoError::Encoder(why.to_string())
}

/// One open bitstream unit.
struct Piece<'a> {
    kind: u8,
    /// With its header.
    whole: &'a [u8],
    body: &'a [u8],
}

fn pieces(mut bytes: &[u8]) -> Result<Vec<Piece<'_>>> {
    let mut pieces = Vec::new();
    while let Some(&head) = bytes.first() {
        if head & 0x80 != 0 || head & 2 == 0 {
            return Err(refused(format_args!("found {head:#04x}; a unit with its size is needed")));
        }
        let start = 1 + usize::from(head >> 2 & 1);
        let (size, width) = leb128(bytes.get(start..).unwrap_or_default())?;
        let (start, rest) = (start + width, bytes.len() - start - width);
        if size > rest {
            return Err(refused(format_args!("a unit of {size} bytes; {rest} are there")));
        }
        let (whole, after) = bytes.split_at(start + size);
        pieces.push(Piece { kind: head >> 3 & 15, whole, body: &whole[start..] });
        bytes = after;
    }
    Ok(pieces)
}

/// A number in sevens of bits, the lowest first, and how many bytes it takes.
fn leb128(bytes: &[u8]) -> Result<(usize, usize)> {
    let mut value = 0;
    for (index, byte) in bytes.iter().take(4).enumerate() {
        value |= usize::from(byte & 0x7f) << (7 * index);
        if byte & 0x80 == 0 {
            return Ok((value, index + 1));
        }
    }
    Err(refused("a size of more than four bytes, or without its end"))
}

struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn read(&mut self, count: usize) -> Result<u32> {
        let mut value = 0;
        for at in self.at..self.at + count {
            let byte = self.bytes.get(at / 8).ok_or_else(|| refused("the sequence header ends early"))?;
            value = value << 1 | u32::from(byte >> (7 - at % 8) & 1);
        }
        self.at += count;
        Ok(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A delimiter, a sequence header, and a frame of three bytes of which the last is missing.
    const UNIT: [u8; 12] = [0x12, 0, 0x0a, 3, 0, 0, 0, 0x32, 0x83, 0, 1, 2];

    #[test]
    fn a_sample_is_a_unit_without_its_delimiter() {
        let mut unit = UNIT.to_vec();
        unit.push(3);
        assert_eq!(sample(&unit).unwrap(), unit[2..]);
        let error = sample(&UNIT).unwrap_err().to_string();
        assert!(error.contains("a unit of 3 bytes; 2 are there"), "{error}");
        for bytes in [[0x10, 0], [0x92, 0], [0x12, 0xff]] {
            assert!(sample(&bytes).is_err(), "{bytes:?}");
        }
    }

    #[test]
    fn a_configuration_repeats_the_sequence_header() {
        // 000 0000 00000 000000000000 01000 1: profile, flags, points, operating point, level 8, upper tier.
        let header = [0x0a, 4, 0, 0, 0, 0b0100_0100];
        let found = Av1Configuration::of(&header).unwrap();
        assert_eq!((found.level, found.tier), (8, 1));
        assert_eq!(found.record(), [&[0x81, 8, 0b1000_1101, 0], &header[..]].concat());
        for (bytes, says) in [
            (&[0x12, 0][..], "does not begin with a sequence header"),
            (&[0x0a, 1, 0], "ends early"),
            (&[0x0a, 1, 0x20], "profile 1"),
            (&[0x0a, 1, 0x10], "flags 1000"),
        ] {
            let error = Av1Configuration::of(bytes).unwrap_err().to_string();
            assert!(error.contains(says), "{error}");
        }
    }
}
