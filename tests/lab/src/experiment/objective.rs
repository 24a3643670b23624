//! Objective study: what each way of training does to the complete state and to the worst tenth of partial
//! ones.

use anyhow::Result;
use trainer_host::train::delivery::{
    ChannelRanges, DeliveryOptions, Evaluation, LossModel, Masks, Variant, Weights,
};

use super::delivery::{BURST, Size, Study, mean_and_deviation};
use crate::{
    figures::{Bench, Figure, Machine},
    setup::Setup,
};

/// Share of packets lost in either test.
const LOSS: f64 = 0.05;
/// Tail fractions of the sensitivity study; the first is the paper's.
const FRACTIONS: [f64; 3] = [0.05, 0.10, 0.20];
/// Worlds per update of the sensitivity study: of fewer, the least fraction would be a part of one world, and
/// the tail is one world at least.
const FRACTION_WORLDS: usize = 20;
/// Whole streams per second that a link of too little bandwidth carries.
const CAPACITY: f64 = 0.5;
/// Its round-trip time and display deadline, seconds.
const ROUND_TRIP_S: f64 = 0.1;
const DEADLINE_S: f64 = 1.0;

/// What one training came to.
struct Tested {
    iid: Evaluation,
    burst: Evaluation,
    /// Over links of too little bandwidth, with a deadline.
    bandwidth: Evaluation,
}

/// The states that trainings are tested in.
struct States {
    iid: Masks,
    burst: Masks,
    bandwidth: Masks,
}

impl Tested {
    /// Clean, and the worst tenth after either loss and over links of too little bandwidth, dB.
    fn conditions(&self) -> [f64; 4] {
        let worst = [&self.iid, &self.burst, &self.bandwidth].map(Evaluation::worst_tenth_db);
        [self.iid.clean_db, worst[0], worst[1], worst[2]]
    }
}

const CONDITIONS: [&str; 4] = ["clean", "iid5_worst10", "burst5_worst10", "bandwidth_worst10"];
/// The first of them, in which variants are compared: a link that brings half of a stream leaves none of them
/// a choice.
const COMPARED: usize = 3;

/// Links of which each brings about half a stream until the deadline, less what is lost by turns on its own
/// and in bursts.
fn narrow_links() -> ChannelRanges {
    ChannelRanges {
        capacity: [CAPACITY; 2],
        round_trip_s: [ROUND_TRIP_S; 2],
        deadline_s: [DEADLINE_S; 2],
        iid: [LOSS; 2],
        burst_share: [LOSS; 2],
        burst_length: [BURST; 2],
    }
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let study = Study::make(Size::of(setup))?;
    let states = States {
        iid: study.masks(LossModel::Iid { probability: LOSS })?,
        burst: study.masks(LossModel::Burst { share: LOSS, length: BURST })?,
        bandwidth: study.link_masks(&narrow_links())?,
    };
    let mut bench = Bench::new(
        "objective",
        format!(
            "{}; mean over {} seeds, error: their standard deviation; {} states per loss, the same for all \
            (FNV-1a: IID 5 % \
             {:016x}, bursts of {BURST} packets and as much {:016x}, links of {CAPACITY} streams a second, \
             {ROUND_TRIP_S} s of round trip and {DEADLINE_S} s to the display, with either loss by turns, \
             {:016x}); weights are the paper's, the last update is taken; \
             *-views: as many complete pictures per update as others have worlds; cvar*: \
             {FRACTION_WORLDS} worlds per update, of which 1, 2 and 4 are the tail",
            study.size.words(),
            study.size.seeds,
            study.size.states,
            states.iid.hash(),
            states.burst.hash(),
            states.bandwidth.hash()
        ),
    );
    // First: what other trainings leave to the allocator would count as memory of one world.
    memory(&study, &mut bench)?;
    let given = Tested {
        iid: study.evaluate_given(&states.iid)?,
        burst: study.evaluate_given(&states.burst)?,
        bandwidth: study.evaluate_given(&states.bandwidth)?,
    };
    push(&mut bench, "given", std::slice::from_ref(&given));
    let mut means = Vec::new();
    for variant in Variant::ALL {
        let tested = test(&study, &study.options(variant), &states)?;
        means.push(push(&mut bench, variant.name(), &tested));
    }
    // What learned steps give: the same without.
    let fixed = DeliveryOptions { learn_steps: false, ..study.options(Variant::Combined) };
    push(&mut bench, "mixed-steps-fixed", &test(&study, &fixed, &states)?);
    let views = study.size.worlds;
    let complete = DeliveryOptions { views, worlds: 1, ..study.options(Variant::Reconstruction) };
    push(&mut bench, "reconstruction-views", &test(&study, &complete, &states)?);

    let others = &means[..means.len() - 1];
    let wins = (0..COMPARED).filter(|&c| others.iter().all(|other| means[means.len() - 1][c] > other[c]));
    bench.push(Figure::new(
        "mixed.wins",
        wins.count() as f64,
        "of the first 3 conditions, against the other three variants",
    ));
    for fraction in FRACTIONS {
        let weights = Weights { cvar_fraction: fraction, ..Weights::default() };
        let worlds = FRACTION_WORLDS;
        let options = DeliveryOptions { weights, worlds, ..study.options(Variant::Combined) };
        let tested = test(&study, &options, &states)?;
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
    Ok(bench)
}

/// `options` with each seed, tested in all states.
fn test(study: &Study, options: &DeliveryOptions, states: &States) -> Result<Vec<Tested>> {
    let mut tested = Vec::new();
    for seed in 1..=study.size.seeds {
        let options = DeliveryOptions { seed, ..options.clone() };
        let tuned = study.train(&options)?;
        tested.push(Tested {
            iid: study.evaluate(&tuned, &states.iid)?,
            burst: study.evaluate(&tuned, &states.burst)?,
            bandwidth: study.evaluate(&tuned, &states.bandwidth)?,
        });
    }
    Ok(tested)
}

/// Adds the conditions of one variant and the bytes of its streams; gives the means of the former.
fn push(bench: &mut Bench, name: &str, tested: &[Tested]) -> [f64; 4] {
    let bytes: Vec<f64> = tested.iter().map(|t| t.iid.wire_bytes as f64).collect();
    bench.push(Figure::new(format!("{name}.bytes"), mean_and_deviation(&bytes).0, "bytes"));
    let cliffs: Vec<f64> = tested.iter().map(|t| t.bandwidth.cliffs()).collect();
    bench.push(Figure::new(format!("{name}.bandwidth_cliffs"), mean_and_deviation(&cliffs).0, "of states"));
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
        // Writing 5 resets the peak to what is resident.
        let is_reset = std::fs::write("/proc/self/clear_refs", "5").is_ok();
        study.train(&options)?;
        match Machine::peak_memory_bytes("self").filter(|_| is_reset) {
            Some(bytes) => peaks.push(bytes as f64),
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Fractions of the sensitivity study are whole worlds, and a narrow link brings about half of a stream.
    #[test]
    fn conditions_are_what_they_are_called() {
        let worlds = FRACTIONS.map(|fraction| fraction * FRACTION_WORLDS as f64);
        assert_eq!(worlds, [1.0, 2.0, 4.0]);
        let size = Size { states: 12, ..Size::of(&Setup::new(None, true, dgs::pipeline::Quiet(true))) };
        let study = Study::make(size).unwrap();
        let masks = study.link_masks(&narrow_links()).unwrap();
        let narrow = study.evaluate_given(&masks).unwrap();
        assert_eq!(narrow.worlds_db.len(), 12);
        // Levels come in order, so that half of the bytes show more than half; a wide link would show all.
        assert!(narrow.mean_db() < narrow.clean_db - 1.0, "{} {}", narrow.mean_db(), narrow.clean_db);
        assert!(narrow.worlds_db.windows(2).any(|pair| pair[0] != pair[1]), "losses differ");
    }
}
