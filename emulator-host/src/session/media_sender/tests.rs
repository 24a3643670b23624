use std::sync::Arc;

use super::*;
use crate::{
    clock::Rate,
    graph::Synthetic,
    policy::{DeadlineUtility, DeadlineUtilityConfig, PolicyKind},
    session::SessionConfig,
};

/// A sender that owns its graph and scheduler lives in a task of its own.
#[test]
fn a_sender_may_move_to_another_thread() {
    let graph = Arc::new(Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap());
    let scheduler = PolicyKind::DeadlineUtility.build(&graph);
    let rules = SessionConfig::default().sending();
    let mut sender = MediaSender::new(graph, scheduler, rules, PathFacts::unknown(1200), Nanos::ZERO);
    let packet = std::thread::spawn(move || sender.next(Nanos::ZERO)).join().unwrap();
    assert!(packet.is_some());
}

/// Until when a sender of 1000 datagrams, `lost` of them lost, stays out of `path` at `now`.
fn full_until(path: PathFacts, config: DeadlineUtilityConfig, lost: usize, now: Nanos) -> Option<Nanos> {
    let graph = Arc::new(Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap());
    let scheduler = DeadlineUtility::new(&graph, config);
    let rules = SessionConfig::default().sending();
    let mut sender = MediaSender::new(graph, scheduler, rules, PathFacts::unknown(1200), Nanos::ZERO);
    sender.on_acks_and_losses(1000 - lost, lost, now);
    sender.look(path, now);
    sender.on_datagram_sent(path.in_flight, now);
    sender.full_until(now)
}

/// 112 ms of media are in flight: 72 more than the path takes by itself.
#[test]
fn the_queue_is_shorter_where_hardly_anything_is_lost() {
    let path = PathFacts {
        rate: Rate::from_mbps(1),
        smoothed_rtt: Nanos::from_ms(40),
        minimum_rtt: Nanos::from_ms(40),
        in_flight: 14_000,
        ..PathFacts::unknown(1200)
    };
    let (config, now) = (DeadlineUtilityConfig::default(), Nanos::from_s(1));
    assert_eq!(full_until(path, config, 0, now), Some(Nanos::from_ms(1200)));
    assert_eq!(full_until(path, config, 50, now), None);
    assert_eq!(full_until(path, DeadlineUtilityConfig { short_queue: false, ..config }, 0, now), None);
}

#[test]
fn a_path_that_was_never_empty_is_emptied_if_the_scheduler_requires_it() {
    let path = PathFacts {
        rate: Rate::from_mbps(100),
        smoothed_rtt: Nanos::from_ms(60),
        minimum_rtt: Nanos::from_ms(60),
        minimum_rtt_age: Nanos::from_s(10),
        in_flight: 60_000,
        ..PathFacts::unknown(1200)
    };
    let (config, now) = (DeadlineUtilityConfig::default(), Nanos::from_s(10));
    assert_eq!(full_until(path, config, 0, now), Some(Nanos::from_s(11)));
    assert_eq!(full_until(path, DeadlineUtilityConfig { empty_path: false, ..config }, 0, now), None);
}

fn sender_of(graph: &Arc<PacketGraph>) -> MediaSender<Arc<PacketGraph>, DeadlineUtility> {
    let scheduler = DeadlineUtility::new(graph, DeadlineUtilityConfig::default());
    let rules = SessionConfig::default().sending();
    MediaSender::new(graph.clone(), scheduler, rules, PathFacts::unknown(1200), Nanos::ZERO)
}

/// What a sender has learnt of the path is not forgotten when the stream grows.
#[test]
fn a_sender_that_follows_another_knows_what_that_one_knew() {
    let graph = Arc::new(Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap());
    let now = Nanos::from_s(1);
    let mut before = sender_of(&graph);
    let sent = before.next(now).unwrap();
    before.on_acks_and_losses(800, 200, now);
    let mut after = sender_of(&graph);
    let opening = after.first_base_bytes;
    after.go_on_from(before, Some);
    after.look(PathFacts::unknown(1200), now);
    assert!(after.view_state.loss > 0.15, "{}", after.view_state.loss);
    assert_eq!(after.sent_times[sent.at()], 1);
    assert_eq!(after.first_base_bytes, opening - u64::from(graph.wire_bytes(sent)));
}
