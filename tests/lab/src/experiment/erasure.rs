//! Erasure study: a scene trained for delivery against the same scene trained without, in the same states.

mod appearance;

use anyhow::Result;
use trainer_host::{
    encode::Protection,
    train::delivery::{
        DeliveryOptions, Evaluation, FineTuned, LossModel, LossUnit, Masks, Validation, Variant, Weights,
    },
};

use self::appearance::{Appearance, Measured, Perceptual};
use super::delivery::{BURST, Size, Study};
use crate::{
    figures::{Bench, Figure, bootstrap95, mean},
    setup::Setup,
};

/// Shares of independent losses, percent.
const IID_PERCENT: [f64; 5] = [1.0, 2.0, 5.0, 10.0, 20.0];
/// Shares of bursts, percent.
const BURST_PERCENT: [f64; 2] = [5.0, 10.0];
/// Shares of whole completion groups that are lost, percent.
const GROUP_PERCENT: [f64; 2] = [5.0, 10.0];
/// Weight of the complete state in the objective that heeds it more; the paper's is 0.5.
const CLEAN_HEAVIER: f64 = 1.5;

/// The scenes, by name: one that is made, and one that is trained from its photographs.
const SHEET: &str = "sheet";
const BALLS: &str = "bouncingballs";
/// Parity that streams are sent with: what `--repair` calls it, and what stands before its keys.
const PROTECTIONS: [(&str, &str, Protection); 4] = [
    ("none", "", Protection::NONE),
    ("standard", "repaired.", Protection::STANDARD),
    ("strong", "strong.", Protection::STRONG),
    ("full", "full.", Protection::FULL),
];

/// What is measured of one loss.
#[derive(Clone, Debug)]
struct Tested {
    evaluation: Evaluation,
    appearance: Appearance,
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let size = Size::of(setup);
    let size = Size { seeds: if setup.quick { 1 } else { size.seeds }, ..size };
    let perceptual = Perceptual::of(setup)?;
    let mut bench = Bench::new("erasure", protocol(&perceptual));
    if perceptual.network.is_none() {
        bench.skipped.push("LPIPS: no weights of it are here (see --lpips)".into());
    }
    let scenes: &[&str] = if setup.quick { &[SHEET] } else { &[SHEET, BALLS] };
    let named = |scene: &str, parity: &str| format!("{scene}.{parity}");
    let names: Vec<String> =
        scenes.iter().flat_map(|scene| PROTECTIONS.map(|(parity, ..)| named(scene, parity))).collect();
    let chosen = setup.chosen(&names.iter().map(String::as_str).collect::<Vec<_>>())?;
    let with = (setup, &perceptual);
    for &scene in scenes {
        let mut protections = PROTECTIONS.to_vec();
        protections.retain(|(parity, ..)| chosen.contains(&&named(scene, parity)[..]));
        if protections.is_empty() {
            continue;
        }
        if scene == SHEET {
            of_sheet(&mut bench, Study::make(size)?, &protections, with)?;
        } else if let Some(path) = setup.data("scenes/dnerf-bouncingballs", &mut bench)? {
            let study = Study::of_photographs(&path, Size { seeds: 1, ..size })?;
            of_photographs(&mut bench, study, &protections, with)?;
        }
    }
    Ok(bench)
}

/// Adds the figures of the made scene with each of `protections`.
fn of_sheet(
    bench: &mut Bench,
    mut sheet: Study,
    protections: &[(&str, &str, Protection)],
    with: (&Setup, &Perceptual),
) -> Result<()> {
    let words = sheet.size.words();
    for &(_, prefix, repair) in protections {
        sheet = sheet.protected(repair)?;
        let pairs = measure(bench, (prefix, &words), &sheet, with)?;
        if repair == Protection::NONE {
            groups(bench, &sheet, &pairs, with)?;
            let first = bench.figures.len();
            clean_heavier(bench, &sheet, &pairs)?;
            with.0.show(bench, first);
        }
    }
    Ok(())
}

/// Adds the figures of the scene that was trained from photographs with each of `protections`.
fn of_photographs(
    bench: &mut Bench,
    mut study: Study,
    protections: &[(&str, &str, Protection)],
    with: (&Setup, &Perceptual),
) -> Result<()> {
    for &(_, prefix, repair) in protections {
        study = study.protected(repair)?;
        let words = study.photographs_in_words(BALLS);
        measure(bench, (&format!("{BALLS}.{prefix}"), &words), &study, with)?;
    }
    Ok(())
}

fn protocol(perceptual: &Perceptual) -> String {
    let lpips = if perceptual.network.is_some() { " and LPIPS (AlexNet)" } else { "" };
    let states = perceptual.states;
    format!(
        "trained: variant mixed, the candidate that validation takes; untrained: variant reconstruction with \
         as many complete pictures per update as mixed has worlds, taken by the same rule; the same states \
         per loss for both; no retransmission, `repaired`: with the parity that streams have by default when \
         they are sent, `strong` and `full`: with `--repair` of that name; PSNR on held-out pictures, drop: \
         below the own complete state, cliffs: states more than 3 dB below it; FLIP{lpips} of the same \
         pictures, of the first {states} states of each loss; flicker: change to the next frame in the same \
         state that the reference does not have, times 1000 (no photograph follows another: what changes \
         there is of renders of the scene before either training); rise: above the own complete state; gain: \
         mean over states of trained less untrained PSNR, difference: the same of another measure; both with \
         paired bootstrap over states"
    )
}

/// States that are tested, by the name of their loss.
type Drawn = Vec<(String, Masks)>;

/// The loss of so many percent on its own, by name.
fn independent(percent: f64) -> (String, LossModel) {
    (format!("iid{percent}"), LossModel::Iid { probability: percent / 100.0 })
}

/// The loss of so many percent in bursts, by name.
fn in_bursts(percent: f64) -> (String, LossModel) {
    (format!("burst{percent}"), LossModel::Burst { share: percent / 100.0, length: BURST })
}

/// The states of `study` after each of `losses`, by `unit`.
fn drawn(
    study: &Study,
    losses: impl IntoIterator<Item = (String, LossModel)>,
    unit: LossUnit,
) -> Result<Drawn> {
    losses.into_iter().map(|(name, loss)| Ok((name, study.masks_by(loss, unit)?))).collect()
}

/// Names of losses and hashes of their states, as a protocol has them.
fn hashes(drawn: &[(String, Masks)]) -> String {
    let each = drawn.iter().map(|(name, masks)| format!("{name} {:016x}", masks.hash()));
    each.collect::<Vec<_>>().join(", ")
}

/// Options of `variant` with `seed`, which take the candidate that validation prefers.
fn validated(study: &Study, variant: Variant, seed: u64) -> DeliveryOptions {
    let validation = Validation { candidates: 2, ..Validation::default() };
    DeliveryOptions { seed, validation, ..study.options(variant) }
}

/// Adds the figures of one study, their keys after `prefix`; gives what was trained and what was not, seed by
/// seed.
fn measure(
    bench: &mut Bench,
    (prefix, words): (&str, &str),
    study: &Study,
    with: (&Setup, &Perceptual),
) -> Result<Vec<[FineTuned; 2]>> {
    let losses = IID_PERCENT.map(independent).into_iter().chain(BURST_PERCENT.map(in_bursts));
    let drawn = drawn(study, losses, LossUnit::Packet)?;
    let Size { seeds, states, worlds, .. } = study.size;
    bench.also(&format!(
        "; {prefix}*: {words}, {seeds} seeds, {states} states per loss \
         (FNV-1a: {})",
        hashes(&drawn)
    ));
    let mut pairs: Vec<[FineTuned; 2]> = Vec::new();
    for seed in 1..=seeds {
        let options = |variant| validated(study, variant, seed);
        let complete = DeliveryOptions { views: worlds, worlds: 1, ..options(Variant::Reconstruction) };
        pairs.push([study.train(&options(Variant::Combined))?, study.train(&complete)?]);
    }
    compare(bench, prefix, study, (&pairs, &drawn), with)?;
    Ok(pairs)
}

/// Adds the figures of `pairs` where completion groups are lost whole, as in the paper.
fn groups(
    bench: &mut Bench,
    study: &Study,
    pairs: &[[FineTuned; 2]],
    with: (&Setup, &Perceptual),
) -> Result<()> {
    let drawn = drawn(study, GROUP_PERCENT.map(independent), LossUnit::Group)?;
    let hashes = hashes(&drawn);
    bench.also(&format!("; groups.*: the same scenes, completion groups are lost whole (FNV-1a: {hashes})"));
    compare(bench, "groups.", study, (pairs, &drawn), with)
}

/// Adds the figures of an objective that heeds the complete state more, beside those of the mixed one, the
/// first of each of `pairs`.
fn clean_heavier(bench: &mut Bench, study: &Study, pairs: &[[FineTuned; 2]]) -> Result<()> {
    let weights = Weights { anchor: CLEAN_HEAVIER, ..Weights::default() };
    let mut heavier = Vec::new();
    for seed in 1..=study.size.seeds {
        let options = DeliveryOptions { weights, ..validated(study, Variant::Combined, seed) };
        heavier.push(study.train(&options)?);
    }
    let normal = Weights::default().anchor;
    bench.also(&format!(
        "; clean_heavier.*: the same sheet and states, variant mixed with {CLEAN_HEAVIER} for {normal} \
         as the weight of the complete state, beside mixed"
    ));
    for (name, masks) in drawn(study, [independent(10.0), in_bursts(10.0)], LossUnit::Packet)? {
        let evaluate = |tuned: &FineTuned| study.evaluate(tuned, &masks);
        let ours = heavier.iter().map(evaluate).collect::<Result<Vec<_>>>()?;
        let usual = pairs.iter().map(|[trained, _]| evaluate(trained)).collect::<Result<Vec<_>>>()?;
        push_levels(bench, &format!("clean_heavier.{name}"), ("mixed", &usual), &ours);
    }
    Ok(())
}

/// Adds the figures of `pairs` in the states of each loss, their keys after `prefix`.
fn compare(
    bench: &mut Bench,
    prefix: &str,
    study: &Study,
    (pairs, drawn): (&[[FineTuned; 2]], &[(String, Masks)]),
    (setup, perceptual): (&Setup, &Perceptual),
) -> Result<()> {
    for (name, masks) in drawn {
        let first = bench.figures.len();
        let mut found: [Vec<Tested>; 2] = Default::default();
        for pair in pairs {
            for (found, tuned) in found.iter_mut().zip(pair) {
                let evaluation = study.evaluate(tuned, masks)?;
                let appearance = Appearance::of(study, tuned, masks, perceptual)?;
                found.push(Tested { evaluation, appearance });
            }
        }
        push(bench, &format!("{prefix}{name}"), &found);
        setup.show(bench, first);
    }
    Ok(())
}

/// Adds the figures of one loss: what trained and untrained scenes come to, seed by seed.
fn push(bench: &mut Bench, name: &str, tested: &[Vec<Tested>; 2]) {
    let evaluations = tested.each_ref().map(|all| all.iter().map(|t| t.evaluation.clone()).collect());
    push_psnr(bench, name, &evaluations);
    let measures = |of: fn(&Appearance) -> Option<&Measured>| {
        tested.each_ref().map(|all| all.iter().filter_map(|t| of(&t.appearance)).cloned().collect())
    };
    push_measure(bench, &format!("{name}.flip"), "", &measures(|a| Some(&a.flip)));
    push_measure(bench, &format!("{name}.lpips"), "", &measures(|a| a.lpips.as_ref()));
    push_measure(bench, &format!("{name}.flicker"), "x 10^-3", &measures(|a| Some(&a.flicker)));
}

/// Adds the figures of PSNR.
fn push_psnr(bench: &mut Bench, name: &str, evaluations: &[Vec<Evaluation>; 2]) {
    let [trained, untrained] = evaluations;
    push_levels(bench, name, ("untrained", untrained), trained);
    let states = trained.first().map_or(0, |e| e.worlds_db.len());
    let gains = differences(evaluations, states, |e, state| e.worlds_db[state]);
    bench.push(difference(format!("{name}.gain"), "dB", &gains, trained.len()));
    let wins = gains.iter().filter(|&&gain| gain > 0.0).count() as f64 / gains.len().max(1) as f64;
    bench.push(Figure::new(format!("{name}.wins"), wins, "of states"));
    let drops = differences(evaluations, states, |e, state| e.clean_db - e.worlds_db[state]);
    bench.push(difference(format!("{name}.drop_difference"), "dB", &drops, trained.len()));
    let cliffs = differences(evaluations, states, |e, state| f64::from(u8::from(e.is_cliff(state))));
    bench.push(difference(format!("{name}.cliffs_difference"), "of states", &cliffs, trained.len()));
}

/// Adds what PSNR comes to over seeds, of `ours` beside a peer.
fn push_levels(bench: &mut Bench, name: &str, (peer, others): (&str, &[Evaluation]), ours: &[Evaluation]) {
    let over_seeds =
        |all: &[Evaluation], value: fn(&Evaluation) -> f64| mean(&all.iter().map(value).collect::<Vec<_>>());
    let mut figure = |key: &str, unit: &str, value: fn(&Evaluation) -> f64| {
        let (ours, other) = (over_seeds(ours, value), over_seeds(others, value));
        let mut figure = Figure::new(format!("{name}.{key}"), ours, unit).peer(peer, other, false);
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
}

/// Adds the figures of one measure, of which less is better; none where it was not taken.
fn push_measure(bench: &mut Bench, name: &str, unit: &str, measured: &[Vec<Measured>; 2]) {
    let [trained, untrained] = measured;
    let Some(states) = trained.first().map(|m| m.states.len()) else { return };
    let over_seeds =
        |all: &[Measured], value: fn(&Measured) -> f64| mean(&all.iter().map(value).collect::<Vec<_>>());
    let mut figure = |key: String, value: fn(&Measured) -> f64| {
        let (ours, other) = (over_seeds(trained, value), over_seeds(untrained, value));
        bench.push(Figure::new(key, ours, unit).peer("untrained", other, true));
    };
    figure(format!("{name}_clean"), |m| m.complete);
    figure(name.to_owned(), Measured::mean);
    figure(format!("{name}_rise"), |m| m.mean() - m.complete);
    let absolute = differences(measured, states, |m, state| m.states[state]);
    bench.push(difference(format!("{name}_difference"), unit, &absolute, trained.len()));
    let rises = differences(measured, states, |m, state| m.states[state] - m.complete);
    bench.push(difference(format!("{name}_rise_difference"), unit, &rises, trained.len()));
}

/// Per state, `value` of trained less that of untrained scenes, mean over seeds: states are what is drawn
/// again.
fn differences<T>(
    [trained, untrained]: &[Vec<T>; 2],
    states: usize,
    value: impl Fn(&T, usize) -> f64,
) -> Vec<f64> {
    let of = |state: usize| {
        let each = trained.iter().zip(untrained).map(|(a, b)| value(a, state) - value(b, state));
        mean(&each.collect::<Vec<_>>())
    };
    (0..states).map(of).collect()
}

/// The mean of paired differences with its interval.
fn difference(key: String, unit: &str, differences: &[f64], seeds: usize) -> Figure {
    let mut figure = Figure::new(key, mean(differences), unit).runs(seeds);
    figure.ci95 = bootstrap95(differences, mean, 1);
    figure
}

#[cfg(test)]
mod tests {
    use super::*;

    fn evaluation(clean_db: f64, worlds_db: &[f64]) -> Evaluation {
        Evaluation { clean_db, worlds_db: worlds_db.to_vec(), wire_bytes: 1, violations: 0 }
    }

    fn measured(complete: f64, states: &[f64]) -> Measured {
        Measured { complete, states: states.to_vec() }
    }

    fn value<'b>(bench: &'b Bench, key: &str) -> &'b Figure {
        bench.figures.iter().find(|f| f.key == key).unwrap()
    }

    #[test]
    fn gains_are_paired_by_state_and_averaged_over_seeds() {
        let mut bench = Bench::new("erasure", "test");
        let trained = vec![evaluation(30.0, &[29.0, 20.0, 28.0]), evaluation(30.0, &[29.5, 21.0, 28.0])];
        let untrained = vec![evaluation(31.0, &[28.0, 21.0, 28.0]), evaluation(31.0, &[28.5, 21.0, 27.0])];
        push_psnr(&mut bench, "x", &[trained, untrained]);
        let value = |key: &str| value(&bench, key);
        // Gains of the states: 1, -0.5, 0.5; of drops each is 1 dB more, as the complete state is 1 dB worse.
        assert!((value("x.gain").value - 1.0 / 3.0).abs() < 1e-12);
        assert!((value("x.drop_difference").value + 4.0 / 3.0).abs() < 1e-12);
        assert!((value("x.wins").value - 2.0 / 3.0).abs() < 1e-12);
        assert!((value("x.cliffs").value - 1.0 / 3.0).abs() < 1e-12);
        // Of the untrained, 20 falls as it does of the trained, and 27 besides, once in six.
        assert!((value("x.cliffs_difference").value + 1.0 / 6.0).abs() < 1e-12);
        assert_eq!(value("x.clean").peer_value, Some(31.0));
        assert!(value("x.drop").value < value("x.drop").peer_value.unwrap());
        let [low, high] = value("x.gain").ci95.unwrap();
        assert!((-0.5..=1.0).contains(&low) && low < high && high <= 1.0);
    }

    /// Rows of groups and of the other objective are there, and groups that are lost are other states.
    #[test]
    fn groups_and_the_heavier_complete_state_have_rows_of_their_own() {
        let setup = Setup::new(None, true, dgs::pipeline::Quiet(true));
        let size = Size { updates: 5, worlds: 2, states: 6, frames: 3, seeds: 1, ..Size::of(&setup) };
        let study = Study::make(size).unwrap();
        let by = |unit| drawn(&study, [independent(10.0)], unit).unwrap();
        assert_ne!(by(LossUnit::Group), by(LossUnit::Packet));
        let trained = study.train(&validated(&study, Variant::Combined, 1)).unwrap();
        let complete = study.train(&validated(&study, Variant::Reconstruction, 1)).unwrap();
        let mut bench = Bench::new("erasure", "test");
        let pairs = [[trained, complete]];
        groups(&mut bench, &study, &pairs, (&setup, &Perceptual { network: None, states: 6 })).unwrap();
        clean_heavier(&mut bench, &study, &pairs).unwrap();
        for key in ["groups.iid5.psnr", "groups.iid10.worst10", "groups.iid10.flip"] {
            assert_eq!(value(&bench, key).peer.as_deref(), Some("untrained"), "{key}");
        }
        for loss in ["iid10", "burst10"] {
            for measure in ["clean", "psnr", "worst10", "cliffs"] {
                let key = format!("clean_heavier.{loss}.{measure}");
                assert_eq!(value(&bench, &key).peer.as_deref(), Some("mixed"), "{key}");
            }
        }
    }

    #[test]
    fn other_measures_are_paired_alike_absolute_and_above_the_own_complete_state() {
        let mut bench = Bench::new("erasure", "test");
        let trained = vec![measured(0.02, &[0.03, 0.05]), measured(0.02, &[0.03, 0.07])];
        let untrained = vec![measured(0.01, &[0.04, 0.08]), measured(0.01, &[0.04, 0.08])];
        push_measure(&mut bench, "x.flip", "", &[trained, untrained]);
        let close = |key: &str, expected: f64| {
            let found = value(&bench, key).value;
            assert!((found - expected).abs() < 1e-12, "{key}: {found}");
        };
        close("x.flip_clean", 0.02);
        close("x.flip", 0.045);
        close("x.flip_rise", 0.025);
        // States: 0.01 and 0.02 less; above the own complete state another 0.01 less.
        close("x.flip_difference", -0.015);
        close("x.flip_rise_difference", -0.025);
        let ratio = value(&bench, "x.flip").ratio.unwrap();
        assert!((ratio - 0.06 / 0.045).abs() < 1e-9, "above 1 is better: {ratio}");
        let [low, high] = value(&bench, "x.flip_difference").ci95.unwrap();
        assert!((low + 0.02).abs() < 1e-9 && (high + 0.01).abs() < 1e-9, "{low} {high}");
        push_measure(&mut bench, "x.lpips", "", &[Vec::new(), Vec::new()]);
        assert!(!bench.figures.iter().any(|f| f.key.contains("lpips")), "without weights");
    }
}
