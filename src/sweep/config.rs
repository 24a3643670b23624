//! Reads the configuration of a sweep, and says of what cannot be used: file, key, found, allowed.

use std::path::Path;

use anyhow::{Context, Result, bail};
use emulator_host::{
    ControllerKind, Nanos, PolicyKind, Rate, Trace,
    graph::{ClosureRule, Dependencies, Synthetic},
    link::LossModel,
    sweep::{Condition, Design, Summary, SweptTrace},
    trace::Step,
};
use serde::Deserialize;

use super::Digests;
use crate::pipeline;

/// Bytes of the largest configuration.
const MAX_BYTES: u64 = 1 << 20;
/// Most simulations of a design: its summary takes two gigabytes then.
const MAX_SIMULATIONS: u64 = 10_000_000;

/// A configuration as it is written.
#[derive(Clone, Debug)]
pub(crate) struct Config {
    /// Its text.
    pub(crate) text: String,
    /// Its size.
    pub(crate) outline: Outline,
    /// Digests of the trace files that it names.
    pub(crate) digests: Digests,
    /// What it asks for.
    pub(crate) design: Design,
    /// Scheduler that the others are compared with.
    pub(crate) baseline: PolicyKind,
    /// What whoever uses its traces should know.
    pub(crate) warnings: Vec<String>,
}

/// Size of a design, which its configuration says without the trace files.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Outline {
    /// Blocks, each a condition over a window of a trace.
    pub(crate) blocks: u64,
    /// Controllers times schedulers.
    pub(crate) simulations_per_block: u64,
    /// Scheduler that the others are compared with.
    pub(crate) baseline: PolicyKind,
    /// Whether it names trace files.
    pub(crate) has_files: bool,
}

impl Outline {
    /// Reads the configuration `text`.
    ///
    /// # Errors
    /// The place or the key, what was found and what is allowed.
    pub(crate) fn parse(text: &str) -> Result<Self> {
        Self::of(&toml::from_str(text)?)
    }

    fn of(document: &Document) -> Result<Self> {
        let replicates = within("replicates", document.replicates, 1, 1_000_000)?;
        let product = |sizes: &[usize]| sizes.iter().fold(1u64, |all, size| all.saturating_mul(*size as u64));
        let blocks = product(&[document.conditions.len(), document.traces.len(), replicates as usize]);
        let simulations_per_block = product(&[document.controllers.len(), document.schedulers.len()]);
        let simulations = blocks.saturating_mul(simulations_per_block);
        within("the number of simulations", simulations, 1, MAX_SIMULATIONS)?;
        let baseline = scheduler("baseline", &document.baseline)?;
        let has_files = document.traces.iter().any(|table| table.files().next().is_some());
        Ok(Self { blocks, simulations_per_block, baseline, has_files })
    }
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    controllers: Vec<String>,
    schedulers: Vec<String>,
    baseline: String,
    replicates: u32,
    seed: u64,
    clip: ClipTable,
    link: LinkTable,
    conditions: Vec<ConditionTable>,
    traces: Vec<TraceTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ClipTable {
    frames: u32,
    frames_per_second: u32,
    mbps: f64,
    clusters: u32,
    levels: u8,
    slices: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct LinkTable {
    load: Option<f64>,
    delay_ms: u64,
    queue_ms: u64,
    uplink_mbps: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ConditionTable {
    name: String,
    dependencies: String,
    repair: u32,
    loss_percent: f64,
    burst: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TraceTable {
    name: String,
    family: String,
    file: Option<String>,
    delay_file: Option<String>,
    constant_mbps: Option<f64>,
    bursty: Option<u64>,
    delay_ms: Option<u64>,
    light: Option<String>,
}

impl TraceTable {
    /// The files that it names.
    fn files(&self) -> impl Iterator<Item = &String> {
        self.file.iter().chain(&self.delay_file)
    }
}

impl Config {
    /// Reads the configuration `path`; files of traces lie in `traces`.
    ///
    /// # Errors
    /// The file, the key, what was found and what is allowed.
    pub(crate) fn read(path: &Path, traces: &Path) -> Result<Self> {
        let named = || path.display().to_string();
        let size = std::fs::metadata(path).with_context(named)?.len();
        if size > MAX_BYTES {
            bail!("{}: {size} bytes, allowed are {MAX_BYTES}", named());
        }
        let text = std::fs::read_to_string(path).with_context(named)?;
        Self::parse(text, traces).with_context(named)
    }

    fn parse(text: String, traces: &Path) -> Result<Self> {
        let document: Document = toml::from_str(&text)?;
        let mut warnings = Vec::new();
        let design = design(&document, traces, &mut warnings)?;
        let outline = Outline::of(&document)?;
        let baseline = outline.baseline;
        let mut digests = Digests::default();
        for name in document.traces.iter().flat_map(TraceTable::files) {
            digests.enter(name, &traces.join(name))?;
        }
        if !design.schedulers.contains(&baseline) {
            bail!("baseline is {:?}, allowed is one of schedulers", document.baseline);
        }
        Ok(Self { text, outline, digests, design, baseline, warnings })
    }
}

fn design(document: &Document, folder: &Path, warnings: &mut Vec<String>) -> Result<Design> {
    let names = |key: &str, names: &[String]| -> Result<()> {
        let repeated = names.iter().enumerate().find(|(at, name)| names[..*at].contains(name));
        match repeated {
            _ if names.is_empty() => bail!("{key} is empty, allowed is at least one"),
            Some((at, name)) => bail!("{key}[{at}] is {name:?} again, allowed is each once"),
            None => Ok(()),
        }
    };
    names("controllers", &document.controllers)?;
    names("schedulers", &document.schedulers)?;
    let condition_names: Vec<String> = document.conditions.iter().map(|table| table.name.clone()).collect();
    names("conditions.name", &condition_names)?;
    if let Some(at) = condition_names.iter().position(|name| name == Summary::EVERY_CONDITION) {
        let name = Summary::EVERY_CONDITION;
        bail!("conditions[{at}].name is {name:?}, which is the row over all; allowed is another");
    }
    let trace_names: Vec<String> = document.traces.iter().map(|table| table.name.clone()).collect();
    names("traces.name", &trace_names)?;
    let replicates = within("replicates", document.replicates, 1, 1_000_000)?;
    let clip = clip(&document.clip)?;
    let each = |key: &'static str| move |(at, name): (usize, &String)| (format!("{key}[{at}]"), name.clone());
    let controllers = document.controllers.iter().enumerate().map(each("controllers"));
    let schedulers = document.schedulers.iter().enumerate().map(each("schedulers"));
    let link = &document.link;
    let delay_ms = within("link.delay_ms", link.delay_ms, 0, 60_000)?;
    let swept = |(at, table)| trace(at, table, folder, Nanos::from_ms(delay_ms), warnings);
    let design = Design {
        controllers: controllers.map(|(key, name)| controller(&key, &name)).collect::<Result<_>>()?,
        schedulers: schedulers.map(|(key, name)| scheduler(&key, &name)).collect::<Result<_>>()?,
        conditions: document.conditions.iter().enumerate().map(condition).collect::<Result<_>>()?,
        traces: document.traces.iter().enumerate().map(swept).collect::<Result<_>>()?,
        replicates,
        seed: document.seed,
        clip,
        load: link.load.map(|load| within("link.load", load, 0.01, 100.0)).transpose()?,
        queue: Nanos::from_ms(within("link.queue_ms", link.queue_ms, 0, 60_000)?),
        uplink: mbps("link.uplink_mbps", link.uplink_mbps)?,
    };
    Ok(design)
}

/// `found`, if it is allowed.
fn within<N: PartialOrd + std::fmt::Display>(key: &str, found: N, least: N, most: N) -> Result<N> {
    // Not the other way round: NaN is in no range.
    if found >= least && found <= most {
        return Ok(found);
    }
    bail!("{key} is {found}, allowed {least} to {most}")
}

fn mbps(key: &str, found: f64) -> Result<Rate> {
    Ok(Rate((within(key, found, 0.001, 10_000.0)? * 1e6).round() as u64))
}

fn clip(table: &ClipTable) -> Result<Synthetic> {
    let per_second = within("clip.frames_per_second", table.frames_per_second, 1, 1000)?;
    Ok(Synthetic {
        frames: within("clip.frames", table.frames, 1, 1_000_000)?,
        frame_interval: Nanos(1_000_000_000 / u64::from(per_second)),
        window_frames: per_second,
        clusters: within("clip.clusters", table.clusters, 1, 10_000)?,
        levels: within("clip.levels", table.levels, 1, 4)?,
        rate: mbps("clip.mbps", table.mbps)?,
        profile: if table.slices { ClosureRule::Sliced } else { ClosureRule::AllOrNothing },
        ..Synthetic::default()
    })
}

fn controller(key: &str, name: &str) -> Result<ControllerKind> {
    let names = ControllerKind::ALL.map(ControllerKind::name).join(", ");
    let found = ControllerKind::ALL.into_iter().find(|kind| kind.name() == name);
    found.with_context(|| format!("{key} is {name:?}, allowed {names}"))
}

fn scheduler(key: &str, name: &str) -> Result<PolicyKind> {
    let names = PolicyKind::ALL.map(PolicyKind::name).join(", ");
    let found = PolicyKind::ALL.into_iter().find(|kind| kind.name() == name);
    found.with_context(|| format!("{key} is {name:?}, allowed {names}"))
}

fn condition((at, table): (usize, &ConditionTable)) -> Result<Condition> {
    let key = |field: &str| format!("conditions[{at}].{field}");
    let dependencies = match table.dependencies.as_str() {
        "layered" => Dependencies::Layered,
        "independent" => Dependencies::Independent,
        other => bail!("{} is {other:?}, allowed layered, independent", key("dependencies")),
    };
    let share = within(&key("loss_percent"), table.loss_percent, 0.0, 50.0)? / 100.0;
    let burst = within(&key("burst"), table.burst, 1.0, 1000.0)?;
    // Half of all datagrams at most, so that no burst is too short.
    let loss = LossModel::in_bursts(share, burst);
    let repair = within(&key("repair"), table.repair, 0, 64)?;
    Ok(Condition { name: table.name.clone(), dependencies, repair: (repair > 0).then_some(repair), loss })
}

fn trace(
    at: usize,
    table: &TraceTable,
    folder: &Path,
    delay: Nanos,
    warnings: &mut Vec<String>,
) -> Result<SweptTrace> {
    let key = |field: &str| format!("traces[{at}].{field}");
    let minute = Nanos::from_s(60);
    let mut replay = match (&table.file, table.constant_mbps, table.bursty) {
        (Some(file), None, None) => {
            let recording = pipeline::read_recording(&folder.join(file)).with_context(|| key("file"))?;
            warnings
                .extend(recording.notes.iter().map(|note| format!("trace {}: {file}: {note}", table.name)));
            recording.replay
        }
        (None, Some(rate), None) => {
            let step = Step { at: Nanos::ZERO, rate: mbps(&key("constant_mbps"), rate)? };
            Trace::steps("constant", vec![step], minute).with_context(|| key("constant_mbps"))?.into()
        }
        (None, None, Some(seed)) => Trace::bursty(seed, minute).into(),
        _ => bail!("traces[{at}] ({:?}) needs one of file, constant_mbps, bursty", table.name),
    };
    if let Some(file) = &table.delay_file {
        if replay.delay.is_some() {
            bail!("traces[{at}] ({:?}) has delays; no delay_file is allowed beside them", table.name);
        }
        let delays = pipeline::read_delays(&folder.join(file)).with_context(|| key("delay_file"))?;
        warnings.extend(delays.unit_warning().map(|doubt| format!("trace {}: {file}: {doubt}", table.name)));
        replay.delay = Some(delays);
    }
    let capacity = &replay.capacity;
    let delay = match table.delay_ms {
        Some(ms) => Nanos::from_ms(within(&key("delay_ms"), ms, 0, 60_000)?),
        None if replay.delay.is_some() => Nanos::ZERO,
        None => capacity.base_rtt().map_or(delay, |round_trip| Nanos(round_trip.0 / 2)),
    };
    let light = table.light.as_ref().map(|text| {
        let allowed = pipeline::LIGHT_LOADS;
        pipeline::light_load(text).with_context(|| format!("{} is {text:?}, allowed {allowed}", key("light")))
    });
    let (name, family) = (table.name.clone(), table.family.clone());
    Ok(SweptTrace { name, family, replay, delay, light: light.transpose()? })
}

#[cfg(test)]
mod tests {
    use emulator_host::{Bytes, link::LightLoad};

    use super::*;

    const QUICK: &str = include_str!("../../tests/sweeps/quick.toml");

    fn parsed(text: &str) -> Result<Config> {
        Config::parse(text.to_owned(), Path::new("."))
    }

    #[test]
    fn the_quick_design_is_read() {
        let config = parsed(QUICK).unwrap();
        assert_eq!(config.baseline, PolicyKind::Layered);
        assert_eq!(config.design.replicates, 3);
        assert!(config.warnings.is_empty());
    }

    #[test]
    fn bursts_after_a_pause_are_read_as_impairments_have_them() {
        let text = QUICK.replacen("bursty = 1", "bursty = 1\nlight = \"40mbit/15kB/100ms\"", 1);
        let traces = parsed(&text).unwrap().design.traces;
        let light = LightLoad { rate: Rate::from_mbps(40), burst: Bytes(15_000), pause: Nanos::from_ms(100) };
        assert_eq!(traces.iter().map(|trace| trace.light).collect::<Vec<_>>(), [None, Some(light)]);
    }

    #[test]
    fn what_cannot_be_used_is_named_with_key_found_and_allowed() {
        for (from, to, words) in [
            ("\"layered\",", "\"lifo\",", "schedulers[0] is \"lifo\", allowed dash, deadline-utility"),
            ("\"newreno\"", "\"reno\"", "controllers[0] is \"reno\", allowed newreno, cubic"),
            ("\"newreno\"", "\"bbr-model\"", "controllers[1] is \"bbr-model\" again, allowed is each once"),
            (
                "name = \"layered\"",
                "name = \"all\"",
                "conditions[0].name is \"all\", which is the row over all",
            ),
            ("replicates = 3", "replicates = 0", "replicates is 0, allowed 1 to 1000000"),
            ("replicates = 3", "repeats = 3", "unknown field `repeats`"),
            ("replicates = 3", "replicates = -3", "expected u32"),
            ("replicates = 3", "", "missing field `replicates`"),
            ("frames = 60", "frames = 0", "clip.frames is 0, allowed 1 to 1000000"),
            ("load = 1.2", "load = nan", "link.load is NaN, allowed 0.01 to 100"),
            ("loss_percent = 2.0", "loss_percent = 60.0", "loss_percent is 60, allowed 0 to 50"),
            ("dependencies = \"layered\"", "dependencies = \"some\"", "allowed layered, independent"),
            ("constant_mbps = 5.0", "bursty = 1\nconstant_mbps = 5.0", "needs one of file, constant_mbps"),
            ("constant_mbps = 5.0", "file = \"none.csv\"", "none.csv"),
            (
                "constant_mbps = 5.0",
                "constant_mbps = 5.0\nlight = \"40mbit\"",
                "traces[0].light is \"40mbit\", allowed the rate of the first bytes after a pause",
            ),
            ("baseline = \"layered\"", "baseline = \"cubic\"", "baseline is \"cubic\", allowed dash"),
            ("baseline = \"layered\"", "baseline = \"dependency\"", "allowed is one of schedulers"),
        ] {
            assert!(QUICK.contains(from), "{from}");
            let error = format!("{:#}", parsed(&QUICK.replacen(from, to, 1)).unwrap_err());
            assert!(error.contains(words), "{to}: {error}");
        }
    }
}
