//! Appends parity packets over ranges of media packets.

use codec_core::internals::{
    limits::MAX_PACKET_BYTES,
    repair::{Combine, Sums},
    wire::{manifest::Repair, packet::Parity},
};
use rayon::prelude::*;

use super::{EncodeError, Ledger, packetise::packet_id};

/// Appends the parity of `repairs` to `packets`, fills in where it starts, and counts its bytes.
pub(super) fn append(
    repairs: &mut [Repair],
    packets: &mut Vec<Vec<u8>>,
    ledger: &mut Ledger,
) -> Result<(), EncodeError> {
    for range in repairs {
        range.first_parity = packets.len() as u32;
        let parity = parity(range, codec_simd::combine(), packets)?;
        ledger.parity += parity.iter().map(|p| p.len() as f64).sum::<f64>();
        ledger.parity_packets += parity.len() as u64;
        packets.extend(parity);
    }
    Ok(())
}

/// The parity packets of `range` in the order of their ids, added up by `combine`; its protected packets
/// are in `packets`.
fn parity(range: &Repair, combine: Combine, packets: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, EncodeError> {
    let sets: Result<Vec<Vec<Vec<u8>>>, EncodeError> =
        (0..range.sets()).into_par_iter().map(|set| rows(range, set, combine, packets)).collect();
    let mut sets = sets?;
    let rows = 0..usize::from(range.parity);
    Ok(rows
        .flat_map(|row| sets.iter_mut().map(move |set| std::mem::take(&mut set[row])).collect::<Vec<_>>())
        .collect())
}

/// The parity packets of one set, row after row.
fn rows(
    range: &Repair,
    set: u32,
    combine: Combine,
    packets: &[Vec<u8>],
) -> Result<Vec<Vec<u8>>, EncodeError> {
    let rows = u32::from(range.parity);
    let mut memory = vec![0u8; range.set_bytes()];
    let sums = Sums::over(&mut memory, range.parity.into(), range.longest.into());
    let sums = sums.ok_or(EncodeError::Bound {
        what: "bytes in a protected packet",
        found: range.longest.into(),
        most: MAX_PACKET_BYTES,
    })?;
    let mut sums = sums.with_combine(combine);
    let members = (0..range.members(set)).map(|p| packets[range.member(set, p) as usize].as_slice());
    let longest = members.clone().map(<[u8]>::len).max().unwrap_or(0);
    sums.add_all(0, members);
    let write = |row: u32| {
        let id = packet_id(range.parity_id(set, row) as usize)?;
        let (length, content) = sums.parity(row, longest).unwrap_or_default();
        let mut bytes = vec![0u8; longest + 16];
        let len = Parity { id, length, content }.write(&mut bytes)?;
        bytes.truncate(len);
        Ok(bytes)
    };
    (0..rows).map(write).collect()
}

#[cfg(test)]
mod tests {
    use codec_core::internals::ids::Level;

    use super::*;
    use crate::encode::Protection;

    #[test]
    fn parity_is_the_same_by_any_arithmetic() {
        let packets: Vec<Vec<u8>> =
            (0..7usize).map(|p| (0..40 + 17 * p).map(|i| (i * 31 + p * 7919) as u8).collect()).collect();
        let strength = Protection::parse("base=4+2").unwrap().of(false, Level::BASE).unwrap();
        let range = strength.range(0, &packets).unwrap();
        let slow = parity(&range, codec_core::internals::repair::combine, &packets).unwrap();
        assert_eq!(slow.len(), 4);
        assert_eq!(parity(&range, codec_simd::combine(), &packets).unwrap(), slow);
        let mut other = packets.clone();
        other[6][3] ^= 1;
        assert_ne!(parity(&range, codec_simd::combine(), &other).unwrap(), slow);
    }
}
