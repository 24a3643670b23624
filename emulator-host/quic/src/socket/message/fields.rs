//! Reads the fields of a message in order, and says why bytes are no message.

/// Why bytes are no message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum MessageError {
    /// No message of this kind comes from that side.
    #[error("message kind is {found:#04x}, allowed {allowed}")]
    Kind {
        /// The kind.
        found: u8,
        /// Kinds from that side.
        allowed: &'static str,
    },
    /// A body of impossible length.
    #[error("{message}: length is {found}, allowed {least} to {most}")]
    Length {
        /// Name of the message.
        message: &'static str,
        /// What it claims.
        found: u32,
        /// Least.
        least: usize,
        /// Most.
        most: usize,
    },
    /// A field with an impossible value.
    #[error("{message}.{field} is {found}, allowed {allowed}")]
    Field {
        /// Name of the message.
        message: &'static str,
        /// Name of the field.
        field: &'static str,
        /// What it says.
        found: u64,
        /// What it may say.
        allowed: &'static str,
    },
    /// A body that ends before its fields do, or goes on after them.
    #[error("{message}: the body has {found} bytes, its fields take {needed}")]
    Body {
        /// Name of the message.
        message: &'static str,
        /// Bytes there are.
        found: usize,
        /// Bytes needed.
        needed: usize,
    },
}

/// Reads the fields of a body in order.
pub(super) struct Fields<'b> {
    message: &'static str,
    body: &'b [u8],
    needed: usize,
}

impl<'b> Fields<'b> {
    pub(super) const fn new(message: &'static str, body: &'b [u8]) -> Self {
        Self { message, body, needed: 0 }
    }

    pub(super) fn bytes(&mut self, len: usize) -> Result<&'b [u8], MessageError> {
        let short = MessageError::Body {
            message: self.message,
            found: self.needed + self.body.len(),
            needed: self.needed + len,
        };
        let (taken, rest) = self.body.split_at_checked(len).ok_or(short)?;
        self.body = rest;
        self.needed += len;
        Ok(taken)
    }

    pub(super) fn number(&mut self, len: usize) -> Result<u64, MessageError> {
        let bytes = self.bytes(len)?.iter().rev();
        Ok(bytes.fold(0, |number, byte| number << 8 | u64::from(*byte)))
    }

    pub(super) fn byte(&mut self) -> Result<u8, MessageError> {
        Ok(self.number(1)? as u8)
    }

    pub(super) fn word(&mut self) -> Result<u32, MessageError> {
        Ok(self.number(4)? as u32)
    }

    pub(super) fn text(&mut self, len: usize, field: &'static str) -> Result<&'b str, MessageError> {
        let bytes = self.bytes(len)?;
        std::str::from_utf8(bytes).map_err(|error| {
            let found = bytes.get(error.valid_up_to()).copied().unwrap_or(0).into();
            MessageError::Field { message: self.message, field, found, allowed: "UTF-8" }
        })
    }

    pub(super) fn end(self) -> Result<(), MessageError> {
        if self.body.is_empty() {
            return Ok(());
        }
        let found = self.needed + self.body.len();
        Err(MessageError::Body { message: self.message, found, needed: self.needed })
    }
}
