//! Objective study: what each way of training does to the complete state and to the worst tenth of partial
//! ones.

use anyhow::Result;
use trainer_host::train::delivery::{DeliveryOptions, Evaluation, LossModel, Masks, Variant, Weights};

use super::delivery::{BURST, Size, Study, mean_and_deviation};
use crate::{
    figures::{Bench, Figure},
    setup::Setup,
};

/// Share of packets lost in either test.
const LOSS: f64 = 0.05;
/// Tail fractions of the sensitivity study; the first is the paper's.
const FRACTIONS: [f64; 3] = [0.05, 0.10, 0.20];

/// What one training came to.
struct Tested {
    iid: Evaluation,
    burst: Evaluation,
}

impl Tested {
    /// Clean, and the worst tenth after either loss, dB.
    fn conditions(&self) -> [f64; 3] {
        [self.iid.clean_db, self.iid.worst_tenth_db(), self.burst.worst_tenth_db()]
    }
}

const CONDITIONS: [&str; 3] = ["clean", "iid5_worst10", "burst5_worst10"];

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let study = Study::make(Size::of(setup))?;
    let iid = study.masks(LossModel::Iid { probability: LOSS })?;
    let burst = study.masks(LossModel::Burst { share: LOSS, length: BURST })?;
    let mut bench = Bench::new(
        "objective",
        format!(
            "{}; mean over {} seeds, error: their standard deviation; {} states per loss, the same for all \
            (FNV-1a: IID 5 % \
             {:016x}, bursts of {BURST} packets and as much {:016x}); weights are the paper's, the last \
             update is taken; \
             *-views: as many complete pictures per update as others have worlds",
            study.size.words(),
            study.size.seeds,
            study.size.states,
            iid.hash(),
            burst.hash()
        ),
    );
    let given = Tested { iid: study.evaluate_given(&iid)?, burst: study.evaluate_given(&burst)? };
    push(&mut bench, "given", std::slice::from_ref(&given));
    let mut means = Vec::new();
    let mut combined = Vec::new();
    for variant in Variant::ALL {
        let tested = test(&study, &study.options(variant), [&iid, &burst])?;
        means.push(push(&mut bench, variant.name(), &tested));
        combined = tested;
    }
    // What learned steps give: the same without.
    let fixed = DeliveryOptions { learn_steps: false, ..study.options(Variant::Combined) };
    push(&mut bench, "mixed-steps-fixed", &test(&study, &fixed, [&iid, &burst])?);
    let views = study.size.worlds;
    let complete = DeliveryOptions { views, worlds: 1, ..study.options(Variant::Reconstruction) };
    push(&mut bench, "reconstruction-views", &test(&study, &complete, [&iid, &burst])?);

    let others = &means[..means.len() - 1];
    let wins =
        (0..CONDITIONS.len()).filter(|&c| others.iter().all(|other| means[means.len() - 1][c] > other[c]));
    bench.push(Figure::new(
        "mixed.wins",
        wins.count() as f64,
        "of 3 conditions, against the other three variants",
    ));
    for fraction in FRACTIONS {
        let tested = if fraction == FRACTIONS[0] {
            std::mem::take(&mut combined)
        } else {
            let weights = Weights { cvar_fraction: fraction, ..Weights::default() };
            let options = DeliveryOptions { weights, ..study.options(Variant::Combined) };
            test(&study, &options, [&iid, &burst])?
        };
        let p10 = |t: &Tested| {
            let worlds_db = [t.iid.worlds_db.as_slice(), &t.burst.worlds_db].concat();
            Evaluation { worlds_db, ..t.iid.clone() }.p10_db()
        };
        let (mean, deviation) = mean_and_deviation(&tested.iter().map(p10).collect::<Vec<_>>());
        let runs = tested.len();
        let figure = Figure::new(format!("mixed.cvar{fraction:.2}.p10"), mean, "dB");
        bench.push(figure.error(deviation, "dB, standard deviation").runs(runs));
        let violations: usize = tested.iter().map(|t| t.iid.violations).sum();
        bench.push(Figure::new(
            format!("mixed.cvar{fraction:.2}.violations"),
            violations as f64,
            "prefix steps",
        ));
    }
    memory(&study, &mut bench)?;
    Ok(bench)
}

/// `options` with each seed, tested on both kinds of states.
fn test(study: &Study, options: &DeliveryOptions, [iid, burst]: [&Masks; 2]) -> Result<Vec<Tested>> {
    let mut tested = Vec::new();
    for seed in 1..=study.size.seeds {
        let options = DeliveryOptions { seed, ..options.clone() };
        let tuned = study.train(&options)?;
        tested.push(Tested { iid: study.evaluate(&tuned, iid)?, burst: study.evaluate(&tuned, burst)? });
    }
    Ok(tested)
}

/// Adds the conditions of one variant and the bytes of its streams; gives the means of the former.
fn push(bench: &mut Bench, name: &str, tested: &[Tested]) -> [f64; 3] {
    let bytes: Vec<f64> = tested.iter().map(|t| t.iid.wire_bytes as f64).collect();
    bench.push(Figure::new(format!("{name}.bytes"), mean_and_deviation(&bytes).0, "bytes"));
    std::array::from_fn(|c| {
        let values: Vec<f64> = tested.iter().map(|t| t.conditions()[c]).collect();
        let (mean, deviation) = mean_and_deviation(&values);
        let figure = Figure::new(format!("{name}.{}", CONDITIONS[c]), mean, "dB");
        bench.push(if values.len() > 1 {
            figure.error(deviation, "dB, standard deviation").runs(values.len())
        } else {
            figure
        });
        mean
    })
}

/// Peak memory of this process while one update runs at 1 and at 96 worlds.
fn memory(study: &Study, bench: &mut Bench) -> Result<()> {
    let mut peaks = Vec::new();
    for worlds in [1, 96] {
        let options =
            DeliveryOptions { worlds, updates: 2, warm_up: 0.0, ..study.options(Variant::Combined) };
        // Writing 5 resets the peak to what is in use.
        let is_reset = std::fs::write("/proc/self/clear_refs", "5").is_ok();
        study.train(&options)?;
        match super::demo::peak_bytes().filter(|_| is_reset) {
            Some(bytes) => peaks.push(bytes),
            None => {
                bench.skipped.push("peak memory: this system does not tell (/proc/self)".into());
                return Ok(());
            }
        }
    }
    let [one, many] = peaks[..] else { return Ok(()) };
    bench.push(Figure::new("W96.peak_memory", many / 1_048_576.0, "MiB").peer(
        "W = 1",
        one / 1_048_576.0,
        false,
    ));
    Ok(())
}
