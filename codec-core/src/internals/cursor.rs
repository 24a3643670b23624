//! Reading and writing bytes that cannot overrun.
//!
//! A [`Reader`] hands out fields in order and remembers the offset for error messages; leftovers
//! are an error ([`Reader::finish`]). A [`Writer`] fills a caller's buffer and says when it is
//! full. Integers are little-endian. Varints are LEB128, at most five bytes, shortest form only.

use crate::error::{Error, ErrorKind, Result};

/// A reader over `bytes`.
#[derive(Clone, Copy, Debug)]
pub struct Reader<'a> {
    /// What has not been read.
    rest: &'a [u8],
    /// Offset of its first byte.
    at: usize,
}

macro_rules! read_le {
    ($($name:ident -> $type:ty),*) => {$(
        /// The next little-endian value.
        ///
        /// # Errors
        /// [`ErrorKind::Short`].
        pub fn $name(&mut self, field: &'static str) -> Result<$type> {
            Ok(<$type>::from_le_bytes(self.array(field)?))
        }
    )*};
}

impl<'a> Reader<'a> {
    /// A reader at the start of `bytes`.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, at: 0 }
    }

    /// Offset of the next byte.
    pub const fn offset(&self) -> usize {
        self.at
    }

    /// Bytes left.
    pub const fn left(&self) -> usize {
        self.rest.len()
    }

    /// The next `len` bytes.
    ///
    /// # Errors
    /// [`ErrorKind::Short`].
    pub fn bytes(&mut self, field: &'static str, len: usize) -> Result<&'a [u8]> {
        let short = Error::short(field, self.at, self.rest.len(), len);
        let (found, rest) = self.rest.split_at_checked(len).ok_or(short)?;
        (self.rest, self.at) = (rest, self.at + len);
        Ok(found)
    }

    /// The next `N` bytes.
    ///
    /// # Errors
    /// [`ErrorKind::Short`].
    pub fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N]> {
        let short = Error::short(field, self.at, self.rest.len(), N);
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or(short)?;
        (self.rest, self.at) = (rest, self.at + N);
        Ok(*head)
    }

    read_le!(u8 -> u8, u16 -> u16, u32 -> u32, u64 -> u64, i16 -> i16, f32 -> f32);

    /// The next varint, at most `max`.
    ///
    /// # Errors
    /// [`ErrorKind::Short`]; [`ErrorKind::Illegal`] if it is over `max`, or, of its last byte, if it is too
    /// long or not in shortest form.
    pub fn varint(&mut self, field: &'static str, max: u32) -> Result<u32> {
        let (start, mut value, mut last) = (self.at, 0u64, 0u8);
        for shift in [0u32, 7, 14, 21, 28] {
            last = self.u8(field)?;
            value |= u64::from(last & 0x7f) << shift;
            if last & 0x80 == 0 {
                if last == 0 && shift > 0 {
                    break;
                }
                return in_range(field, start, value, 0, max.into()).map(|value| value as u32);
            }
        }
        Err(Error::illegal(field, self.at - 1, last.into(), (1, 0x7f)))
    }

    /// A varint in `low..=high`.
    ///
    /// # Errors
    /// As [`Reader::varint`].
    pub fn varint_in(&mut self, field: &'static str, low: u32, high: u32) -> Result<u32> {
        let start = self.at;
        let value = self.varint(field, high)?;
        in_range(field, start, value, low, high)
    }

    /// Refuses leftovers.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`] naming `field` if bytes are left.
    pub fn finish(self, field: &'static str) -> Result<()> {
        if self.left() == 0 {
            return Ok(());
        }
        Err(Error::illegal(field, self.at, self.left() as u64, (0, 0)))
    }
}

/// `value` if it lies in `low..=high`.
///
/// # Errors
/// [`ErrorKind::Illegal`].
pub fn in_range<T: Into<u64> + Copy>(
    field: &'static str,
    offset: usize,
    value: T,
    low: T,
    high: T,
) -> Result<T> {
    let (v, l, h): (u64, u64, u64) = (value.into(), low.into(), high.into());
    if v < l || v > h {
        return Err(Error::illegal(field, offset, v, (l, h)));
    }
    Ok(value)
}

/// A writer into a caller's buffer.
#[derive(Debug)]
pub struct Writer<'a> {
    bytes: &'a mut [u8],
    /// Invariant: `at <= bytes.len()`.
    at: usize,
}

impl<'a> Writer<'a> {
    /// A writer at the start of `bytes`.
    pub fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// Bytes written.
    pub const fn len(&self) -> usize {
        self.at
    }

    /// True before the first byte.
    pub const fn is_empty(&self) -> bool {
        self.at == 0
    }

    /// The bytes written so far.
    pub fn written(&self) -> &[u8] {
        &self.bytes[..self.at]
    }

    /// Appends `bytes`.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if they do not fit; nothing is written then.
    pub fn bytes(&mut self, bytes: &[u8]) -> Result<()> {
        let room = self.bytes.len() - self.at;
        let target = self.bytes.get_mut(self.at..self.at + bytes.len());
        let target =
            target.ok_or(Error::short("buffer", self.at, room, bytes.len()).kind(ErrorKind::Capacity))?;
        target.copy_from_slice(bytes);
        self.at += bytes.len();
        Ok(())
    }

    /// Appends `value` as a varint in shortest form.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`].
    pub fn varint(&mut self, mut value: u32) -> Result<()> {
        while value >= 0x80 {
            self.bytes(&[value as u8 | 0x80])?;
            value >>= 7;
        }
        self.bytes(&[value as u8])
    }
}

/// Bytes that [`Writer::varint`] takes for `value`.
pub const fn varint_len(value: u32) -> usize {
    // Of seven bits each; 0 takes one, too.
    (u32::BITS - (value | 1).leading_zeros()).div_ceil(7) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn varints_round_trip_in_their_stated_length(value: u32) {
            let mut buffer = [0u8; 8];
            let mut writer = Writer::new(&mut buffer);
            writer.varint(value).unwrap();
            prop_assert_eq!(writer.len(), varint_len(value));
            let len = writer.len();
            let mut reader = Reader::new(&buffer[..len]);
            prop_assert_eq!(reader.varint("v", u32::MAX).unwrap(), value);
            reader.finish("v").unwrap();
        }

        #[test]
        fn any_bytes_are_read_or_refused(bytes: [u8; 6], max: u32) {
            let mut reader = Reader::new(&bytes);
            if let Ok(value) = reader.varint("v", max) {
                prop_assert!(value <= max);
                let mut again = [0u8; 8];
                let mut writer = Writer::new(&mut again);
                writer.varint(value).unwrap();
                prop_assert_eq!(writer.written(), &bytes[..reader.offset()]);
            }
        }
    }

    #[test]
    fn long_forms_and_overlong_values_are_refused() {
        let long_zero = [0x80, 0x00];
        assert_eq!(Reader::new(&long_zero).varint("v", 9), Err(Error::illegal("v", 1, 0, (1, 0x7f))));
        let six = [0xff, 0xff, 0xff, 0xff, 0xff, 0x01];
        assert_eq!(Reader::new(&six).varint("v", u32::MAX), Err(Error::illegal("v", 4, 0xff, (1, 0x7f))));
        assert_eq!(Reader::new(&[0x8a, 0x01]).varint("v", 9), Err(Error::illegal("v", 0, 138, (0, 9))));
        assert_eq!(Reader::new(&[0x80]).varint("v", 9).unwrap_err().kind, ErrorKind::Short);
    }

    #[test]
    fn a_full_buffer_is_a_capacity_error_and_writes_nothing() {
        let mut buffer = [0u8; 3];
        let mut writer = Writer::new(&mut buffer);
        writer.bytes(&[1, 2]).unwrap();
        assert_eq!(writer.bytes(&[3, 4]).unwrap_err().kind, ErrorKind::Capacity);
        assert_eq!(writer.written(), [1, 2]);
    }
}
