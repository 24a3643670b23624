//! Erasure study: a scene trained for delivery against the same scene trained without, in the same states.

use anyhow::Result;
use trainer_host::{
    encode::Protection,
    train::delivery::{DeliveryOptions, Evaluation, FineTuned, LossModel, Validation, Variant},
};

use super::delivery::{BURST, Size, Study};
use crate::{
    figures::{Bench, Figure, bootstrap95, mean},
    setup::Setup,
};

/// Shares of independent losses, percent.
const IID_PERCENT: [f64; 5] = [1.0, 2.0, 5.0, 10.0, 20.0];
/// Shares of bursts, percent.
const BURST_PERCENT: [f64; 2] = [5.0, 10.0];

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let size = Size::of(setup);
    let size = Size { seeds: if setup.quick { 1 } else { size.seeds }, ..size };
    let mut bench = Bench::new(
        "erasure",
        "trained: variant mixed, the candidate that validation takes; untrained: variant reconstruction with \
         as many complete pictures per update as mixed has worlds, taken by the same rule; the same states \
         per loss for both; no retransmission, `repaired`: with the parity that streams have by default when \
         they are sent, `strong` and `full`: with `--repair` of that name; PSNR on held-out pictures, drop: \
         below the own complete state, cliffs: states more than 3 dB below it; gain: mean over states \
         of trained less untrained, paired bootstrap over states",
    );
    let sheet = Study::make(size)?;
    let words = size.words();
    measure(&mut bench, ("", &words), &sheet)?;
    let sheet = sheet.protected(Protection::STANDARD)?;
    measure(&mut bench, ("repaired.", "the same"), &sheet)?;
    let sheet = sheet.protected(Protection::STRONG)?;
    measure(&mut bench, ("strong.", "the same"), &sheet)?;
    measure(&mut bench, ("full.", "the same"), &sheet.protected(Protection::FULL)?)?;
    if setup.quick {
        return Ok(bench);
    }
    let (folder, name) = ("scenes/dnerf-bouncingballs", "bouncingballs");
    if let Some(path) = setup.data(folder, &mut bench)? {
        let study = Study::of_photographs(&path, Size { seeds: 1, ..size })?;
        let words = study.photographs_in_words(name);
        measure(&mut bench, ("bouncingballs.", &words), &study)?;
        let mut study = study;
        let levels =
            [("repaired", Protection::STANDARD), ("strong", Protection::STRONG), ("full", Protection::FULL)];
        for (prefix, repair) in levels {
            study = study.protected(repair)?;
            let words = format!("the same, {} packets", study.encoded.stream.packets().len());
            measure(&mut bench, (&format!("bouncingballs.{prefix}."), &words), &study)?;
        }
    }
    Ok(bench)
}

/// Adds the figures of one study, their keys after `prefix`.
fn measure(bench: &mut Bench, (prefix, words): (&str, &str), study: &Study) -> Result<()> {
    let iid =
        IID_PERCENT.map(|percent| (format!("iid{percent}"), LossModel::Iid { probability: percent / 100.0 }));
    let burst = BURST_PERCENT.map(|percent| {
        (format!("burst{percent}"), LossModel::Burst { share: percent / 100.0, length: BURST })
    });
    let losses: Vec<(String, LossModel)> = iid.into_iter().chain(burst).collect();
    let mut masks = Vec::new();
    for (_, loss) in &losses {
        masks.push(study.masks(*loss)?);
    }
    let hashes: Vec<String> =
        losses.iter().zip(&masks).map(|((name, _), masks)| format!("{name} {:016x}", masks.hash())).collect();
    let Size { seeds, states, worlds, .. } = study.size;
    bench.also(&format!(
        "; {prefix}*: {words}, {seeds} seeds, {states} states per loss \
         (FNV-1a: {})",
        hashes.join(", ")
    ));
    let validation = Validation { candidates: 2, ..Validation::default() };
    let mut pairs: Vec<[FineTuned; 2]> = Vec::new();
    for seed in 1..=seeds {
        let options = |variant| DeliveryOptions { seed, validation, ..study.options(variant) };
        let complete = DeliveryOptions { views: worlds, worlds: 1, ..options(Variant::Reconstruction) };
        pairs.push([study.train(&options(Variant::Combined))?, study.train(&complete)?]);
    }
    for ((name, _), masks) in losses.iter().zip(&masks) {
        let mut found: [Vec<Evaluation>; 2] = Default::default();
        for pair in &pairs {
            for (found, tuned) in found.iter_mut().zip(pair) {
                found.push(study.evaluate(tuned, masks)?);
            }
        }
        push(bench, &format!("{prefix}{name}"), &found);
    }
    Ok(())
}

/// Adds the figures of one loss: evaluations of trained and untrained scenes, seed by seed.
fn push(bench: &mut Bench, name: &str, [trained, untrained]: &[Vec<Evaluation>; 2]) {
    let over_seeds =
        |all: &[Evaluation], value: fn(&Evaluation) -> f64| mean(&all.iter().map(value).collect::<Vec<_>>());
    let mut figure = |key: &str, unit: &str, value: fn(&Evaluation) -> f64| {
        let (ours, other) = (over_seeds(trained, value), over_seeds(untrained, value));
        let mut figure = Figure::new(format!("{name}.{key}"), ours, unit).peer("untrained", other, false);
        // A ratio of decibels says nothing.
        figure.ratio = None;
        bench.push(figure);
    };
    figure("bytes", "of packets and manifest", |e| e.wire_bytes as f64);
    figure("clean", "dB", |e| e.clean_db);
    figure("psnr", "dB", Evaluation::mean_db);
    figure("drop", "dB", |e| e.clean_db - e.mean_db());
    figure("worst10", "dB", Evaluation::worst_tenth_db);
    figure("cliffs", "of states", Evaluation::cliffs);
    // A state's gain is its mean over seeds: states are what is drawn again.
    let states = trained.first().map_or(0, |e| e.worlds_db.len());
    let gain = |state: usize| {
        let each = trained.iter().zip(untrained).map(|(a, b)| a.worlds_db[state] - b.worlds_db[state]);
        mean(&each.collect::<Vec<_>>())
    };
    let gains: Vec<f64> = (0..states).map(gain).collect();
    let mut gain = Figure::new(format!("{name}.gain"), mean(&gains), "dB").runs(trained.len());
    gain.ci95 = bootstrap95(&gains, mean, 1);
    bench.push(gain);
    let wins = gains.iter().filter(|&&gain| gain > 0.0).count() as f64 / gains.len().max(1) as f64;
    bench.push(Figure::new(format!("{name}.wins"), wins, "of states"));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation(clean_db: f64, worlds_db: &[f64]) -> Evaluation {
        Evaluation { clean_db, worlds_db: worlds_db.to_vec(), wire_bytes: 1, violations: 0 }
    }

    #[test]
    fn gains_are_paired_by_state_and_averaged_over_seeds() {
        let mut bench = Bench::new("erasure", "test");
        let trained = vec![evaluation(30.0, &[29.0, 20.0, 28.0]), evaluation(30.0, &[29.5, 21.0, 28.0])];
        let untrained = vec![evaluation(31.0, &[28.0, 21.0, 28.0]), evaluation(31.0, &[28.5, 21.0, 27.0])];
        push(&mut bench, "x", &[trained, untrained]);
        let value = |key: &str| bench.figures.iter().find(|f| f.key == key).unwrap();
        // Gains of the states: 1, -0.5, 0.5.
        assert!((value("x.gain").value - 1.0 / 3.0).abs() < 1e-12);
        assert!((value("x.wins").value - 2.0 / 3.0).abs() < 1e-12);
        assert!((value("x.cliffs").value - 1.0 / 3.0).abs() < 1e-12);
        assert_eq!(value("x.clean").peer_value, Some(31.0));
        assert!(value("x.drop").value < value("x.drop").peer_value.unwrap());
    }
}
