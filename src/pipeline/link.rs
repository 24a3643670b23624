//! Builds the link of the command line: a capacity trace, scaled to the stream, with its delay, loss and
//! queue.

use anyhow::{Context, Result, bail, ensure};
use dgs_quic::socket::Impairment;
use emulator_host::{
    Bytes, ControllerKind, Nanos, PacketGraph, Rate, SessionConfig, Trace,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    trace::{self, Replay},
};

use super::{
    impair::{Impaired, impairment},
    recording::{Recording, read_delays, read_recording},
};
use crate::{
    args::{ControllerName, LinkArgs, TransportName},
    figures::number,
};

/// From receiver to sender.
const UPLINK: Rate = Rate::from_mbps(2);
/// Mean number of datagrams lost in a row.
const BURST: f64 = 4.0;
/// Share of datagrams that the built-in link loses in bursts.
const BUILT_IN_LOSS: f64 = 0.02;

/// A link ready to use, and what to say about it.
#[derive(Clone, Debug)]
pub struct Link {
    /// The session without its scheduler.
    pub config: SessionConfig,
    /// Name, mean rate, delay, queue, loss, for people.
    pub description: String,
    /// Warnings of the trace loader.
    pub warnings: Vec<String>,
}

impl Link {
    /// Capacity over time, where it follows a trace.
    pub fn trace(&self) -> Option<&Trace> {
        match &self.config.forward.capacity {
            Capacity::Trace(trace) => Some(trace),
            _ => None,
        }
    }

    /// Mean rate from the start until `time`, with all that bursts could have; `None` without a limit.
    pub fn mean_until(&self, time: Nanos) -> Option<Rate> {
        let path = &self.config.forward;
        let is_limited = !matches!(path.capacity, Capacity::Unlimited);
        is_limited.then(|| Rate::over(path.bytes_until(time), time))
    }
}

/// The link as typed, for a stream of `graph`'s size.
///
/// # Errors
/// An unreadable trace, or numbers out of range.
pub fn link(args: &LinkArgs, graph: &PacketGraph) -> Result<Link> {
    typed_link(args)?.before(graph)
}

/// The link as typed, before it is known what goes over it: its traces are read.
pub(crate) struct TypedLink<'a> {
    args: &'a LinkArgs,
    replay: Replay,
    /// What whoever uses its traces should know.
    notes: Vec<String>,
}

/// Reads the link as typed: asked before the work that makes the stream for it.
///
/// # Errors
/// An unreadable trace, a scale out of range, or a controller that the transport has not.
pub(crate) fn typed_link(args: &LinkArgs) -> Result<TypedLink<'_>> {
    check_controller(args)?;
    let (replay, notes) = recorded(args)?;
    if let Some(scale) = args.scale {
        scaled_as_typed(args, &replay.capacity, scale)?;
    }
    Ok(TypedLink { args, replay, notes })
}

impl TypedLink<'_> {
    /// The link before a stream of `graph`'s size.
    ///
    /// # Errors
    /// A load that the built-in trace cannot be scaled to.
    pub(crate) fn before(self, graph: &PacketGraph) -> Result<Link> {
        let Self { args, replay, notes } = self;
        let scale = match args.scale {
            Some(scale) => scale,
            None if args.trace.is_none() => {
                scale_for(&replay.capacity, graph, args.load.unwrap_or(LinkArgs::LOAD))?
            }
            None => 1.0,
        };
        scaled_link(args, replay, scale, notes)
    }
}

/// The link as typed, with `scale` times the capacity of what was recorded.
fn scaled_link(args: &LinkArgs, replay: Replay, scale: f64, mut warnings: Vec<String>) -> Result<Link> {
    let Replay { capacity: trace, delay: delay_trace, loss: loss_trace } = replay;
    warnings.extend(args.unused());
    let trace = scaled_as_typed(args, &trace, scale)?;
    let delay = args
        .delay_ms
        .map(Nanos::from_ms)
        .or_else(|| delay_trace.as_ref().map(|_| Nanos::ZERO))
        .or_else(|| trace.base_rtt().map(|rtt| Nanos(rtt.0 / 2)))
        .unwrap_or(Nanos::from_ms(30));
    // Over a recording the recording shows, and not what NewReno makes of losses that nobody recorded.
    let burst_loss = args.burst_loss.unwrap_or(if args.trace.is_some() { 0.0 } else { BUILT_IN_LOSS });
    let name = match scale {
        1.0 => trace.name().to_owned(),
        scale => format!("{} × {}", trace.name(), number(scale)),
    };
    let forward = PathConfig {
        queue: QueueLimit::lasting(Nanos::from_ms(args.queue_ms), trace.mean_rate()),
        capacity: Capacity::Trace(trace),
        loss: LossModel::in_bursts(burst_loss, BURST),
        loss_trace,
        delay,
        delay_trace,
        ..PathConfig::default()
    };
    let loss = format!("bursts of loss {} %", percent(burst_loss));
    let description = description(&name, &forward, &loss, args.transport);
    Ok(Link { config: session(args, args.link_seed, forward), description, warnings })
}

/// The link that `text` describes in the words of `--impair`, with the controller and transport of `args`.
///
/// # Errors
/// As [`impairment`].
pub(crate) fn impaired_link(text: &str, args: &LinkArgs) -> Result<Link> {
    let Impaired { impairment: Impairment { path, seed }, notes } = impairment(text)?;
    let mut name = match &path.capacity {
        Capacity::Unlimited => "a link without a limit of rate".to_owned(),
        Capacity::Constant(_) => "a constant rate".to_owned(),
        Capacity::Trace(trace) => trace.name().to_owned(),
    };
    if let Some(light) = path.light {
        let (kilobytes, rate) = (number(light.burst.0 as f64 / 1e3), rate_words(light.rate));
        name += &format!(", {kilobytes} kB at {rate} after {} ms", number(light.pause.as_ms()));
    }
    let loss = match path.loss {
        LossModel::None => "no loss".to_owned(),
        LossModel::Iid(share) => format!("loss {} %", percent(share)),
        LossModel::GilbertElliott { enter_bad, leave_bad, .. } => {
            let share = enter_bad / (enter_bad + leave_bad);
            format!("loss {} % in bursts of {:.1}", percent(share), 1.0 / leave_bad)
        }
    };
    let description = description(&name, &path, &loss, args.transport);
    Ok(Link { config: session(args, seed, path), description, warnings: notes })
}

/// What is recorded of the link as typed, or the built-in trace, from its offset on; and notes on it.
fn recorded(args: &LinkArgs) -> Result<(Replay, Vec<String>)> {
    let Recording { mut replay, mut notes } = match &args.trace {
        Some(path) => {
            let Recording { replay, notes } = read_recording(path)?;
            let named = notes.iter().map(|note| format!("{}: {note}", path.display())).collect();
            Recording { replay, notes: named }
        }
        None => {
            Recording { replay: Trace::bursty(args.link_seed, Nanos::from_s(60)).into(), notes: Vec::new() }
        }
    };
    if let Some(path) = &args.delay_trace {
        if let (Some(_), Some(trace)) = (&replay.delay, &args.trace) {
            bail!("{} has delays, and so has {}; one of them is needed", trace.display(), path.display());
        }
        let delays = read_delays(path)?;
        notes.extend(delays.unit_warning().map(|unit_warning| format!("{}: {unit_warning}", path.display())));
        replay.delay = Some(delays);
    }
    let replay = match args.trace_offset {
        0.0 => replay,
        offset => replay.starting_at(Nanos((offset * 1e9) as u64))?,
    };
    Ok((replay, notes))
}

/// The factor on `trace` by which the manifest and the packets of `graph` are `load` times what it carries
/// while the clip plays.
fn scale_for(trace: &Trace, graph: &PacketGraph, load: f64) -> Result<f64> {
    let wanted = (graph.total_bytes() + u64::from(graph.manifest_bytes())) as f64 / load;
    let mut scale = 1.0;
    for round in 0..20 {
        let Bytes(passed) = playout_capacity(&scaled(trace, scale).context("--load")?, graph);
        let ratio = wanted / (passed.max(1) as f64);
        // On a faster link playout starts earlier, over another part of the trace: steps that go too far and
        // back again are halved.
        scale *= if round < 4 { ratio } else { ratio.sqrt() };
    }
    Ok(scale)
}

/// What a link that follows `trace` carries while the clip of `graph` plays, which starts once the manifest
/// and the base of its first frame have passed, or after the wait of a session.
fn playout_capacity(trace: &Trace, graph: &PacketGraph) -> Bytes {
    let opening = Bytes(graph.first_base_bytes(0) + u64::from(graph.manifest_bytes()));
    let (mut early, mut late) = (Nanos::ZERO, SessionConfig::default().startup.max_wait);
    while late - early > Nanos::from_ms(1) {
        let middle = Nanos((early.0 + late.0) / 2);
        match trace.bytes_until(middle) < opening {
            true => early = middle,
            false => late = middle,
        }
    }
    let clip = graph.frame_interval().times(u64::from(graph.frames()));
    trace.bytes_until(late + clip) - trace.bytes_until(late)
}

/// `trace` with `factor` times the capacity.
///
/// # Errors
/// A mean rate that is too high, or no capacity left: what it would be, and what is allowed.
fn scaled(trace: &Trace, factor: f64) -> Result<Trace> {
    const PARTS: u64 = 1_000_000_000;
    if factor == 1.0 {
        return Ok(trace.clone());
    }
    let mean = trace.mean_rate().0.max(1) as f64;
    let (wanted, most) = (mean * factor, trace::MAX_RATE.0 as f64);
    let least_factor = (1.0 / mean).max(1.0 / PARTS as f64);
    let refusal = || {
        format!(
            "the mean rate would be {wanted:.3e} bit/s, allowed are 1 to {most:.0e} bit/s, factors of about \
             {least_factor:.1e} to {:.1e}",
            most / mean
        )
    };
    ensure!(wanted <= most, refusal());
    trace.scaled((factor * PARTS as f64).round() as u64, PARTS).with_context(refusal)
}

/// As [`scaled`], with the scale and the name of the trace in the error.
fn scaled_as_typed(args: &LinkArgs, trace: &Trace, scale: f64) -> Result<Trace> {
    scaled(trace, scale).with_context(|| {
        let file = args.trace.as_ref().map(|path| path.display().to_string());
        format!("--scale {scale:?}: {}", file.as_deref().unwrap_or(trace.name()))
    })
}

/// Refuses a controller of the model alone over another transport.
fn check_controller(args: &LinkArgs) -> Result<()> {
    let is_of_quinn = match args.controller {
        ControllerName::Newreno | ControllerName::Cubic | ControllerName::Scream => true,
        ControllerName::BbrModel | ControllerName::BbrPaper => false,
    };
    ensure!(
        is_of_quinn || args.transport == TransportName::Model,
        "--transport quic: controller is {}; over quinn-proto it must be newreno, cubic or scream",
        controller(args.controller).name()
    );
    Ok(())
}

/// A session over `forward`.
fn session(args: &LinkArgs, seed: u64, forward: PathConfig) -> SessionConfig {
    let reverse = PathConfig {
        capacity: Capacity::Constant(UPLINK),
        delay: forward.delay,
        delay_trace: forward.delay_trace.clone(),
        ..PathConfig::default()
    };
    let controller = controller(args.controller);
    SessionConfig { seed, controller, forward, reverse, ..SessionConfig::default() }
}

/// Name, mean rate, delay, queue and loss of a path, for people.
fn description(name: &str, path: &PathConfig, loss: &str, transport: TransportName) -> String {
    let mean = match &path.capacity {
        Capacity::Unlimited => None,
        Capacity::Constant(rate) => Some(*rate),
        Capacity::Trace(trace) => Some(trace.mean_rate()),
    };
    let rate = mean.map_or(String::new(), |mean| format!(", mean {}", rate_words(mean)));
    let queue = mean.map_or(String::new(), |mean| format!(", {}", queue_words(path.queue, mean)));
    let delays = path.delay_trace.as_ref().map_or(String::new(), |delays| {
        format!(" and those of a trace, median {:.0} ms", delays.median().as_ms())
    });
    let jitter = match path.jitter {
        Nanos::ZERO => String::new(),
        jitter => format!(" and up to {} ms of jitter", number(jitter.as_ms())),
    };
    let losses = if path.loss_trace.is_some() { " and those of the trace" } else { "" };
    let carrier = match transport {
        TransportName::Model => "",
        TransportName::Quic => ", over quinn-proto",
    };
    let delay = path.delay.as_ms();
    format!("{name}{rate}, {delay:.0} ms one way{delays}{jitter}{queue}, {loss}{losses}{carrier}")
}

/// A share in percent.
fn percent(share: f64) -> String {
    match 100.0 * share {
        small if small > 0.0 && small < 0.1 => number(small),
        percent => format!("{percent:.1}"),
    }
}

/// A rate in the largest unit of which it is one at least.
pub(crate) fn rate_words(rate: Rate) -> String {
    match rate.0 {
        bits if bits >= 1_000_000 => format!("{:.2} Mbit/s", bits as f64 / 1e6),
        bits if bits >= 1_000 => format!("{:.2} kbit/s", bits as f64 / 1e3),
        bits => format!("{bits} bit/s"),
    }
}

/// A queue as time at `rate`, and its bytes.
fn queue_words(queue: QueueLimit, rate: Rate) -> String {
    let kilobytes = (queue.bytes as f64 / 1e3).round();
    if rate == Rate(0) {
        return format!("queue {kilobytes} kB");
    }
    let ms = rate.time_for(Bytes(queue.bytes)).as_ms();
    let is_least = queue.bytes == QueueLimit::lasting(Nanos::ZERO, rate).bytes;
    format!("queue {ms:.0} ms ({kilobytes} kB{})", if is_least { ", the least" } else { "" })
}

/// Mean capacity of the first `bins` bins of `width`, bits/s, the trace repeating.
pub fn capacity_bins(trace: &Trace, width: Nanos, bins: usize) -> Vec<f64> {
    let mut out = vec![0.0; bins];
    let period = trace.period().0.max(1);
    match trace.shape() {
        trace::Shape::Opportunities(at) => {
            let span = width.0 * bins as u64;
            let mut start = 0u64;
            while start < span {
                for t in at.iter().map(|t| t.0 + start).take_while(|&t| t < span) {
                    out[(t / width.0) as usize] += 1500.0 * 8.0 / width.as_s();
                }
                start += period;
            }
        }
        trace::Shape::Steps(steps) => {
            for (i, out) in out.iter_mut().enumerate() {
                // Samples inside the bin are enough: steps are far longer than bins.
                let samples = 4;
                for s in 0..samples {
                    let t = (i as u64 * width.0 + width.0 * s / samples) % period;
                    let at = steps.partition_point(|step| step.at.0 <= t).max(1) - 1;
                    *out += steps[at].rate.0 as f64 / samples as f64;
                }
            }
        }
    }
    out
}

/// The controller of a name.
fn controller(name: ControllerName) -> ControllerKind {
    match name {
        ControllerName::Newreno => ControllerKind::NewReno,
        ControllerName::Cubic => ControllerKind::Cubic,
        ControllerName::BbrModel => ControllerKind::BbrModel,
        ControllerName::Scream => ControllerKind::Scream,
        ControllerName::BbrPaper => ControllerKind::BbrPaper,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn typed(args: &[&str]) -> LinkArgs {
        #[derive(clap::Parser)]
        struct Typed {
            #[command(flatten)]
            link: LinkArgs,
        }
        <Typed as clap::Parser>::parse_from([&["dgs"], args].concat()).link
    }

    fn graph(frames: u32) -> PacketGraph {
        let spec = emulator_host::graph::Synthetic { frames, ..emulator_host::graph::Synthetic::default() };
        spec.build(1).unwrap()
    }

    #[test]
    fn a_queue_is_as_long_in_time_on_a_slow_link_as_on_a_fast_one() {
        for kbps in [125, 1_000, 20_000] {
            let rate = Rate::from_kbps(kbps);
            let queue = queue_words(QueueLimit::lasting(Nanos::from_ms(250), rate), rate);
            assert!(
                queue.starts_with("queue 250 ms (") && !queue.contains("least"),
                "{kbps} kbit/s: {queue}"
            );
        }
        let slow = Rate::from_kbps(42);
        let queue = queue_words(QueueLimit::lasting(Nanos::from_ms(250), Rate(0)), Rate(0));
        assert_eq!(queue, "queue 3 kB");
        let queue = queue_words(QueueLimit::lasting(Nanos::from_ms(250), slow), slow);
        assert_eq!(queue, "queue 571 ms (3 kB, the least)");
    }

    #[test]
    fn small_rates_have_digits() {
        let said = [5_000_000, 123_456, 4_210, 70].map(|bits| rate_words(Rate(bits)));
        assert_eq!(said, ["5.00 Mbit/s", "123.46 kbit/s", "4.21 kbit/s", "70 bit/s"]);
    }

    #[test]
    fn a_scaled_trace_has_its_round_trip_and_no_opportunity_less() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, text).unwrap();
            path.to_str().unwrap().to_owned()
        };
        let steady = file("steady", "1\n");
        let halved = link(&typed(&["--trace", &steady, "--scale", "0.5"]), &graph(30)).unwrap();
        assert_eq!(halved.trace().unwrap().mean_rate(), Rate::from_mbps(6));
        assert_eq!(halved.config.forward.loss, LossModel::None);
        let built_in = link(&typed(&[]), &graph(30)).unwrap();
        assert_eq!(built_in.config.forward.loss, LossModel::in_bursts(BUILT_IN_LOSS, BURST));
        let rows = "Timestamp,DL_bitrate,UL_bitrate,State,PINGAVG\n2020.02.14_09.38.00,10,1,I,80\n\
                    2020.02.14_09.38.01,900,1,I,-\n";
        let logged = file("phone.csv", rows);
        let doubled = link(&typed(&["--trace", &logged, "--scale", "2"]), &graph(30)).unwrap();
        assert_eq!(doubled.config.forward.delay, Nanos::from_ms(40));
        assert!(doubled.warnings.iter().any(|warning| warning.contains("idle")), "{:?}", doubled.warnings);
        let error = link(&typed(&["--trace", &steady, "--scale", "1e30"]), &graph(30)).unwrap_err();
        assert!(format!("{error:#}").contains("the mean rate would be 1.200e37 bit/s"), "{error:#}");
        assert!(format!("{error:#}").starts_with(&format!("--scale 1e30: {steady}: the mean")), "{error:#}");
        let error = link(&typed(&["--trace", &steady, "--scale", "1e-9"]), &graph(30)).unwrap_err();
        let said = format!("{error:#}");
        assert!(
            said.starts_with(&format!("--scale 1e-9: {steady}: the mean rate would be 1.200e-2")),
            "{said}"
        );
        let allowed = "allowed are 1 to 1e12 bit/s, factors of about 8.3e-8 to 8.3e4";
        assert!(said.contains(allowed) && said.ends_with("no capacity"), "{said}");
        link(&typed(&["--trace", &steady, "--scale", "8.4e-8"]), &graph(30)).unwrap();
        let error = link(&typed(&["--scale", "1e-9"]), &graph(30)).unwrap_err();
        assert!(format!("{error:#}").starts_with("--scale 1e-9: bursty"), "{error:#}");
        let backward = link(&typed(&["--trace", &file("pitree-1", "0 1\n1 2\n")]), &graph(30)).unwrap();
        assert!(backward.warnings[0].contains("pitree"), "{:?}", backward.warnings);
    }

    /// Before anything is known of a stream.
    #[test]
    fn what_no_stream_can_be_sent_over_is_refused_as_it_is_typed() {
        for (args, says) in [
            (&["--trace", "nofile"][..], "nofile"),
            (&["--delay-trace", "nofile"], "nofile"),
            (&["--scale", "1e9"], "--scale 1000000000.0: bursty"),
            (&["--transport", "quic", "--controller", "bbr-model"], "quic: controller is bbr-model"),
        ] {
            let error = typed_link(&typed(args)).err().map(|error| format!("{error:#}"));
            assert!(error.as_ref().is_some_and(|error| error.contains(says)), "{args:?}: {error:?}");
        }
        typed_link(&typed(&["--transport", "quic", "--controller", "scream"])).unwrap();
    }

    #[test]
    fn a_load_is_of_what_the_link_carries_while_the_clip_plays() {
        for (frames, load, seed) in [(30, "1.2", "2"), (30, "2.5", "3"), (90, "0.5", "4"), (1000, "3", "5")] {
            let graph = graph(frames);
            let link = link(&typed(&["--load", load, "--link-seed", seed]), &graph).unwrap();
            let trace = link.trace().unwrap();
            let mut config = link.config.clone();
            (config.forward.loss, config.forward.delay, config.reverse.delay) =
                (LossModel::None, Nanos::ZERO, Nanos::ZERO);
            let report = emulator_host::simulate(&graph, &config).unwrap();
            let start = Nanos((report.startup_ms.unwrap() * 1e6) as u64);
            let clip = graph.frame_interval().times(u64::from(graph.frames()));
            let passed = (trace.bytes_until(start + clip) - trace.bytes_until(start)).0 as f64;
            let bytes = (graph.total_bytes() + u64::from(graph.manifest_bytes())) as f64;
            let found = bytes / passed / load.parse::<f64>().unwrap();
            assert!((found - 1.0).abs() < 0.01, "{frames} frames, seed {seed}: {found}");
        }
    }

    #[test]
    fn options_that_change_nothing_are_named() {
        let warned = |args: &[&str]| link(&typed(args), &graph(30)).unwrap().warnings.join("; ");
        assert!(warned(&["--scale", "2", "--load", "2"]).contains("--load is not used beside --scale"));
        assert_eq!(warned(&["--load", "2"]), "");
    }
}
