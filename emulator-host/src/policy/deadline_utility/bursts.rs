//! Says how much less parity saves where losses come in bursts than where each is independent.
//!
//! A set of k packets with r parity packets is repaired if at most r of its k + r datagrams are lost. Losses
//! are taken to follow a chain of two states (Gilbert's): a share `loss` of all datagrams, and a share
//! `loss_after_loss` of those whose predecessor was lost. Datagrams of a set do not follow each other where
//! sets are interleaved: over a distance of d datagrams the correlation λ of the chain counts as λ^d.

use crate::{graph::PacketIndex, policy::SenderView};

/// Distance at which datagrams count as independent at the latest.
const FARTHEST: u64 = 64;

/// Losses of the repair set `set` that are repaired, relative to those that would be if as many datagrams
/// were lost independently: 1 then, and less the longer bursts are. Both are expectations of the number of
/// lost datagrams where no more than the parity packets are lost, and of none otherwise.
pub(super) fn repaired_share(view: &SenderView<'_>, set: u32) -> f64 {
    if view.loss_after_loss <= view.loss {
        return 1.0;
    }
    let members = &view.graph.repair_sets()[set as usize].members;
    let parity = view.graph.parity(set).len();
    let datagrams = members.len() + parity;
    let correlation = (view.loss_after_loss - view.loss) / (1.0 - view.loss);
    let after_loss = view.loss + (1.0 - view.loss) * power(correlation, distance(view, members));
    let independent = repaired(view.loss, view.loss, datagrams, parity);
    if independent > 0.0 { repaired(view.loss, after_loss, datagrams, parity) / independent } else { 1.0 }
}

/// Mean distance of two successive members in the order of sending, in datagrams, 1..=64.
fn distance(view: &SenderView<'_>, members: &[PacketIndex]) -> u64 {
    let numbers = members.iter().filter_map(|member| view.sent_number.get(member.at()));
    let sent = numbers.filter(|number| **number != u64::MAX);
    let (mut count, mut first, mut last) = (0, u64::MAX, 0);
    for number in sent {
        (count, first, last) = (count + 1, first.min(*number), last.max(*number));
    }
    if count < 2 { 1 } else { ((last - first) / (count - 1)).clamp(1, FARTHEST) }
}

/// Σ j · P(j lost) over j = 0..=`parity` of so many `datagrams`.
fn repaired(loss: f64, after_loss: f64, datagrams: usize, parity: usize) -> f64 {
    let after_arrival = loss * (1.0 - after_loss) / (1.0 - loss);
    // Of each number of losses so far, the chances that the last datagram arrived and that it was lost. The
    // datagram before the first is one like any other.
    let mut chances = vec![[0.0, 0.0]; parity + 1];
    chances[0] = [1.0 - loss, loss];
    for _ in 0..datagrams {
        for lost in (0..=parity).rev() {
            let [arrived_before, lost_before] = chances[lost];
            let arrives = arrived_before * (1.0 - after_arrival) + lost_before * (1.0 - after_loss);
            let is_lost = match lost.checked_sub(1) {
                Some(fewer) => chances[fewer][0] * after_arrival + chances[fewer][1] * after_loss,
                None => 0.0,
            };
            chances[lost] = [arrives, is_lost];
        }
    }
    chances.iter().enumerate().map(|(lost, [arrived, last])| lost as f64 * (arrived + last)).sum()
}

/// Whole powers by repeated multiplication, the same to the bit on every machine.
fn power(base: f64, exponent: u64) -> f64 {
    (0..exponent).fold(1.0, |product, _| product * base)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        clock::Nanos,
        graph::{PacketGraph, Synthetic},
        policy::{PacketStatus, deadline_utility::tests::view},
    };

    /// Sums over all patterns of losses.
    fn by_enumeration(loss: f64, after_loss: f64, datagrams: usize, parity: usize) -> f64 {
        let after_arrival = loss * (1.0 - after_loss) / (1.0 - loss);
        let chance = |pattern: u32| {
            let lost = |at: usize| (pattern >> at) & 1 == 1;
            let first = if lost(0) { loss } else { 1.0 - loss };
            (1..datagrams).fold(first, |chance, at| {
                let lost_now = if lost(at - 1) { after_loss } else { after_arrival };
                chance * if lost(at) { lost_now } else { 1.0 - lost_now }
            })
        };
        let patterns = (0..1u32 << datagrams).filter(|pattern| pattern.count_ones() as usize <= parity);
        patterns.map(|pattern| f64::from(pattern.count_ones()) * chance(pattern)).sum()
    }

    #[test]
    fn the_chain_agrees_with_the_sum_over_all_patterns() {
        for (datagrams, parity) in [(5, 1), (8, 2), (12, 4), (3, 3)] {
            for (loss, after_loss) in [(0.02, 0.02), (0.02, 0.7), (0.2, 0.5), (0.5, 0.9)] {
                let found = repaired(loss, after_loss, datagrams, parity);
                let expected = by_enumeration(loss, after_loss, datagrams, parity);
                assert!((found - expected).abs() < 1e-12, "{found} {expected}");
            }
        }
    }

    fn share(graph: &PacketGraph, sent_number: &[u64], loss_after_loss: f64) -> f64 {
        let count = graph.packets().len();
        let (status, sent_at) = (vec![PacketStatus::InFlight; count], vec![Nanos::ZERO; count]);
        let view = view(graph, &status, &sent_at);
        repaired_share(&SenderView { sent_number, loss: 0.03, loss_after_loss, ..view }, 0)
    }

    #[test]
    fn one_parity_packet_saves_less_the_longer_bursts_are_and_the_denser_its_set() {
        let graph = Synthetic { frames: 30, repair: Some(4), ..Synthetic::default() }.build(1).unwrap();
        let numbers = |spacing: u64| {
            let mut numbers = vec![u64::MAX; graph.packets().len()];
            for (at, member) in graph.repair_sets()[0].members.iter().enumerate() {
                numbers[member.at()] = 7 + at as u64 * spacing;
            }
            numbers
        };
        assert_eq!(share(&graph, &numbers(1), 0.03), 1.0);
        let lengths = [1.1, 1.5, 2.0, 3.0, 5.0].map(|length| share(&graph, &numbers(1), 1.0 - 1.0 / length));
        assert!(lengths.is_sorted_by(|one, other| one > other), "{lengths:?}");
        assert!(lengths[0] < 1.0 && lengths[3] < 0.6, "{lengths:?}");
        // What was sent far apart is hardly in one burst; what was never sent counts as sent side by side.
        let apart = [1, 2, 4, 8, 60].map(|spacing| share(&graph, &numbers(spacing), 2.0 / 3.0));
        assert!(apart.is_sorted_by(|one, other| one < other) && apart[4] > 0.999, "{apart:?}");
        assert_eq!(share(&graph, &[], 2.0 / 3.0), apart[0]);
    }
}
