//! XOR repair: one loss per set, no packet store.
//!
//! The receiver keeps, per repair set, the running XOR of everything that has arrived for it,
//! parity included. When all but one of set and parity are there, what remains in the
//! accumulator *is* the missing packet, length and bytes. It must still pass its own CRC.
//! Sender and receiver share [`Accumulator::add`]: parity is the XOR over the whole set.

use crate::limits::{MAX_PACKET_BYTES, MAX_REPAIR_SET};

/// Bytes of one accumulator in the caller's memory.
pub const ACCUMULATOR_BYTES: usize = 8 + MAX_PACKET_BYTES;

/// The running XOR of one repair set, over [`ACCUMULATOR_BYTES`] bytes of the caller's that start
/// as zeros.
#[derive(Debug)]
pub struct Accumulator<'a> {
    /// XOR of lengths u16, parity seen u8, zero u8, members seen u32.
    head: &'a mut [u8; 8],
    content: &'a mut [u8],
}

impl<'a> Accumulator<'a> {
    /// A view of `bytes`, if they are [`ACCUMULATOR_BYTES`] long.
    pub fn over(bytes: &'a mut [u8]) -> Option<Self> {
        let (head, content) = bytes.split_first_chunk_mut::<8>()?;
        (content.len() == MAX_PACKET_BYTES).then_some(Self { head, content })
    }

    fn length(&self) -> u16 {
        u16::from_le_bytes([self.head[0], self.head[1]])
    }

    fn members(&self) -> u32 {
        u32::from_le_bytes([self.head[4], self.head[5], self.head[6], self.head[7]])
    }

    fn mix(&mut self, length: u16, content: &[u8]) {
        let mixed = (self.length() ^ length).to_le_bytes();
        self.head[0] = mixed[0];
        self.head[1] = mixed[1];
        self.content.iter_mut().zip(content).for_each(|(a, b)| *a ^= b);
    }

    /// Adds member `position` (0..32) of the set; a member that was there changes nothing.
    pub fn add(&mut self, position: u32, packet: &[u8]) {
        let bit = 1u32 << (position % MAX_REPAIR_SET as u32);
        let members = self.members();
        if members & bit != 0 || packet.len() > MAX_PACKET_BYTES {
            return;
        }
        self.head[4..].copy_from_slice(&(members | bit).to_le_bytes());
        self.mix(packet.len() as u16, packet);
    }

    /// Adds the set's parity; a second one changes nothing.
    pub fn add_parity(&mut self, length: u16, content: &[u8]) {
        if self.head[2] == 0 && content.len() <= MAX_PACKET_BYTES {
            self.head[2] = 1;
            self.mix(length, content);
        }
    }

    /// The position and bytes of the one missing member of `members`, if exactly one is missing
    /// and the parity is there.
    pub fn missing(&self, members: u32) -> Option<(u32, &[u8])> {
        let all = match members {
            1..=31 => (1u32 << members) - 1,
            32 => u32::MAX,
            _ => return None,
        };
        let absent = all & !self.members();
        if self.head[2] == 0 || absent.count_ones() != 1 {
            return None;
        }
        self.content.get(..usize::from(self.length())).map(|bytes| (absent.trailing_zeros(), bytes))
    }

    /// XOR of the lengths and of the bytes so far, cut to the longest member `longest`: the
    /// content of a parity packet.
    pub fn parity(&self, longest: usize) -> (u16, &[u8]) {
        (self.length(), self.content.get(..longest).unwrap_or(self.content))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    proptest! {
        #[test]
        fn any_one_loss_is_repaired_and_two_are_not(
            packets in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..1200), 2..=32),
            lost: usize, second: usize,
        ) {
            let n = packets.len();
            let mut bytes = vec![0u8; ACCUMULATOR_BYTES];
            let mut sender = Accumulator::over(&mut bytes).unwrap();
            for (i, p) in packets.iter().enumerate() { sender.add(i as u32, p); }
            let longest = packets.iter().map(Vec::len).max().unwrap();
            let (length, content) = sender.parity(longest);
            let (length, content) = (length, content.to_vec());

            let mut bytes = vec![0u8; ACCUMULATOR_BYTES];
            let mut receiver = Accumulator::over(&mut bytes).unwrap();
            let lost = lost % n;
            for (i, p) in packets.iter().enumerate() {
                if i != lost { receiver.add(i as u32, p); receiver.add(i as u32, p); }
            }
            prop_assert!(receiver.missing(n as u32).is_none());
            receiver.add_parity(length, &content);
            receiver.add_parity(length, &content);
            prop_assert_eq!(receiver.missing(n as u32), Some((lost as u32, &packets[lost][..])));

            let second = second % n;
            if second != lost {
                let mut bytes = vec![0u8; ACCUMULATOR_BYTES];
                let mut receiver = Accumulator::over(&mut bytes).unwrap();
                receiver.add_parity(length, &content);
                for (i, p) in packets.iter().enumerate() {
                    if i != lost && i != second { receiver.add(i as u32, p); }
                }
                prop_assert!(receiver.missing(n as u32).is_none());
            }
        }
    }
}
