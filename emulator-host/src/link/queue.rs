//! Queues datagrams in front of a serialiser: first in, first out, dropping at the tail.
//!
//! It is a part of the rate boxes and no box by itself, because only the serialiser knows when the head may
//! leave. The datagram in service does not count against the limit.

use std::collections::VecDeque;

use super::{Datagram, Tally};

/// Most that may wait. Both bounds hold; use `u64::MAX` and `u32::MAX` for none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QueueLimit {
    /// Bytes on the link.
    pub bytes: u64,
    /// Datagrams.
    pub datagrams: u32,
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
