//! Cuts windows out of measured and made traces, each scaled to one load.

use anyhow::{Context, Result};
use dgs::pipeline;
use emulator_host::{
    Bytes, Nanos, PacketGraph, Rate, SessionConfig, Trace,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    session::{Startup, StartupRule},
    trace::Step,
};

use crate::{figures::Bench, setup::Setup};

/// Family and file of the measured traces.
const FILES: [(&str, &str); 12] = [
    ("ucc5g", "ucc5g/driving/B_2020.01.16_07.26.43.csv"),
    ("ucc5g", "ucc5g/static/B_2019.12.16_13.40.04.csv"),
    ("mahimahi", "mahimahi_lte/ATT-LTE-driving-2016.down"),
    ("mahimahi", "mahimahi_lte/Verizon-LTE-short.down"),
    ("starlink", "starlink_leocc/bw_example.0-60s.txt"),
    ("wifi", "wireless_zhuge/office-wifi_0.pitree-trace"),
    ("wifi", "wireless_zhuge/rest-wifi_3.pitree-trace"),
    ("cellular", "wireless_zhuge/abc4g_0.pitree-trace"),
    ("hsdpa", "broadband_merina/hsdpa/norway_tram_43"),
    ("fcc", "broadband_merina/fcc/ferry.nesoddtangen-oslo-report.2010-09-20_1542CEST.log"),
    ("oboe", "broadband_merina/oboe/oboe_trace_24.txt"),
    ("puffer", "broadband_merina/puffer/traceqlR-8J7X0pokdh-1du6gTz2WWgygH2P4X-SuTVinEVA=_3"),
];
/// The same of recordings that are held out: no constant of a scheduler, a controller or a receiver was
/// chosen on them. One choice was made on four of them: to scale gains of bases to what they gain at once.
const HELD_OUT: [(&str, &str); 12] = [
    ("ucc5g", "ucc5g/driving/B_2020.02.27_20.35.57.csv"),
    ("ucc5g", "ucc5g/static/B_2020.02.14_13.21.26.csv"),
    ("mahimahi", "mahimahi_lte/TMobile-LTE-short.down"),
    ("mahimahi", "mahimahi_lte/Verizon-LTE-short.up"),
    ("wifi", "wireless_zhuge/office-wifi_7.pitree-trace"),
    ("wifi", "wireless_zhuge/rest-wifi_11.pitree-trace"),
    ("cellular", "wireless_zhuge/abc4g_12.pitree-trace"),
    ("cellular 5G", "wireless_zhuge/xu5g_2.pitree-trace"),
    ("hsdpa", "broadband_merina/hsdpa/norway_bus_4"),
    ("fcc", "broadband_merina/fcc/bus.ljansbakken-oslo-report.2010-09-29_1827CEST.log"),
    ("oboe", "broadband_merina/oboe/oboe_trace_351.txt"),
    ("puffer", "broadband_merina/puffer/trace226vcF9QZ1rH48UM0D3ItEoCuwaukap5f0D5+qx1RuA=_0"),
];
/// Stream bytes over what the link carries until the clip is over.
pub(super) const LOAD: f64 = 1.6;
/// Shortest and longest wait before playout, seconds: the longest is what players wait by default.
const WAIT_S: [f64; 2] = [1.0, 5.0];
/// A window whose bound is lower says nothing of schedulers: its link is dead.
pub(super) const MIN_BOUND: f64 = 0.05;

/// A trace and the family that it stands for.
pub(super) struct Channel {
    pub family: &'static str,
    trace: Trace,
}

/// Measured traces as far as they are here, and three made ones.
///
/// # Errors
/// A trace that cannot be read.
pub(super) fn all(setup: &Setup, bench: &mut Bench) -> Result<Vec<Channel>> {
    let mut channels = read(&FILES, setup, bench)?;
    channels.push(Channel { family: "made", trace: Trace::bursty(5, Nanos::from_s(120)) });
    channels.push(Channel { family: "made", trace: outages()? });
    channels.push(Channel { family: "constant", trace: constant()? });
    Ok(channels)
}

/// Measured traces that are held out ([`HELD_OUT`]), as far as they are here; without any, made ones.
///
/// # Errors
/// A trace that cannot be read.
pub(super) fn held_out(setup: &Setup, bench: &mut Bench) -> Result<Vec<Channel>> {
    let mut channels = read(&HELD_OUT, setup, bench)?;
    if channels.is_empty() {
        channels.push(Channel { family: "made", trace: Trace::bursty(11, Nanos::from_s(120)) });
        channels.push(Channel { family: "made", trace: Trace::bursty(12, Nanos::from_s(120)) });
    }
    Ok(channels)
}

fn read(files: &[(&'static str, &str)], setup: &Setup, bench: &mut Bench) -> Result<Vec<Channel>> {
    let mut channels = Vec::new();
    for &(family, file) in files {
        if let Some(path) = setup.data(&format!("traces/{file}"), bench)? {
            channels.push(Channel { family, trace: pipeline::read_trace(&path)? });
        }
    }
    Ok(channels)
}

/// The measured traces as far as they are here.
///
/// # Errors
/// A trace that cannot be read.
pub(in crate::experiment) fn measured(setup: &Setup, bench: &mut Bench) -> Result<Vec<Trace>> {
    Ok(read(&FILES, setup, bench)?.into_iter().map(|channel| channel.trace).collect())
}

/// Five seconds at full rate, one without any.
fn outages() -> Result<Trace> {
    let steps = (0..20u64).flat_map(|round| {
        let at = Nanos::from_s(6).times(round);
        [Step { at, rate: Rate::from_mbps(6) }, Step { at: at + Nanos::from_s(5), rate: Rate(0) }]
    });
    Ok(Trace::steps("outages", steps.collect(), Nanos::from_s(120))?)
}

fn constant() -> Result<Trace> {
    let step = Step { at: Nanos::ZERO, rate: Rate::from_mbps(5) };
    Ok(Trace::steps("constant", vec![step], Nanos::from_s(120))?)
}

/// Bytes that must be there before playout: the manifest and the base of frame 0, with a fifth to spare.
fn opening_bytes(graph: &PacketGraph) -> f64 {
    1.2 * (graph.first_base_bytes(58) + u64::from(graph.manifest_bytes())) as f64
}

fn clip(graph: &PacketGraph) -> Nanos {
    graph.frame_interval().times(u64::from(graph.frames()))
}

/// Rate at which `graph` is [`LOAD`] times what is carried until its clip is over: in the wait before
/// playout, and while it plays.
fn wanted(graph: &PacketGraph) -> Rate {
    let (fits, clip) = (graph.total_bytes() as f64 / LOAD, clip(graph).as_s());
    // A short wait has to carry more a second.
    let [highest, lowest] = WAIT_S.map(|wait| fits / (clip + wait));
    // The wait that just carries the opening leaves the rest to the clip.
    let after_the_opening = (fits - opening_bytes(graph)) / clip;
    Rate((8.0 * after_the_opening.clamp(lowest, highest)) as u64)
}

/// When playout starts, for everyone: when the mean rate has carried the opening, within the bounds of waits.
pub(super) fn start(graph: &PacketGraph) -> Nanos {
    let opening = wanted(graph).time_for(Bytes(opening_bytes(graph) as u64));
    let [shortest, longest] = WAIT_S.map(|wait| Nanos((wait * 1e9) as u64));
    opening.clamp(shortest, longest)
}

impl Channel {
    /// The link of window `window` of `windows`, on which `graph` is [`LOAD`] times what fits. `seed` differs
    /// between traces and windows and is the same for all schedulers. `None` if the window has no capacity.
    ///
    /// # Errors
    /// A window that cannot be cut.
    pub(super) fn session(
        &self,
        graph: &PacketGraph,
        (window, windows): (usize, usize),
        seed: u64,
        loss: f64,
    ) -> Result<Option<SessionConfig>> {
        let start = start(graph);
        let length = (start + clip(graph) + Nanos::from_s(1)).min(self.trace.period());
        let offset = Nanos(self.trace.period().0 / windows as u64 * window as u64);
        let cut = match self.trace.window(offset, length) {
            Err(emulator_host::trace::TraceError::NoCapacity) => return Ok(None),
            cut => cut.with_context(|| self.trace.name().to_owned())?,
        };
        let cut = cut.scaled(wanted(graph).0, cut.mean_rate().0)?;
        let queue = QueueLimit::lasting(Nanos::from_ms(500), cut.mean_rate());
        // Bursts of three datagrams on average.
        let leave_bad = 1.0 / 3.0;
        let burst = LossModel::GilbertElliott {
            enter_bad: loss * leave_bad / (1.0 - loss),
            leave_bad,
            loss_good: 0.0,
            loss_bad: 1.0,
        };
        let forward = PathConfig {
            capacity: Capacity::Trace(cut),
            queue,
            loss: if loss > 0.0 { burst } else { LossModel::None },
            ..PathConfig::default()
        };
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: start };
        let config = SessionConfig { seed, forward, startup, ..SessionConfig::default() };
        Ok(Some(SessionConfig { sample_interval: Nanos::ZERO, ..config }))
    }
}
