//! Compares the index of a `.dgs` file with its packets, as they are walked over: nothing is kept of either.

use codec_core::{
    Error, ErrorKind,
    internals::wire::file::{self, Record},
};
use codec_simd::crc32;

/// Bytes of an index before its entries (magic, count) and behind them (CRC, length).
const AROUND_BYTES: usize = 8;
/// Bytes of an entry.
const ENTRY_BYTES: usize = 4;
/// Bytes of the end mark, and of the length before a packet.
const LENGTH_BYTES: usize = 2;

/// The index of a file against the records of the file that have been taken.
pub struct IndexCheck<'f> {
    entries: Box<dyn ExactSizeIterator<Item = u32> + 'f>,
    /// The first entry that has not been met.
    entry: Option<u32>,
    /// Entries of the index; byte of the file at which it begins.
    count: usize,
    place: usize,
    /// Where the next record begins, bytes of the file.
    next: usize,
    /// The first thing that is wrong.
    wrong: Option<Error>,
}

impl<'f> IndexCheck<'f> {
    /// Of the index of `file`, whose packets begin at byte `start`.
    pub fn of(file: &'f [u8], start: usize) -> Self {
        let (mut entries, wrong): (Box<dyn ExactSizeIterator<Item = u32> + 'f>, _) =
            match file::index(file, crc32) {
                Ok(entries) => (Box::new(entries), None),
                Err(error) => (Box::new(std::iter::empty()), Some(error)),
            };
        let count = entries.len();
        // Where there is an index, the file is as long as that.
        let place = file.len().saturating_sub(2 * AROUND_BYTES + ENTRY_BYTES * count);
        Self { entry: entries.next(), entries, count, place, next: start, wrong }
    }

    /// Takes the next record of the file.
    pub fn take(&mut self, record: &Record<'_>) {
        match *record {
            Record::Packet(at, ref packet) => self.packet(at, packet.bytes().len()),
            Record::Illegal(at, len, _) => self.packet(at, len),
            Record::Damaged(from, len) => {
                self.next = from + len;
                // What the index says of packets that cannot be read may well be right.
                while self.entry.is_some_and(|entry| (from..self.next).contains(&(entry as usize))) {
                    self.entry = self.entries.next();
                }
            }
            Record::End => {
                if self.entry.is_some() {
                    let most = self.met() as u64;
                    self.differs("file.index_packets", self.place + 4, self.count, (0, most));
                }
                let wanted = (self.next + LENGTH_BYTES) as u64;
                if self.place as u64 != wanted {
                    self.differs("file.index", self.place, self.place, (wanted, wanted));
                }
            }
        }
    }

    /// What is wrong with the index, if anything is.
    pub fn wrong(self) -> Option<Error> {
        self.wrong
    }

    /// A packet at byte `at`, `len` bytes.
    fn packet(&mut self, at: usize, len: usize) {
        self.next = at + len;
        let (met, wanted) = (self.met(), at - LENGTH_BYTES);
        match self.entry {
            Some(entry) if entry as usize == wanted => {}
            Some(entry) => {
                let place = self.place + AROUND_BYTES + ENTRY_BYTES * met;
                self.differs("file.index", place, entry as usize, (wanted as u64, wanted as u64));
            }
            None => {
                let least = self.count as u64 + 1;
                self.differs("file.index_packets", self.place + 4, self.count, (least, u32::MAX.into()));
            }
        }
        self.entry = self.entries.next();
    }

    /// Entries that have been met.
    fn met(&self) -> usize {
        self.count - self.entries.len() - usize::from(self.entry.is_some())
    }

    fn differs(&mut self, field: &'static str, at: usize, found: usize, allowed: (u64, u64)) {
        let error = Error::illegal(field, at, found as u64, allowed).kind(ErrorKind::Contradiction);
        self.wrong.get_or_insert(error);
    }
}
