use codec_core::internals::ids::{ClusterId, Group as GroupId, Level, PacketId, Span, WindowId};

use super::*;
use crate::{
    graph::{ClosureRule, GraphParts, Group, GroupIndex, Packet, RepairSet},
    policy::deadline_utility::tests::view,
};

/// Groups, each of packets of its own: (level, bytes of each packet, utility, needs).
fn graph(groups: &[(u8, &[u16], f64, &[u32])]) -> PacketGraph {
    let (mut packets, mut made) = (Vec::new(), Vec::new());
    for (at, (level, sizes, utility, needs)) in (0u32..).zip(groups) {
        let first = packets.len();
        packets.extend(sizes.iter().enumerate().map(|(place, bytes)| Packet {
            id: PacketId::new((first + place) as u32).unwrap(),
            wire_bytes: *bytes,
            groups: vec![GroupIndex(at)],
            needs_packets: Vec::new(),
            parity_of: None,
        }));
        made.push(Group {
            id: GroupId {
                span: Span::Motion(WindowId(0)),
                cluster: ClusterId(at as u16),
                level: Level::new(*level).unwrap(),
            },
            first_frame: 0,
            last_frame: 99,
            needs: needs.iter().map(|need| GroupIndex(*need)).collect(),
            packets: (first..packets.len()).map(|packet| PacketIndex(packet as u32)).collect(),
            utility: *utility,
            risk_adjusted: *utility,
            place: None,
        });
    }
    PacketGraph::new(GraphParts {
        packets,
        groups: made,
        repair_sets: Vec::new(),
        frames: 100,
        frame_interval: Nanos::from_ms(33),
        manifest_bytes: 0,
        profile: ClosureRule::AllOrNothing,
    })
    .unwrap()
}

/// A plan that has heard of what of `view` does not wait.
fn plan(view: &SenderView<'_>) -> Plan {
    let mut plan = Plan::new(view.graph);
    for (packet, status) in (0u32..).map(PacketIndex).zip(view.status) {
        if *status != PacketStatus::Waiting {
            let change = [PacketStatus::Waiting, *status];
            plan.on_status(packet, view.graph.wire_bytes(packet), change);
        }
    }
    plan
}

/// What `view` is first sent at `now`.
fn choice(view: &SenderView<'_>, config: &DeadlineUtilityConfig, now: Nanos) -> Option<PacketIndex> {
    let mut plan = plan(view);
    plan.renew(view, config, now);
    plan.next(view, now)
}

/// What of `graph` is first sent where packets have this `status`.
fn first_of(graph: &PacketGraph, status: &[PacketStatus], config: &DeadlineUtilityConfig) -> PacketIndex {
    let sent_at = vec![Nanos::ZERO; status.len()];
    choice(&view(graph, status, &sent_at), config, Nanos::ZERO).unwrap()
}

fn first(graph: &PacketGraph, config: &DeadlineUtilityConfig) -> PacketIndex {
    first_of(graph, &vec![PacketStatus::Waiting; graph.packets().len()], config)
}

/// A large ancestor that adds little by itself stands under three that add much: together they add more
/// per byte than the rival.
#[test]
fn an_ancestor_is_credited_with_what_stands_on_it() {
    let graph = graph(&[
        (1, &[900], 0.01, &[]),
        (1, &[100], 1.0, &[0]),
        (1, &[100], 1.0, &[0]),
        (1, &[100], 1.0, &[0]),
        (1, &[700], 1.0, &[]),
    ]);
    let config = DeadlineUtilityConfig::default();
    assert_eq!(first(&graph, &config), PacketIndex(0));
    assert_eq!(first(&graph, &DeadlineUtilityConfig { credit: false, ..config }), PacketIndex(4));
}

#[test]
fn what_adds_nothing_is_never_sent() {
    let graph = graph(&[(1, &[100], -1.0, &[]), (1, &[1000], 1e-6, &[])]);
    assert_eq!(first(&graph, &DeadlineUtilityConfig::default()), PacketIndex(1));
}

#[test]
fn what_is_in_flight_counts_less_the_longer_no_receipt_tells_of_it() {
    let graph = graph(&[(0, &[100], 1.0, &[])]);
    let (status, sent_at) = (vec![PacketStatus::InFlight], vec![Nanos::ZERO]);
    let view = view(&graph, &status, &sent_at);
    let chance = |ms| survival(&view, PacketIndex(0), 0.05, Nanos::from_ms(ms));
    let falling: Vec<f64> = (0..40).map(|step| chance(10 * step)).collect();
    assert!(falling.windows(2).all(|pair| pair[0] >= pair[1]), "{falling:?}");
    assert!(falling[0] > 0.94 && falling[39] < 0.2, "{falling:?}");
}

/// What stands on a packet of which no receipt tells gives way to a lesser rival, unless it counts as there.
#[test]
fn what_needs_a_packet_that_may_be_lost_waits() {
    let graph = graph(&[(0, &[100], 0.01, &[]), (1, &[100], 1.0, &[0]), (1, &[100], 0.5, &[])]);
    let status = [PacketStatus::InFlight, PacketStatus::Waiting, PacketStatus::Waiting];
    let sent_at = [Nanos::ZERO; 3];
    let view = SenderView { loss: 0.05, ..view(&graph, &status, &sent_at) };
    let config = DeadlineUtilityConfig::default();
    let at = |ms, config: &DeadlineUtilityConfig| choice(&view, config, Nanos::from_ms(ms));
    assert_eq!(at(20, &config), Some(PacketIndex(1)));
    assert_eq!(at(400, &config), Some(PacketIndex(2)));
    assert_eq!(at(400, &DeadlineUtilityConfig { survival: false, ..config }), Some(PacketIndex(1)));
}

/// A packet is lost that another one needs, which is there already: sent again, it brings both.
#[test]
fn a_lost_packet_is_credited_with_what_is_there_and_needs_it() {
    let graph = graph(&[(1, &[100], 0.01, &[]), (1, &[100], 1.0, &[0]), (1, &[100], 0.5, &[])]);
    let status = |first| [first, PacketStatus::Delivered, PacketStatus::Waiting];
    let (before, after) = (status(PacketStatus::InFlight), status(PacketStatus::Waiting));
    let sent_at = [Nanos::ZERO; 3];
    let (before, after) = (view(&graph, &before, &sent_at), view(&graph, &after, &sent_at));
    for survival in [true, false] {
        let config = DeadlineUtilityConfig { survival, ..DeadlineUtilityConfig::default() };
        let mut plan = plan(&before);
        plan.renew(&before, &config, Nanos::ZERO);
        plan.on_status(PacketIndex(0), 100, [PacketStatus::InFlight, PacketStatus::Waiting]);
        plan.renew(&after, &config, Nanos::ZERO);
        assert_eq!(plan.next(&after, Nanos::ZERO), Some(PacketIndex(0)), "survival: {survival}");
    }
}

/// The last frame is shown in 67 ms: 20 ms are in time, 100 ms more of queue are not.
#[test]
fn what_its_own_queue_makes_late_is_not_sent() {
    let graph = graph(&[(1, &[100], 1.0, &[])]);
    let (status, sent_at) = ([PacketStatus::Waiting], [Nanos::ZERO]);
    let empty = view(&graph, &status, &sent_at);
    let full = SenderView { in_flight: 20_000, ..empty };
    let config = DeadlineUtilityConfig::default();
    let at =
        |view: &SenderView<'_>, config: &DeadlineUtilityConfig| choice(view, config, Nanos::from_ms(4200));
    assert_eq!(at(&empty, &config), Some(PacketIndex(0)));
    assert_eq!(at(&full, &config), None);
    assert_eq!(at(&full, &DeadlineUtilityConfig { skip_late: false, ..config }), Some(PacketIndex(0)));
    // Without a bound the queue is a forecast, and no more.
    assert_eq!(at(&full, &DeadlineUtilityConfig { max_queue_delay: None, ..config }), Some(PacketIndex(0)));
}

/// Half of the first group is there: its rest adds 1 for one packet. U_g makes 1.5 of it, and a half that is
/// in flight is not acknowledged.
#[test]
fn a_group_that_was_begun_counts_by_its_rest() {
    let config = DeadlineUtilityConfig::default();
    let paper = DeadlineUtilityConfig { rest_only: false, ..config };
    let first = |rival, begun, config| {
        let graph = graph(&[(1, &[500, 500], 1.0, &[]), (1, &[500], rival, &[])]);
        first_of(&graph, &[begun, PacketStatus::Waiting, PacketStatus::Waiting], config)
    };
    assert_eq!(first(1.2, PacketStatus::Delivered, &config), PacketIndex(2));
    assert_eq!(first(1.2, PacketStatus::Delivered, &paper), PacketIndex(1));
    assert_eq!(first(0.9, PacketStatus::InFlight, &config), PacketIndex(1));
    assert_eq!(first(0.9, PacketStatus::InFlight, &paper), PacketIndex(2));
}

/// Eleven small packets take more bytes than a large one only with their headers.
#[test]
fn headers_count_for_what_is_cut_small() {
    let graph = graph(&[(1, &[50; 11], 1.0, &[]), (1, &[800], 1.0, &[])]);
    let config = DeadlineUtilityConfig::default();
    assert_eq!(first(&graph, &config), PacketIndex(11));
    assert_eq!(first(&graph, &DeadlineUtilityConfig { headers: false, ..config }), PacketIndex(0));
}

/// Of ten packets one is likely to be lost: that is made good, or the group counts less, if it is no base.
#[test]
fn what_is_lost_may_be_sent_again_and_counts_as_if_it_were_not() {
    let config = DeadlineUtilityConfig::default();
    let once = DeadlineUtilityConfig { loss_repaired: false, ..config };
    let first = |level, config| {
        // The rival takes as many bytes and adds less.
        let graph = graph(&[(level, &[42; 10], 1.0, &[]), (level, &[942], 0.8, &[])]);
        let (status, sent_at) = ([PacketStatus::Waiting; 11], [Nanos::ZERO; 11]);
        let view = SenderView { loss: 0.1, ..view(&graph, &status, &sent_at) };
        choice(&view, config, Nanos::ZERO)
    };
    assert_eq!(first(1, &config), Some(PacketIndex(0)));
    assert_eq!(first(1, &once), Some(PacketIndex(10)));
    assert_eq!(first(0, &once), Some(PacketIndex(0)));
}

/// Two groups that each add to one half of the clip: the second is all that its half has.
#[test]
fn utility_counts_by_its_share_of_the_frame() {
    let mut parts =
        graph(&[(1, &[100], 2.0, &[]), (1, &[100], 1.0, &[]), (1, &[1200], 10.0, &[])]).parts().clone();
    for (group, frames) in parts.groups.iter_mut().zip([(0, 49), (50, 99), (0, 49)]) {
        (group.first_frame, group.last_frame) = frames;
    }
    let graph = PacketGraph::new(parts).unwrap();
    let config = DeadlineUtilityConfig { delay_weight: 0.0, ..DeadlineUtilityConfig::default() };
    assert_eq!(first(&graph, &config), PacketIndex(1));
    assert_eq!(first(&graph, &DeadlineUtilityConfig { frame_share: false, ..config }), PacketIndex(0));
}

/// Two bases of a second that has just begun, in flight, and a parity packet for them: what it saves of the
/// second is what a repetition takes, 76 ms.
#[test]
fn parity_that_saves_little_is_sent_only_without_a_threshold() {
    let mut parts = graph(&[(0, &[900], 1.0, &[]), (0, &[900], 1.0, &[])]).parts().clone();
    parts.groups.iter_mut().for_each(|group| group.last_frame = 29);
    parts.packets.push(Packet {
        id: PacketId::new(2).unwrap(),
        wire_bytes: 900,
        groups: Vec::new(),
        needs_packets: Vec::new(),
        parity_of: Some(0),
    });
    parts.repair_sets.push(RepairSet { members: vec![PacketIndex(0), PacketIndex(1)] });
    let graph = PacketGraph::new(parts).unwrap();
    let status = [PacketStatus::InFlight, PacketStatus::InFlight, PacketStatus::Waiting];
    let (sent_at, now) = ([Nanos::from_s(1); 3], Nanos::from_s(1));
    let view = SenderView { playing: true, loss: 0.03, ..view(&graph, &status, &sent_at) };
    let rank = |loss_after_loss, config: &DeadlineUtilityConfig| {
        let view = SenderView { loss_after_loss, ..view };
        let mut plan = plan(&view);
        plan.renew(&view, config, now);
        assert_eq!(plan.best_rank(), 0.0, "nothing else waits");
        plan.parity_rank(&view, config, &Forecast::new(&view, config, now), PacketIndex(2))
    };
    let config = DeadlineUtilityConfig::default();
    let any = DeadlineUtilityConfig { least_saved: 0.0, ..config };
    assert_eq!(rank(0.03, &config), 0.0);
    assert!(rank(0.03, &any) > 0.0);
    // In bursts both members are lost, or one and its parity.
    let alone = DeadlineUtilityConfig { parity_bursts: false, ..any };
    assert!(rank(0.7, &any) < 0.7 * rank(0.03, &any), "{} {}", rank(0.7, &any), rank(0.03, &any));
    assert_eq!(rank(0.7, &alone), rank(0.03, &any));
    // Bytes count with their header, or alone.
    let bare = rank(0.03, &DeadlineUtilityConfig { headers: false, ..any });
    assert!((bare / rank(0.03, &any) - 958.0 / 900.0).abs() < 1e-9, "{bare}");
}
