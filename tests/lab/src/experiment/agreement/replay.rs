//! Records what a viewer over sockets received, and measures it as a run in virtual time is measured.

use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use codec_core::internals::{ids::PacketId, wire::packet::Head};
use dgs_player::Player;
use dgs_quic::socket::{FrameSink, PlayReport};
use emulator_host::{
    Nanos, PacketGraph, PacketIndex, PolicyKind, Report, SessionConfig,
    session::{MediaSender, PathFacts, Startup, StartupRule, Viewer},
};

use crate::experiment::quic_model::pairing::{ArrivalLog, frame_latency_ms};

/// What one viewer saw.
#[derive(Clone, Copy, Debug)]
pub struct Seen {
    /// From the hello to the first frame.
    pub startup_ms: f64,
    /// Share of bases that were missing, mean over frames.
    pub base_miss: f64,
    /// Share of sendings of media that did not arrive.
    pub lost: f64,
    /// Media bits that arrived, per second.
    pub goodput_bps: f64,
    /// As [`frame_latency_ms`].
    pub latency_ms: f64,
    /// Mean over frames.
    pub utility: f64,
}

impl Seen {
    /// `arrivals` of `sent` packets came.
    pub fn new(report: &Report, sent: u64, arrivals: u64, latency_ms: f64) -> Self {
        Self {
            startup_ms: report.startup_ms.unwrap_or(f64::NAN),
            base_miss: report.base_miss_rate,
            lost: 1.0 - arrivals as f64 / sent.max(1) as f64,
            goodput_bps: report.goodput_bps,
            latency_ms,
            utility: report.utility,
        }
    }
}

/// What came when, and when playout began.
pub struct Recorder {
    began: Instant,
    manifest: Option<Instant>,
    media: Vec<(Instant, PacketId)>,
    /// Of the hello, which time counts from, and of the first frame.
    hello: Duration,
    start: Duration,
}

impl Recorder {
    /// The handshake begins.
    pub fn new() -> Self {
        let (hello, start) = (Duration::ZERO, Duration::ZERO);
        Self { began: Instant::now(), manifest: None, media: Vec::new(), hello, start }
    }

    /// Playing is over.
    ///
    /// # Errors
    /// That no frame was shown.
    pub fn end(&mut self, report: &PlayReport) -> Result<()> {
        let (hello, start) = report.handshake_ms.zip(report.startup_ms).context("no frame was shown")?;
        self.hello = Duration::from_secs_f64(hello * 1e-3);
        self.start = Duration::from_secs_f64(start * 1e-3);
        Ok(())
    }

    /// What was seen of `graph`, of which `sent` packets were sent.
    ///
    /// # Errors
    /// A path that is illegal; none is here.
    pub fn seen(&self, graph: &PacketGraph, sent: u64) -> Result<Seen> {
        let start = nanos(self.start - self.hello);
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: start };
        let config = SessionConfig { startup, ..SessionConfig::default() };
        let mut endpoint = ArrivalLog::new(graph, config.buffer_limit);
        let mut viewer = Viewer::new(graph, &config, &mut endpoint);
        let mut now = Nanos::ZERO;
        let mut manifest = self.manifest;
        for (at, id) in &self.media {
            if let Some(there) = manifest.take_if(|there| *there <= *at) {
                viewer.control(graph.manifest_bytes() as usize, true);
                now = self.time(there);
            }
            let at = self.time(*at);
            show_until(&mut viewer, at);
            let packet = graph.packets_in(*id, *id).next();
            packet.into_iter().for_each(|packet: PacketIndex| viewer.media(packet, at));
            now = now.max(at);
        }
        while !viewer.playout().is_over() {
            now = viewer.playout().next_time();
            show_until(&mut viewer, now + Nanos(1));
        }
        let path = PathFacts::unknown(1200);
        let scheduler = PolicyKind::Layered.build(graph);
        let sender = MediaSender::new(graph, scheduler, config.sending(), path, Nanos::ZERO);
        let [forward, reverse] = config.paths()?;
        let report = viewer.report(&sender, [&forward, &reverse], now);
        let latency = frame_latency_ms(graph, (start, config.lookahead), &endpoint.arrived);
        Ok(Seen::new(&report, sent, endpoint.arrivals, latency))
    }

    /// Since the hello.
    fn time(&self, at: Instant) -> Nanos {
        nanos(at.saturating_duration_since(self.began + self.hello))
    }
}

/// Shows what is due before `end`.
fn show_until(viewer: &mut Viewer<'_>, end: Nanos) {
    while viewer.playout().next_time() < end && !viewer.playout().is_over() {
        let due = viewer.playout().next_time();
        viewer.start_if_ready(due);
        viewer.show_due(due);
    }
}

fn nanos(span: Duration) -> Nanos {
    Nanos(u64::try_from(span.as_nanos()).unwrap_or(u64::MAX))
}

impl FrameSink for Recorder {
    fn show(&mut self, _player: &mut Player, _frame: u32) -> Result<(), String> {
        Ok(())
    }

    fn manifest(&mut self, _message: &[u8]) {
        self.manifest.get_or_insert_with(Instant::now);
    }

    fn media(&mut self, packet: &[u8]) {
        if let Ok(head) = Head::parse(packet) {
            self.media.push((Instant::now(), head.id));
        }
    }
}
