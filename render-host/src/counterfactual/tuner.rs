//! Finds how many worlds one call may hold under a memory budget.
//!
//! The tuner predicts before it probes: the first probe is the largest size that the prediction allows. A
//! probe that fits tells how good the prediction was, and the next is the largest size that the corrected
//! prediction allows; one that runs out of memory, or over the budget, is a bound from above, and the search
//! goes on below it. The answer is always a size that was probed and fitted.

/// Probes at most; bisection of any size below 2³² ends within them.
const MAX_PROBES: usize = 40;

/// A probe that could not get its memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("out of memory")]
pub struct OutOfMemory;

/// One probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Probe {
    /// Worlds tried.
    pub worlds: usize,
    /// Bytes predicted for them.
    pub predicted: u64,
    /// Bytes used at the peak, unless memory ran out.
    pub used: Result<u64, OutOfMemory>,
}

/// What the tuner found.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tuned {
    /// The largest number of worlds that was probed and fitted; 0 when not even one fits.
    pub worlds: usize,
    /// Every probe, in order.
    pub probes: Vec<Probe>,
}

/// Finds the largest number of worlds, up to `most`, whose probe uses at most `budget` bytes.
///
/// `predict` must not fall as worlds grow. `probe` runs a batch and says how much memory it used at its
/// peak. Usage is taken to grow with the number of worlds.
pub fn largest(
    budget: u64,
    most: usize,
    predict: impl Fn(usize) -> u64,
    mut probe: impl FnMut(usize) -> Result<u64, OutOfMemory>,
) -> Tuned {
    let mut out = Tuned { worlds: 0, probes: Vec::new() };
    // `out.worlds` fits, `past` does not.
    let mut past = most + 1;
    let mut correction = 1.0;
    while out.worlds + 1 < past && out.probes.len() < MAX_PROBES {
        let allowed = |worlds: usize| predict(worlds) as f64 * correction <= budget as f64;
        let guess = last(out.worlds, past, allowed);
        // After a first miss of the prediction, halve what is left, so that the end is always near.
        let middle = out.worlds + (past - out.worlds) / 2;
        let failed = out.probes.last().is_some_and(|p| p.used.is_err());
        let worlds = if failed { guess.min(middle) } else { guess };
        let worlds = worlds.clamp(out.worlds + 1, past - 1);
        let (predicted, used) = (predict(worlds), probe(worlds));
        out.probes.push(Probe { worlds, predicted, used });
        match used {
            Ok(used) => {
                correction = used as f64 / predicted.max(1) as f64;
                if used <= budget {
                    out.worlds = worlds;
                } else {
                    past = worlds;
                }
            }
            Err(OutOfMemory) => past = worlds,
        }
        // A corrected prediction that goes past the bound again and again must not creep: bisect.
        if out.probes.len() > 4 {
            correction = f64::NAN;
        }
    }
    out
}

/// Largest number in `low..past` that is allowed, if `allowed` is true up to some point; the middle when
/// nothing above `low` is.
fn last(low: usize, past: usize, allowed: impl Fn(usize) -> bool) -> usize {
    let (mut good, mut bad) = (low, past);
    while good + 1 < bad {
        let middle = good + (bad - good) / 2;
        if allowed(middle) { good = middle } else { bad = middle }
    }
    if good == low { low + (past - low) / 2 } else { good }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A machine with `memory` bytes, on which W worlds take `fixed + each · W`.
    fn machine(memory: u64, fixed: u64, each: u64) -> impl FnMut(usize) -> Result<u64, OutOfMemory> {
        move |worlds| {
            let used = fixed + each * worlds as u64;
            if used <= memory { Ok(used) } else { Err(OutOfMemory) }
        }
    }

    #[test]
    fn a_right_prediction_needs_one_probe_within_the_cap() {
        let predict = |w: usize| 1000 + 10 * w as u64;
        // 1500 bytes hold 50 worlds; that 51 do not is predicted, then confirmed.
        let tuned = largest(1500, 1000, predict, machine(u64::MAX, 1000, 10));
        assert_eq!((tuned.worlds, tuned.probes[0].worlds), (50, 50));
        let tuned = largest(1 << 40, 128, predict, machine(u64::MAX, 1000, 10));
        assert_eq!((tuned.worlds, tuned.probes.len()), (128, 1));
    }

    #[test]
    fn it_recovers_from_running_out_of_memory() {
        // The prediction is four times too low and the machine smaller than the budget.
        let predict = |w: usize| 250 + 10 * w as u64;
        let tuned = largest(100_000, 100_000, predict, machine(60_000, 1000, 40));
        assert_eq!(tuned.worlds, 59_000 / 40);
        assert_eq!(tuned.probes[0].used, Err(OutOfMemory));
        assert!(tuned.probes.len() <= 24, "{}", tuned.probes.len());
        let none = largest(100_000, 1000, predict, |_| Err(OutOfMemory));
        assert_eq!(none.worlds, 0);
        assert!(none.probes.iter().all(|p| p.used.is_err()) && none.probes.len() <= 12);
        assert_eq!(largest(10, 0, predict, |_| Ok(0)), Tuned { worlds: 0, probes: vec![] });
    }

    proptest! {
        #[test]
        fn it_finds_the_largest_that_fits(
            fixed in 0u64..100_000, each in 1u64..5000, guess_fixed in 0u64..100_000, guess in 0u64..5000,
            budget in 1u64..5_000_000, memory in 1u64..5_000_000, most in 1usize..5000,
        ) {
            let predict = |w: usize| guess_fixed + guess * w as u64;
            let tuned = largest(budget, most, predict, machine(memory, fixed, each));
            let room = budget.min(memory).checked_sub(fixed).map_or(0, |left| left / each);
            prop_assert_eq!(tuned.worlds, (room as usize).min(most));
            prop_assert!(tuned.probes.len() <= 24, "{} probes", tuned.probes.len());
        }
    }
}
