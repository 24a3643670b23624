//! Sends the manifest reliably, in chunks, each until it is acknowledged.

use std::collections::VecDeque;

/// Bytes of one chunk.
const CHUNK_BYTES: u32 = 1150;

/// Sizes of the chunks of a stream of `bytes`.
fn chunks(bytes: u32) -> impl Iterator<Item = u32> {
    (0..bytes.div_ceil(CHUNK_BYTES)).map(move |at| CHUNK_BYTES.min(bytes - at * CHUNK_BYTES))
}

/// The sending end.
#[derive(Debug)]
pub(super) struct ControlSender {
    sizes: Vec<u32>,
    acked: Vec<bool>,
    pending: VecDeque<u32>,
}

impl ControlSender {
    pub(super) fn new(bytes: u32) -> Self {
        let sizes: Vec<u32> = chunks(bytes).collect();
        Self { acked: vec![false; sizes.len()], pending: (0..sizes.len() as u32).collect(), sizes }
    }

    /// The next chunk to send. With `probe`, an unacknowledged one if nothing is pending.
    pub(super) fn next(&mut self, probe: bool) -> Option<u32> {
        while let Some(chunk) = self.pending.pop_front() {
            if !self.acked[chunk as usize] {
                return Some(chunk);
            }
        }
        let open = self.acked.iter().position(|acked| !acked).filter(|_| probe)?;
        Some(open as u32)
    }

    /// Whether a chunk waits to be sent, for the first time or again.
    pub(super) fn has_pending(&self) -> bool {
        self.pending.iter().any(|chunk| !self.acked[*chunk as usize])
    }

    pub(super) fn bytes(&self, chunk: u32) -> u32 {
        self.sizes[chunk as usize]
    }

    pub(super) fn on_acked(&mut self, chunk: u32) {
        self.acked[chunk as usize] = true;
    }

    pub(super) fn on_lost(&mut self, chunk: u32) {
        if !self.acked[chunk as usize] {
            self.pending.push_front(chunk);
        }
    }
}

/// The receiving end.
#[derive(Debug)]
pub(super) struct ControlReceiver {
    sizes: Vec<u32>,
    arrived: Vec<bool>,
    bytes: usize,
    missing: usize,
}

impl ControlReceiver {
    pub(super) fn new(bytes: u32) -> Self {
        let sizes: Vec<u32> = chunks(bytes).collect();
        Self { arrived: vec![false; sizes.len()], missing: sizes.len(), sizes, bytes: 0 }
    }

    /// Distinct bytes so far and whether that is all, if the chunk is new.
    pub(super) fn on_chunk(&mut self, chunk: u32) -> Option<(usize, bool)> {
        if std::mem::replace(&mut self.arrived[chunk as usize], true) {
            return None;
        }
        self.bytes += self.sizes[chunk as usize] as usize;
        self.missing -= 1;
        Some((self.bytes, self.missing == 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_chunk_is_sent_until_acknowledged_and_counted_once() {
        let mut sender = ControlSender::new(2400);
        let mut receiver = ControlReceiver::new(2400);
        assert_eq!([sender.next(false), sender.next(false), sender.next(false)], [Some(0), Some(1), Some(2)]);
        assert_eq!(sender.next(false), None);
        sender.on_acked(0);
        sender.on_lost(2);
        sender.on_lost(0);
        assert_eq!(sender.next(false), Some(2));
        assert_eq!(sender.next(true), Some(1));
        assert_eq!(receiver.on_chunk(2), Some((100, false)));
        assert_eq!(receiver.on_chunk(2), None);
        assert_eq!(receiver.on_chunk(0), Some((1250, false)));
        assert_eq!(receiver.on_chunk(1), Some((2400, true)));
    }
}
