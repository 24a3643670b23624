use std::sync::Arc;

use super::*;
use crate::{graph::Synthetic, policy::PolicyKind, session::SessionConfig};

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
