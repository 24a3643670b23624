//! Decodes the attribute mode, versions 0 and 1: differences of bytes, packed by sixteen elements.
//!
//! Elements come in blocks. Of a block, each byte position of the elements has its own run of differences;
//! four positions are a channel, whose mode says whether they are differences of bytes, of 16-bit numbers,
//! or of the bits of 32-bit ones.

use super::source::{Fault, Source};

/// Elements packed together.
const GROUP: usize = 16;
/// Most elements in a block.
const MAX_ELEMENTS: usize = 256;
/// Most bytes that the elements of a block take.
const MAX_BYTES: usize = 8192;
/// Byte positions in a channel.
const CHANNEL: usize = 4;
/// First byte of a stream, without its version.
const MAGIC: u8 = 0xa0;

/// Differences at one byte position of a block.
type Differences = [u8; MAX_ELEMENTS];

/// How the bytes at one position of a block are stored.
enum Stored {
    /// In groups, each of one of four numbers of bits per difference.
    Groups([u32; 4]),
    /// Not at all: they are zero.
    Zero,
    /// As they are.
    Plain,
}

impl Stored {
    /// From the two bits of a stream of version 1.
    fn from_bits(bits: u8) -> Self {
        match bits {
            0 => Self::Groups([0, 1, 2, 4]),
            1 => Self::Groups([1, 2, 4, 8]),
            2 => Self::Zero,
            _ => Self::Plain,
        }
    }
}

/// What the numbers of a channel are.
#[derive(Clone, Copy)]
enum Channel {
    Bytes,
    Words,
    /// 32-bit numbers whose changed bits were turned right by so many places.
    Bits(u32),
}

impl Channel {
    fn from_byte(byte: u8) -> Result<Self, Fault> {
        match (byte & 15, byte >> 4) {
            (0, 0) => Ok(Self::Bytes),
            (1, 0) => Ok(Self::Words),
            (2, turn) => Ok(Self::Bits(u32::from(turn))),
            _ => Err(Fault::new("channel mode", format_args!("{byte:#04x}"), "0x00, 0x01 or 0x02 to 0xf2")),
        }
    }
}

/// The `count` elements of `stride` bytes, a multiple of four up to 256, that `bytes` hold. Memory grows with
/// the blocks that have been read.
pub fn decode(bytes: &[u8], count: usize, stride: usize) -> Result<Vec<u8>, Fault> {
    let mut source = Source(bytes);
    let header = source.byte()?;
    let version = header ^ MAGIC;
    if version > 1 {
        return Err(Fault::new("first byte", format_args!("{header:#04x}"), "0xa0 or 0xa1"));
    }
    let channels = stride / CHANNEL;
    let (tail, least_tail) = if version == 0 { (stride, 32) } else { (stride + channels, 24) };
    let body = source.0.len().checked_sub(tail.max(least_tail));
    let body = body.ok_or_else(|| Fault::new("content", "no room for its last element", "more bytes"))?;
    let (body, end) = source.0.split_at(body);
    let (previous, modes) = end[end.len() - tail..].split_at(stride);
    let mut previous = previous.to_vec();
    let modes = match version {
        0 => vec![Channel::Bytes; channels],
        _ => modes.iter().map(|&byte| Channel::from_byte(byte)).collect::<Result<_, _>>()?,
    };
    let mut source = Source(body);
    let most = ((MAX_BYTES / stride) & !(GROUP - 1)).min(MAX_ELEMENTS);
    let mut out = Vec::new();
    let mut left = count;
    while left > 0 {
        let elements = left.min(most);
        let controls = if version == 0 { None } else { Some(source.take(channels)?) };
        let start = out.len();
        out.resize(start + elements * stride, 0);
        for (channel, &mode) in modes.iter().enumerate() {
            let control = controls.map(|bytes| bytes[channel]);
            let mut differences = [[0; MAX_ELEMENTS]; CHANNEL];
            for (position, values) in differences.iter_mut().enumerate() {
                let stored = match control {
                    None => Stored::Groups([0, 2, 4, 8]),
                    Some(control) => Stored::from_bits(control >> (2 * position) & 3),
                };
                read_differences(&mut source, &stored, elements, values)?;
            }
            let first = channel * CHANNEL;
            let block = &mut out[start + first..];
            add_up(&differences, mode, &previous[first..first + CHANNEL], block, elements, stride);
        }
        previous.copy_from_slice(&out[start + (elements - 1) * stride..]);
        left -= elements;
    }
    source.end()?;
    Ok(out)
}

/// Reads the differences of `elements` elements at one byte position.
fn read_differences(
    source: &mut Source<'_>,
    stored: &Stored,
    elements: usize,
    out: &mut Differences,
) -> Result<(), Fault> {
    let widths = match stored {
        Stored::Zero => return Ok(()),
        Stored::Plain => {
            out[..elements].copy_from_slice(source.take(elements)?);
            return Ok(());
        }
        Stored::Groups(widths) => widths,
    };
    let groups = elements.div_ceil(GROUP);
    let header = source.take(groups.div_ceil(4))?;
    for (group, values) in out.chunks_exact_mut(GROUP).take(groups).enumerate() {
        let width = header[group / 4] >> (2 * (group % 4)) & 3;
        read_group(source, widths[usize::from(width)], values)?;
    }
    Ok(())
}

/// Reads sixteen differences of `width` bits each. Those with all bits set stand for a byte that follows.
fn read_group(source: &mut Source<'_>, width: u32, values: &mut [u8]) -> Result<(), Fault> {
    if width == 0 {
        values.fill(0);
        return Ok(());
    }
    let packed = source.take(GROUP * width as usize / 8)?;
    if width == 8 {
        values.copy_from_slice(packed);
        return Ok(());
    }
    let per_byte = 8 / width as usize;
    let full = (1u8 << width) - 1;
    for (i, value) in values.iter_mut().enumerate() {
        // Single bits start at the lowest, wider ones at the highest.
        let place = if width == 1 { i % per_byte } else { per_byte - 1 - i % per_byte };
        *value = packed[i / per_byte] >> (place as u32 * width) & full;
        if *value == full {
            *value = source.byte()?;
        }
    }
    Ok(())
}

/// Adds the differences of one channel to the element before, element by element. `block` starts at the
/// channel of the block's first element.
fn add_up(
    differences: &[Differences; CHANNEL],
    mode: Channel,
    previous: &[u8],
    block: &mut [u8],
    elements: usize,
    stride: usize,
) {
    let mut value = [previous[0], previous[1], previous[2], previous[3]];
    for element in 0..elements {
        let change = differences.each_ref().map(|position| position[element]);
        value = match mode {
            Channel::Bytes => {
                let change = change.map(|d| d >> 1 ^ (d & 1).wrapping_neg());
                [0, 1, 2, 3].map(|i| value[i].wrapping_add(change[i]))
            }
            Channel::Words => {
                let sum = |low: usize| {
                    let change = u16::from_le_bytes([change[low], change[low + 1]]);
                    let change = change >> 1 ^ (change & 1).wrapping_neg();
                    u16::from_le_bytes([value[low], value[low + 1]]).wrapping_add(change).to_le_bytes()
                };
                let (low, high) = (sum(0), sum(2));
                [low[0], low[1], high[0], high[1]]
            }
            Channel::Bits(turn) => {
                let change = u32::from_le_bytes(change).rotate_right(turn);
                (u32::from_le_bytes(value) ^ change).to_le_bytes()
            }
        };
        block[element * stride..element * stride + CHANNEL].copy_from_slice(&value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_groups_of_the_specification_are_read() {
        let bytes = [0x17, 0x5f, 0xf0, 0xbc, 0x77, 0xa9, 0x21, 0x00, 0x34, 0xb5];
        let mut values = [0; GROUP];
        let mut source = Source(&bytes);
        read_group(&mut source, 4, &mut values).unwrap();
        source.end().unwrap();
        let signed = values.map(|d| (d >> 1 ^ (d & 1).wrapping_neg()) as i8);
        assert_eq!(signed, [-1, -4, -3, 26, -91, 0, -6, 6, -4, -4, 5, -5, 1, -1, 0, 0]);
    }

    #[test]
    fn streams_that_end_early_or_late_are_refused() {
        // Twenty elements of four zero bytes after a first one: a header byte per position and group of four.
        let stream = |body: usize| {
            let mut bytes = vec![MAGIC];
            bytes.resize(1 + body + 28, 0);
            bytes.extend([1, 2, 3, 4]);
            bytes
        };
        assert_eq!(decode(&stream(4), 20, 4).unwrap(), [1, 2, 3, 4].repeat(20));
        assert_eq!(decode(&stream(3), 20, 4).unwrap_err().field, "content");
        assert!(decode(&stream(5), 20, 4).unwrap_err().found.contains("too many"));
        assert!(decode(&[0xa2; 90], 20, 4).unwrap_err().found.contains("0xa2"));
        assert!(decode(&[MAGIC], 20, 4).is_err() && decode(&[], 20, 4).is_err());
    }

    #[test]
    fn channels_that_do_not_exist_are_refused() {
        let mut bytes = vec![MAGIC | 1, 0b1010_1010];
        bytes.resize(2 + 23, 0);
        let with = |mode: u8| [&bytes[..], &[mode]].concat();
        assert_eq!(decode(&with(0), 2, 4).unwrap(), [0; 8]);
        assert_eq!(decode(&with(0xf2), 2, 4).unwrap(), [0; 8]);
        for mode in [3, 0x10, 0x21] {
            assert_eq!(decode(&with(mode), 2, 4).unwrap_err().field, "channel mode");
        }
    }
}
