//! Rank study: the shared temporal basis of profile paper after packet-conditioned training, rank by
//! validation.

use std::ops::ControlFlow;

use anyhow::{Context, Result};
use trainer_host::{
    encode,
    train::delivery::{DeliveryOptions, RankResult, Update, Variant, choose_rank, measure_rank},
};

use super::delivery::{Size, Study, mean_and_deviation};
use crate::{
    figures::{Bench, Figure},
    setup::Setup,
};

/// Every so many training pictures one is for choosing the rank: held-out ones are for other figures.
const VALIDATED: usize = 4;

/// What a figure shows of a training.
type Value = fn(&RankResult) -> f64;

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
             every fourth training picture, which is then not trained on",
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
        let run = (rank, seed);
        results.extend(measure_rank(&study.scene, &training, &validation, &options, run, &went_on)?);
    }
    let values: [(&str, &str, Value); 4] = [
        ("clean", "dB", |r| r.clean_db),
        ("burst5_p10", "dB", |r| r.p10_db),
        ("burst5_worst10", "dB", |r| r.worst_tenth_db),
        ("rate", "bytes", |r| r.wire_bytes as f64),
    ];
    let mut table = String::from("rank,seed,clean_db,burst5_p10_db,burst5_worst10_db,wire_bytes\n");
    for r in &results {
        let (quality, bytes) = ([r.clean_db, r.p10_db, r.worst_tenth_db], r.wire_bytes);
        table += &format!("{},{},{},{},{},{bytes}\n", r.rank, r.seed, quality[0], quality[1], quality[2]);
    }
    setup.write("rank.csv", &table)?;
    for rank in ranks {
        for (key, unit, value) in values {
            let own: Vec<f64> = results.iter().filter(|r| r.rank == *rank).map(value).collect();
            let (mean, deviation) = mean_and_deviation(&own);
            let figure = Figure::new(format!("rank{rank}.{key}"), mean, unit);
            bench.push(figure.error(deviation, &format!("{unit}, standard deviation")).runs(own.len()));
        }
    }
    let choice = choose_rank(&results).context("no rank was measured")?;
    bench.push(Figure::new("chosen", choice.rank as f64, choice.rule));
    Ok(bench)
}
