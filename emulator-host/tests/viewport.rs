//! Holds a sender to it that what a viewer sees comes first, and that nothing changes for one that says
//! nothing.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use std::sync::Arc;

use codec_core::internals::wire::{
    crc::crc32,
    receipt::{Value, ViewerPose},
};
use emulator_host::{
    GraphReceiver, Nanos, PacketGraph, PacketIndex, Rate, Report, SessionConfig,
    graph::{Ball, GraphParts, Place, Synthetic},
    policy::{DeadlineUtility, DeadlineUtilityConfig},
    run,
    session::{MediaSender, PathFacts, Startup, StartupRule, ViewerPath},
    simulate,
};

/// Looks along +z; and half a turn around y, along -z.
const AHEAD: [f32; 4] = [1.0, 0.0, 0.0, 0.0];
const BACK: [f32; 4] = [0.0, 0.0, 1.0, 0.0];

fn pose(rotation: [f32; 4]) -> ViewerPose {
    ViewerPose { position: [0.0; 3], rotation }
}

fn plain() -> PacketGraph {
    Synthetic { frames: 90, clusters: 8, ..Synthetic::default() }.build(3).unwrap()
}

/// Clusters of even number lie ahead of [`AHEAD`], the others of [`BACK`].
fn is_ahead(cluster: u16) -> bool {
    cluster.is_multiple_of(2)
}

fn placed() -> PacketGraph {
    let mut parts: GraphParts = plain().parts().clone();
    for group in &mut parts.groups {
        let z = if is_ahead(group.id.cluster.0) { 5.0 } else { -5.0 };
        group.place = Place::new(&[Ball::new([0.0, 0.0, z], 1.0, 5.0).unwrap()]);
    }
    PacketGraph::new(parts).unwrap()
}

fn session(viewer: Option<ViewerPose>) -> SessionConfig {
    let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(1) };
    let viewer = viewer.and_then(|pose| ViewerPath::new(&[pose]));
    SessionConfig { startup, viewer, ..SessionConfig::default() }
}

#[test]
fn a_viewer_that_says_nothing_is_served_as_before() {
    let (plain, placed) = (plain(), placed());
    let of = |graph: &PacketGraph| simulate(graph, &session(None)).unwrap().digest;
    assert_eq!(of(&plain), of(&placed));
}

fn with(graph: &PacketGraph, viewer: [f32; 4], config: DeadlineUtilityConfig) -> Report {
    let session = session(Some(pose(viewer)));
    let mut endpoint = GraphReceiver::new(graph, session.buffer_limit);
    run(graph, &session, &mut DeadlineUtility::new(graph, config), &mut endpoint).unwrap()
}

#[test]
fn the_switch_turns_all_of_it_off_and_places_that_are_not_known_change_nothing() {
    let (plain, placed) = (plain(), placed());
    let on = DeadlineUtilityConfig::default();
    let off = DeadlineUtilityConfig { viewport: None, ..on };
    assert_eq!(with(&plain, AHEAD, on).digest, with(&plain, BACK, on).digest);
    assert_eq!(with(&placed, AHEAD, off).digest, with(&plain, AHEAD, off).digest);
    assert_eq!(with(&placed, AHEAD, off).digest, with(&placed, BACK, off).digest);
    assert_ne!(with(&placed, AHEAD, on).digest, with(&placed, BACK, on).digest);
}

/// A sender that may send as much as it likes.
struct Free {
    sender: MediaSender<Arc<PacketGraph>, DeadlineUtility>,
    graph: Arc<PacketGraph>,
    now: Nanos,
    receipts: u32,
}

impl Free {
    fn new() -> Self {
        let graph = Arc::new(placed());
        let path = PathFacts { rate: Rate::from_mbps(5), ..PathFacts::unknown(1200) };
        let scheduler = DeadlineUtility::new(&graph, DeadlineUtilityConfig::default());
        let rules = session(None).sending();
        let sender = MediaSender::new(graph.clone(), scheduler, rules, path, Nanos::ZERO);
        Self { sender, graph, now: Nanos::ZERO, receipts: 0 }
    }

    fn hear(&mut self, pose: Option<ViewerPose>) {
        let lists = (&[][..], &[][..], &[][..]);
        let (acknowledged, recovered, completed) = lists;
        let sequence = self.receipts;
        let value = Value { sequence, playout_us: 0, pose, acknowledged, recovered, completed };
        let mut bytes = [0; 1200];
        let len = value.write(&mut bytes).unwrap();
        assert!(codec_core::internals::wire::receipt::Receipt::parse(&bytes[..len], crc32).is_ok());
        self.sender.on_receipt(&bytes[..len]);
        self.receipts += 1;
    }

    fn next(&mut self) -> Option<PacketIndex> {
        self.now += Nanos::from_ms(1);
        self.sender.advance(self.now);
        let packet = self.sender.next(self.now)?;
        self.sender.on_acked(packet);
        Some(packet)
    }

    /// Share of refinement bytes among the next `count` packets that lie ahead of [`AHEAD`].
    fn share_ahead(&mut self, count: usize) -> f64 {
        let (mut ahead, mut all) = (0.0, 0.0);
        for _ in 0..count {
            let Some(packet) = self.next() else { break };
            let facts = &self.graph.packets()[packet.at()];
            if facts.parity_of.is_some() || self.graph.level(packet) == 0 {
                continue;
            }
            all += f64::from(facts.wire_bytes);
            let group = &self.graph.groups()[facts.groups[0].at()];
            ahead += f64::from(facts.wire_bytes) * f64::from(u8::from(is_ahead(group.id.cluster.0)));
        }
        ahead / f64::max(all, 1.0)
    }
}

#[test]
fn what_the_viewer_sees_comes_first_and_follows_its_turns() {
    let share = |rotation: Option<[f32; 4]>| {
        let mut free = Free::new();
        free.hear(rotation.map(pose));
        free.share_ahead(200)
    };
    let (ahead, blind, back) = (share(Some(AHEAD)), share(None), share(Some(BACK)));
    assert!(ahead > 0.8 && back < 0.2 && (0.2..0.8).contains(&blind), "{ahead} {blind} {back}");
    // Half way it turns round.
    let mut free = Free::new();
    free.hear(Some(pose(AHEAD)));
    assert!(free.share_ahead(100) > 0.8);
    free.hear(Some(pose(BACK)));
    // The plan of before is used for 50 ms more at most, 50 packets here.
    free.share_ahead(50);
    let turned = free.share_ahead(100);
    assert!(turned < 0.2, "{turned}");
}

#[test]
fn what_is_out_of_sight_is_sent_all_the_same() {
    let mut free = Free::new();
    free.hear(Some(pose(AHEAD)));
    let mut sent = vec![false; free.graph.packets().len()];
    while let Some(packet) = free.next() {
        sent[packet.at()] = true;
    }
    let mut blind = Free::new();
    let mut wanted = vec![false; sent.len()];
    while let Some(packet) = blind.next() {
        wanted[packet.at()] = true;
    }
    assert_eq!(sent, wanted);
}

#[test]
fn hostile_poses_are_ignored_or_taken_and_never_stop_a_sender() {
    let mut free = Free::new();
    let most = f32::MAX;
    for at in 0..2000u32 {
        let wild = [0.0, most, -most, f32::MIN_POSITIVE, at as f32][at as usize % 5];
        free.hear(Some(ViewerPose { position: [wild, -wild, most], rotation: [wild, 0.0, wild, most] }));
        free.hear(Some(ViewerPose { position: [most; 3], rotation: [0.0; 4] }));
        if at % 10 == 0 {
            free.next();
        }
    }
    assert_eq!(free.sender.counts().refused_receipts, 0);
    assert!(free.next().is_some());
}
