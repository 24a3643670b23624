//! Rank study: the shared temporal basis of profile paper after packet-conditioned training, rank by
//! validation.

use std::ops::ControlFlow;

use anyhow::{Context, Result};
use render_host::Backend;
use trainer_host::{
    encode,
    train::delivery::{DeliveryOptions, RankResult, Update, Variant, choose_rank, measure_rank},
};

use super::delivery::{Size, Study, mean_and_deviation};
use crate::{
    draw::curves::{Curve, Curves},
    figures::{Bench, Figure},
    setup::Setup,
};

/// Every so many training pictures one is for choosing the rank: held-out ones are for other figures. No
/// divisor of the frames that each camera has pictures of, so that all frames are among them.
const VALIDATED: usize = 5;

/// Ranks whose difference is shown, seed by seed.
const PAIR: [usize; 2] = [2, 4];

/// What a figure shows of a training.
type Value = fn(&RankResult) -> f64;

const VALUES: [(&str, &str, Value); 4] = [
    ("clean", "dB", |r| r.clean_db),
    ("burst5_p10", "dB", |r| r.p10_db),
    ("burst5_worst10", "dB", |r| r.worst_tenth_db),
    ("rate", "bytes", |r| r.wire_bytes as f64),
];

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let size = Size::of(setup);
    let (ranks, seeds): (&[usize], &[u64]) =
        if setup.quick { (&[0, 2, 4, 8], &[1]) } else { (&[0, 1, 2, 3, 4, 5, 6, 7, 8], &[1, 2, 3]) };
    let updates = size.updates / 2;
    let study = Study::make(Size { updates, ..size })?;
    let mut bench = Bench::new(
        "rank",
        format!(
            "profile paper, variant mixed; {}, but as that profile has it; {} seeds, error: their standard \
            deviation; {} \
             states after bursts of 5 % by packets of each rank's own stream; the rank is chosen by rule, on \
             every fifth training picture, which is then not trained on; rank2_less_rank4: of the same seed",
            study.size.words(),
            seeds.len(),
            size.states
        ),
    );
    let mut options =
        DeliveryOptions { encode: encode::EncodeOptions::paper(), ..study.options(Variant::Combined) };
    options.encode.pictures = 0;
    options.validation.states = size.states;
    let (mut training, mut validation) = (Vec::new(), Vec::new());
    for (at, reference) in study.training.iter().enumerate() {
        let list = if at % VALIDATED == VALIDATED - 1 { &mut validation } else { &mut training };
        list.push(reference.clone());
    }
    let mut results = Vec::new();
    for (&rank, &seed) in ranks.iter().flat_map(|rank| seeds.iter().map(move |seed| (rank, seed))) {
        let went_on = |_: &Update| ControlFlow::Continue(());
        let (scene, run) = (&study.scene, (rank, seed));
        let on = &Backend::Cpu;
        results.extend(measure_rank(scene, &training, &validation, &options, run, on, &went_on)?);
    }
    let mut table = String::from("rank,seed,clean_db,burst5_p10_db,burst5_worst10_db,wire_bytes\n");
    for r in &results {
        let (quality, bytes) = ([r.clean_db, r.p10_db, r.worst_tenth_db], r.wire_bytes);
        table += &format!("{},{},{},{},{},{bytes}\n", r.rank, r.seed, quality[0], quality[1], quality[2]);
    }
    setup.write("rank.csv", &table)?;
    setup.write("rank.svg", &drawing(ranks, &results))?;
    let mut push = |key: String, unit: &str, own: &[f64]| {
        let (mean, deviation) = mean_and_deviation(own);
        let figure = Figure::new(key, mean, unit);
        bench.push(figure.error(deviation, &format!("{unit}, standard deviation")).runs(own.len()));
    };
    for rank in ranks {
        for (key, unit, value) in VALUES {
            push(format!("rank{rank}.{key}"), unit, &of_rank(&results, *rank, value));
        }
    }
    for (key, unit, value) in VALUES {
        let [low, high] = PAIR;
        push(format!("rank{low}_less_rank{high}.{key}"), unit, &paired(&results, value));
    }
    let choice = choose_rank(&results).context("no rank was measured")?;
    bench.push(Figure::new("chosen", choice.rank as f64, choice.rule));
    Ok(bench)
}

/// `value` of each training at one rank, in the order of seeds.
fn of_rank(results: &[RankResult], rank: usize, value: Value) -> Vec<f64> {
    results.iter().filter(|r| r.rank == rank).map(value).collect()
}

/// `value` at the first rank of [`PAIR`] less that at the second with the same seed.
fn paired(results: &[RankResult], value: Value) -> Vec<f64> {
    let [low, high] = PAIR.map(|rank| of_rank(results, rank, value));
    low.iter().zip(high).map(|(low, high)| low - high).collect()
}

/// Quality over size, a point per rank: a mean over seeds.
fn drawing(ranks: &[usize], results: &[RankResult]) -> String {
    let mean = |rank: usize, value: Value| mean_and_deviation(&of_rank(results, rank, value)).0;
    let bytes = |rank: usize| mean(rank, |r| r.wire_bytes as f64);
    let curve = |(name, _, value): (&str, &str, Value)| Curve {
        name: name.to_owned(),
        points: ranks.iter().map(|&rank| (bytes(rank), mean(rank, value))).collect(),
    };
    let sizes: Vec<String> = ranks.iter().map(|&rank| format!("{rank} at {:.0}", bytes(rank))).collect();
    Curves {
        title: "Rank of the shared temporal basis",
        subtitle: &format!("rank at bytes: {}", sizes.join(", ")),
        x_label: "bytes of packets and manifest",
        y_label: "PSNR, dB",
        curves: VALUES.into_iter().filter(|(_, unit, _)| *unit == "dB").map(curve).collect(),
    }
    .svg()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn result(rank: usize, seed: u64, p10_db: f64) -> RankResult {
        let (clean_db, worst_tenth_db, wire_bytes) = (p10_db + 5.0, p10_db - 1.0, 1000 + 100 * rank as u64);
        RankResult { rank, seed, clean_db, p10_db, worst_tenth_db, wire_bytes, device: "cpu".to_owned() }
    }

    #[test]
    fn ranks_are_paired_by_seed_and_each_has_a_point_of_every_quality() {
        let results: Vec<RankResult> = [(0, 20.0), (2, 25.0), (4, 24.0)]
            .into_iter()
            .flat_map(|(rank, db)| [1, 2].map(|seed| result(rank, seed, db + seed as f64 * rank as f64)))
            .collect();
        assert_eq!(paired(&results, |r| r.p10_db), [27.0 - 28.0, 29.0 - 32.0]);
        assert_eq!(paired(&results, |r| r.wire_bytes as f64), [-200.0, -200.0]);
        let svg = drawing(&[0, 2, 4], &results);
        assert_eq!(svg.matches("<circle").count(), 9);
        assert!(svg.contains("0 at 1000, 2 at 1200, 4 at 1400") && svg.contains(">clean</text>"), "{svg}");
    }
}
