//! One delivery: sender, path, receiver, feedback, playout, in virtual time.
//!
//! Order within one instant: arrivals at the receiver, arrivals at the sender, timers, playout, sending,
//! receipts. So what arrives at the very time of a snapshot is in it.
//!
//! What is modelled: control and media share one congestion budget, control first; media that overtakes the
//! manifest is buffered; receipts cost uplink and may be lost; lost base packets are sent again within a
//! budget while they can still be shown; playout starts at a threshold and never waits after it. Not
//! modelled: handshake, clock offset (the receipt carries the playout time and both ends share a clock),
//! decoding time.

mod client;
mod control;
mod feedback;
mod metrics;
mod sender;

use crate::{
    clock::{Nanos, Rate},
    congestion::ControllerKind,
    graph::PacketGraph,
    link::{Chain, Datagram, LinkBox, Output, PathConfig, PathError},
    policy::{PolicyKind, Scheduler},
    receiver::{Endpoint, GraphReceiver},
    report::Report,
};
use client::Client;
use metrics::Metrics;
use sender::Sender;

/// Bytes around a DGSP packet inside the UDP payload: QUIC short header 11, DATAGRAM frame 3, authentication
/// tag 16.
pub const QUIC_OVERHEAD_BYTES: u32 = 30;
/// IPv4 and UDP headers, counted on the link only.
pub const IP_UDP_BYTES: u32 = 28;

/// What must be there before playout starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StartupRule {
    /// Share of the level-0 groups active at frame 0.
    BaseGroups(f64),
    /// The same, weighted by positive utility.
    BaseUtility(f64),
}

/// When playout starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Startup {
    /// What must be usable, 0..=1. The manifest is always needed.
    pub rule: StartupRule,
    /// Playout starts after this long in any case.
    pub max_wait: Nanos,
}

/// Everything that a run depends on besides the graph.
#[derive(Clone, Debug)]
pub struct SessionConfig {
    /// Seed of the path's random streams.
    pub seed: u64,
    /// Scheduler used by [`simulate`].
    pub policy: PolicyKind,
    /// Congestion controller.
    pub controller: ControllerKind,
    /// From sender to receiver.
    pub forward: PathConfig,
    /// From receiver to sender.
    pub reverse: PathConfig,
    /// Rate of the sender's own serialiser; loss timers start when it is through. `None`: instantly.
    pub access_rate: Option<Rate>,
    /// How far ahead of playout media may be sent.
    pub lookahead: Nanos,
    /// When playout starts.
    pub startup: Startup,
    /// Times that one lost packet may be sent again.
    pub retransmissions: u32,
    /// Levels below this one are sent again; 1 = base only.
    pub retransmit_levels: u8,
    /// Whether canonical packets of every level are sent again too: motion of all windows stands on them.
    pub retransmit_canonical: bool,
    /// Ack-eliciting datagrams per receipt, at least 1.
    pub ack_every: u32,
    /// Longest time that a receipt is held back.
    pub max_ack_delay: Nanos,
    /// Media packets that the receiver of [`simulate`] keeps before the manifest is complete.
    pub buffer_limit: usize,
    /// Time between [`crate::report::SenderRow`]s; zero for none.
    pub sample_interval: Nanos,
    /// The run ends here if playout has not ended before.
    pub cap: Nanos,
}

impl Default for SessionConfig {
    /// Deadline-utility over NewReno on 5 Mbit/s down and 2 Mbit/s up, 20 ms each way.
    fn default() -> Self {
        let up = PathConfig {
            capacity: crate::link::Capacity::Constant(Rate::from_mbps(2)),
            ..PathConfig::default()
        };
        Self {
            seed: 1,
            policy: PolicyKind::DeadlineUtility,
            controller: ControllerKind::NewReno,
            forward: PathConfig::default(),
            reverse: up,
            access_rate: None,
            lookahead: Nanos::from_s(2),
            startup: Startup { rule: StartupRule::BaseGroups(0.95), max_wait: Nanos::from_s(5) },
            retransmissions: 2,
            retransmit_levels: 1,
            retransmit_canonical: false,
            ack_every: 2,
            max_ack_delay: Nanos::from_ms(25),
            buffer_limit: GraphReceiver::BUFFER_LIMIT,
            sample_interval: Nanos::from_ms(100),
            cap: Nanos::from_s(3600),
        }
    }
}

/// Why a run cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// A direction of the path is illegal.
    #[error("{direction}: {error}")]
    Path {
        /// `forward` or `reverse`.
        direction: &'static str,
        /// What is wrong.
        error: PathError,
    },
    /// A number of the configuration is illegal.
    #[error("{field} is {found}, allowed {allowed}")]
    Config {
        /// Which.
        field: &'static str,
        /// What it is.
        found: f64,
        /// What it may be.
        allowed: &'static str,
    },
}

/// Runs `graph` under `config` with the scheduler it names and a [`GraphReceiver`].
///
/// # Errors
/// [`SessionError`] if the configuration is illegal; a legal run always ends and reports.
pub fn simulate(graph: &PacketGraph, config: &SessionConfig) -> Result<Report, SessionError> {
    let mut scheduler = config.policy.build(graph);
    let mut endpoint = GraphReceiver::new(graph, config.buffer_limit);
    run(graph, config, &mut *scheduler, &mut endpoint)
}

/// Runs `graph` under `config` with a scheduler and a receiver of the caller's; `config.policy` and
/// `config.buffer_limit` are not used.
///
/// # Errors
/// As [`simulate`].
pub fn run(
    graph: &PacketGraph,
    config: &SessionConfig,
    scheduler: &mut dyn Scheduler,
    endpoint: &mut dyn Endpoint,
) -> Result<Report, SessionError> {
    check(config)?;
    let path = |direction, path: &PathConfig| {
        path.build(direction, config.seed).map_err(|error| SessionError::Path { direction, error })
    };
    let mut walk = Walk {
        forward: path("forward", &config.forward)?,
        reverse: path("reverse", &config.reverse)?,
        sender: Sender::new(graph, config, scheduler),
        client: Client::new(graph, config, endpoint),
        metrics: Metrics::new(graph),
        digest: 0xcbf2_9ce4_8422_2325,
        sample_at: Nanos::ZERO,
        config,
    };
    let mut now = Nanos::ZERO;
    while now <= config.cap && !walk.step(now) {
        now = walk.next_time(now);
    }
    Ok(walk.report(now.min(config.cap)))
}

fn check(config: &SessionConfig) -> Result<(), SessionError> {
    let (StartupRule::BaseGroups(share) | StartupRule::BaseUtility(share)) = config.startup.rule;
    if !(0.0..=1.0).contains(&share) {
        return Err(SessionError::Config { field: "startup share", found: share, allowed: "0 to 1" });
    }
    if config.ack_every == 0 {
        return Err(SessionError::Config { field: "ack_every", found: 0.0, allowed: "at least 1" });
    }
    Ok(())
}

struct Walk<'a> {
    config: &'a SessionConfig,
    forward: Chain,
    reverse: Chain,
    sender: Sender<'a>,
    client: Client<'a>,
    metrics: Metrics<'a>,
    digest: u64,
    sample_at: Nanos,
}

/// Directions in the digest.
const DOWN_SENT: u64 = 0;
const DOWN_DELIVERED: u64 = 1;
const UP_SENT: u64 = 2;
const UP_DELIVERED: u64 = 3;

impl Walk<'_> {
    /// Everything that happens at `now`; whether the run is over.
    fn step(&mut self, now: Nanos) -> bool {
        self.carry_down(None, now);
        self.carry_up(None, now);
        self.sender.on_timer(now);
        self.client.start_if_ready(now);
        if self.config.sample_interval > Nanos::ZERO && now >= self.sample_at {
            self.metrics.sample(self.sender.row(now));
            self.sample_at = now + self.config.sample_interval;
        }
        while let Some(frame) = self.client.frame_due(now) {
            self.metrics.show(frame, now, self.client.snapshot(frame));
            if self.client.is_over() {
                return true;
            }
        }
        self.sender.advance(now);
        while let Some(datagram) = self.sender.poll(now) {
            self.note(datagram, DOWN_SENT, now);
            self.carry_down(Some(datagram), now);
        }
        while let Some(datagram) = self.client.poll(now) {
            self.note(datagram, UP_SENT, now);
            self.carry_up(Some(datagram), now);
        }
        false
    }

    fn next_time(&self, now: Nanos) -> Nanos {
        let sample = if self.config.sample_interval > Nanos::ZERO { self.sample_at } else { Nanos::MAX };
        let times = [
            self.forward.next_wake(),
            self.reverse.next_wake(),
            self.sender.next_time(now),
            self.client.next_time(),
            sample,
        ];
        let next = times.into_iter().min().unwrap_or(Nanos::MAX);
        // Time goes on even if something asks to be woken in the past.
        next.max(now + Nanos(u64::from(!self.sender.is_dirty())))
    }

    fn carry_down(&mut self, mut input: Option<Datagram>, now: Nanos) {
        if input.is_none() && self.forward.next_wake() > now {
            return;
        }
        while let Output::Datagram(datagram) = self.forward.step(input.take(), now) {
            self.note(datagram, DOWN_DELIVERED, now);
            let content = self.sender.content(datagram.tag);
            self.client.receive(datagram.tag, content, now, &mut self.metrics);
        }
    }

    fn carry_up(&mut self, mut input: Option<Datagram>, now: Nanos) {
        if input.is_none() && self.reverse.next_wake() > now {
            return;
        }
        while let Output::Datagram(datagram) = self.reverse.step(input.take(), now) {
            self.note(datagram, UP_DELIVERED, now);
            let (acknowledgement, receipt) = self.client.feedback(datagram.tag);
            self.sender.on_feedback(acknowledgement, receipt, now);
        }
    }

    fn note(&mut self, datagram: Datagram, direction: u64, now: Nanos) {
        for word in [now.0, u64::from(datagram.bytes) << 2 | direction] {
            self.digest = (self.digest ^ word).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn report(self, now: Nanos) -> Report {
        let boxes = self.forward.box_counts().chain(self.reverse.box_counts());
        let boxes = boxes.map(|(label, counts)| (label.to_owned(), counts)).collect();
        let mut report = self.metrics.report(now, boxes);
        report.policy = self.sender.policy().to_owned();
        report.controller = self.sender.controller().to_owned();
        report.seed = self.config.seed;
        report.startup_ms = self.client.playout_start().map(Nanos::as_ms);
        report.startup_reached = self.client.threshold_reached();
        report.sender = self.sender.counts();
        report.digest = self.digest;
        report
    }
}
