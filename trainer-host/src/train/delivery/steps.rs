//! Learns quantiser steps, straight through their rounding.
//!
//! A quantised value is `v̂ = s · round(v / s)`. With the slope of the rounding taken as 1, as the
//! straight-through estimator does, `∂v̂ / ∂ ln s = v̂ − v` at every level: nested steps are multiples of
//! the last one. So the slope of the objective by a step is the sum, over the values that share it, of the
//! value's gradient times its quantisation error. Source: paper section 3; Esser et al., "Learned Step Size
//! Quantization" (2020), equation 3. Known bias: what the rank of motion leaves out counts as such an error,
//! too, so that steps of moving parts come out shorter than best where the rank is low.
//!
//! What a step saves is measured: the scene is coded with that step longer and shorter and bytes are counted.
//! Where no other steps of the same size are better, all have the same slope per byte. The objective grows
//! with the square of a step, so `ln s` moves by half the logarithm of what its slope per byte is over that,
//! damped. A change of all steps together keeps the size that the encoder's steps would give, or follows the
//! price of a byte where the objective has one (λr R).

use std::ops::Range;

use codec_core::internals::quant::Class;
use rayon::prelude::*;

use super::{
    error::DeliveryError,
    parameters::{COLOUR, COMPONENTS, OPACITY, SCALE, TURN},
};
use crate::{
    encode::{
        self, Decisions, EncodeError, Encoded,
        decisions::{QuantiserDecision, Quantisers},
    },
    scene::Scene,
};

/// Attributes whose steps are learned, and the parameters of each; they are the classes that can move, whose
/// motion is quantised in proportion.
pub(super) const LEARNED: [(Class, Range<usize>); Class::MOVING] = [
    (Class::Position, 0..SCALE),
    (Class::Scale, SCALE..TURN),
    (Class::Rotation, TURN..OPACITY),
    (Class::Opacity, OPACITY..COLOUR),
    (Class::Sh0, COLOUR..COMPONENTS),
];

/// One number per learned class.
pub(super) type PerClass = [f64; Class::MOVING];

/// Change of `ln s`, up and down, by which bytes are measured: enough that values which lie on a grid of
/// their own, and sizes of packets, make little of it.
const PROBE: f64 = 0.4;
/// Largest change of `ln s` at once.
const MAX_AT_ONCE: f64 = 0.1;
/// Largest change of `ln s` in all: a third, or three times.
const MOST: f64 = 1.1;
/// Share of the way to the optimum that is gone at once.
const DAMPING: f64 = 0.3;
/// Share of what the slopes were that they still are after an update.
const MEMORY: f64 = 0.9;
/// A slope per byte counts as at least this share of the mean: what noise makes negative has no logarithm.
const MIN_RATIO: f64 = 0.02;
/// Levels of `ln` of slopes per byte over their mean that are searched, and their negatives.
const LEVELS: f64 = 20.0;

/// Steps of a stream's quantisers over those that the encoder chose, one row per quantiser of an epoch.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct Steps {
    /// Natural logarithms.
    factors: Vec<PerClass>,
    /// The same before the last change.
    before: Vec<PerClass>,
    /// Running means of the objective's slopes by `ln s`.
    slopes: Vec<PerClass>,
    /// Bytes that a step saves, by `ln s`; 0 where it saves none.
    savings: Vec<PerClass>,
    /// What decides about a change of all steps together; without, steps stay.
    control: Option<RateControl>,
}

/// How the size of the stream is controlled.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub(super) enum RateControl {
    /// The stream is so many bytes smaller than with the encoder's steps, as far as savings add up.
    Size { saved: f64 },
    /// A byte costs so much of the objective.
    Price(f64),
}

impl Steps {
    /// Those that the encoder chose, which stay.
    pub(super) fn fixed(decisions: &Decisions) -> Self {
        let none = vec![PerClass::default(); rows(decisions)];
        Self {
            factors: none.clone(),
            before: none.clone(),
            slopes: none.clone(),
            savings: none,
            control: None,
        }
    }

    /// Those that the encoder chose for `scene`, whose stream is `encoded` with at most `table_choices`
    /// tables to a set. A byte costs `price` of the objective; where that is 0, all steps together save
    /// nothing.
    ///
    /// # Errors
    /// What the encoder refuses of other steps, but for a block too large for a packet: that step stays.
    pub(super) fn learned(
        scene: &Scene,
        encoded: &Encoded,
        table_choices: usize,
        price: f64,
    ) -> Result<Self, DeliveryError> {
        let decisions = &encoded.decisions;
        let mut steps = Self::fixed(decisions);
        let bytes_with = |place: usize, factor: f64| -> Result<Option<f64>, DeliveryError> {
            let mut factors = steps.factors.clone();
            factors.as_flattened_mut()[place] = factor;
            let scaled = scaled(decisions, &factors);
            match encode::with_levels(scene, &scaled, &[], table_choices, &encode::no_progress) {
                Ok(encoded) => Ok(Some(encoded.report.ledger.wire())),
                Err(EncodeError::BlockTooLarge { .. }) => Ok(None),
                Err(error) => Err(error.into()),
            }
        };
        let probed = |place: usize| {
            let both = bytes_with(place, -PROBE)?.zip(bytes_with(place, PROBE)?);
            Ok(both.map_or(0.0, |(shorter, longer)| (shorter - longer) / (2.0 * PROBE)))
        };
        let places = 0..steps.factors.as_flattened().len();
        let probed: Result<Vec<f64>, DeliveryError> = places.into_par_iter().map(probed).collect();
        for (saving, probed) in steps.savings.as_flattened_mut().iter_mut().zip(probed?) {
            *saving = probed.max(0.0);
        }
        steps.control = Some(match price {
            price if price > 0.0 => RateControl::Price(price),
            _ => RateControl::Size { saved: 0.0 },
        });
        Ok(steps)
    }

    /// Whether there are steps of as many rows as in `decisions`, and all are numbers.
    pub(super) fn is_sound(&self, decisions: &Decisions) -> bool {
        let lists = [&self.factors, &self.before, &self.slopes, &self.savings];
        let fits = |list: &&Vec<PerClass>| {
            list.len() == rows(decisions) && list.as_flattened().iter().all(|value| value.is_finite())
        };
        lists.iter().all(fits)
    }

    /// Takes in the slopes of one update.
    pub(super) fn observe(&mut self, slopes: &[PerClass]) {
        for (mean, slope) in self.slopes.as_flattened_mut().iter_mut().zip(slopes.as_flattened()) {
            *mean = MEMORY * *mean + (1.0 - MEMORY) * slope;
        }
    }

    /// Moves the steps towards equal slopes per byte.
    pub(super) fn advance(&mut self) {
        let Some(control) = self.control else { return };
        let savings = self.savings.as_flattened();
        let all: f64 = savings.iter().sum();
        let mean = self.slopes.as_flattened().iter().map(|slope| slope.max(0.0)).sum::<f64>() / all;
        if !(mean > 0.0 && mean.is_finite()) {
            return;
        }
        // Logarithms of slopes per byte over their mean; what has next to none counts as little.
        let ratio = |(slope, saving): (&f64, &f64)| (slope / saving / mean).max(MIN_RATIO).ln();
        let ratios: Vec<f64> = self.slopes.as_flattened().iter().zip(savings).map(ratio).collect();
        let changes = match control {
            RateControl::Price(price) => self.changes(&ratios, (price / mean).ln()),
            RateControl::Size { saved } => self.changes_to(&ratios, saved),
        };
        self.before.clone_from(&self.factors);
        self.factors
            .as_flattened_mut()
            .iter_mut()
            .zip(changes)
            .for_each(|(factor, change)| *factor += change);
    }

    /// What brings slopes per byte, as logarithms `ratios`, towards `level`, within the bounds.
    fn changes(&self, ratios: &[f64], level: f64) -> Vec<f64> {
        let places = self.factors.as_flattened().iter().zip(ratios).zip(self.savings.as_flattened());
        let change = |((factor, ratio), saving): ((&f64, &f64), &f64)| {
            let change = (0.5 * DAMPING * (level - ratio)).clamp(-MAX_AT_ONCE, MAX_AT_ONCE);
            if *saving > 0.0 { (factor + change).clamp(-MOST, MOST) - factor } else { 0.0 }
        };
        places.map(change).collect()
    }

    /// As [`Steps::changes`], towards the level at which all steps together save `wanted` bytes, or as near
    /// as the bounds allow: what they save grows with the level.
    fn changes_to(&self, ratios: &[f64], wanted: f64) -> Vec<f64> {
        let saved = |changes: &[f64]| -> f64 {
            let places = self.factors.as_flattened().iter().zip(changes).zip(self.savings.as_flattened());
            places.map(|((factor, change), saving)| saving * (factor + change)).sum()
        };
        let (mut low, mut high) = (-LEVELS, LEVELS);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if saved(&self.changes(ratios, middle)) < wanted { low = middle } else { high = middle }
        }
        self.changes(ratios, 0.5 * (low + high))
    }

    /// Lengthens all steps alike so that they save `bytes` more, as far as savings add up and the bounds
    /// allow, and keeps to that. False where steps do not keep to a size, or save nothing.
    pub(super) fn save(&mut self, bytes: f64) -> bool {
        let all: f64 = self.savings.as_flattened().iter().sum();
        let Some(RateControl::Size { saved }) = &mut self.control else { return false };
        if all <= 0.0 {
            return false;
        }
        // What the bounds do not allow is not asked for later, either.
        *saved = (*saved + bytes).min(MOST * all);
        self.before.clone_from(&self.factors);
        let places = self.factors.as_flattened_mut().iter_mut().zip(self.savings.as_flattened());
        for (factor, _) in places.filter(|(_, saving)| **saving > 0.0) {
            *factor = (*factor + bytes / all).clamp(-MOST, MOST);
        }
        self.factors != self.before
    }

    /// Takes the last change back and stays there. False if there is none to take back.
    pub(super) fn step_back(&mut self) -> bool {
        self.control = None;
        let is_back = self.factors != self.before;
        self.factors.clone_from(&self.before);
        is_back
    }

    /// `decisions`, as the encoder made them, with these steps.
    pub(super) fn of(&self, decisions: &Decisions) -> Decisions {
        scaled(decisions, &self.factors)
    }
}

/// Which row of quantisers cluster `cluster` of epoch `epoch` is coded with.
pub(super) fn row(decisions: &Decisions, epoch: usize, cluster: usize) -> usize {
    let Decisions::Dgs1(all) = decisions else { return 0 };
    let cluster = all.epochs.get(epoch).and_then(|epoch| epoch.clusters.get(cluster));
    cluster.map_or(0, |cluster| cluster.quantisers)
}

/// Rows of quantisers that `decisions` have in an epoch, at most.
pub(super) fn rows(decisions: &Decisions) -> usize {
    match decisions {
        Decisions::Dgs1(all) => all.epochs.iter().map(|epoch| epoch.quantisers.len()).max().unwrap_or(0),
        Decisions::Paper(_) => 1,
    }
}

/// `decisions` with each learned step times the exponential of its entry of `factors`.
fn scaled(decisions: &Decisions, factors: &[PerClass]) -> Decisions {
    let mut decisions = decisions.clone();
    let scale = |quantisers: &mut Quantisers, factors: &PerClass| {
        for ((class, _), factor) in LEARNED.iter().zip(factors) {
            let times = |decision: &mut QuantiserDecision| {
                decision.step = (f64::from(decision.step) * factor.exp()) as f32;
            };
            times(&mut quantisers.canonical[class.index()]);
            times(&mut quantisers.motion[class.index()]);
        }
    };
    match &mut decisions {
        Decisions::Dgs1(all) => {
            for epoch in &mut all.epochs {
                epoch.quantisers.iter_mut().zip(factors).for_each(|(row, factors)| scale(row, factors));
            }
        }
        Decisions::Paper(all) => {
            for epoch in &mut all.epochs {
                factors.first().into_iter().for_each(|factors| scale(&mut epoch.quantisers, factors));
            }
        }
    }
    decisions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        import::{Limits, synth},
        train::delivery::coded::Coded,
    };

    const SAME_SIZE: RateControl = RateControl::Size { saved: 0.0 };

    /// An objective that grows with the square of its steps, whose bytes fall with their logarithms.
    struct Bowl {
        weights: Vec<PerClass>,
        savings: Vec<PerClass>,
    }

    impl Bowl {
        fn new() -> Self {
            let weights = vec![[1.0, 4.0, 0.5, 2.0, 1.0], [2.0, 0.6, 1.5, 0.0, 1.0]];
            let savings = vec![[1000.0, 2000.0, 700.0, 900.0, 400.0], [3000.0, 800.0, 0.0, 500.0, 1000.0]];
            Self { weights, savings }
        }

        fn slopes(&self, steps: &Steps) -> Vec<PerClass> {
            let pairs = self.weights.iter().zip(&steps.factors);
            pairs.map(|(w, x)| std::array::from_fn(|c| 2.0 * w[c] * (2.0 * x[c]).exp())).collect()
        }

        fn objective(&self, steps: &Steps) -> f64 {
            0.5 * self.slopes(steps).as_flattened().iter().sum::<f64>()
        }

        fn bytes(&self, steps: &Steps) -> f64 {
            let pairs = self.savings.as_flattened().iter().zip(steps.factors.as_flattened());
            50_000.0 - pairs.map(|(saving, x)| saving * x).sum::<f64>()
        }

        /// Steps after many changes.
        fn reached(&self, control: RateControl) -> Steps {
            let none = vec![PerClass::default(); 2];
            let (factors, before, slopes) = (none.clone(), none.clone(), none);
            let mut steps =
                Steps { factors, before, slopes, savings: self.savings.clone(), control: Some(control) };
            for _ in 0..400 {
                steps.observe(&self.slopes(&steps));
                steps.advance();
            }
            steps
        }

        fn slopes_per_byte(&self, steps: &Steps) -> Vec<f64> {
            let slopes = self.slopes(steps);
            let pairs = slopes.as_flattened().iter().zip(self.savings.as_flattened());
            // What saves nothing stays; what does not show goes as far as it may.
            pairs.filter(|(slope, saving)| **saving > 0.0 && **slope > 0.0).map(|(s, b)| s / b).collect()
        }
    }

    #[test]
    fn equal_slopes_per_byte_are_reached_at_the_same_size() {
        let bowl = Bowl::new();
        let steps = bowl.reached(SAME_SIZE);
        let found = bowl.slopes_per_byte(&steps);
        let (low, high) = found.iter().fold((f64::MAX, 0f64), |(l, h), &v| (l.min(v), h.max(v)));
        assert!(found.len() == 8 && high / low < 1.02, "{found:?}");
        assert!((bowl.bytes(&steps) - 50_000.0).abs() < 5.0, "{}", bowl.bytes(&steps));
        let given = Steps { factors: vec![PerClass::default(); 2], ..steps.clone() };
        assert!(bowl.objective(&steps) < 0.95 * bowl.objective(&given), "the same bytes show more");
        assert_eq!((steps.factors[1][2], steps.factors[1][3]), (0.0, MOST));
        // Any two steps changed at the same size are worse: the comparison can fail.
        let mut other = steps.clone();
        other.factors[0][1] += 0.2;
        other.factors[0][0] -= 0.2 * 2000.0 / 1000.0;
        assert!(bowl.objective(&other) > bowl.objective(&steps));
    }

    #[test]
    fn what_is_too_large_is_lengthened_and_stays_so() {
        let bowl = Bowl::new();
        let mut steps = bowl.reached(SAME_SIZE);
        assert!(steps.save(1000.0));
        assert!((bowl.bytes(&steps) - 49_000.0).abs() < 250.0, "bounds hold some: {}", bowl.bytes(&steps));
        for _ in 0..400 {
            steps.observe(&bowl.slopes(&steps));
            steps.advance();
        }
        assert!((bowl.bytes(&steps) - 49_000.0).abs() < 5.0, "{}", bowl.bytes(&steps));
        assert!(!bowl.reached(RateControl::Price(2e-3)).save(1000.0), "a price has no size");
    }

    #[test]
    fn a_price_is_met_by_every_step() {
        let bowl = Bowl::new();
        let price = 2e-3;
        let steps = bowl.reached(RateControl::Price(price));
        let found = bowl.slopes_per_byte(&steps);
        assert!(found.iter().all(|slope| (slope / price - 1.0).abs() < 0.02), "{found:?}");
        assert!(bowl.bytes(&bowl.reached(RateControl::Price(2.0 * price))) < bowl.bytes(&steps));
    }

    #[test]
    fn a_step_back_is_the_last_change_and_ends_the_learning() {
        let bowl = Bowl::new();
        let mut steps = bowl.reached(SAME_SIZE);
        let was = steps.factors.clone();
        steps.observe(&[[1.0; Class::MOVING]; 2]);
        steps.advance();
        assert_ne!(steps.factors, was);
        assert!(steps.step_back() && steps.factors == was);
        steps.advance();
        assert!(!steps.step_back() && steps.factors == was);
    }

    /// Every longer step saves bytes or counts as saving none; those of whole attributes save.
    #[test]
    fn savings_are_those_of_streams_with_longer_steps() {
        let of = synth::SynthOptions {
            gaussians: 3000,
            frames: 4,
            kind: synth::SynthKind::Figure,
            ..Default::default()
        };
        let scene = synth::make(&of, &Limits::default()).unwrap();
        for options in [encode::EncodeOptions::default(), encode::EncodeOptions::paper()] {
            let coded = Coded::first(&scene, &options).unwrap();
            let steps = Steps::learned(&scene, &coded.encoded, options.table_choices, 0.0).unwrap();
            let all: f64 = steps.savings.as_flattened().iter().sum();
            let mut longer = steps.clone();
            let wire = |steps: &Steps| {
                let (decisions, no_progress) = (steps.of(&coded.encoded.decisions), &encode::no_progress);
                let again = encode::with_levels(&scene, &decisions, &[], options.table_choices, no_progress);
                again.unwrap().report.ledger.wire()
            };
            assert_eq!(steps.control, Some(SAME_SIZE));
            let mut with = |factor: f64| {
                longer.factors.as_flattened_mut().fill(factor);
                wire(&longer)
            };
            let together = (with(-PROBE) - with(PROBE)) / (2.0 * PROBE);
            assert!((0.5..2.0).contains(&(all / together)), "{all} {together}");
        }
    }
}
