//! Runs one delivery: steps from event to event, and hands datagrams from end to end.

use super::{SessionConfig, SessionError, client::Client, sender::Sender};
use crate::{
    clock::Nanos,
    graph::PacketGraph,
    link::{Chain, Datagram},
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
    walk(graph, config, scheduler, endpoint, false)
}

/// [`run`]; with `serves_always`, both ends are looked after in every step, whether or not it can matter.
fn walk(
    graph: &PacketGraph,
    config: &SessionConfig,
    scheduler: &mut dyn Scheduler,
    endpoint: &mut dyn Endpoint,
    serves_always: bool,
) -> Result<Report, SessionError> {
    config.check()?;
    let [forward, reverse] = config.paths()?;
    let mut walk = Walk {
        forward,
        reverse,
        sender: Sender::new(graph, config, scheduler),
        client: Client::new(graph, config, endpoint),
        digest: 0xcbf2_9ce4_8422_2325,
        sent_at: Vec::with_capacity(graph.packets().len()),
        delays: Vec::with_capacity(graph.packets().len()),
        sample_at: Nanos::ZERO,
        due_at: Nanos::ZERO,
        arrived: serves_always,
        serves_always,
        config,
    };
    let mut now = Nanos::ZERO;
    let end = config.end(graph);
    while now <= end && !walk.step(now) {
        now = walk.next_time(now);
    }
    Ok(walk.report(now.min(end)))
}

/// One run: both ends, the path between them, and what is measured.
struct Walk<'a> {
    config: &'a SessionConfig,
    forward: Chain,
    reverse: Chain,
    sender: Sender<'a>,
    client: Client<'a>,
    digest: u64,
    /// When each datagram left the sender, by its tag, and how long those took that have arrived.
    sent_at: Vec<Nanos>,
    delays: Vec<Nanos>,
    sample_at: Nanos,
    /// When an end, or the sampling, has something to do without an arrival.
    due_at: Nanos,
    /// Whether something has arrived at an end since both were last looked after.
    arrived: bool,
    serves_always: bool,
}

/// Directions in the digest.
const DOWN_SENT: u64 = 0;
const DOWN_DELIVERED: u64 = 1;
const UP_SENT: u64 = 2;
const UP_DELIVERED: u64 = 3;

impl Walk<'_> {
    /// Everything that happens at `now`; whether the run is over.
    fn step(&mut self, now: Nanos) -> bool {
        if self.forward.next_wake() <= now {
            self.carry_down(None, now);
        }
        if self.reverse.next_wake() <= now {
            self.carry_up(None, now);
        }
        // Every second step only moves a datagram from one box to the next, which nobody notices.
        let is_served = self.arrived || now >= self.due_at.min(self.sender.horizon_moves_at());
        if is_served && self.serve(now) {
            return true;
        }
        let mut has_moved = is_served;
        while let Some(datagram) = self.sender.poll(now) {
            note(&mut self.digest, datagram, DOWN_SENT, now);
            self.sent_at.push(now);
            self.carry_down(Some(datagram), now);
            has_moved = true;
        }
        while let Some(datagram) = self.client.poll(now) {
            note(&mut self.digest, datagram, UP_SENT, now);
            self.carry_up(Some(datagram), now);
            has_moved = true;
        }
        if has_moved {
            self.due_at = self.next_due();
        }
        false
    }

    /// Timers, playout and sampling at `now`; whether the run is over.
    fn serve(&mut self, now: Nanos) -> bool {
        self.arrived = self.serves_always;
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
        false
    }

    fn next_due(&self) -> Nanos {
        let sample = if self.config.sample_interval > Nanos::ZERO { self.sample_at } else { Nanos::MAX };
        self.sender.timer().min(self.client.next_time()).min(sample)
    }

    fn next_time(&self, now: Nanos) -> Nanos {
        if self.sender.is_dirty() {
            return now;
        }
        let moves = self.forward.next_wake().min(self.reverse.next_wake());
        // Time goes on even if something asks to be woken in the past.
        moves.min(self.sender.next_send()).min(self.due_at).max(now + Nanos(1))
    }

    fn carry_down(&mut self, input: Option<Datagram>, now: Nanos) {
        let Self { forward, sender, client, digest, sent_at, delays, arrived, .. } = self;
        forward.carry(input, now, |datagram| {
            note(digest, datagram, DOWN_DELIVERED, now);
            delays.extend(sent_at.get(datagram.tag as usize).map(|sent| now - *sent));
            client.receive(datagram.tag, sender.content(datagram.tag), now);
            *arrived = true;
        });
    }

    fn carry_up(&mut self, input: Option<Datagram>, now: Nanos) {
        let Self { reverse, sender, client, digest, arrived, .. } = self;
        reverse.carry(input, now, |datagram| {
            note(digest, datagram, UP_DELIVERED, now);
            let (acknowledgement, reported) = client.feedback(datagram.tag);
            sender.on_feedback(acknowledgement, reported, client.news(), now);
            *arrived = true;
        });
    }

    fn report(mut self, now: Nanos) -> Report {
        let mut share = |part: usize| {
            let at = self.delays.len() * part / 100;
            (at < self.delays.len()).then(|| *self.delays.select_nth_unstable(at).1)
        };
        let one_way_delay = share(50).zip(share(95)).map(|(median, tail)| [median, tail]);
        let viewer = self.client.into_viewer();
        let mut report = viewer.report(self.sender.media(), [&self.forward, &self.reverse], now);
        report.controller = self.sender.controller().to_owned();
        report.seed = self.config.seed;
        report.sender = self.sender.counts();
        report.digest = self.digest;
        report.one_way_delay = one_way_delay;
        report
    }
}

/// Enters a datagram that was sent or delivered into the digest.
fn note(digest: &mut u64, datagram: Datagram, direction: u64, now: Nanos) {
    for word in [now.0, u64::from(datagram.bytes) << 2 | direction] {
        *digest = (*digest ^ word).wrapping_mul(0x0100_0000_01b3);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        ControllerKind, PolicyKind, Rate, Trace,
        graph::Synthetic,
        link::{Capacity, LossModel, PathConfig, Reordering},
    };

    fn paths(seed: u64) -> [PathConfig; 5] {
        let bursty = Capacity::Trace(Trace::bursty(seed, Nanos::from_s(20)));
        let lossy = LossModel::in_bursts(0.03, 3.0);
        let reorder = Reordering { probability: 0.05, extra: Nanos::from_ms(15) };
        [
            PathConfig::default(),
            PathConfig { capacity: bursty.clone(), ..PathConfig::default() },
            PathConfig { loss: lossy, jitter: Nanos::from_ms(3), ..PathConfig::default() },
            PathConfig { capacity: bursty, loss: lossy, reorder: Some(reorder), ..PathConfig::default() },
            PathConfig { capacity: Capacity::Constant(Rate::from_mbps(1)), ..PathConfig::unimpaired() },
        ]
    }

    /// A step in which nothing arrives and nothing is due may leave out all but the sending.
    #[test]
    fn looking_after_both_ends_in_every_step_changes_nothing() {
        for seed in 1..4 {
            let spec = Synthetic { frames: 60, repair: (seed == 2).then_some(4), ..Synthetic::default() };
            let graph = spec.build(seed).unwrap();
            for (at, forward) in paths(seed).into_iter().enumerate() {
                for policy in PolicyKind::ALL {
                    let controller = ControllerKind::ALL[(at + seed as usize) % ControllerKind::ALL.len()];
                    let mut config = SessionConfig {
                        seed,
                        policy,
                        controller,
                        forward: forward.clone(),
                        ..Default::default()
                    };
                    if seed == 3 {
                        config.access_rate = Some(Rate::from_mbps(20));
                        config.reverse = PathConfig::unimpaired();
                    }
                    let run = |serves_always| {
                        let mut endpoint = GraphReceiver::new(&graph, config.buffer_limit);
                        walk(&graph, &config, &mut *policy.build(&graph), &mut endpoint, serves_always)
                    };
                    assert_eq!(run(false), run(true), "{policy:?} on path {at}");
                }
            }
        }
    }
}
