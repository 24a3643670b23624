//! Bytes as choices: a reader that never runs out, seeded noise, and edits.

/// Hands out bytes of an input; zeros once it is used up.
pub struct Choices<'a> {
    rest: &'a [u8],
}

impl<'a> Choices<'a> {
    pub fn new(data: &'a [u8]) -> Self {
        Self { rest: data }
    }

    pub fn is_empty(&self) -> bool {
        self.rest.is_empty()
    }

    pub fn rest(self) -> &'a [u8] {
        self.rest
    }

    pub fn u8(&mut self) -> u8 {
        let Some((first, rest)) = self.rest.split_first() else { return 0 };
        self.rest = rest;
        *first
    }

    pub fn u16(&mut self) -> u16 {
        u16::from_le_bytes([self.u8(), self.u8()])
    }

    pub fn u32(&mut self) -> u32 {
        u32::from(self.u16()) | u32::from(self.u16()) << 16
    }

    /// Below `count`, or 0 if that is 0.
    pub fn below(&mut self, count: usize) -> usize {
        usize::from(self.u16()) % count.max(1)
    }

    /// Up to `len` bytes.
    pub fn take(&mut self, len: usize) -> &'a [u8] {
        let (head, rest) = self.rest.split_at(len.min(self.rest.len()));
        self.rest = rest;
        head
    }
}

/// A small generator (SplitMix64): the same seed gives the same noise everywhere.
pub struct Noise(pub u64);

impl Noise {
    pub fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }
}

/// Changes `bytes` as `choices` say until they are used up: each edit is a place (2 bytes) and
/// what to do there (1 byte kind, 1 byte operand).
pub fn edit(bytes: &mut Vec<u8>, choices: &mut Choices<'_>) {
    while !choices.is_empty() {
        let at = choices.below(bytes.len());
        let (kind, operand) = (choices.u8(), choices.u8());
        match (kind % 8, bytes.get_mut(at)) {
            (0..=3, Some(byte)) => *byte ^= operand,
            (4, Some(byte)) => *byte = byte.wrapping_add(operand),
            (5, Some(byte)) => *byte = operand,
            (6, _) => bytes.truncate(at.max(1)),
            (_, _) => bytes.insert(at, operand),
        }
    }
}
