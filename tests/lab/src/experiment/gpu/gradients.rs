//! Times forward and backward of many worlds, by squared error and with `1 - SSIM` added: world-frames per
//! second, beside the adjoint of the CPU.

use std::time::Instant;

use anyhow::Result;
use render_host::{
    Gradients, Settings, Splats, Workspace,
    adjoint::{
        SplatGradient,
        loss::{Distortion, Loss, Mix, Mse},
        render_and_gradients_into,
    },
    counterfactual::{States, brute},
    gpu::{
        Device, Executor, Recording, Scene, Stages,
        adjoint::{Engine, Objective, Worlds},
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

/// Worlds whose summed gradient is compared with the CPU's.
const JUDGED: usize = 3;

/// The losses, and what their keys add.
const MIXES: [(Mix, &str); 2] = [(Mix::MSE, ""), (Mix::weighted(1.0), ".mse+ssim")];

struct Case {
    name: String,
    /// The loss of the CPU.
    loss: Box<dyn Loss>,
    subject: Partial,
    stages: Stages,
    engine: Engine,
    /// One world, and many; how many, and seconds per step.
    batches: Vec<(Worlds, usize, Vec<f64>)>,
    /// Seconds per world on the CPU.
    cpu: Vec<f64>,
    workspace: Workspace,
    room: Gradients,
}

/// Measures.
pub(super) fn run(context: &Context, bench: &mut Bench) -> Result<()> {
    let (n, sides, worlds, runs): (usize, &[u32], usize, usize) = match (context.quick, context.is_cpu) {
        (true, _) => (2000, &[48], 8, 3),
        (false, true) => (20_000, &[128], 16, 7),
        (false, false) => (84_000, &[400, 800], 128, 7),
    };
    let executor = &context.executor;
    let mut cases = Vec::new();
    for &side in sides {
        for (name, subject) in partials(n, side, context.quick)? {
            for (mix, suffix) in MIXES {
                let name = format!("{name}{suffix}");
                cases.push(Case::new(executor, (name, subject.clone()), mix, worlds)?);
            }
        }
    }
    for run in 0..=runs {
        for case in &mut cases {
            case.measure(context)?;
            if run == 0 {
                case.batches.iter_mut().for_each(|(.., seconds)| seconds.clear());
                case.cpu.clear();
            }
        }
    }
    for case in &cases {
        let [loss, worst] = case.check(executor.device())?;
        let name = format!("gradients.{n}.{}", case.name);
        bench.push(Figure::new(format!("{name}.loss_error"), loss, "relative"));
        let peer = 1.0 / median(&case.cpu);
        for (_, worlds, seconds) in &case.batches {
            let rate = *worlds as f64 / median(seconds);
            let figure = Figure::new(format!("{name}.W{worlds:03}"), rate, "world-frames/s");
            let figure = figure.error(worst, "relative L2, worst field").runs(seconds.len());
            bench.push(figure.peer("adjoint of the CPU, one by one", peer, false));
        }
    }
    Ok(())
}

impl Case {
    fn new(executor: &Executor, (name, subject): (String, Partial), mix: Mix, worlds: usize) -> Result<Self> {
        let (device, settings) = (executor.device(), Settings::default());
        let scene = Scene::with_groups(device, &subject.splats(), &subject.groups)?;
        let mut stages = Stages::new(device)?;
        stages.prepare(device, &scene, &subject.camera, &settings)?;
        let tiles = stages.tiles()?;
        let objective = Objective { target: &subject.against, mix };
        let engine = Engine::with_tiles(executor, scene, tiles, LATTICE.groups(), &objective, &settings)?;
        let batch =
            |count: usize| -> Result<_> { Ok((engine.worlds(&deliveries(count))?, count, Vec::new())) };
        Ok(Self {
            batches: vec![batch(1)?, batch(worlds)?],
            cpu: Vec::new(),
            workspace: Workspace::new(),
            room: Gradients::default(),
            name,
            loss: if mix == Mix::MSE {
                Box::new(Mse::new(subject.against.clone()))
            } else {
                Box::new(Distortion::weighted(subject.against.clone(), mix.structure))
            },
            subject,
            stages,
            engine,
        })
    }

    fn measure(&mut self, context: &Context) -> Result<()> {
        let (executor, settings) = (&context.executor, Settings::default());
        let device = executor.device();
        let Self { subject, loss, stages, engine, batches, cpu, workspace, room, .. } = self;
        for (worlds, count, seconds) in batches {
            // Steps in a train without waiting.
            let train = if context.is_cpu { 1 } else { 4 + 60 / *count };
            let mut recording = Recording::new();
            stages.record(engine.scene(), &mut recording)?;
            engine.record(worlds, &mut recording)?;
            let bound = executor.bind(recording)?;
            device.wait()?;
            let start = Instant::now();
            for _ in 0..train {
                stages.prepare(device, engine.scene(), &subject.camera, &settings)?;
                executor.submit(&bound, None);
            }
            device.wait()?;
            seconds.push(start.elapsed().as_secs_f64() / train as f64);
        }
        let start = Instant::now();
        render_and_gradients_into(workspace, &subject.splats(), &subject.camera, &settings, &**loss, room)?;
        cpu.push(start.elapsed().as_secs_f64());
        Ok(())
    }

    /// Worst relative error of a loss, and worst relative L2 error of a field of the gradient, against the
    /// CPU's world by world.
    fn check(&self, device: &Device) -> Result<[f64; 2]> {
        let (subject, settings) = (&self.subject, Settings::default());
        let states = deliveries(JUDGED);
        let got = self.engine.gradients(&states)?;
        self.stages.lists().read_counts(device)?;
        let mut expected = vec![[0.0f64; 16]; subject.gaussians.len()];
        let mut loss_error = 0.0f64;
        for (world, &found) in got.loss.iter().enumerate() {
            let alone = alone(subject, &states, world, &settings, &*self.loss)?;
            loss_error = loss_error.max((found / alone.loss - 1.0).abs());
            let present = subject.groups.iter().enumerate().filter(|(_, g)| states.has(world, **g as usize));
            for ((i, _), gradient) in present.zip(&alone.splats) {
                let values = numbers(gradient);
                expected[i].iter_mut().zip(values).for_each(|(sum, v)| *sum += f64::from(v));
            }
        }
        // Position, log-scale, rotation, opacity, colour, image mean.
        let fields = [0..3, 3..6, 6..10, 10..11, 11..14, 14..16];
        let worst = fields.into_iter().map(|field| {
            let (mut off, mut all) = (0.0, 0.0);
            for (gradient, expected) in got.splats.iter().zip(&expected) {
                let values = numbers(gradient);
                for k in field.clone() {
                    off += (f64::from(values[k]) - expected[k]).powi(2);
                    all += expected[k].powi(2);
                }
            }
            (off / all).sqrt()
        });
        Ok([loss_error, worst.fold(0.0, f64::max)])
    }
}

fn alone(
    subject: &Partial,
    states: &States,
    world: usize,
    settings: &Settings,
    loss: &dyn Loss,
) -> Result<Gradients> {
    let (gaussians, _) = brute::world(&subject.variants()?, states, world);
    let mut out = Gradients::default();
    let splats = Splats::plain(&gaussians);
    render_and_gradients_into(&mut Workspace::new(), &splats, &subject.camera, settings, loss, &mut out)?;
    Ok(out)
}

fn numbers(g: &SplatGradient) -> [f32; 16] {
    let fields = [&g.position[..], &g.log_scale, &g.rotation, &[g.opacity_logit], &g.sh0, &g.image_mean];
    let mut out = [0.0; 16];
    out.iter_mut().zip(fields.concat()).for_each(|(out, v)| *out = v);
    out
}
