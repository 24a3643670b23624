//! Reports how packets are filled and how many a completion group takes.

use std::collections::BTreeMap;

use codec_core::internals::{
    ids::{Group, Level},
    limits::MAX_PAYLOAD_BYTES,
};

use super::{Decisions, EncodeError, Encoded};
use crate::stream::PacketMap;

/// How the media packets of a stream are filled.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PacketReport {
    /// Mean bytes of entropy-coded payload in a packet.
    pub mean_payload_bytes: f64,
    /// Mean bytes of a whole packet.
    pub mean_packet_bytes: f64,
    /// Share of what a packet may hold that is used: of 1200 payload bytes in profile `paper`, of the packet
    /// size that was asked for in `dgs1`.
    pub fill: f64,
    /// Bytes per packet by which payloads exceed the same symbols coded as one stream.
    pub chunk_loss_bytes: f64,
    /// Mean number of packets that hold a part of a base group.
    pub packets_per_base_group: f64,
    /// Mean number of packets that hold a part of a refinement group.
    pub packets_per_refinement_group: f64,
    /// Mean number of groups of which a packet holds a part.
    pub groups_per_packet: f64,
}

impl Encoded {
    /// How its media packets are filled; all 0 if there are none.
    ///
    /// # Errors
    /// None in practice: the stream's manifest was checked when it was made.
    pub fn packet_report(&self) -> Result<PacketReport, EncodeError> {
        let map = PacketMap::of(&self.stream)?;
        let mut packets_of: BTreeMap<Group, usize> = BTreeMap::new();
        for id in 0..self.stream.packets().len() {
            let mut groups: Vec<Group> = map.placements(id).iter().map(|placement| placement.group).collect();
            groups.sort_unstable();
            groups.dedup();
            groups.into_iter().for_each(|group| *packets_of.entry(group).or_default() += 1);
        }
        let ledger = &self.report.ledger;
        let packets = ledger.packets.max(1) as f64;
        let overhead = ledger.headers + ledger.dependencies + ledger.crc;
        let mean_payload_bytes = ledger.payload / packets;
        let mean_packet_bytes = (ledger.payload + overhead) / packets;
        let fill = match &self.decisions {
            Decisions::Paper(_) => mean_payload_bytes / MAX_PAYLOAD_BYTES as f64,
            Decisions::Dgs1(decisions) => mean_packet_bytes / decisions.packet_bytes as f64,
        };
        let of_level = |is_level: fn(Level) -> bool| {
            let counts = || packets_of.iter().filter(|(group, _)| is_level(group.level)).map(|(_, &n)| n);
            counts().sum::<usize>() as f64 / counts().count().max(1) as f64
        };
        Ok(PacketReport {
            mean_payload_bytes,
            mean_packet_bytes,
            fill,
            chunk_loss_bytes: if ledger.packets == 0 {
                0.0
            } else {
                (ledger.payload - ledger.monolithic) / packets
            },
            packets_per_base_group: of_level(|level| level == Level::BASE),
            packets_per_refinement_group: of_level(|level| level > Level::BASE),
            groups_per_packet: packets_of.values().sum::<usize>() as f64 / packets,
        })
    }
}

#[cfg(test)]
mod tests {
    use crate::{
        encode::{EncodeOptions, encode},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    /// `paper` cuts groups into chunks of their own; `dgs1` packs parts of several groups together.
    #[test]
    fn packets_are_counted_per_group() {
        let options = synth::SynthOptions {
            gaussians: 2000,
            frames: 12,
            kind: SynthKind::Figure,
            ..Default::default()
        };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let report = |options: &EncodeOptions| {
            let encoded = encode(&scene, options, &crate::encode::no_progress).unwrap();
            let longest = encoded.stream.packets().iter().map(Vec::len).max().unwrap();
            let report = encoded.packet_report().unwrap();
            assert!(report.mean_packet_bytes <= longest as f64, "{report:?}");
            assert!(report.fill > 0.5 && report.fill <= 1.0, "{report:?}");
            (encoded, report)
        };
        let (encoded, paper) = report(&EncodeOptions::paper());
        assert_eq!(paper.groups_per_packet, 1.0);
        assert!(paper.packets_per_refinement_group > paper.packets_per_base_group);
        let groups = encoded.report.clustering.clusters as f64;
        let packets = groups * (paper.packets_per_base_group + 3.0 * paper.packets_per_refinement_group);
        assert!((packets - encoded.report.ledger.packets as f64).abs() < 1e-6);
        let (_, dgs1) = report(&EncodeOptions::default());
        assert!(dgs1.groups_per_packet > 1.0, "{dgs1:?}");
    }
}
