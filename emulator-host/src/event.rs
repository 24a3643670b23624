//! Queues events by time, and by order of insertion where times are equal.
//!
//! Equal times come out in the order in which they went in, so a run never depends on how a heap breaks ties.

use std::{cmp::Ordering, collections::BinaryHeap};

use crate::clock::Nanos;

/// Events ordered by (time, insertion sequence).
#[derive(Debug)]
pub struct EventQueue<T> {
    heap: BinaryHeap<Entry<T>>,
    sequence: u64,
}

impl<T> EventQueue<T> {
    /// An empty queue.
    pub fn new() -> Self {
        Self { heap: BinaryHeap::new(), sequence: 0 }
    }

    /// Adds `item` at `at`.
    pub fn push(&mut self, at: Nanos, item: T) {
        self.heap.push(Entry { at, sequence: self.sequence, item });
        self.sequence += 1;
    }

    /// Time of the earliest event.
    pub fn next_at(&self) -> Option<Nanos> {
        self.heap.peek().map(|entry| entry.at)
    }

    /// Takes the earliest event if it is due at `now`.
    pub fn pop_due(&mut self, now: Nanos) -> Option<(Nanos, T)> {
        if self.next_at()? > now {
            return None;
        }
        self.heap.pop().map(|entry| (entry.at, entry.item))
    }
}

impl<T> Default for EventQueue<T> {
    fn default() -> Self {
        Self::new()
    }
}

#[derive(Debug)]
struct Entry<T> {
    at: Nanos,
    sequence: u64,
    item: T,
}

impl<T> Ord for Entry<T> {
    // Reversed: `BinaryHeap` is a max-heap and the earliest entry has to be on top.
    fn cmp(&self, other: &Self) -> Ordering {
        (other.at, other.sequence).cmp(&(self.at, self.sequence))
    }
}

impl<T> PartialOrd for Entry<T> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<T> PartialEq for Entry<T> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl<T> Eq for Entry<T> {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_times_keep_their_order() {
        let mut queue = EventQueue::new();
        for (at, item) in [(5, 'c'), (1, 'a'), (5, 'd'), (1, 'b')] {
            queue.push(Nanos(at), item);
        }
        assert_eq!(queue.pop_due(Nanos(0)), None);
        let order: Vec<char> = std::iter::from_fn(|| queue.pop_due(Nanos(9)).map(|(_, item)| item)).collect();
        assert_eq!(order, ['a', 'b', 'c', 'd']);
        assert!(queue.heap.is_empty());
    }
}
