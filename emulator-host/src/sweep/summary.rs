//! Summarises the simulations of a sweep: means, differences from a baseline, and intervals by trace.
//!
//! Differences are paired: a scheduler and the baseline in the same block under the same controller.
//! Intervals are those of a cluster bootstrap: traces are drawn with replacement, then windows within them,
//! because windows of one trace resemble each other. All conditions of a replicate share the window and its
//! random numbers, so where several are summarised together their mean over the window is drawn, not each.

use std::collections::BTreeMap;

use serde::Serialize;

use super::Trial;
use crate::rng::{RandomStream, stream};

type Column = (&'static str, fn(&Trial) -> f64);

/// Draws of an interval.
const RESAMPLES: usize = 1000;
/// What is summarised, by name.
const COLUMNS: [Column; 7] = [
    ("startup_ms", |trial| trial.startup_ms),
    ("miss", |trial| trial.miss),
    ("positive_miss", |trial| trial.positive_miss),
    ("base_miss", |trial| trial.base_miss),
    ("utility", |trial| trial.utility),
    ("usable_goodput_bps", |trial| trial.usable_goodput_bps),
    ("waste_bytes", |trial| trial.waste_bytes as f64),
];

/// A mean and its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Over all simulations.
    pub mean: f64,
    /// 2.5 % of the draws lie below; `None` of a single window, which says nothing of others.
    pub low: Option<f64>,
    /// 2.5 % of the draws lie above; `None` of a single window.
    pub high: Option<f64>,
}

/// One scheduler under one controller and one condition.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Name of the condition, or [`Summary::EVERY_CONDITION`].
    pub condition: String,
    /// Name of the controller.
    pub controller: String,
    /// Name of the scheduler.
    pub scheduler: String,
    /// Simulations.
    pub simulations: u64,
    /// Those in which playout started without what it waits for.
    pub startup_not_reached: u64,
    /// Means by column.
    pub mean: BTreeMap<&'static str, Estimate>,
    /// Means of the differences from the baseline, by column.
    pub less_baseline: BTreeMap<&'static str, Estimate>,
}

/// All comparisons of a sweep.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Scheduler that the others are compared with.
    pub baseline: String,
    /// Simulations.
    pub simulations: u64,
    /// All conditions together first, then each.
    pub comparisons: Vec<Comparison>,
}

impl Summary {
    /// Name of the rows over all conditions.
    pub const EVERY_CONDITION: &str = "all";
}

/// What a summary needs of simulations, which are entered in the order of their numbers: some 200 bytes each
/// while it is made.
#[derive(Clone, Debug, Default)]
pub struct Outcomes {
    rows: Vec<Row>,
    traces: Names<String>,
    conditions: Names<String>,
    /// Controllers and schedulers.
    arms: Names<(String, String)>,
}

/// One simulation; names by their places.
#[derive(Clone, Copy, Debug)]
struct Row {
    trace: u32,
    condition: u32,
    replicate: u32,
    arm: u32,
    startup_reached: bool,
    values: [f64; COLUMNS.len()],
}

/// Different names in the order in which they came.
#[derive(Clone, Debug, Default)]
struct Names<N>(Vec<N>);

impl<N> Names<N> {
    /// The place of the name that `is` recognises; `new` makes it if it is not there.
    fn place(&mut self, is: impl Fn(&N) -> bool, new: impl FnOnce() -> N) -> u32 {
        // Simulations of one block follow each other, and so do blocks of one trace: the newest come first.
        let found = self.0.iter().rposition(is);
        let place = found.unwrap_or_else(|| {
            self.0.push(new());
            self.0.len() - 1
        });
        place as u32
    }
}

impl Outcomes {
    /// Enters a simulation.
    pub fn push(&mut self, trial: &Trial) {
        let arm = (trial.controller.as_str(), trial.scheduler.as_str());
        let is_arm = |known: &(String, String)| (known.0.as_str(), known.1.as_str()) == arm;
        let row = Row {
            trace: self.traces.place(|name| *name == trial.trace, || trial.trace.clone()),
            condition: self.conditions.place(|name| *name == trial.condition, || trial.condition.clone()),
            replicate: trial.replicate,
            arm: self.arms.place(is_arm, || (trial.controller.clone(), trial.scheduler.clone())),
            startup_reached: trial.startup_reached,
            values: COLUMNS.map(|(_, of)| of(trial)),
        };
        self.rows.push(row);
    }

    /// Summarises all, against the scheduler called `baseline`.
    pub fn summary(&self, baseline: &str) -> Summary {
        let all: Vec<&Row> = self.rows.iter().collect();
        let mut comparisons = self.compare(Summary::EVERY_CONDITION, &all, baseline);
        drop(all);
        for (condition, name) in (0u32..).zip(&self.conditions.0) {
            let own: Vec<&Row> = self.rows.iter().filter(|row| row.condition == condition).collect();
            comparisons.extend(self.compare(name, &own, baseline));
        }
        Summary { baseline: baseline.to_owned(), simulations: self.rows.len() as u64, comparisons }
    }

    fn compare(&self, condition: &str, rows: &[&Row], baseline: &str) -> Vec<Comparison> {
        let arms = &self.arms.0;
        let traces = self.windows(rows);
        let everything: Vec<&Window> = traces.iter().flatten().collect();
        let means = mean_of(&everything);
        let mut random = stream(0, "sweep/summary");
        // Drawing from a single window gives that window again.
        let draws = if everything.len() > 1 { RESAMPLES } else { 0 };
        let drawn: Vec<Window> = (0..draws).map(|_| mean_of(&resample(&traces, &mut random))).collect();
        let mut comparisons = Vec::new();
        for (at, (controller, scheduler)) in arms.iter().enumerate() {
            let is_base = |arm: &(String, String)| arm.0 == *controller && arm.1 == baseline;
            let base = arms.iter().position(is_base).unwrap_or(at);
            let own = || rows.iter().filter(|row| row.arm as usize == at);
            let mut comparison = Comparison {
                condition: condition.to_owned(),
                controller: controller.clone(),
                scheduler: scheduler.clone(),
                simulations: own().count() as u64,
                startup_not_reached: own().filter(|row| !row.startup_reached).count() as u64,
                mean: BTreeMap::new(),
                less_baseline: BTreeMap::new(),
            };
            for (column, (name, _)) in COLUMNS.iter().enumerate() {
                let of = |arm: usize, window: &Window| window[arm * COLUMNS.len() + column];
                let value = |window: &Window| of(at, window);
                comparison.mean.insert(name, estimate(&means, &drawn, &value));
                let difference = |window: &Window| of(at, window) - of(base, window);
                comparison.less_baseline.insert(name, estimate(&means, &drawn, &difference));
            }
            comparisons.push(comparison);
        }
        comparisons
    }

    /// The windows of each trace, by its name, each the mean over its conditions. Simulations of one block
    /// follow each other, so a block is full when all arms have been entered.
    fn windows(&self, rows: &[&Row]) -> Vec<Vec<Window>> {
        let mut by_trace: BTreeMap<&str, BTreeMap<u32, Vec<Window>>> = BTreeMap::new();
        for block in rows.chunks(self.arms.0.len().max(1)) {
            let window = block.iter().flat_map(|row| row.values).collect();
            let trace = by_trace.entry(&self.traces.0[block[0].trace as usize]).or_default();
            trace.entry(block[0].replicate).or_default().push(window);
        }
        let over_conditions = |conditions: &Vec<Window>| mean_of(&conditions.iter().collect::<Vec<_>>());
        by_trace.values().map(|windows| windows.values().map(over_conditions).collect()).collect()
    }
}

/// What one window of one trace gave: for each arm and column a value.
type Window = Vec<f64>;

fn resample<'a>(traces: &'a [Vec<Window>], random: &mut RandomStream) -> Vec<&'a Window> {
    let mut sample = Vec::new();
    for _ in 0..traces.len() {
        let trace = &traces[random.up_to(traces.len() as u64 - 1) as usize];
        sample.extend((0..trace.len()).map(|_| &trace[random.up_to(trace.len() as u64 - 1) as usize]));
    }
    sample
}

/// Value by value.
fn mean_of(windows: &[&Window]) -> Window {
    let mut sum = vec![0.0; windows.first().map_or(0, |window| window.len())];
    for window in windows {
        sum.iter_mut().zip(*window).for_each(|(sum, value)| *sum += value);
    }
    sum.iter_mut().for_each(|sum| *sum /= windows.len() as f64);
    sum
}

fn estimate(means: &Window, drawn: &[Window], value: &dyn Fn(&Window) -> f64) -> Estimate {
    let mut values: Vec<f64> = drawn.iter().map(value).collect();
    values.sort_by(f64::total_cmp);
    let at = |share: f64| values.get((share * values.len() as f64) as usize).copied();
    Estimate { mean: value(means), low: at(0.025), high: at(0.975) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two schedulers in blocks of (trace, miss of the first, miss of the second).
    fn trials(blocks: &[(usize, f64, f64)]) -> Vec<Trial> {
        let mut trials = Vec::new();
        for (replicate, (trace, one, other)) in (0..).zip(blocks) {
            for (scheduler, miss) in [("layered", one), ("dash", other)] {
                trials.push(Trial {
                    simulation: trials.len() as u64,
                    trace: format!("trace {trace}"),
                    family: "made".into(),
                    condition: "clean".into(),
                    replicate,
                    controller: "newreno".into(),
                    scheduler: scheduler.into(),
                    startup_ms: 100.0,
                    startup_reached: true,
                    miss: *miss,
                    positive_miss: *miss / 2.0,
                    base_miss: 0.0,
                    utility: 1.0,
                    goodput_bps: 1e6,
                    usable_goodput_bps: 1e6,
                    waste_bytes: 0,
                    lost: 0,
                    digest: String::new(),
                });
            }
        }
        trials
    }

    fn summary(trials: &[Trial], baseline: &str) -> Summary {
        let mut outcomes = Outcomes::default();
        trials.iter().for_each(|trial| outcomes.push(trial));
        outcomes.summary(baseline)
    }

    fn difference(blocks: &[(usize, f64, f64)]) -> Estimate {
        let summary = summary(&trials(blocks), "layered");
        let row = summary.comparisons.iter().find(|row| row.scheduler == "dash").unwrap();
        row.less_baseline["miss"]
    }

    #[test]
    fn a_difference_in_every_pair_is_certain_however_much_windows_differ() {
        let blocks: Vec<(usize, f64, f64)> =
            (0..40).map(|at| (at / 10, at as f64 / 40.0, at as f64 / 40.0 + 0.01)).collect();
        let found = difference(&blocks);
        assert!((found.mean - 0.01).abs() < 1e-9, "{found:?}");
        assert!(found.low.unwrap() > 0.0099 && found.high.unwrap() < 0.0101, "{found:?}");
        // Without pairs the same difference would drown.
        let summary = summary(&trials(&blocks), "layered");
        let positive = summary.comparisons[1].less_baseline["positive_miss"];
        assert!((positive.mean - 0.005).abs() < 1e-9 && positive.low.unwrap() > 0.0049, "{positive:?}");
        let mean = summary.comparisons[0].mean["miss"];
        assert!(mean.high.unwrap() - mean.low.unwrap() > 0.1, "{mean:?}");
    }

    #[test]
    fn windows_of_one_trace_do_not_pass_for_independent() {
        let alike: Vec<(usize, f64, f64)> = (0..40).map(|at| (at / 10, 0.0, (at / 10) as f64)).collect();
        let apart: Vec<(usize, f64, f64)> = (0..40).map(|at| (at, 0.0, (at / 10) as f64)).collect();
        let width = |blocks| {
            let found: Estimate = difference(blocks);
            assert!((found.mean - 1.5).abs() < 1e-12 && found.low <= Some(1.5) && found.high >= Some(1.5));
            found.high.unwrap() - found.low.unwrap()
        };
        assert!(width(&alike) > 2.0 * width(&apart));
    }

    #[test]
    fn a_difference_by_chance_is_not_certain() {
        let blocks: Vec<(usize, f64, f64)> =
            (0..40).map(|at| (at / 10, 0.5, if at % 2 == 0 { 0.4 } else { 0.61 })).collect();
        let found = difference(&blocks);
        assert!(found.low < Some(0.0) && found.high > Some(0.0), "{found:?}");
    }
    #[test]
    fn conditions_of_one_window_do_not_pass_for_windows() {
        // Each window under eight conditions that resemble each other says no more than under one.
        let once = trials(&(0..12).map(|at| (at / 3, 0.5, 0.4 + at as f64 * 0.02)).collect::<Vec<_>>());
        let mut eight = Vec::new();
        for condition in 0..8 {
            let renamed = once.iter().cloned();
            eight.extend(renamed.map(|trial| Trial { condition: format!("{condition}"), ..trial }));
        }
        let all = |trials: &[Trial]| summary(trials, "layered").comparisons[1].less_baseline["miss"];
        assert_eq!(summary(&eight, "layered").comparisons[1].simulations, 96);
        let (one, together) = (all(&once), all(&eight));
        assert!((one.mean - together.mean).abs() < 1e-12);
        let width = |estimate: Estimate| estimate.high.unwrap() - estimate.low.unwrap();
        assert!((width(one) - width(together)).abs() < 1e-12, "{one:?} {together:?}");
    }

    #[test]
    fn a_single_window_has_no_interval() {
        let found = difference(&[(0, 0.5, 0.4)]);
        assert!((found.mean + 0.1).abs() < 1e-12 && (found.low, found.high) == (None, None), "{found:?}");
    }
}
