//! Sends one stream over the model, over quinn-proto in virtual time and over loopback sockets, and compares
//! what viewers see.

mod replay;

use anyhow::{Result, ensure};
use dgs::{args::ProfileName, pipeline};
use dgs_quic::{
    CongestionControl,
    socket::{ClientConfig, Impairment, ServedStream, play},
    virtual_time,
};
use emulator_host::{
    Bytes, ControllerKind, Nanos, PacketGraph, Rate, Report, SessionConfig,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
};
use tokio::{runtime::Runtime, task::LocalSet};
use trainer_host::{Stream, encode::Protection, stream::PacketMap};

use self::replay::{Recorder, Seen};
use super::{
    quic_model::pairing::{ArrivalLog, frame_latency_ms},
    serve::serving::Serving,
};
use crate::{
    figures::{Bench, Figure, mean},
    setup::{Setup, codec_args, synth},
};

const GAUSSIANS: usize = 16_000;
/// Frames of the clip: eight seconds.
const FRAMES: usize = 240;
/// One way, towards the viewer: what viewers send is not impaired over sockets, and so nowhere.
const DELAY: Nanos = Nanos::from_ms(40);
/// What a server says in a handshake is padded to a whole datagram (RFC 9000, 14.1), whose transmission is
/// part of the round trip that it measures.
const HANDSHAKE: Bytes = Bytes(1228);

/// A link before viewers.
struct Condition {
    /// In keys of figures.
    name: &'static str,
    rate: Rate,
    loss: LossModel,
}

fn conditions() -> [Condition; 4] {
    let clean = |name, kbps| Condition { name, rate: Rate::from_kbps(kbps), loss: LossModel::None };
    let loss = LossModel::in_bursts(0.05, 4.0);
    [
        clean("60kbit", 60),
        clean("120kbit", 120),
        clean("1mbit", 1000),
        Condition { loss, ..clean("1mbit_loss5", 1000) },
    ]
}

impl Condition {
    fn path(&self) -> PathConfig {
        PathConfig {
            capacity: Capacity::Constant(self.rate),
            queue: QueueLimit::lasting(Nanos::from_ms(250), self.rate),
            loss: self.loss,
            delay: DELAY,
            ..PathConfig::unimpaired()
        }
    }

    fn session(&self, seed: u64) -> SessionConfig {
        SessionConfig {
            seed,
            controller: ControllerKind::NewReno,
            forward: self.path(),
            reverse: PathConfig::unimpaired(),
            handshake_rtt: Some(DELAY + self.rate.time_for(HANDSHAKE)),
            sample_interval: Nanos::ZERO,
            ..SessionConfig::default()
        }
    }
}

/// How it is measured.
fn protocol(setup: &Setup) -> String {
    format!(
        "synth figure of {GAUSSIANS} Gaussians, {FRAMES} frames, groups count alike, deadline-utility over \
         NewReno, links towards the viewer of 60, 120 and 1000 kbit/s with 40 ms and 250 ms of queue, one \
         also with 5 % loss in bursts of four; model, quinn-proto in virtual time, and a server and its \
         viewers over loopback in real time, means over {} seeds, each with losses of its own, the same for \
         all three but that the handshake over sockets uses up some; time counts from the hello on, after \
         the handshake; lost: sendings of media that did not arrive; latency: the 95th percentile over \
         frames of the time from when a frame may be sent, 4 s before it is shown, until the last of it that \
         arrives is there; differences are from the model. The model and the sockets begin with the round \
         trip of a whole datagram, as a handshake measures it; quinn-proto in virtual time has shaken hands \
         over the bare delays",
        seeds(setup)
    )
}

fn seeds(setup: &Setup) -> u64 {
    if setup.quick { 4 } else { 12 }
}

/// Value of a run, name, unit.
type Column = (fn(&Seen) -> f64, &'static str, &'static str);

const COLUMNS: [Column; 6] = [
    (|seen| seen.startup_ms, "startup", "ms"),
    (|seen| 100.0 * seen.base_miss, "base_miss", "%"),
    (|seen| 100.0 * seen.lost, "lost", "%"),
    (|seen| seen.goodput_bps * 1e-3, "goodput", "kbit/s"),
    (|seen| seen.latency_ms, "latency_p95", "ms"),
    (|seen| seen.utility, "utility", ""),
];

/// Runs the bench.
///
/// # Errors
/// A session that a transport refuses, or a viewer over sockets who saw no frame.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new("agreement", protocol(setup));
    let scene = synth("figure", GAUSSIANS, FRAMES)?;
    let options = pipeline::encode_options(&codec_args(ProfileName::Dgs1), Protection::STANDARD);
    let stream = pipeline::encode(&scene, &options, setup.quiet)?.stream;
    let map = PacketMap::of(&stream)?;
    let graph = pipeline::graph(&stream, &map, None)?;
    let conditions = conditions();
    let sockets = over_sockets(&stream, &graph, &conditions, seeds(setup))?;
    for (condition, sockets) in conditions.iter().zip(&sockets) {
        let (mut model, mut quic) = (Vec::new(), Vec::new());
        for seed in 1..=seeds(setup) {
            let config = condition.session(seed);
            model.push(simulated(&graph, &config, |scheduler, endpoint| {
                Ok(emulator_host::run(&graph, &config, scheduler, endpoint)?)
            })?);
            quic.push(simulated(&graph, &config, |scheduler, endpoint| {
                Ok(virtual_time::run(&graph, &config, scheduler, endpoint)?)
            })?);
        }
        for (transport, runs) in [("quic", &quic), ("sockets", sockets)] {
            enter(&mut bench, condition.name, transport, &model, runs);
        }
    }
    Ok(bench)
}

fn enter(bench: &mut Bench, key: &str, transport: &str, model: &[Seen], runs: &[Seen]) {
    for (of, column, unit) in COLUMNS {
        let mean = |seen: &[Seen]| mean(&seen.iter().map(of).collect::<Vec<_>>());
        let (model, value) = (mean(model), mean(runs));
        let mut figure = Figure::new(format!("{key}.{column}.{transport}"), value, unit);
        (figure.peer, figure.peer_value) = (Some("the model".to_owned()), Some(model));
        bench.push(figure.error(value - model, "from it").runs(runs.len()));
    }
}

/// A run in virtual time.
fn simulated(
    graph: &PacketGraph,
    config: &SessionConfig,
    run: impl FnOnce(&mut dyn emulator_host::Scheduler, &mut dyn emulator_host::Endpoint) -> Result<Report>,
) -> Result<Seen> {
    let mut endpoint = ArrivalLog::new(graph, config.buffer_limit);
    let report = run(&mut *config.policy.build(graph), &mut endpoint)?;
    let start = Nanos((report.startup_ms.unwrap_or(0.0) * 1e6) as u64);
    let latency = frame_latency_ms(graph, (start, config.lookahead), &endpoint.arrived);
    let sent = report.sender.media + report.sender.retransmitted + report.sender.parity;
    Ok(Seen::new(&report, sent, endpoint.arrivals, latency))
}

/// All links at once, and all viewers of each: what they saw, by link.
fn over_sockets(
    stream: &Stream,
    graph: &PacketGraph,
    conditions: &[Condition],
    seeds: u64,
) -> Result<Vec<Vec<Seen>>> {
    let runtime = Runtime::new()?;
    let servings: Vec<Serving> = conditions
        .iter()
        .map(|condition| {
            let offer = ServedStream::new("figure", stream, graph.clone())?;
            let impairment = Some(Impairment { path: condition.path(), seed: 1 });
            Serving::start(&runtime, offer, |config| {
                (config.congestion, config.impairment) = (CongestionControl::NewReno, impairment);
            })
        })
        .collect::<Result<_>>()?;
    let viewing = servings.iter().flat_map(|serving| (0..seeds).map(|_| watch(serving.client.clone())));
    // Players are not sent between threads once they play; one thread carries them all.
    let local = LocalSet::new();
    let viewing: Vec<_> = viewing.map(|viewer| local.spawn_local(viewer)).collect();
    let recorded = runtime.block_on(local.run_until(async {
        let mut recorded = Vec::new();
        for viewer in viewing {
            recorded.push(viewer.await??);
        }
        anyhow::Ok(recorded)
    }))?;
    let mut seen = Vec::new();
    for (serving, recorded) in servings.into_iter().zip(recorded.chunks(seeds as usize)) {
        let (_, served) = serving.stop(&runtime)?;
        ensure!(served.len() == recorded.len(), "{} viewers were served of {}", served.len(), recorded.len());
        // Viewers do not know who they were to the server: what was sent is a mean over them.
        let sent = served.iter().map(|viewer| viewer.packets).sum::<u64>() / served.len() as u64;
        seen.push(recorded.iter().map(|viewer| viewer.seen(graph, sent)).collect::<Result<_>>()?);
    }
    Ok(seen)
}

/// Plays and records.
async fn watch(config: ClientConfig) -> Result<Recorder> {
    let mut recorder = Recorder::new();
    let report = play(&config, &mut recorder, std::future::pending()).await.whole()?;
    recorder.end(&report)?;
    Ok(recorder)
}
