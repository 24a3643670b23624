//! Delivers over a transport that could not be better: it knows the link, fills it, and loses nothing.
//!
//! What a scheduler shows this way is what its choices are worth by themselves. What the same scheduler shows
//! less in a real run is the price of the transport: losses and their repetition, receipts, congestion
//! control, and not knowing what the link will carry. A datagram leaves when the one before it is through the
//! link, so nothing waits in its queue; the sender learns at once that it arrives; the rate that it expects
//! is what the link will carry.

use std::collections::VecDeque;

use super::{
    IP_UDP_BYTES, QUIC_OVERHEAD_BYTES, SessionConfig, SessionError,
    control::{ControlReceiver, ControlSender},
    datagram::Content,
    media_sender::MediaSender,
    view_state::PathFacts,
    viewer::Viewer,
};
use crate::{
    clock::{Bytes, Nanos, Rate},
    graph::PacketGraph,
    link::{BoxOutput, Chain, Datagram, LinkBox, LossModel, PathConfig},
    policy::Scheduler,
    receiver::Endpoint,
    report::Report,
};

/// How far ahead the link's true rate is taken.
const AHEAD: Nanos = Nanos::from_s(1);

/// Runs `graph` under `config` with `scheduler` into `endpoint`; of the path forward only capacity and delay
/// count.
///
/// # Errors
/// [`SessionError`] if the configuration is illegal.
pub fn run_ideal(
    graph: &PacketGraph,
    config: &SessionConfig,
    scheduler: &mut dyn Scheduler,
    endpoint: &mut dyn Endpoint,
) -> Result<Report, SessionError> {
    config.check()?;
    let bare = PathConfig {
        queue: config.forward.queue,
        capacity: config.forward.capacity.clone(),
        light: config.forward.light,
        delay: Nanos::ZERO,
        loss: LossModel::None,
        ..PathConfig::default()
    };
    let [forward, reverse] = SessionConfig { forward: bare, ..config.clone() }.paths()?;
    let viewer = Viewer::new(graph, config, endpoint);
    let path = facts(config, Nanos::ZERO);
    let mut ideal = Ideal {
        config,
        link: forward,
        media: MediaSender::new(graph, scheduler, config.sending(), path, Nanos::ZERO),
        control: ControlSender::new(graph.manifest_bytes()),
        manifest: ControlReceiver::new(graph.manifest_bytes()),
        viewer,
        sending: None,
        on_the_way: VecDeque::new(),
        sent: 0,
    };
    let mut now = Nanos::ZERO;
    let end = config.end(graph);
    while now <= end && !ideal.step(now) {
        now = ideal.next_time().max(now + Nanos(1));
    }
    let Ideal { link, media, viewer, .. } = ideal;
    let mut report = viewer.report(&media, [&link, &reverse], now.min(end));
    "ideal".clone_into(&mut report.controller);
    report.seed = config.seed;
    Ok(report)
}

/// What the sender knows of the path at `now`: the truth.
fn facts(config: &SessionConfig, now: Nanos) -> PathFacts {
    let capacity = &config.forward.capacity;
    let ahead = capacity.bytes_until(now + AHEAD).0 - capacity.bytes_until(now).0;
    let round_trip = config.forward.delay + config.reverse.delay;
    PathFacts {
        rate: Rate::over(Bytes(ahead), AHEAD),
        smoothed_rtt: round_trip,
        rtt_variation: Nanos::ZERO,
        minimum_rtt: Nanos(2 * config.forward.delay.0),
        ..PathFacts::unknown(1200)
    }
}

/// One run.
struct Ideal<'a> {
    config: &'a SessionConfig,
    link: Chain,
    media: MediaSender<&'a PacketGraph, &'a mut dyn Scheduler>,
    control: ControlSender,
    manifest: ControlReceiver,
    viewer: Viewer<'a>,
    /// What is in the link.
    sending: Option<Content>,
    on_the_way: VecDeque<(Nanos, Content)>,
    sent: u64,
}

impl Ideal<'_> {
    /// Everything that happens at `now`; whether the run is over.
    fn step(&mut self, now: Nanos) -> bool {
        if self.link.next_wake() <= now {
            self.push_through(None, now);
        }
        while let Some((_, content)) = self.on_the_way.pop_front_if(|(at, _)| *at <= now) {
            self.arrive(content, now);
        }
        if self.viewer.start_if_ready(now) {
            self.media.on_playout(self.viewer.playout().playout_start());
        }
        self.viewer.show_due(now);
        if self.viewer.playout().is_over() {
            return true;
        }
        self.media.look(facts(self.config, now), now);
        self.media.advance(now);
        while self.sending.is_none() {
            let Some((content, bytes)) = self.pick(now) else { break };
            self.sending = Some(content);
            let bytes = bytes + QUIC_OVERHEAD_BYTES + IP_UDP_BYTES;
            self.push_through(Some(Datagram { tag: self.sent, bytes }), now);
            self.sent += 1;
        }
        false
    }

    /// Puts `input` into the link; what is through is one delay from its viewer.
    fn push_through(&mut self, mut input: Option<Datagram>, now: Nanos) {
        while let BoxOutput::Datagram(_) = self.link.step(input.take(), now) {
            let content = self.sending.take();
            self.on_the_way.extend(content.map(|content| (now + self.config.forward.delay, content)));
        }
    }

    fn pick(&mut self, now: Nanos) -> Option<(Content, u32)> {
        if let Some(chunk) = self.control.next(false) {
            return Some((Content::Control(chunk), self.control.bytes(chunk)));
        }
        let packet = self.media.next(now)?;
        self.media.on_sent(packet, self.sent, now);
        self.media.on_acks_and_losses(1, 0, now);
        self.media.on_acked(packet);
        let bytes = self.media.graph().wire_bytes(packet);
        Some((Content::Media(packet), u32::from(bytes)))
    }

    fn arrive(&mut self, content: Content, now: Nanos) {
        match content {
            Content::Media(packet) => self.viewer.media(packet, now),
            Content::Control(chunk) => {
                if let Some((bytes, complete)) = self.manifest.on_chunk(chunk) {
                    self.viewer.control(bytes, complete);
                }
            }
            Content::Ping => {}
        }
    }

    fn next_time(&self) -> Nanos {
        let arrival = self.on_the_way.front().map_or(Nanos::MAX, |(at, _)| *at);
        self.link.next_wake().min(arrival).min(self.viewer.playout().next_time())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        GraphReceiver, PolicyKind,
        bound::upper_bound,
        graph::Synthetic,
        session::{Startup, StartupRule},
        simulate,
    };

    fn narrow() -> (PacketGraph, SessionConfig) {
        let rate = Rate::from_kbps(800);
        let graph = Synthetic { frames: 150, clusters: 8, rate, ..Synthetic::default() }.build(1).unwrap();
        let trace = crate::Trace::bursty(3, Nanos::from_s(20)).scaled(1, 10).unwrap();
        let forward = PathConfig {
            capacity: crate::link::Capacity::Trace(trace),
            loss: LossModel::Iid(0.02),
            ..PathConfig::default()
        };
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(1) };
        (graph, SessionConfig { startup, forward, ..SessionConfig::default() })
    }

    fn ideal(graph: &PacketGraph, config: &SessionConfig, policy: PolicyKind) -> Report {
        let mut receiver = GraphReceiver::new(graph, config.buffer_limit);
        run_ideal(graph, config, &mut *policy.build(graph), &mut receiver).unwrap()
    }

    #[test]
    fn it_stands_between_the_run_and_the_bound() {
        let (graph, config) = narrow();
        let policy = PolicyKind::DeadlineUtility;
        let real = simulate(&graph, &SessionConfig { policy, ..config.clone() }).unwrap();
        let ideal = ideal(&graph, &config, policy);
        let bound = upper_bound(&graph, &config.forward, Nanos::from_s(1), 800);
        assert!(real.utility < ideal.utility, "{} {}", real.utility, ideal.utility);
        assert!(ideal.utility < bound.utility, "{} {bound:?}", ideal.utility);
        assert_eq!((ideal.sender.lost, ideal.sender.retransmitted), (0, 0));
    }

    #[test]
    fn the_link_is_never_idle_while_there_is_something_to_send_and_never_queues() {
        let (graph, config) = narrow();
        let report = ideal(&graph, &config, PolicyKind::Layered);
        let link = report.boxes[0].counts;
        let moved = config.forward.capacity.bytes_until(report.duration_ns);
        assert_eq!(link.dropped.datagrams, 0);
        assert!(link.inside.datagrams <= 1);
        assert!(link.delivered.bytes + 1500 > moved.0 || link.delivered.bytes > graph.total_bytes());
    }
}
