//! XOR parity packets over ranges of media packets.

use codec_core::{
    repair::{ACCUMULATOR_BYTES, Accumulator},
    wire::{manifest::Repair, packet::Parity},
};

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

/// The parity packets of `range`, whose protected packets are in `packets`.
fn parity(range: &Repair, packets: &[Vec<u8>]) -> Result<Vec<Vec<u8>>, EncodeError> {
    let mut out = Vec::new();
    for set in 0..range.sets() {
        let mut memory = vec![0u8; ACCUMULATOR_BYTES];
        let mut longest = 0;
        let Some(mut accumulator) = Accumulator::over(&mut memory) else { continue };
        for position in 0..range.members(set) {
            let packet = &packets[(range.first_packet + set + position * range.sets()) as usize];
            longest = longest.max(packet.len());
            accumulator.add(position, packet);
        }
        let (length, content) = accumulator.parity(longest);
        let id = packet_id((range.first_parity + set) as usize)?;
        let mut bytes = vec![0u8; longest + 16];
        let len = Parity { id, length, content }.write(&mut bytes)?;
        bytes.truncate(len);
        out.push(bytes);
    }
    Ok(out)
}
