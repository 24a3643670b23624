//! Hands out the bytes of a compressed view from front to back, and says what is wrong with them.

use std::fmt::Display;

/// What is wrong with a compressed view.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// The field at fault.
    pub field: &'static str,
    /// What was there.
    pub found: String,
    /// What would have been accepted.
    pub allowed: String,
}

impl Fault {
    pub fn new(field: &'static str, found: impl Display, allowed: impl Display) -> Self {
        Self { field, found: found.to_string(), allowed: allowed.to_string() }
    }
}

/// Bytes not read yet.
pub struct Source<'a>(pub &'a [u8]);

impl<'a> Source<'a> {
    /// The next `count` bytes.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], Fault> {
        let (taken, rest) = self
            .0
            .split_at_checked(count)
            .ok_or_else(|| Fault::new("content", format_args!("{} bytes more", self.0.len()), count))?;
        self.0 = rest;
        Ok(taken)
    }

    /// The next byte.
    pub fn byte(&mut self) -> Result<u8, Fault> {
        self.take(1).map(|byte| byte[0])
    }

    /// A number in groups of seven bits, lowest first, each but the last marked by its highest bit.
    pub fn varint(&mut self) -> Result<u32, Fault> {
        let mut value = 0;
        for group in 0..5 {
            let byte = self.byte()?;
            value |= u32::from(byte & 0x7f) << (7 * group);
            if byte < 0x80 {
                return Ok(value);
            }
        }
        Err(Fault::new("content", "a number of more than five bytes", "up to five"))
    }

    /// Refuses bytes that nothing has read.
    pub fn end(&self) -> Result<(), Fault> {
        if self.0.is_empty() {
            return Ok(());
        }
        Err(Fault::new("content", format_args!("{} bytes too many", self.0.len()), "none"))
    }
}
