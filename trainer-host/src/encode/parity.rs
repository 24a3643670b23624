//! Parity packets over ranges of media packets.

use codec_core::{
    limits::MAX_PACKET_BYTES,
    repair::Sums,
    wire::{manifest::Repair, packet::Parity},
};
use rayon::prelude::*;

use super::{EncodeError, Ledger, packet_id};

/// Appends the parity of `repairs` to `packets`, fills in where it starts, and counts its bytes.
pub(super) fn append(
    repairs: &mut [Repair],
    packets: &mut Vec<Vec<u8>>,
    ledger: &mut Ledger,
) -> Result<(), EncodeError> {
    for range in repairs {
        range.first_parity = packets.len() as u32;
        let parity = parity(range, packets)?;
        ledger.parity += parity.iter().map(|p| p.len() as f64).sum::<f64>();
        ledger.parity_packets += parity.len() as u64;
        packets.extend(parity);
    }
    Ok(())
}

/// The parity packets of `range` in the order of their ids; its protected packets are in
/// `packets`.
fn parity(range: &Repair, packets: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, EncodeError> {
    let sets: Result<Vec<Vec<Vec<u8>>>, EncodeError> =
        (0..range.sets()).into_par_iter().map(|set| rows(range, set, packets)).collect();
    let mut sets = sets?;
    let rows = 0..usize::from(range.parity);
    Ok(rows
        .flat_map(|row| sets.iter_mut().map(move |set| std::mem::take(&mut set[row])).collect::<Vec<_>>())
        .collect())
}

/// The parity packets of one set, row after row.
fn rows(range: &Repair, set: u32, packets: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, EncodeError> {
    let rows = u32::from(range.parity);
    let mut memory = vec![0u8; range.set_bytes()];
    let sums = Sums::over(&mut memory, range.parity.into(), range.longest.into());
    let mut sums = sums.ok_or(EncodeError::Bound {
        what: "bytes in a protected packet",
        found: range.longest.into(),
        most: MAX_PACKET_BYTES,
    })?;
    let mut longest = 0;
    for position in 0..range.members(set) {
        let packet = &packets[range.member(set, position) as usize];
        longest = longest.max(packet.len());
        sums.add(position, packet);
    }
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
