//! Makes a synthetic trace that resembles a mobile link, so that a demo needs no file.
//!
//! Steps of 100 ms. The link is good (mostly), middling or in a deep fade; stays are 1 to 4 s, 0.5 to 2 s and
//! 0.3 to 1.5 s. Within a state the rate wanders by a quarter. At the end all rates are scaled so that the
//! mean is 4 Mbit/s.

use super::{MAX_PERIOD, Step, Trace};
use crate::{
    clock::{Nanos, Rate},
    rng::stream,
};

const STEP: Nanos = Nanos::from_ms(100);
const MEAN: u64 = 4_000_000;

impl Trace {
    /// A built-in trace of mean 4 Mbit/s (within 1 %) with fades to a few per cent of it; see the module
    /// `bursty`.
    pub fn bursty(seed: u64, length: Nanos) -> Self {
        generate(seed, length)
    }
}

fn generate(seed: u64, length: Nanos) -> Trace {
    let mut random = stream(seed, "trace/bursty");
    let count = (length.min(MAX_PERIOD).0.div_ceil(STEP.0)).max(1);
    let mut rates: Vec<u64> = Vec::with_capacity(count as usize);
    while (rates.len() as u64) < count {
        let (centre, shortest, spread) = match random.up_to(9) {
            0..=4 => (6_500_000, 10, 30),
            5..=7 => (3_000_000, 5, 15),
            _ => (120_000, 3, 12),
        };
        for _ in 0..=shortest + random.up_to(spread) {
            rates.push(centre * 3 / 4 + random.up_to(centre / 2));
        }
    }
    rates.truncate(count as usize);
    let sum = rates.iter().map(|rate| u128::from(*rate)).sum::<u128>().max(1);
    let scale = |rate: u64| u128::from(rate) * u128::from(MEAN) * u128::from(count) / sum;
    let steps: Vec<Step> = (0..count)
        .zip(&rates)
        .map(|(at, rate)| Step { at: STEP.times(at), rate: Rate(scale(*rate) as u64) })
        .collect();
    let period = STEP.times(count);
    Trace::raw(&format!("bursty-{seed}"), super::Shape::Steps(steps.into()), period)
}

#[cfg(test)]
mod tests {
    use super::super::Shape;
    use super::*;

    #[test]
    fn the_mean_is_four_and_there_are_fades() {
        for seed in 0..20 {
            let trace = generate(seed, Nanos::from_s(60));
            let mean = trace.mean_rate().0;
            assert!((3_960_000..=4_040_000).contains(&mean), "{mean}");
            let Shape::Steps(steps) = trace.shape() else { panic!("steps") };
            assert!(steps.iter().any(|step| step.rate.0 < 300_000), "seed {seed} has no fade");
        }
    }
}
