//! Repairs any r losses of a set from its r parity packets, without a packet store.
//!
//! Each set keeps r sums in the caller's memory: what its parity rows say, less everything that has
//! arrived. As soon as no more members are missing than rows are there, the sums over the missing
//! ones are solved for them, length and bytes. What comes out must still pass its own CRC, parse and
//! decode. Sender and receiver share [`Sums::add`]: the parity of a whole set is its sums.
//!
//! With one row the code is XOR ([`cauchy`]), and nothing is multiplied. All arithmetic on whole
//! packets is one function, [`combine`]; a host that has a faster one passes it as a [`Combine`].

pub mod cauchy;
pub mod gf256;

use self::cauchy::{Solution, column};
use crate::limits::{MAX_PACKET_BYTES, MAX_REPAIR_PARITY, MAX_REPAIR_SET};

/// Bytes of a set's memory before its sums: members seen u64, rows seen u8, zeros.
pub const HEAD_BYTES: usize = 16;
/// Bytes of a packet's length in what is coded.
pub const LENGTH_BYTES: usize = 2;
/// Most packets of a set: a bit for each.
const MAX_MEMBERS: u32 = MAX_REPAIR_SET as u32;
const _: () = assert!(MAX_MEMBERS == u64::BITS);
/// Packets that a sender adds in one call.
const AT_ONCE: usize = 16;
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
    head: Head<'a>,
    /// Row after row, each a length u16 and `longest` bytes.
    sums: &'a mut [u8],
    /// Bytes of a row.
    stride: usize,
    combine: Combine,
}

/// What of a set has been seen, a bit each.
#[derive(Debug)]
struct Head<'a> {
    members: &'a mut [u8; 8],
    rows: &'a mut u8,
}

/// A coded packet, and what each row of sums multiplies it by.
#[derive(Clone, Copy, Debug)]
pub struct Term<'a> {
    /// The packet's length as it is coded, ahead of its content.
    pub length: [u8; LENGTH_BYTES],
    /// The packet.
    pub content: &'a [u8],
    /// One factor per row.
    pub factors: &'a [u8],
}

impl Term<'_> {
    /// Adds nothing to any row.
    const NOTHING: Self = Self { length: [0; LENGTH_BYTES], content: &[], factors: &[] };
}

/// Adds to row i of `rows`, each of `stride` bytes, `factors[i]` times each of `terms`; what of a
/// term is longer than a row is cut. Products are those of [`gf256`]. Rows without a factor stay as
/// they are, and all rows if they are shorter than [`LENGTH_BYTES`].
pub type Combine = fn(rows: &mut [u8], stride: usize, terms: &[Term<'_>]);

/// The [`Combine`] of every machine.
pub fn combine(rows: &mut [u8], stride: usize, terms: &[Term<'_>]) {
    for term in terms {
        let mut rows = &mut *rows;
        for &factor in term.factors {
            let Some((row, rest)) = rows.split_at_mut_checked(stride) else { break };
            rows = rest;
            if let Some((head, tail)) = row.split_first_chunk_mut::<LENGTH_BYTES>() {
                gf256::mul_add(head, &term.length, factor);
                gf256::mul_add(tail, term.content, factor);
            }
        }
    }
}

impl<'a> Sums<'a> {
    /// A view of `bytes`, if they are [`set_bytes`] long for `rows` in
    /// 1..=[`MAX_REPAIR_PARITY`] and `longest` in 1..=[`MAX_PACKET_BYTES`].
    pub fn over(bytes: &'a mut [u8], rows: usize, longest: usize) -> Option<Self> {
        let fits = (1..=MAX_REPAIR_PARITY).contains(&rows)
            && (1..=MAX_PACKET_BYTES).contains(&longest)
            && bytes.len() == set_bytes(rows, longest);
        if !fits {
            return None;
        }
        let (head, sums) = bytes.split_at_mut_checked(HEAD_BYTES)?;
        let (members, rest) = head.split_first_chunk_mut()?;
        let head = Head { members, rows: rest.first_mut()? };
        Some(Self { head, sums, stride: LENGTH_BYTES + longest, combine })
    }

    /// The same sums, added up by `combine`.
    pub fn with_combine(self, combine: Combine) -> Self {
        Self { combine, ..self }
    }

    /// Bytes of the longest packet.
    fn longest(&self) -> usize {
        self.stride - LENGTH_BYTES
    }

    /// Where row `row` lies.
    fn place(&self, row: u32) -> Option<core::ops::Range<usize>> {
        let start = (row as usize).checked_mul(self.stride)?;
        Some(start..start.checked_add(self.stride)?)
    }

    /// Members seen, a bit each.
    fn members(&self) -> u64 {
        u64::from_le_bytes(*self.head.members)
    }

    fn sum(&self, row: u32) -> Option<&[u8]> {
        self.sums.get(self.place(row)?)
    }

    /// Notes member `position` as seen; `None` if it cannot be added.
    fn term<'p>(&mut self, position: u32, packet: &'p [u8]) -> Option<Term<'p>> {
        let bit = 1u64.checked_shl(position)?;
        let members = self.members();
        if members & bit != 0 || packet.len() > self.longest() {
            return None;
        }
        let factors = column(position)?;
        *self.head.members = (members | bit).to_le_bytes();
        Some(Term { length: (packet.len() as u16).to_le_bytes(), content: packet, factors })
    }

    /// Adds member `position` (below [`MAX_REPAIR_SET`]) of the set; a member that was there, or is
    /// longer than the set's longest, changes nothing.
    pub fn add(&mut self, position: u32, packet: &[u8]) {
        if let Some(term) = self.term(position, packet) {
            (self.combine)(self.sums, self.stride, &[term]);
        }
    }

    /// Adds `packets` as the members from position `first` on, each as [`Self::add`] would, several
    /// in one call of the [`Combine`]: for senders, who have them at hand.
    pub fn add_all<'p>(&mut self, first: u32, packets: impl IntoIterator<Item = &'p [u8]>) {
        let mut packets = packets.into_iter().zip(first..=u32::MAX);
        loop {
            let mut terms = [Term::NOTHING; AT_ONCE];
            let mut count = 0;
            for (term, (packet, position)) in terms.iter_mut().zip(packets.by_ref()) {
                *term = self.term(position, packet).unwrap_or(Term::NOTHING);
                count += 1;
            }
            let Some(terms) = terms.get(..count).filter(|terms| !terms.is_empty()) else { return };
            (self.combine)(self.sums, self.stride, terms);
        }
    }

    /// Adds parity row `row`: coded length and content. A row that was there, or whose content is
    /// longer than the set's longest, changes nothing.
    pub fn add_parity(&mut self, row: u32, length: u16, content: &[u8]) {
        let Some(bit) = 1u8.checked_shl(row) else { return };
        if *self.head.rows & bit != 0 || content.len() > self.longest() {
            return;
        }
        // Of a row that the set has not there is no sum.
        if let Some(sum) = self.place(row).and_then(|place| self.sums.get_mut(place)) {
            *self.head.rows |= bit;
            let term = Term { length: length.to_le_bytes(), content, factors: &[1] };
            (self.combine)(sum, self.stride, &[term]);
        }
    }

    /// How to get the missing ones of the first `members` members, if some are missing and enough
    /// parity is there.
    pub fn solution(&self, members: u32) -> Option<Solution> {
        let all = match members {
            0 => 0,
            1..=MAX_MEMBERS => u64::MAX >> (MAX_MEMBERS - members),
            // No set has as many.
            _ => return None,
        };
        Solution::of(all & !self.members(), *self.head.rows)
    }

    /// The bytes of missing member number `index` of `solution`, in `out`; `None` if its length is
    /// no packet's. Members of the same solution may be added in between.
    pub fn recover<'o>(
        &self,
        solution: &Solution,
        index: usize,
        out: &'o mut [u8; MAX_CODED_BYTES],
    ) -> Option<&'o [u8]> {
        let coded = out.get_mut(..self.stride)?;
        coded.fill(0);
        let (mut terms, mut count) = ([Term::NOTHING; MAX_REPAIR_PARITY], 0);
        for (term, (row, factor)) in terms.iter_mut().zip(solution.terms(index)) {
            let (length, content) = self.sum(row)?.split_first_chunk()?;
            *term = Term { length: *length, content, factors: core::slice::from_ref(factor) };
            count += 1;
        }
        (self.combine)(coded, self.stride, terms.get(..count)?);
        let (length, packet) = coded.split_first_chunk::<LENGTH_BYTES>()?;
        packet.get(..usize::from(u16::from_le_bytes(*length))).filter(|packet| !packet.is_empty())
    }

    /// Row `row` of the sums so far: length, and bytes cut to the longest member `longest`, which is at
    /// most what the sums are over. Over a whole set they are the content of its parity packet.
    pub fn parity(&self, row: u32, longest: usize) -> Option<(u16, &[u8])> {
        let (length, content) = self.sum(row)?.split_first_chunk::<LENGTH_BYTES>()?;
        Some((u16::from_le_bytes(*length), content.get(..longest)?))
    }
}

#[cfg(test)]
mod tests;
