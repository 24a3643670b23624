//! A channel loses packets as a network does, by a seed: what arrives, and when.

use std::collections::VecDeque;

/// What a channel does to packets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Conditions {
    /// Share of packets lost, 0 to 0.95.
    pub loss: f64,
    /// Mean number of packets lost in a row, 1 to 100; at 1 losses are independent.
    pub burst: f64,
    /// Bits per second; `None` for all at once.
    pub rate_bps: Option<f64>,
    /// Seconds from the end of sending to arrival, 0 to 10.
    pub delay_s: f64,
    /// Which packets are lost.
    pub seed: u64,
}

impl Default for Conditions {
    fn default() -> Self {
        Self { loss: 0.0, burst: 1.0, rate_bps: None, delay_s: 0.0, seed: 1 }
    }
}

impl Conditions {
    /// The same within their bounds; what is no number is left out.
    #[must_use]
    pub fn bounded(self) -> Self {
        let or = |value: f64, otherwise: f64| if value.is_finite() { value } else { otherwise };
        Self {
            loss: or(self.loss, 0.0).clamp(0.0, 0.95),
            burst: or(self.burst, 1.0).clamp(1.0, 100.0),
            rate_bps: self.rate_bps.filter(|rate| rate.is_finite()).map(|rate| rate.max(1e3)),
            delay_s: or(self.delay_s, 0.0).clamp(0.0, 10.0),
            seed: self.seed,
        }
    }

    /// Whether every packet arrives at once.
    pub fn is_perfect(&self) -> bool {
        self.loss == 0.0 && self.rate_bps.is_none() && self.delay_s == 0.0
    }
}

/// Packets on their way: a two-state model of loss (Gilbert), a rate and a delay.
#[derive(Clone, Debug)]
pub struct Channel {
    conditions: Conditions,
    random: u64,
    /// Whether the packet before was lost; `None` before the first.
    losing: Option<bool>,
    /// When all that was handed over is sent, seconds.
    free_s: f64,
    /// Of each packet that is not through: when it is, seconds, and whether it arrives.
    on_way: VecDeque<(f64, bool)>,
}

impl Channel {
    /// A channel under `conditions`, brought within their bounds.
    pub fn new(conditions: Conditions) -> Self {
        let conditions = conditions.bounded();
        let (free_s, on_way) = (f64::NEG_INFINITY, VecDeque::new());
        Self { conditions, random: conditions.seed, losing: None, free_s, on_way }
    }

    /// Its conditions.
    pub fn conditions(&self) -> Conditions {
        self.conditions
    }

    /// Sends the next packet, of `bytes` bytes, once those before are sent; it was handed over at `handed_s`,
    /// seconds.
    pub fn send(&mut self, bytes: usize, handed_s: f64) {
        let Conditions { loss, burst, rate_bps, delay_s, .. } = self.conditions;
        self.free_s = self.free_s.max(handed_s) + rate_bps.map_or(0.0, |rate| 8.0 * bytes as f64 / rate);
        // From one state to the other so often that the share lost is `loss` and runs are `burst` long.
        let chance = match self.losing {
            None => loss,
            Some(true) if burst > 1.0 => 1.0 - 1.0 / burst,
            Some(false) if burst > 1.0 => (loss / (burst * (1.0 - loss))).min(1.0),
            Some(_) => loss,
        };
        let lost = self.uniform() < chance;
        self.losing = Some(lost);
        self.on_way.push_back((self.free_s + delay_s, !lost));
    }

    /// The next packet that is through at `now_s`, seconds: true where it arrives, false where it is lost;
    /// `None` where none is.
    pub fn next_through(&mut self, now_s: f64) -> Option<bool> {
        self.on_way.pop_front_if(|(due_s, _)| *due_s <= now_s).map(|(_, arrives)| arrives)
    }

    /// Packets that are not through.
    pub fn on_way(&self) -> usize {
        self.on_way.len()
    }

    /// The next number of SplitMix64, in 0..1.
    fn uniform(&mut self) -> f64 {
        self.random = self.random.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.random;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lost(conditions: Conditions, packets: usize) -> Vec<bool> {
        let mut channel = Channel::new(conditions);
        (0..packets).for_each(|_| channel.send(1000, 0.0));
        std::iter::from_fn(|| channel.next_through(0.0)).map(|arrives| !arrives).collect()
    }

    #[test]
    fn as_many_are_lost_as_said_in_runs_as_long_as_said() {
        for (loss, burst) in [(0.1, 1.0), (0.1, 8.0), (0.5, 3.0), (0.02, 4.0)] {
            let lost = lost(Conditions { loss, burst, ..Conditions::default() }, 200_000);
            let share = lost.iter().filter(|&&l| l).count() as f64 / lost.len() as f64;
            assert!((share / loss - 1.0).abs() < 0.08, "{loss} {burst}: {share}");
            let runs = lost.windows(2).filter(|pair| !pair[0] && pair[1]).count() as f64;
            let mean = share * lost.len() as f64 / runs;
            let wanted = if burst > 1.0 { burst } else { 1.0 / (1.0 - loss) };
            assert!((mean / wanted - 1.0).abs() < 0.08, "{loss} {burst}: runs of {mean}");
        }
    }

    #[test]
    fn a_seed_says_which() {
        let some = Conditions { loss: 0.3, ..Conditions::default() };
        assert_eq!(lost(some, 1000), lost(some, 1000));
        assert_ne!(lost(some, 1000), lost(Conditions { seed: 2, ..some }, 1000));
        assert!(!lost(Conditions::default(), 1000).contains(&true));
    }

    #[test]
    fn a_rate_says_when() {
        let due_s = |conditions, handed_s: &[f64]| -> Vec<f64> {
            let mut channel = Channel::new(conditions);
            handed_s.iter().for_each(|&handed_s| channel.send(1000, handed_s));
            channel.on_way.iter().map(|(due_s, _)| *due_s).collect()
        };
        let at_rate = Conditions { rate_bps: Some(80_000.0), ..Conditions::default() };
        // A packet takes 0.1 s, after those before it; what was not used of the rate is gone.
        let expected = [5.1, 5.2, 5.3, 9.1, 9.2];
        let found = due_s(at_rate, &[5.0, 5.0, 5.15, 9.0, 9.01]);
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        assert_eq!(due_s(Conditions::default(), &[3.0, 4.0]), [3.0, 4.0]);
        let late = Conditions { delay_s: 0.25, ..Conditions::default() };
        assert!(!late.is_perfect());
        assert_eq!(due_s(late, &[0.0, 10.0]), [0.25, 10.25]);
        let mut channel = Channel::new(late);
        channel.send(1000, 1.0);
        assert_eq!((channel.next_through(1.2), channel.on_way()), (None, 1));
        assert_eq!((channel.next_through(1.25), channel.on_way()), (Some(true), 0));
    }

    #[test]
    fn conditions_stay_within_bounds() {
        let wild = Conditions { loss: f64::NAN, burst: 1e9, rate_bps: Some(-1.0), delay_s: -1.0, seed: 0 };
        let wild = wild.bounded();
        assert_eq!((wild.loss, wild.burst, wild.rate_bps, wild.delay_s), (0.0, 100.0, Some(1e3), 0.0));
        assert_eq!(Conditions { loss: 2.0, ..wild }.bounded().loss, 0.95);
        assert_eq!(Conditions { rate_bps: Some(f64::INFINITY), ..wild }.bounded().rate_bps, None);
    }
}
