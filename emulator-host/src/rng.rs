//! Makes random streams, keyed by a seed and the label of their owner.
//!
//! Adding a box to a chain, or drawing more numbers in one box, changes no draw of another box: this is what
//! lets every policy meet the same losses (common random numbers).

use rand::Rng;
use rand_pcg::Pcg64;

/// A random stream with one owner.
#[derive(Clone, Debug)]
pub struct RandomStream(Pcg64);

/// The stream of the owner called `label` in the run with `seed`.
pub fn stream(seed: u64, label: &str) -> RandomStream {
    let low = fnv(0xcbf2_9ce4_8422_2325, label.as_bytes());
    let high = fnv(low ^ 0x9e37_79b9_7f4a_7c15, label.as_bytes());
    let state = (u128::from(mix(seed ^ high)) << 64) | u128::from(mix(seed.wrapping_add(low)));
    RandomStream(Pcg64::new(state, (u128::from(high) << 64) | u128::from(low)))
}

impl RandomStream {
    /// 64 uniform bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// Uniform in `0..=max`, by multiplication (bias below 2⁻³² for `max` below 2³²).
    pub fn up_to(&mut self, max: u64) -> u64 {
        match max.checked_add(1) {
            Some(span) => ((u128::from(self.0.next_u64()) * u128::from(span)) >> 64) as u64,
            None => self.0.next_u64(),
        }
    }

    /// True with this probability. Always draws once, so that later draws do not depend on the probability.
    pub fn happens(&mut self, probability: Probability) -> bool {
        (self.0.next_u64() >> 32) < probability.0
    }
}

/// A probability held as an integer in units of 2⁻³², so that a comparison on the event path is exact.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Probability(u64);

impl Probability {
    /// From a probability in 0..=1; `None` for anything else, NaN included.
    pub fn new(probability: f64) -> Option<Self> {
        let legal = (0.0..=1.0).contains(&probability);
        legal.then_some(Self((probability * 4_294_967_296.0) as u64))
    }
}

fn fnv(offset: u64, bytes: &[u8]) -> u64 {
    bytes.iter().fold(offset, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

/// SplitMix64's finaliser: neighbouring seeds give unrelated states.
fn mix(value: u64) -> u64 {
    let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    value ^ (value >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_differ_by_seed_and_by_label_and_repeat() {
        let first = stream(1, "loss").bits();
        assert_eq!(first, stream(1, "loss").bits());
        assert_ne!(first, stream(2, "loss").bits());
        assert_ne!(first, stream(1, "loss2").bits());
    }

    #[test]
    fn chance_is_honest_at_the_ends_and_in_between() {
        let mut draws = stream(7, "chance");
        assert!((0..1000).all(|_| !draws.happens(Probability(0))));
        assert!((0..1000).all(|_| draws.happens(Probability::new(1.0).unwrap())));
        let quarter = Probability::new(0.25).unwrap();
        let hits = (0..100_000).filter(|_| draws.happens(quarter)).count();
        assert!((24_500..25_500).contains(&hits), "{hits}");
        assert_eq!(Probability::new(f64::NAN), None);
        assert_eq!(Probability::new(-0.1), None);
    }
}
