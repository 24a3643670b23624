//! Measures the counterfactual engine: states and utilities per second, beside the engine of the CPU.

use std::time::Instant;

use anyhow::Result;
use render_host::{
    Settings,
    counterfactual::{Engine as OnCpu, States},
    gpu::{
        Device, Executor, Recording, Scene, Stages,
        counterfactual::{Contexts, Engine, Worlds},
    },
};

use super::{
    super::{
        cloud::LATTICE,
        partial::{Partial, deliveries},
    },
    context::{Context, partials},
};
use crate::figures::{Bench, Figure, median};

struct Case {
    name: String,
    subject: Partial,
    scene: Scene,
    stages: Stages,
    engine: Engine,
    states: States,
    worlds: Worlds,
    full: Contexts,
    many: Contexts,
    /// Seconds: errors, utilities in one context, in all contexts, strict errors; errors and utilities on
    /// the CPU.
    seconds: [Vec<f64>; 6],
}

/// Measures.
pub(super) fn run(context: &Context, bench: &mut Bench) -> Result<()> {
    let (n, sides, worlds, contexts, runs): (usize, &[u32], usize, usize, usize) =
        match (context.quick, context.is_cpu) {
            (true, _) => (2000, &[48], 16, 2, 3),
            (false, true) => (20_000, &[128], 32, 2, 7),
            (false, false) => (84_000, &[400, 800], 128, 32, 7),
        };
    let executor = &context.executor;
    let mut cases = Vec::new();
    for &side in sides {
        for (name, subject) in partials(n, side, context.quick)? {
            cases.push(Case::new(executor, (name, subject), worlds, contexts)?);
        }
    }
    for run in 0..=runs {
        for case in &mut cases {
            case.measure(context)?;
            if run == 0 {
                case.seconds.iter_mut().for_each(Vec::clear);
            }
        }
    }
    for case in &cases {
        case.report(executor.device(), worlds, contexts, n, bench)?;
    }
    Ok(())
}

impl Case {
    fn new(
        executor: &Executor,
        (name, subject): (String, Partial),
        worlds: usize,
        contexts: usize,
    ) -> Result<Self> {
        let device = executor.device();
        let scene = Scene::with_groups(device, &subject.splats(), &subject.groups)?;
        let mut stages = Stages::new(device)?;
        stages.prepare(device, &scene, &subject.camera, &Settings::default())?;
        let engine = Engine::with_tiles(executor, stages.tiles()?, LATTICE.groups(), &subject.against)?;
        let states = deliveries(worlds);
        Ok(Self {
            worlds: engine.worlds(&states)?,
            full: engine.contexts(&States::full(LATTICE.groups()))?,
            many: engine.contexts(&deliveries(contexts))?,
            seconds: Default::default(),
            name,
            subject,
            scene,
            stages,
            engine,
            states,
        })
    }

    fn measure(&mut self, context: &Context) -> Result<()> {
        let executor = &context.executor;
        let device = executor.device();
        // Steps in a train without waiting.
        let train = if context.is_cpu { 1 } else { 16 };
        let Self { subject, scene, stages, engine, worlds, full, many, .. } = self;
        let mut time = |question: &dyn Fn(&mut Recording)| -> Result<f64> {
            let mut recording = Recording::new();
            stages.record(scene, &mut recording)?;
            engine.record_lists(&mut recording);
            question(&mut recording);
            let bound = executor.bind(recording)?;
            device.wait()?;
            let start = Instant::now();
            for _ in 0..train {
                stages.prepare(device, scene, &subject.camera, &Settings::default())?;
                executor.submit(&bound, None);
            }
            device.wait()?;
            Ok(start.elapsed().as_secs_f64() / train as f64)
        };
        let found = [
            time(&|recording| engine.record_fast(worlds, recording))?,
            time(&|recording| engine.record_utilities(full, recording))?,
            time(&|recording| engine.record_utilities(many, recording))?,
            time(&|recording| engine.record_strict(worlds, recording))?,
        ];
        self.seconds.iter_mut().zip(found).for_each(|(all, one)| all.push(one));
        let start = Instant::now();
        self.on_cpu()?.fast(&self.states)?;
        self.seconds[4].push(start.elapsed().as_secs_f64());
        let start = Instant::now();
        self.on_cpu()?.utilities(&States::full(LATTICE.groups()))?;
        self.seconds[5].push(start.elapsed().as_secs_f64());
        Ok(())
    }

    fn on_cpu(&self) -> Result<OnCpu> {
        let Partial { camera, against, .. } = &self.subject;
        Ok(OnCpu::new(&self.subject.variants()?, camera, against, &Settings::default())?)
    }

    fn report(
        &self,
        device: &Device,
        worlds: usize,
        contexts: usize,
        n: usize,
        bench: &mut Bench,
    ) -> Result<()> {
        let on_cpu = self.on_cpu()?;
        let relative = |got: &[f64], expected: &[f64]| {
            got.iter().zip(expected).map(|(a, b)| (a / b - 1.0).abs()).fold(0.0, f64::max)
        };
        let error = relative(&self.engine.fast(&self.states)?, &on_cpu.fast(&self.states)?);
        let strictly = relative(&self.engine.strict(&self.states)?, &on_cpu.strict(&self.states)?);
        let got = self.engine.utilities(&States::full(LATTICE.groups()))?.delta;
        let expected = on_cpu.utilities(&States::full(LATTICE.groups()))?.delta;
        let largest = expected.iter().fold(0.0f64, |m, d| m.max(d.abs()));
        let off = got.iter().zip(&expected).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / largest;
        // Lists that did not fit would have shown errors; they are named.
        self.stages.lists().read_counts(device)?;

        let name = format!("counterfactual.{n}.{}", self.name);
        let [fast, one, many, strict, fast_cpu, one_cpu] = self.seconds.each_ref().map(|s| median(s));
        let runs = self.seconds[0].len();
        let mut push = |key: String, value: f64, error: f64, unit: &str, of: &str, peer: Option<f64>| {
            let figure = Figure::new(format!("{name}.{key}"), value, unit).error(error, of).runs(runs);
            bench.push(match peer {
                Some(peer) => figure.peer("engine of the CPU", peer, false),
                None => figure,
            });
        };
        let rate = |count: usize, seconds: f64| count as f64 / seconds;
        let (states, utilities) = ("states/s", "utilities/s");
        let (of_sse, of_largest) = ("relative SSE", "of the largest utility");
        push(
            format!("fast.W{worlds}"),
            rate(worlds, fast),
            error,
            states,
            of_sse,
            Some(rate(worlds, fast_cpu)),
        );
        push(format!("strict.W{worlds}"), rate(worlds, strict), strictly, states, of_sse, None);
        let peer = Some(rate(LATTICE.groups(), one_cpu));
        push("utilities.1".into(), rate(LATTICE.groups(), one), off, utilities, of_largest, peer);
        let key = format!("utilities.{contexts}");
        push(key, rate(LATTICE.groups() * contexts, many), off, utilities, of_largest, None);
        Ok(())
    }
}
