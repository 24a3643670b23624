//! Says which parity still repairs something once packets are left out.

use codec_core::internals::wire::manifest::Manifest;
use trainer_host::{Stream, stream::PacketMap};

/// Leaves out parity of repair sets of which a packet that is there is left out: it repairs what was left out
/// on purpose, or nothing.
pub(super) fn only_of_whole_sets(manifest: &Manifest<'_>, stream: &Stream, stays: &mut [bool]) {
    let is_there = |id: usize| !stream.packets()[id].is_empty();
    for range in manifest.repairs() {
        for set in 0..range.sets() {
            let mut members = (0..range.members(set)).map(|position| range.member(set, position) as usize);
            if members.any(|id| is_there(id) && !stays[id]) {
                let rows = (0..range.parity.into()).map(|row| range.parity_id(set, row) as usize);
                rows.for_each(|id| stays[id] = false);
            }
        }
    }
}

/// Parity packets that are there, and their bytes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Amount {
    pub(super) packets: usize,
    pub(super) bytes: usize,
}

impl Amount {
    /// Of the packets of `stream` that `stays` says.
    pub(super) fn of(stream: &Stream, map: &PacketMap, stays: impl Fn(usize) -> bool) -> Self {
        let there = stream.packets().iter().enumerate().filter(|(_, packet)| !packet.is_empty());
        let bytes: Vec<usize> = there
            .filter(|(id, _)| map.is_parity(*id) && stays(*id))
            .map(|(_, packet)| packet.len())
            .collect();
        Self { packets: bytes.len(), bytes: bytes.iter().sum() }
    }
}
