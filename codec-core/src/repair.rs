//! Repair: any r losses of a set from its r parity packets, no packet store.
//!
//! Each set keeps r sums in the caller's memory: what its parity rows say, less everything that has
//! arrived. As soon as no more members are missing than rows are there, the sums over the missing
//! ones are solved for them, length and bytes. What comes out must still pass its own CRC, parse and
//! decode. Sender and receiver share [`Sums::add`]: the parity of a whole set is its sums.
//!
//! With one row the code is XOR ([`cauchy`]), and nothing is multiplied.

pub mod cauchy;
pub mod gf256;

use crate::limits::{MAX_PACKET_BYTES, MAX_REPAIR_PARITY, MAX_REPAIR_SET};
use cauchy::{Solution, coefficient};

/// Bytes of a set's memory before its sums: members seen u64, rows seen u8, zeros.
pub const HEAD_BYTES: usize = 16;
/// Bytes of a packet's length in what is coded.
pub const LENGTH_BYTES: usize = 2;
/// Most bytes of one coded packet: its length, then itself.
pub const MAX_CODED_BYTES: usize = LENGTH_BYTES + MAX_PACKET_BYTES;

/// Bytes of the memory of one set with `rows` parity packets over packets of at most `longest`
/// bytes.
pub const fn set_bytes(rows: usize, longest: usize) -> usize {
    HEAD_BYTES + rows * (LENGTH_BYTES + longest)
}

/// The sums of one repair set, over [`set_bytes`] bytes of the caller's that start as zeros.
#[derive(Debug)]
pub struct Sums<'a> {
    head: &'a mut [u8; HEAD_BYTES],
    /// Row after row, each a length u16 and `longest` bytes.
    sums: &'a mut [u8],
    longest: usize,
}

/// Where row `row` lies among rows of `longest` bytes.
fn place(row: u32, longest: usize) -> core::ops::Range<usize> {
    let stride = LENGTH_BYTES.saturating_add(longest);
    let start = (row as usize).saturating_mul(stride);
    start..start.saturating_add(stride)
}

impl<'a> Sums<'a> {
    /// A view of `bytes`, if they are [`set_bytes`] long for `rows` in
    /// 1..=[`MAX_REPAIR_PARITY`] and `longest` in 1..=[`MAX_PACKET_BYTES`].
    pub fn over(bytes: &'a mut [u8], rows: usize, longest: usize) -> Option<Self> {
        let fits = (1..=MAX_REPAIR_PARITY).contains(&rows)
            && (1..=MAX_PACKET_BYTES).contains(&longest)
            && bytes.len() == set_bytes(rows, longest);
        let (head, sums) = bytes.split_first_chunk_mut::<HEAD_BYTES>()?;
        fits.then_some(Self { head, sums, longest })
    }

    fn members(&self) -> u64 {
        self.head.first_chunk().map_or(0, |bytes| u64::from_le_bytes(*bytes))
    }

    fn rows(&self) -> u8 {
        self.head[8]
    }

    fn sum(&self, row: u32) -> Option<&[u8]> {
        self.sums.get(place(row, self.longest))
    }

    /// Adds member `position` (below [`MAX_REPAIR_SET`]) of the set; a member that was there, or is
    /// longer than the set's longest, changes nothing.
    pub fn add(&mut self, position: u32, packet: &[u8]) {
        let bit = 1u64.checked_shl(position).unwrap_or(0);
        let members = self.members();
        if bit == 0 || members & bit != 0 || packet.len() > self.longest {
            return;
        }
        if let Some(target) = self.head.first_chunk_mut() {
            *target = (members | bit).to_le_bytes();
        }
        let length = (packet.len() as u16).to_le_bytes();
        for row in 0..MAX_REPAIR_PARITY as u32 {
            let Some(sum) = self.sums.get_mut(place(row, self.longest)) else { break };
            mix(sum, length, packet, coefficient(row, position));
        }
    }

    /// Adds parity row `row`: coded length and content. A row that was there, or whose content is
    /// longer than the set's longest, changes nothing.
    pub fn add_parity(&mut self, row: u32, length: u16, content: &[u8]) {
        let bit = 1u8.checked_shl(row).unwrap_or(0);
        if self.head[8] & bit != 0 || content.len() > self.longest {
            return;
        }
        if let Some(sum) = self.sums.get_mut(place(row, self.longest)) {
            self.head[8] |= bit;
            mix(sum, length.to_le_bytes(), content, 1);
        }
    }

    /// How to get the missing ones of the first `members` members, if some are missing and enough
    /// parity is there.
    pub fn solution(&self, members: u32) -> Option<Solution> {
        let members = members.min(MAX_REPAIR_SET as u32);
        let all = u64::MAX.checked_shr(u64::BITS - members).unwrap_or(0);
        Solution::of(all & !self.members(), self.rows())
    }

    /// The bytes of missing member number `index` of `solution`, in `out`; `None` if its length is
    /// no packet's. Members of the same solution may be added in between.
    pub fn recover<'o>(
        &self,
        solution: &Solution,
        index: usize,
        out: &'o mut [u8; MAX_CODED_BYTES],
    ) -> Option<&'o [u8]> {
        let coded = out.get_mut(place(0, self.longest))?;
        coded.fill(0);
        for (row, factor) in solution.terms(index) {
            gf256::mul_add(coded, self.sum(row)?, factor);
        }
        let (length, packet) = coded.split_first_chunk::<LENGTH_BYTES>()?;
        packet.get(..usize::from(u16::from_le_bytes(*length))).filter(|packet| !packet.is_empty())
    }

    /// Row `row` of the sums so far: length, and bytes cut to the longest member `longest`. Over a
    /// whole set they are the content of its parity packet.
    pub fn parity(&self, row: u32, longest: usize) -> Option<(u16, &[u8])> {
        let (length, content) = self.sum(row)?.split_first_chunk::<LENGTH_BYTES>()?;
        Some((u16::from_le_bytes(*length), content.get(..longest).unwrap_or(content)))
    }
}

fn mix(sum: &mut [u8], length: [u8; LENGTH_BYTES], content: &[u8], factor: u8) {
    if let Some((head, tail)) = sum.split_first_chunk_mut::<LENGTH_BYTES>() {
        gf256::mul_add(head, &length, factor);
        gf256::mul_add(tail, content, factor);
    }
}

#[cfg(test)]
mod tests;
