//! Runs the model and real QUIC on one link, and compares what came through and how late frames were.

use anyhow::Result;
use dgs_quic::virtual_time;
use emulator_host::{
    ControllerKind, Endpoint, GraphReceiver, Nanos, PacketGraph, PacketIndex, PolicyKind, Rate, Report,
    SessionConfig, Snapshot,
    graph::{Synthetic, Utilities},
    link::PathConfig,
    receiver::Arrival,
    session::{Startup, StartupRule},
};

/// Frames of a clip: ten seconds.
const FRAMES: u32 = 300;
/// When playout starts.
const START: Nanos = Nanos::from_ms(500);

/// How much there is to send.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// Twice what the link carries, all of it at once.
    Bulk,
    /// Six tenths of what the link carries, frame by frame, each half a second before it is shown.
    Limited,
}

impl Load {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Bulk, Self::Limited];

    /// In keys of figures.
    pub fn name(self) -> &'static str {
        match self {
            Self::Bulk => "bulk",
            Self::Limited => "limited",
        }
    }

    /// What is sent over a link of `rate` on average.
    ///
    /// # Errors
    /// A rate that makes no clip.
    pub fn graph(self, rate: Rate) -> Result<PacketGraph> {
        let spec = Synthetic {
            frames: FRAMES,
            window_frames: 1,
            clusters: 2,
            canonical_percent: 0,
            utilities: Utilities::Flat,
            rate: match self {
                Self::Bulk => rate.scaled(2, 1),
                Self::Limited => rate.scaled(6, 10),
            },
            ..Synthetic::default()
        };
        Ok(spec.build(1)?)
    }

    /// The session over `forward`. The model's transport has seen a handshake, as the real one has.
    pub fn session(self, controller: ControllerKind, forward: PathConfig, seed: u64) -> SessionConfig {
        let base = SessionConfig::default();
        SessionConfig {
            seed,
            controller,
            policy: PolicyKind::Layered,
            handshake_rtt: Some(forward.delay + base.reverse.delay),
            forward,
            lookahead: match self {
                Self::Bulk => Nanos::from_s(3600),
                Self::Limited => Nanos::from_ms(500),
            },
            startup: Startup { rule: StartupRule::AfterWait, max_wait: START },
            sample_interval: Nanos::ZERO,
            ..base
        }
    }
}

/// A receiver that notes when each packet arrived first, and how many arrived in all.
pub struct ArrivalLog<'a> {
    inner: GraphReceiver<'a>,
    /// By packet.
    pub arrived: Vec<Option<Nanos>>,
    /// Arrivals, repeats included.
    pub arrivals: u64,
}

impl<'a> ArrivalLog<'a> {
    /// Nothing has arrived; up to `buffer_limit` packets are kept before the manifest is there.
    pub fn new(graph: &'a PacketGraph, buffer_limit: usize) -> Self {
        let inner = GraphReceiver::new(graph, buffer_limit);
        Self { inner, arrived: vec![None; graph.packets().len()], arrivals: 0 }
    }
}

impl Endpoint for ArrivalLog<'_> {
    fn control(&mut self, bytes: usize, complete: bool, recovered: &mut Vec<PacketIndex>) {
        self.inner.control(bytes, complete, recovered);
    }

    fn media(&mut self, packet: PacketIndex, now: Nanos, recovered: &mut Vec<PacketIndex>) -> Arrival {
        self.arrived[packet.at()].get_or_insert(now);
        self.arrivals += 1;
        self.inner.media(packet, now, recovered)
    }

    fn snapshot(&mut self, frame: u32) -> &Snapshot {
        self.inner.snapshot(frame)
    }
}

/// One run, as it is compared.
#[derive(Debug)]
pub struct Seen {
    /// Media bits that arrived, per second.
    pub goodput: f64,
    /// As [`frame_latency_ms`].
    pub late_ms: f64,
}

/// One link under both transports.
#[derive(Debug)]
pub struct Pair {
    /// The model.
    pub model: Seen,
    /// Real QUIC.
    pub quic: Seen,
}

impl Pair {
    /// Runs both.
    ///
    /// # Errors
    /// A configuration that one of them refuses.
    pub fn run(graph: &PacketGraph, config: &SessionConfig) -> Result<Self> {
        let model = see(graph, config, |scheduler, endpoint| {
            Ok(emulator_host::run(graph, config, scheduler, endpoint)?)
        })?;
        let quic = see(graph, config, |scheduler, endpoint| {
            Ok(virtual_time::run(graph, config, scheduler, endpoint)?)
        })?;
        Ok(Self { model, quic })
    }
}

fn see(
    graph: &PacketGraph,
    config: &SessionConfig,
    run: impl FnOnce(&mut dyn emulator_host::Scheduler, &mut dyn Endpoint) -> Result<Report>,
) -> Result<Seen> {
    let mut endpoint = ArrivalLog::new(graph, config.buffer_limit);
    let report = run(&mut *config.policy.build(graph), &mut endpoint)?;
    let late_ms = frame_latency_ms(graph, (config.startup.max_wait, config.lookahead), &endpoint.arrived);
    Ok(Seen { goodput: report.goodput_bps, late_ms })
}

/// 95th percentile, over the frames from which on packets are needed, parity aside, of the time from when a
/// frame may be sent, `lookahead` before it is shown, until the last of it that arrives at all is there;
/// one whose base never comes counts as arriving when it is shown. Frame 0 is shown at `start`.
/// Milliseconds.
pub fn frame_latency_ms(
    graph: &PacketGraph,
    (start, lookahead): (Nanos, Nanos),
    arrived: &[Option<Nanos>],
) -> f64 {
    let mut last = vec![None::<(Nanos, bool)>; graph.frames() as usize];
    for (at, arrival) in (0u32..).zip(arrived) {
        let packet = PacketIndex(at);
        if graph.packets()[packet.at()].parity_of.is_some() {
            continue;
        }
        let Some(last) = last.get_mut(graph.needed_from(packet) as usize) else { continue };
        let (latest, lacks_base) = last.get_or_insert_default();
        match arrival {
            Some(arrival) => *latest = (*latest).max(*arrival),
            None => *lacks_base |= graph.level(packet) == 0,
        }
    }
    let mut late: Vec<f64> = (0u64..)
        .zip(last)
        .filter_map(|(frame, last)| Some((frame, last?)))
        .map(|(frame, (latest, lacks_base))| {
            let shown = start + graph.frame_interval().times(frame);
            let there = if lacks_base { shown } else { latest };
            (there - (shown - lookahead)).as_ms()
        })
        .collect();
    late.sort_by(f64::total_cmp);
    percentile(&late, 0.95)
}

/// The value below which `share` of the ascending `values` lie; zero of none.
pub fn percentile(values: &[f64], share: f64) -> f64 {
    let place = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(place).copied().unwrap_or(0.0)
}
