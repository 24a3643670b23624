//! Which entropy tables a stream's runs choose from, and the code words by which they say so.
//!
//! Symbols of one component of one block are alike, those of the next block may not be: each run
//! names its table. Code words travel apart from the entropy-coded values, so that all tables of a
//! packet are known before its first value is decoded.

use crate::{
    cursor::in_range,
    error::{Error, ErrorKind, Result},
    limits::MAX_TABLE_SET,
    wire::bits::Bits,
};

/// The entropy tables that a stream's runs choose from: a prefix code over indices of tables.
///
/// A table set of one table costs no bits. A longer one has a complete canonical prefix code: `lengths`
/// ascend, each 1..=7, and 2^−length sums to one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TableSet {
    /// Number of choices; 0 for a stream that never occurs.
    count: u8,
    lengths: [u8; MAX_TABLE_SET],
    tables: [u8; MAX_TABLE_SET],
}

/// Longest code word of a table set, bits.
pub const MAX_TABLE_SET_BITS: u8 = 7;

impl TableSet {
    /// A table set without tables.
    pub const EMPTY: Self = Self { count: 0, lengths: [0; MAX_TABLE_SET], tables: [0; MAX_TABLE_SET] };
    /// Bytes of one record.
    pub const BYTES: usize = 1 + MAX_TABLE_SET / 2 + MAX_TABLE_SET;

    /// A table set of `choices`: (table, code length), lengths ascending.
    ///
    /// # Errors
    /// More than [`MAX_TABLE_SET`] choices, or lengths that are no complete prefix code.
    pub fn new(choices: &[(u8, u8)]) -> Result<Self> {
        in_range("table_set.count", 0, choices.len() as u64, 0, MAX_TABLE_SET as u64)?;
        let mut table_set = Self { count: choices.len() as u8, ..Self::default() };
        for ((length, table), &(t, l)) in table_set.lengths.iter_mut().zip(&mut table_set.tables).zip(choices)
        {
            (*length, *table) = (l, t);
        }
        table_set.check(0)?;
        Ok(table_set)
    }

    /// Checks the record, which lies at offset `place`.
    pub(super) fn check(&self, place: usize) -> Result<()> {
        in_range("table_set.count", place, self.count, 0, MAX_TABLE_SET as u8)?;
        if self.count < 2 {
            in_range("table_set.lengths", place + 1, largest(&self.lengths, 0), 0, 0)?;
        } else {
            self.check_code(place)?;
        }
        let used = usize::from(self.count);
        in_range("table_set.lengths", place + 1, largest(&self.lengths, used), 0, 0)?;
        in_range("table_set.tables", place + 5, largest(&self.tables, used), 0, 0)?;
        Ok(())
    }

    /// Checks that lengths ascend and that the code is complete: no bits lead nowhere, none to two
    /// tables.
    fn check_code(&self, place: usize) -> Result<()> {
        // Code words of the longest kind that no table has taken yet.
        let mut free = 1u32 << MAX_TABLE_SET_BITS;
        let mut before = 1;
        for (i, &length) in self.lengths.iter().take(usize::from(self.count)).enumerate() {
            in_range("table_set.lengths", place + 1, length, before, MAX_TABLE_SET_BITS)?;
            let Some(shortest) = free.checked_ilog2() else {
                let (count, most) = (u64::from(self.count), i as u64);
                return Err(Error::illegal("table_set.count", place, count, (0, most)));
            };
            let least = MAX_TABLE_SET_BITS - shortest as u8;
            in_range("table_set.lengths", place + 1, length, least, MAX_TABLE_SET_BITS)?;
            free -= 1 << (MAX_TABLE_SET_BITS - length);
            before = length;
        }
        if free > 0 {
            // A shorter last code word would take what is left.
            in_range("table_set.lengths", place + 1, before, 1, before - 1)?;
        }
        Ok(())
    }

    /// The record of `bytes`, which [`TableSet::check`] has let pass or has yet to.
    pub(super) fn from_bytes(bytes: &[u8; Self::BYTES]) -> Self {
        let [count, a, b, c, d, tables @ ..] = *bytes;
        let mut lengths = [0; MAX_TABLE_SET];
        for ([low, high], byte) in lengths.as_chunks_mut::<2>().0.iter_mut().zip([a, b, c, d]) {
            (*low, *high) = (byte & 0xf, byte >> 4);
        }
        Self { count, lengths, tables }
    }

    /// The record's bytes: count, code lengths as nibbles (first low), tables.
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let mut bytes = [0; Self::BYTES];
        let (head, tables) = bytes.split_at_mut(1 + MAX_TABLE_SET / 2);
        tables.copy_from_slice(&self.tables);
        for (i, byte) in head.iter_mut().enumerate() {
            *byte = match i {
                0 => self.count,
                _ => self.lengths[2 * i - 2] | self.lengths[2 * i - 1] << 4,
            };
        }
        bytes
    }

    /// Number of choices.
    pub const fn len(&self) -> usize {
        self.count as usize
    }

    /// True for a stream that never occurs.
    pub const fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Tables and code lengths, in order of their code words.
    pub fn choices(&self) -> impl Iterator<Item = (u8, u8)> + use<> {
        let Self { count, lengths, tables } = *self;
        tables.into_iter().zip(lengths).take(usize::from(count))
    }

    /// The table that the next code word of `bits` names. Nothing is read for a table set of one.
    ///
    /// # Errors
    /// [`ErrorKind::Short`] if the bits end, a contradiction for an empty table set.
    pub fn select(&self, bits: &mut Bits<'_>) -> Result<u8> {
        if self.count == 1 {
            return Ok(self.tables[0]);
        }
        // Canonical codes: code words of one length are consecutive numbers.
        let (mut code, mut first, mut length) = (0u32, 0u32, 0u8);
        for (&table, &wanted) in self.tables.iter().zip(&self.lengths).take(usize::from(self.count)) {
            while length < wanted {
                code = code << 1 | u32::from(bits.bit()?);
                first <<= 1;
                length += 1;
            }
            if code == first {
                return Ok(table);
            }
            first += 1;
        }
        let none = Error::illegal("slice.table", 0, 0, (1, MAX_TABLE_SET as u64));
        Err(none.kind(ErrorKind::Contradiction))
    }

    /// The code word of choice `index`: value, most significant bit first, and length.
    pub fn code(&self, index: usize) -> Option<(u32, u8)> {
        let (mut first, mut length) = (0u32, 0u8);
        for (i, &wanted) in self.lengths.iter().take(usize::from(self.count)).enumerate() {
            first <<= wanted - length;
            length = wanted;
            if i == index {
                return Some((first, length));
            }
            first += 1;
        }
        None
    }
}

/// The largest of `values` behind the first `used`.
fn largest(values: &[u8; MAX_TABLE_SET], used: usize) -> u8 {
    values.iter().skip(used).fold(0, |largest, &value| largest.max(value))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::bits::BitWriter;

    fn table_set() -> TableSet {
        TableSet::new(&[(7, 1), (3, 2), (9, 3), (0, 4), (200, 4)]).unwrap()
    }

    #[test]
    fn every_choice_reads_back_from_its_code_word() {
        let table_set = table_set();
        let mut bytes = [0u8; 8];
        let mut writer = BitWriter::new(&mut bytes);
        let order = [4usize, 0, 0, 3, 1, 2, 4, 0];
        for &choice in &order {
            let (code, length) = table_set.code(choice).unwrap();
            writer.code(code, length).unwrap();
        }
        let used = writer.finish();
        let mut bits = Bits::new(&bytes[..used]);
        for &choice in &order {
            let (table, _) = table_set.choices().nth(choice).unwrap();
            assert_eq!(table_set.select(&mut bits).unwrap(), table);
        }
        assert_eq!(bits.used_bytes(), used);
        assert_eq!(table_set.code(5), None);
    }

    #[test]
    fn records_round_trip_and_broken_codes_are_refused() {
        let table_set = table_set();
        let bytes = table_set.to_bytes();
        assert_eq!(TableSet::from_bytes(&bytes), table_set);
        assert_eq!(table_set.check(0), Ok(()));
        for (choices, field) in [
            (&[(1u8, 1u8), (2, 2)][..], "table_set.lengths"),
            (&[(1, 2), (2, 1), (3, 2)], "table_set.lengths"),
            (&[(1, 1)], "table_set.lengths"),
            (&[(1, 0), (2, 1)], "table_set.lengths"),
            (&[(0, 4); 9], "table_set.count"),
        ] {
            assert_eq!(TableSet::new(choices).unwrap_err().field, field, "{choices:?}");
        }
        let mut dirty = bytes;
        dirty[12] = 1;
        assert_eq!(TableSet::from_bytes(&dirty).check(0).unwrap_err().field, "table_set.tables");
        // Far more choices than there are places for.
        dirty[0] = u8::MAX;
        assert_eq!(TableSet::from_bytes(&dirty).check(0).unwrap_err().field, "table_set.count");
    }

    #[test]
    fn a_table_set_of_one_reads_nothing_and_of_none_contradicts() {
        let mut bits = Bits::new(&[]);
        assert_eq!(TableSet::new(&[(5, 0)]).unwrap().select(&mut bits).unwrap(), 5);
        assert_eq!(TableSet::default().select(&mut bits).unwrap_err().kind, ErrorKind::Contradiction);
        assert_eq!(self::table_set().select(&mut bits).unwrap_err().kind, ErrorKind::Short);
    }
}
