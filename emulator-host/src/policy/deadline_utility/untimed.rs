//! The order of packets where no clock runs: what each byte adds most to the whole clip comes first.

use super::{DeadlineUtilityConfig, Plan};
use crate::{
    clock::{Nanos, Rate},
    graph::{PacketGraph, PacketIndex},
    policy::{PacketStatus, SenderView},
    startup::StartupRule,
};

/// Long before the first frame: whatever is sent arrives in time.
const LEAD: Nanos = Nanos::from_s(1 << 30);
/// The plan is renewed so often in a graph: enough for its ranks, and the time stays linear in its size.
const PLANS: usize = 128;

/// The packets of `graph` that add to its clip, by what each byte of them adds with all that stands on them;
/// nothing comes before what it needs of what the graph has, so that every beginning of the order is closed.
/// It is the order of [`super::DeadlineUtility`] for a clip of which everything comes in time: the best
/// picture of a file cut to a size, or of one that is fetched from its beginning.
///
/// Packets that add nothing by their groups' utilities, and parity, are left out.
///
/// ```
/// use emulator_host::{graph::Synthetic, policy::order_by_utility};
///
/// let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1)?;
/// let order = order_by_utility(&graph);
/// let first = &graph.packets()[order[0].at()];
/// assert!(first.groups.iter().any(|group| graph.groups()[group.at()].level() == 0));
/// # Ok::<(), emulator_host::graph::GraphError>(())
/// ```
pub fn order_by_utility(graph: &PacketGraph) -> Vec<PacketIndex> {
    let config = DeadlineUtilityConfig { delay_weight: 0.0, ..DeadlineUtilityConfig::default() };
    let count = graph.packets().len();
    let mut status = vec![PacketStatus::Waiting; count];
    let sent_at = vec![Nanos::ZERO; count];
    let mut plan = Plan::new(graph);
    let every = (count / PLANS).max(1);
    let mut order = Vec::with_capacity(count);
    loop {
        let view = SenderView {
            graph,
            status: &status,
            playout_start: LEAD,
            playing: true,
            horizon_frame: u32::MAX,
            rate: Rate(u64::MAX),
            smoothed_rtt: Nanos::ZERO,
            rtt_variation: Nanos::ZERO,
            minimum_rtt: Nanos::ZERO,
            in_flight: 0,
            sent_at: &sent_at,
            loss: 0.0,
            loss_after_loss: 0.0,
            sent_number: &[],
            startup: StartupRule::AfterWait,
            retransmissions: 0,
            viewpoint: None,
        };
        if order.len().is_multiple_of(every) {
            plan.renew(&view, &config, Nanos::ZERO);
        }
        let Some(packet) = plan.next(&view, Nanos::ZERO) else {
            return order;
        };
        let bytes = graph.wire_bytes(packet);
        status[packet.at()] = PacketStatus::Delivered;
        plan.on_status(packet, bytes, [PacketStatus::Waiting, PacketStatus::Delivered]);
        order.push(packet);
    }
}

/// All packets of `graph` in the order for a file that is fetched from its beginning: epoch after epoch, the
/// base level as it lies in the stream, so that a picture comes soon, then refinements by
/// [`order_by_utility`], those that add nothing last; after everything else parity. Where all groups have one
/// utility nobody has measured any, and packets lie as they are numbered.
pub fn file_order(graph: &PacketGraph) -> Vec<PacketIndex> {
    let groups = graph.groups();
    if groups.windows(2).all(|pair| pair[0].utility == pair[1].utility) {
        let mut order: Vec<PacketIndex> = (0..graph.packets().len() as u32).map(PacketIndex).collect();
        order.sort_by_key(|packet| graph.wire_id(*packet));
        return order;
    }
    let mut ranks = vec![usize::MAX; graph.packets().len()];
    for (rank, packet) in order_by_utility(graph).into_iter().enumerate() {
        ranks[packet.at()] = rank;
    }
    let mut epochs: Vec<u32> =
        groups.iter().filter(|group| group.is_canonical()).map(|group| group.first_frame).collect();
    epochs.sort_unstable();
    epochs.dedup();
    let mut order: Vec<PacketIndex> = (0..graph.packets().len() as u32).map(PacketIndex).collect();
    order.sort_by_key(|packet| {
        let first = graph.groups_of(*packet).map(|group| groups[group.at()].first_frame).min();
        let level = graph.groups_of(*packet).map(|group| groups[group.at()].level()).min();
        let epoch = first.map(|frame| epochs.partition_point(|begin| *begin <= frame));
        let rank = if level == Some(0) { 0 } else { ranks[packet.at()] };
        (epoch.unwrap_or(usize::MAX), level != Some(0), rank, graph.wire_id(*packet))
    });
    order
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use codec_core::internals::ids::PacketId;

    use super::*;
    use crate::graph::{ClosureRule, Synthetic, Utilities};

    /// Σ over frames of the utility of the groups that show, of those whose packets are in `have`, by the
    /// definition.
    fn utility(graph: &PacketGraph, have: &BTreeSet<PacketIndex>) -> f64 {
        let complete = |at: usize| graph.groups()[at].packets.iter().all(|packet| have.contains(packet));
        let mut sum = 0.0;
        for (at, group) in graph.groups().iter().enumerate() {
            let mut needed = vec![at];
            let mut shows = true;
            while let Some(group) = needed.pop() {
                shows &= complete(group);
                needed.extend(graph.groups()[group].needs.iter().map(|need| need.at()));
            }
            if shows {
                sum += group.utility * f64::from(group.last_frame - group.first_frame + 1);
            }
        }
        sum
    }

    /// The area under utility by bytes, in shares of both.
    fn area(graph: &PacketGraph, order: &[PacketIndex]) -> f64 {
        let (mut have, mut area, mut bytes) = (BTreeSet::new(), 0.0, 0.0);
        for packet in order {
            let length = f64::from(graph.packets()[packet.at()].wire_bytes);
            area += length * utility(graph, &have);
            bytes += length;
            have.insert(*packet);
        }
        area / bytes / utility(graph, &have)
    }

    #[test]
    fn every_beginning_is_closed_and_adds_more_than_levels_in_order() {
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            for seed in 0..4 {
                let graph = Synthetic { frames: 48, profile, ..Synthetic::default() }.build(seed).unwrap();
                let order = order_by_utility(&graph);
                let mut have = BTreeSet::new();
                for packet in &order {
                    let needs = &graph.packets()[packet.at()].needs_packets;
                    assert!(needs.iter().all(|need| have.contains(need)), "{packet:?} before its needs");
                    assert!(have.insert(*packet), "{packet:?} twice");
                }
                let mut levels = order.clone();
                let level = |packet: &PacketIndex| {
                    let groups = graph.packets()[packet.at()].groups.iter();
                    groups.map(|group| graph.groups()[group.at()].level()).min()
                };
                levels.sort_by_key(level);
                let (by_utility, by_level) = (area(&graph, &order), area(&graph, &levels));
                assert!(by_utility > by_level, "{profile:?}, seed {seed}: {by_utility} against {by_level}");
                let mut backwards = order.clone();
                backwards.reverse();
                assert!(area(&graph, &backwards) < by_level, "the area tells a bad order");
                let file = file_order(&graph);
                let distinct: BTreeSet<PacketIndex> = file.iter().copied().collect();
                assert_eq!((file.len(), distinct.len()), (graph.packets().len(), graph.packets().len()));
                let is_base = |packet: &PacketIndex| level(packet) == Some(0);
                let bases = file.iter().filter(|packet| is_base(packet)).count();
                assert!(file[..bases].iter().all(is_base), "one epoch: its base before everything else");
                let ranked: Vec<PacketIndex> =
                    file.into_iter().filter(|packet| have.contains(packet)).collect();
                let mut numbered = ranked.clone();
                numbered.sort_by_key(|packet| (level(packet), graph.wire_id(*packet)));
                assert!(area(&graph, &ranked) > area(&graph, &numbered), "refinements by utility");
                let flat =
                    Synthetic { utilities: Utilities::Flat, frames: 48, profile, ..Synthetic::default() };
                let graph = flat.build(seed).unwrap();
                let ids: Vec<PacketId> =
                    file_order(&graph).iter().map(|packet| graph.wire_id(*packet)).collect();
                assert!(ids.is_sorted(), "nothing measured: as they are numbered");
            }
        }
    }
}
