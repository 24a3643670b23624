//! Runs one delivery: steps from event to event, and hands datagrams from end to end.

use super::{SessionConfig, SessionError, client::Client, sender::Sender};
use crate::{
    clock::Nanos,
    graph::PacketGraph,
    link::{BoxOutput, Chain, Datagram, LinkBox},
    policy::Scheduler,
    receiver::{Endpoint, GraphReceiver},
    report::Report,
};

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
    config.check()?;
    let [forward, reverse] = config.paths()?;
    let mut walk = Walk {
        forward,
        reverse,
        sender: Sender::new(graph, config, scheduler),
        client: Client::new(graph, config, endpoint),
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

/// One run: both ends, the path between them, and what is measured.
struct Walk<'a> {
    config: &'a SessionConfig,
    forward: Chain,
    reverse: Chain,
    sender: Sender<'a>,
    client: Client<'a>,
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
            self.client.viewer().sample(self.sender.row(now));
            self.sample_at = now + self.config.sample_interval;
        }
        self.client.viewer().show_due(now);
        if self.client.is_over() {
            return true;
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
        while input.is_some() || self.forward.next_wake() <= now {
            let BoxOutput::Datagram(datagram) = self.forward.step(input.take(), now) else { return };
            self.note(datagram, DOWN_DELIVERED, now);
            let content = self.sender.content(datagram.tag);
            self.client.receive(datagram.tag, content, now);
        }
    }

    fn carry_up(&mut self, mut input: Option<Datagram>, now: Nanos) {
        while input.is_some() || self.reverse.next_wake() <= now {
            let BoxOutput::Datagram(datagram) = self.reverse.step(input.take(), now) else { return };
            self.note(datagram, UP_DELIVERED, now);
            let (acknowledgement, reported) = self.client.feedback(datagram.tag);
            self.sender.on_feedback(acknowledgement, reported, self.client.news(), now);
        }
    }

    fn note(&mut self, datagram: Datagram, direction: u64, now: Nanos) {
        for word in [now.0, u64::from(datagram.bytes) << 2 | direction] {
            self.digest = (self.digest ^ word).wrapping_mul(0x0100_0000_01b3);
        }
    }

    fn report(self, now: Nanos) -> Report {
        let viewer = self.client.into_viewer();
        let mut report = viewer.report(self.sender.media(), [&self.forward, &self.reverse], now);
        report.controller = self.sender.controller().to_owned();
        report.seed = self.config.seed;
        report.sender = self.sender.counts();
        report.digest = self.digest;
        report
    }
}
