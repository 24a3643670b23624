//! Runs one delivery: steps from event to event, and hands datagrams from end to end.
//!
//! The order within one instant is that of the model.

use emulator_host::{
    Endpoint, GraphReceiver, Nanos, PacketGraph, Report, Scheduler, SessionConfig, SessionError,
    link::{Capacity, Chain, LossModel, PathConfig},
    session::Viewer,
};

use super::{
    VirtualError,
    end::{self, DATAGRAM_OVERHEAD, End},
    messages::MessageWriter,
    receiving::Receiving,
    sending::Sending,
    wire::Wire,
};
use crate::{
    clock::Clock,
    congestion::{CongestionControl, Factory, Observed, Watch},
};

/// Longest time for a handshake.
const HANDSHAKE_TIMEOUT: Nanos = Nanos::from_s(60);
/// After the handshake, until the last of its packets has been acknowledged and the keys are discarded.
const SETTLING: Nanos = Nanos::from_s(2);

/// Runs `graph` under `config` with the scheduler it names and a [`GraphReceiver`].
///
/// # Examples
/// ```
/// use dgs_quic::virtual_time;
/// use emulator_host::{SessionConfig, graph::Synthetic};
///
/// let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1)?;
/// let config = SessionConfig::default();
/// let real = virtual_time::simulate(&graph, &config)?;
/// let model = emulator_host::simulate(&graph, &config)?;
/// println!("{:.2} and {:.2} Mbit/s", real.goodput_bps / 1e6, model.goodput_bps / 1e6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// [`VirtualError`] if the configuration is illegal or asks for what this transport does not do.
pub fn simulate(graph: &PacketGraph, config: &SessionConfig) -> Result<Report, VirtualError> {
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
) -> Result<Report, VirtualError> {
    check(config)?;
    let controller = end::controller(config.controller, datagram_bytes(graph))?;
    let named = (config.controller.name(), controller);
    Ok(walk(graph, config, named, MessageWriter::none(), (scheduler, endpoint))?.0)
}

/// As [`simulate`], under a controller of the transport in place of `config.controller`; the report names it.
///
/// One seed gives one run, except under [`CongestionControl::Bbr`], which draws from the operating system in
/// which phase it begins to probe.
///
/// # Errors
/// As [`simulate`].
pub fn simulate_with(
    graph: &PacketGraph,
    config: &SessionConfig,
    controller: CongestionControl,
) -> Result<Report, VirtualError> {
    check(config)?;
    let mut scheduler = config.policy.build(graph);
    let mut endpoint = GraphReceiver::new(graph, config.buffer_limit);
    let named = (controller.name(), controller.factory(datagram_bytes(graph)));
    Ok(walk(graph, config, named, MessageWriter::none(), (&mut *scheduler, &mut endpoint))?.0)
}

/// As [`simulate`], with a control message of 200 bytes towards the receiver every `interval` (at least 1 ms)
/// from 2 s on: how long each took from being written until it was read, as they arrived. A message leaves
/// before all media that waits; what is in flight already is before it.
///
/// # Errors
/// As [`simulate`].
pub fn control_times(
    graph: &PacketGraph,
    config: &SessionConfig,
    interval: Nanos,
) -> Result<Vec<Nanos>, VirtualError> {
    check(config)?;
    let mut scheduler = config.policy.build(graph);
    let mut endpoint = GraphReceiver::new(graph, config.buffer_limit);
    let named = (config.controller.name(), end::controller(config.controller, datagram_bytes(graph))?);
    let messages = MessageWriter::every(interval.max(Nanos::from_ms(1)));
    Ok(walk(graph, config, named, messages, (&mut *scheduler, &mut endpoint))?.1)
}

/// Runs `graph` under a legal `config` with this controller, by its name in reports; gives the report, and
/// the times of control messages.
fn walk(
    graph: &PacketGraph,
    config: &SessionConfig,
    (name, controller): (&'static str, Factory),
    messages: MessageWriter,
    (scheduler, endpoint): (&mut dyn Scheduler, &mut dyn Endpoint),
) -> Result<(Report, Vec<Nanos>), VirtualError> {
    let [forward, reverse] = config.paths()?;
    let datagram_bytes = datagram_bytes(graph);
    let mut pair = Pair::new(config, datagram_bytes, controller, bare_paths(config)?)?;
    let connected = pair.connect(HANDSHAKE_TIMEOUT)? + SETTLING;
    pair.go_on_until(connected)?;
    pair.server.restart(connected);
    pair.client.restart(connected);
    let viewer = Viewer::new(graph, config, endpoint);
    let bytes = u64::from(datagram_bytes);
    let mut walk = Walk {
        forward: Wire::new(forward),
        reverse: Wire::new(reverse),
        sending: Sending::new(pair.server, pair.watch, graph, config, scheduler, bytes),
        receiving: Receiving::new(pair.client, viewer, graph, config),
        digest: 0xcbf2_9ce4_8422_2325,
        sample_at: Nanos::ZERO,
        controller: name,
        config,
    };
    walk.sending.messages = messages;
    let mut now = Nanos::ZERO;
    let end = config.end(graph);
    while now <= end && !walk.step(now)? {
        now = walk.next_time().max(now + Nanos(1));
    }
    let times = walk.receiving.messages.times(&walk.sending.messages);
    Ok((walk.report(now.min(end)), times))
}

/// Duration of the handshake over the path of `config`, losses and queues included.
///
/// # Errors
/// As [`simulate`], and [`VirtualError::Handshake`] if it takes longer than a minute.
pub fn handshake(config: &SessionConfig) -> Result<Nanos, VirtualError> {
    check(config)?;
    let controller = end::controller(config.controller, 1200)?;
    Pair::new(config, 1200, controller, config.paths()?)?.connect(HANDSHAKE_TIMEOUT)
}

fn check(config: &SessionConfig) -> Result<(), VirtualError> {
    config.check()?;
    let unsupported =
        |field, found: String, allowed| Err(VirtualError::Unsupported { field, found, allowed });
    if let Some(rate) = config.access_rate {
        return unsupported("access_rate", format!("{} bit/s", rate.0), "none");
    }
    if config.ack_every != 2 {
        return unsupported("ack_every", config.ack_every.to_string(), "2");
    }
    if config.max_ack_delay != Nanos::from_ms(25) {
        return unsupported("max_ack_delay", config.max_ack_delay.to_string(), "25 ms");
    }
    Ok(())
}

/// UDP payload that carries every packet of `graph`, at least the 1200 bytes that every path carries.
fn datagram_bytes(graph: &PacketGraph) -> u16 {
    let widest = graph.packets().iter().map(|packet| packet.wire_bytes).max().unwrap_or(0);
    // The sum is below 1300: a packet has at most 1200 bytes.
    u16::try_from(u64::from(widest) + DATAGRAM_OVERHEAD).unwrap_or(u16::MAX).max(1200)
}

/// The delays of the path and nothing else; of recorded ones the first.
fn bare_paths(config: &SessionConfig) -> Result<[Chain; 2], SessionError> {
    let bare = |path: &PathConfig| PathConfig {
        capacity: Capacity::Unlimited,
        loss: LossModel::None,
        delay: path.delay + path.delay_trace.as_ref().map_or(Nanos::ZERO, |trace| trace.at(Nanos::ZERO)),
        ..PathConfig::default()
    };
    let bare = SessionConfig {
        forward: bare(&config.forward),
        reverse: bare(&config.reverse),
        ..SessionConfig::default()
    };
    bare.paths()
}

/// Two ends that are about to connect. The client speaks first, over the reverse path.
struct Pair {
    server: End,
    client: End,
    watch: Watch,
    forward: Wire,
    reverse: Wire,
    now: Nanos,
}

impl Pair {
    fn new(
        config: &SessionConfig,
        datagram_bytes: u16,
        controller: Factory,
        [forward, reverse]: [Chain; 2],
    ) -> Result<Self, VirtualError> {
        let clock = Clock::start();
        let watch = Watch::new(Observed::new(clock, config.max_ack_delay));
        Ok(Self {
            server: End::server(clock, config.seed, datagram_bytes, controller, watch.clone())?,
            client: End::client(clock, config.seed, datagram_bytes)?,
            watch,
            forward: Wire::new(forward),
            reverse: Wire::new(reverse),
            now: Nanos::ZERO,
        })
    }

    /// Goes on until both ends may send; when that is.
    fn connect(&mut self, within: Nanos) -> Result<Nanos, VirtualError> {
        while self.now <= within {
            self.step()?;
            if self.server.is_connected() && self.client.is_connected() {
                return Ok(self.now);
            }
            self.now = self.next_time().max(self.now + Nanos(1));
        }
        Err(VirtualError::Handshake { within })
    }

    fn go_on_until(&mut self, end: Nanos) -> Result<(), VirtualError> {
        loop {
            let next = self.next_time().max(self.now + Nanos(1));
            if next > end {
                return Ok(());
            }
            self.now = next;
            self.step()?;
        }
    }

    fn next_time(&mut self) -> Nanos {
        let wakes = self.forward.next_wake().min(self.reverse.next_wake());
        wakes.min(self.server.next_time()).min(self.client.next_time())
    }

    fn step(&mut self) -> Result<(), VirtualError> {
        let now = self.now;
        carry(&mut self.forward, None, &mut self.client, now)?;
        carry(&mut self.reverse, None, &mut self.server, now)?;
        self.server.on_time(now);
        self.client.on_time(now);
        while self.client.transmit(now).is_some() {
            carry(&mut self.reverse, Some(self.client.sent()), &mut self.server, now)?;
        }
        while self.server.transmit(now).is_some() {
            carry(&mut self.forward, Some(self.server.sent()), &mut self.client, now)?;
        }
        Ok(())
    }
}

/// Puts `payload` on `wire`, if any, and hands `end` what arrives.
fn carry(wire: &mut Wire, mut payload: Option<&[u8]>, end: &mut End, now: Nanos) -> Result<(), VirtualError> {
    if payload.is_none() && wire.next_wake() > now {
        return Ok(());
    }
    while let Some(bytes) = wire.step(payload.take(), now) {
        end.receive(bytes, now)?;
    }
    Ok(())
}

/// One run: both ends and the path between them.
struct Walk<'a> {
    config: &'a SessionConfig,
    controller: &'static str,
    forward: Wire,
    reverse: Wire,
    sending: Sending<'a>,
    receiving: Receiving<'a>,
    digest: u64,
    sample_at: Nanos,
}

/// Directions in the digest.
const DOWN: u64 = 0;
const UP: u64 = 2;

impl Walk<'_> {
    /// Everything that happens at `now`; whether the run is over.
    fn step(&mut self, now: Nanos) -> Result<bool, VirtualError> {
        carry(&mut self.forward, None, &mut self.receiving.end, now)?;
        carry(&mut self.reverse, None, &mut self.sending.end, now)?;
        self.receiving.take(now);
        self.sending.end.on_time(now);
        self.receiving.end.on_time(now);
        self.sending.learn(now);
        self.receiving.start_if_ready(now);
        if self.config.sample_interval > Nanos::ZERO && now >= self.sample_at {
            let row = self.sending.row(now);
            self.receiving.viewer.sample(row);
            self.sample_at = now + self.config.sample_interval;
        }
        self.receiving.viewer.show_due(now);
        if self.receiving.viewer.playout().is_over() {
            return Ok(true);
        }
        while let Some(payload) = self.sending.poll(now) {
            note(&mut self.digest, payload.len(), DOWN, now);
            carry(&mut self.forward, Some(payload), &mut self.receiving.end, now)?;
        }
        while let Some(payload) = self.receiving.poll(now) {
            note(&mut self.digest, payload.len(), UP, now);
            carry(&mut self.reverse, Some(payload), &mut self.sending.end, now)?;
        }
        Ok(false)
    }

    fn next_time(&mut self) -> Nanos {
        let sample = if self.config.sample_interval > Nanos::ZERO { self.sample_at } else { Nanos::MAX };
        let wakes = self.forward.next_wake().min(self.reverse.next_wake());
        wakes.min(self.sending.next_time()).min(self.receiving.next_time()).min(sample)
    }

    fn report(mut self, now: Nanos) -> Report {
        let chains = [self.forward.chain(), self.reverse.chain()];
        let counts = self.sending.counts();
        let mut report = self.receiving.viewer.report(&self.sending.media, chains, now);
        self.controller.clone_into(&mut report.controller);
        report.seed = self.config.seed;
        report.sender = counts.plus(report.sender);
        report.digest = self.digest;
        report
    }
}

/// Enters a datagram that was sent into the digest: time, length, direction.
fn note(digest: &mut u64, bytes: usize, direction: u64, now: Nanos) {
    for word in [now.0, (bytes as u64) << 2 | direction] {
        *digest = (*digest ^ word).wrapping_mul(0x0100_0000_01b3);
    }
}
