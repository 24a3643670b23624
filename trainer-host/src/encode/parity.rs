//! Parity packets over ranges of media packets.

use codec_core::{
    limits::MAX_PACKET_BYTES,
    repair::{Mix, Sums},
    wire::{manifest::Repair, packet::Parity},
};
use rayon::prelude::*;

use super::{EncodeError, Ledger, packet_id};

/// How parity is added up: [`codec_core::repair::mix`], or a host's faster way to the same bytes, so
/// that all are equal.
#[derive(Clone, Copy, Debug)]
pub struct Mixer(pub Mix);

impl Default for Mixer {
    fn default() -> Self {
        Self(codec_core::repair::mix)
    }
}

impl PartialEq for Mixer {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Appends the parity of `repairs` to `packets`, added up by `mixer`, fills in where it starts, and
/// counts its bytes.
pub(super) fn append(
    repairs: &mut [Repair],
    mixer: Mixer,
    packets: &mut Vec<Vec<u8>>,
    ledger: &mut Ledger,
) -> Result<(), EncodeError> {
    for range in repairs {
        range.first_parity = packets.len() as u32;
        let parity = parity(range, mixer, packets)?;
        ledger.parity += parity.iter().map(|p| p.len() as f64).sum::<f64>();
        ledger.parity_packets += parity.len() as u64;
        packets.extend(parity);
    }
    Ok(())
}

/// The parity packets of `range` in the order of their ids; its protected packets are in
/// `packets`.
fn parity(range: &Repair, mixer: Mixer, packets: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, EncodeError> {
    let sets: Result<Vec<Vec<Vec<u8>>>, EncodeError> =
        (0..range.sets()).into_par_iter().map(|set| rows(range, set, mixer, packets)).collect();
    let mut sets = sets?;
    let rows = 0..usize::from(range.parity);
    Ok(rows
        .flat_map(|row| sets.iter_mut().map(move |set| std::mem::take(&mut set[row])).collect::<Vec<_>>())
        .collect())
}

/// The parity packets of one set, row after row.
fn rows(range: &Repair, set: u32, mixer: Mixer, packets: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, EncodeError> {
    let rows = u32::from(range.parity);
    let mut memory = vec![0u8; range.set_bytes()];
    let sums = Sums::over(&mut memory, range.parity.into(), range.longest.into());
    let sums = sums.ok_or(EncodeError::Bound {
        what: "bytes in a protected packet",
        found: range.longest.into(),
        most: MAX_PACKET_BYTES,
    })?;
    let mut sums = sums.with_mix(mixer.0);
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
