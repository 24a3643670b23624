//! Queues datagrams in front of a serialiser: first in, first out, dropping at the tail.
//!
//! It is a part of the rate boxes and no box by itself, because only the serialiser knows when the head may
//! leave. The datagram in service does not count against the limit.

use std::collections::VecDeque;

use super::{Datagram, Tally};
use crate::clock::{Bytes, Nanos, Rate};

/// Most that may wait. Both bounds hold; use `u64::MAX` and `u32::MAX` for none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueLimit {
    /// Bytes on the link.
    pub bytes: u64,
    /// Datagrams.
    pub datagrams: u32,
}

/// Two whole datagrams: a shorter queue would let no packet wait behind another.
const MIN_BYTES: u64 = 3000;

impl QueueLimit {
    /// As many bytes as a link of `rate` sends in `time`, two whole datagrams at least.
    ///
    /// # Examples
    /// ```
    /// use emulator_host::{Nanos, Rate, link::QueueLimit};
    ///
    /// assert_eq!(QueueLimit::lasting(Nanos::from_ms(250), Rate::from_mbps(5)).bytes, 156_250);
    /// ```
    pub fn lasting(time: Nanos, rate: Rate) -> Self {
        let Bytes(bytes) = rate.bytes_in(time);
        Self { bytes: bytes.max(MIN_BYTES), ..Self::default() }
    }
}

impl Default for QueueLimit {
    /// 150 kB, any number of datagrams.
    fn default() -> Self {
        Self { bytes: 150_000, datagrams: u32::MAX }
    }
}

/// A drop-tail queue.
#[derive(Debug)]
pub struct DropTail {
    limit: QueueLimit,
    waiting: VecDeque<Datagram>,
    bytes: u64,
}

impl DropTail {
    /// An empty queue.
    pub fn new(limit: QueueLimit) -> Self {
        Self { limit, waiting: VecDeque::new(), bytes: 0 }
    }

    /// Whether `datagram` found room; if not, it is dropped.
    pub fn offer(&mut self, datagram: Datagram) -> bool {
        let bytes = self.bytes.saturating_add(u64::from(datagram.bytes));
        if bytes > self.limit.bytes || self.waiting.len() >= self.limit.datagrams as usize {
            return false;
        }
        self.bytes = bytes;
        self.waiting.push_back(datagram);
        true
    }

    /// The oldest datagram.
    pub fn take(&mut self) -> Option<Datagram> {
        let datagram = self.waiting.pop_front()?;
        self.bytes -= u64::from(datagram.bytes);
        Some(datagram)
    }

    /// What waits.
    pub fn contents(&self) -> Tally {
        Tally { datagrams: self.waiting.len() as u64, bytes: self.bytes }
    }
}
