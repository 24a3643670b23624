//! Runs every combination of controllers, schedulers, conditions, traces and replicates of a design.
//!
//! A *block* is one condition over one window of one trace. All controllers and schedulers of a block get the
//! same packets, the same window and the same random numbers, so that they are compared in pairs. A replicate
//! is another window of the trace and other random numbers. Blocks are numbered; what a block gives follows
//! from the design and its number alone, so blocks may run in any order, on any number of threads and in any
//! number of processes.

mod summary;

use serde::{Deserialize, Serialize};

use crate::{
    clock::{Nanos, Rate},
    congestion::ControllerKind,
    graph::{Dependencies, GraphError, PacketGraph, Synthetic},
    link::{Capacity, LightLoad, LossModel, PathConfig, QueueLimit},
    policy::PolicyKind,
    report::{FrameRow, Report},
    rng::stream,
    session::{SessionConfig, SessionError, simulate},
    trace::{Replay, TraceError},
};

pub use summary::{Comparison, Estimate, Outcomes, Summary};

/// One way in which links and packets differ between blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// Name in results.
    pub name: String,
    /// Whether levels stand on each other.
    pub dependencies: Dependencies,
    /// Parity for every so many base packets.
    pub repair: Option<u32>,
    /// Loss on the way to the receiver.
    pub loss: LossModel,
}

/// A trace of a design.
#[derive(Clone, Debug)]
pub struct SweptTrace {
    /// Name in results.
    pub name: String,
    /// Traces of one family resemble each other.
    pub family: String,
    /// Capacity, with delays and losses where they were recorded.
    pub replay: Replay,
    /// One-way delay, beside those of the recording.
    pub delay: Nanos,
    /// What it does for bursts after a pause, as cellular links do.
    pub light: Option<LightLoad>,
}

/// What is run.
#[derive(Clone, Debug)]
pub struct Design {
    /// Congestion controllers.
    pub controllers: Vec<ControllerKind>,
    /// Schedulers.
    pub schedulers: Vec<PolicyKind>,
    /// Conditions.
    pub conditions: Vec<Condition>,
    /// Traces.
    pub traces: Vec<SweptTrace>,
    /// Windows of each trace, their starts spread over it.
    pub replicates: u32,
    /// Everything random follows from it.
    pub seed: u64,
    /// The clip; a condition decides its dependencies and its repair.
    pub clip: Synthetic,
    /// Traces are scaled so that the bytes of the clip are so many times what they carry while it lasts;
    /// `None`: they keep their own capacity.
    pub load: Option<f64>,
    /// Queue, as time at a trace's mean rate.
    pub queue: Nanos,
    /// Rate from receiver to sender.
    pub uplink: Rate,
}

/// Why a design cannot be run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SweepError {
    /// The clip cannot be made.
    #[error("clip: {0}")]
    Clip(#[from] GraphError),
    /// A trace cannot be scaled or cut.
    #[error("trace {name}: {error}")]
    Trace {
        /// Which.
        name: String,
        /// What is wrong.
        error: TraceError,
    },
    /// A session refuses its configuration.
    #[error("condition {name}: {error}")]
    Session {
        /// Which condition.
        name: String,
        /// What is wrong.
        error: SessionError,
    },
}

/// What one simulation gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Number in the design.
    pub simulation: u64,
    /// Name of the trace.
    pub trace: String,
    /// Its family.
    pub family: String,
    /// Name of the condition.
    pub condition: String,
    /// Number of the window.
    pub replicate: u32,
    /// Name of the controller.
    pub controller: String,
    /// Name of the scheduler.
    pub scheduler: String,
    /// When playout started; if it never did, how long the run was.
    pub startup_ms: f64,
    /// Whether it started because what it waits for was there.
    pub startup_reached: bool,
    /// Share of the groups that were not usable when they were to be shown.
    pub miss: f64,
    /// The same among groups of positive utility.
    pub positive_miss: f64,
    /// The same as `miss` among level 0.
    pub base_miss: f64,
    /// Usable utility over positive utility.
    pub utility: f64,
    /// Media bits per second that arrived.
    pub goodput_bps: f64,
    /// Media bits per second that showed.
    pub usable_goodput_bps: f64,
    /// Bytes that arrived and showed nothing.
    pub waste_bytes: u64,
    /// Datagrams declared lost.
    pub lost: u64,
    /// Digest of the run, hexadecimal.
    pub digest: String,
}

/// A design that is ready to run.
#[derive(Clone, Debug)]
pub struct Sweep {
    design: Design,
    /// One per condition.
    graphs: Vec<PacketGraph>,
    /// Each trace at the design's load.
    replays: Vec<Replay>,
}

impl Sweep {
    /// Makes the clips and scales the traces of `design`.
    ///
    /// # Errors
    /// [`SweepError`] names what cannot be used.
    pub fn new(design: Design) -> Result<Self, SweepError> {
        let graph = |condition: &Condition| {
            let (dependencies, repair) = (condition.dependencies, condition.repair);
            Synthetic { dependencies, repair, ..design.clip }.build(design.seed)
        };
        let graphs: Vec<PacketGraph> = design.conditions.iter().map(graph).collect::<Result<_, _>>()?;
        let wanted = design.load.map(|load| (design.clip.rate.0 as f64 / load) as u64);
        let replay = |swept: &SweptTrace| {
            let recorded = &swept.replay;
            let capacity = match wanted {
                None => recorded.capacity.clone(),
                Some(wanted) => recorded.capacity.scaled(wanted, recorded.capacity.mean_rate().0)?,
            };
            Ok(Replay { capacity, ..recorded.clone() })
        };
        let named = |swept: &SweptTrace| {
            replay(swept).map_err(|error| SweepError::Trace { name: swept.name.clone(), error })
        };
        let replays = design.traces.iter().map(named).collect::<Result<_, _>>()?;
        Ok(Self { design, graphs, replays })
    }

    /// What is run.
    pub fn design(&self) -> &Design {
        &self.design
    }

    /// Blocks of the design.
    pub fn blocks(&self) -> u64 {
        let pairs = self.design.traces.len() as u64 * self.design.conditions.len() as u64;
        pairs * u64::from(self.design.replicates)
    }

    /// Simulations of one block.
    pub fn simulations_per_block(&self) -> u64 {
        self.design.controllers.len() as u64 * self.design.schedulers.len() as u64
    }

    /// Frames of one simulation.
    pub fn frames(&self) -> u32 {
        self.design.clip.frames
    }

    /// Runs `block`, which is below [`Self::blocks`]: what each simulation gave, and what it showed frame by
    /// frame, in the order of controllers, then schedulers.
    ///
    /// # Errors
    /// [`SweepError`] names the trace or the condition.
    pub fn run_block(&self, block: u64) -> Result<Vec<(Trial, Vec<FrameRow>)>, SweepError> {
        let design = &self.design;
        let (rest, replicate) =
            (block / u64::from(design.replicates), (block % u64::from(design.replicates)) as u32);
        let conditions = design.conditions.len() as u64;
        let (trace, condition) = ((rest / conditions) as usize, (rest % conditions) as usize);
        let session = self.session(trace, condition, replicate)?;
        let mut trials = Vec::new();
        for controller in &design.controllers {
            for scheduler in &design.schedulers {
                let config = SessionConfig { controller: *controller, policy: *scheduler, ..session.clone() };
                let name = || design.conditions[condition].name.clone();
                let report = simulate(&self.graphs[condition], &config)
                    .map_err(|error| SweepError::Session { name: name(), error })?;
                let trial = Trial {
                    simulation: block * self.simulations_per_block() + trials.len() as u64,
                    trace: design.traces[trace].name.clone(),
                    family: design.traces[trace].family.clone(),
                    condition: name(),
                    replicate,
                    ..trial(&report)
                };
                trials.push((trial, report.frames));
            }
        }
        Ok(trials)
    }

    fn session(&self, trace: usize, condition: usize, replicate: u32) -> Result<SessionConfig, SweepError> {
        let (design, replay) = (&self.design, &self.replays[trace]);
        let swept = &design.traces[trace];
        let offset = replay.capacity.period().0 / u64::from(design.replicates) * u64::from(replicate);
        let Replay { capacity, delay, loss } = replay
            .starting_at(Nanos(offset))
            .map_err(|error| SweepError::Trace { name: swept.name.clone(), error })?;
        let queue = QueueLimit::lasting(design.queue, capacity.mean_rate());
        let forward = PathConfig {
            capacity: Capacity::Trace(capacity),
            queue,
            loss: design.conditions[condition].loss,
            loss_trace: loss,
            delay: swept.delay,
            delay_trace: delay.clone(),
            light: swept.light,
            ..PathConfig::default()
        };
        let reverse = PathConfig {
            capacity: Capacity::Constant(design.uplink),
            delay: swept.delay,
            delay_trace: delay,
            ..PathConfig::default()
        };
        let stream_name = format!("sweep/{}/{replicate}", swept.name);
        Ok(SessionConfig {
            seed: stream(design.seed, &stream_name).bits(),
            forward,
            reverse,
            sample_interval: Nanos::ZERO,
            ..SessionConfig::default()
        })
    }
}

/// What `report` says; where in the design it stands is the caller's to enter.
fn trial(report: &Report) -> Trial {
    Trial {
        simulation: 0,
        trace: String::new(),
        family: String::new(),
        condition: String::new(),
        replicate: 0,
        controller: report.controller.clone(),
        scheduler: report.policy.clone(),
        startup_ms: report.startup_ms.unwrap_or(report.duration_ns.as_ms()),
        startup_reached: report.startup_reached,
        miss: report.miss_rate,
        positive_miss: report.positive_miss_rate,
        base_miss: report.base_miss_rate,
        utility: report.utility,
        goodput_bps: report.goodput_bps,
        usable_goodput_bps: report.usable_goodput_bps,
        waste_bytes: report.waste.total_bytes(),
        lost: report.sender.lost,
        digest: format!("{:016x}", report.digest),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{clock::Bytes, trace::Trace};

    fn design() -> Design {
        let swept = |seed: u64| SweptTrace {
            name: format!("bursty {seed}"),
            family: "made".into(),
            replay: Trace::bursty(seed, Nanos::from_s(20)).into(),
            delay: Nanos::from_ms(20),
            light: None,
        };
        let condition = |name: &str, dependencies, repair| Condition {
            name: name.into(),
            dependencies,
            repair,
            loss: LossModel::Iid(0.01),
        };
        Design {
            controllers: vec![ControllerKind::NewReno, ControllerKind::BbrModel],
            schedulers: vec![PolicyKind::Layered, PolicyKind::DeadlineUtility],
            conditions: vec![
                condition("layered", Dependencies::Layered, None),
                condition("independent, repair", Dependencies::Independent, Some(4)),
            ],
            traces: vec![swept(1), swept(2)],
            replicates: 3,
            seed: 7,
            clip: Synthetic { frames: 45, rate: Rate::from_mbps(2), ..Synthetic::default() },
            load: Some(1.2),
            queue: Nanos::from_ms(250),
            uplink: Rate::from_mbps(2),
        }
    }

    #[test]
    fn blocks_number_all_combinations_once_and_their_simulations_share_the_window() {
        let sweep = Sweep::new(design()).unwrap();
        assert_eq!((sweep.blocks(), sweep.simulations_per_block()), (12, 4));
        let mut seen = std::collections::BTreeSet::new();
        let mut left_out = 0;
        for block in 0..sweep.blocks() {
            let trials = sweep.run_block(block).unwrap();
            for (at, (trial, frames)) in trials.iter().enumerate() {
                assert_eq!(trial.simulation, block * 4 + at as u64);
                assert_eq!(frames.len(), 45);
                let first = &trials[0].0;
                assert_eq!((&trial.trace, &trial.condition), (&first.trace, &first.condition));
                let place = (trial.trace.clone(), trial.condition.clone(), trial.replicate);
                assert!(seen.insert((place, trial.controller.clone(), trial.scheduler.clone())));
                assert!((0.0..=1.0).contains(&trial.positive_miss), "{trial:?}");
                left_out += usize::from(trial.positive_miss < trial.miss);
            }
        }
        assert_eq!(seen.len(), 48);
        assert!(left_out > 0, "some groups of the clip harm, and are left out");
    }

    #[test]
    fn a_block_gives_the_same_whatever_ran_before_it_and_replicates_differ() {
        let (one, other) = (Sweep::new(design()).unwrap(), Sweep::new(design()).unwrap());
        one.run_block(0).unwrap();
        assert_eq!(one.run_block(5).unwrap(), other.run_block(5).unwrap());
        let digest = |block| other.run_block(block).unwrap()[0].0.digest.clone();
        assert_ne!(digest(0), digest(1), "another window, other random numbers");
        assert_ne!(digest(0), digest(6), "another trace");
        let reseeded = Sweep::new(Design { seed: 8, ..design() }).unwrap();
        assert_ne!(reseeded.run_block(0).unwrap()[0].0.digest, digest(0));
    }

    #[test]
    fn playback_begins_sooner_where_the_first_burst_is_let_through() {
        let startup_ms = |design| {
            let block = Sweep::new(design).unwrap().run_block(0).unwrap();
            block.iter().map(|(trial, _)| trial.startup_ms).collect::<Vec<_>>()
        };
        let mut light = design();
        light.traces[0].light =
            Some(LightLoad { rate: Rate::from_mbps(40), burst: Bytes(60_000), pause: Nanos::from_s(1) });
        let (with, without) = (startup_ms(light), startup_ms(design()));
        assert!(with.iter().zip(&without).all(|(with, without)| with < without), "{with:?}, {without:?}");
    }
}
