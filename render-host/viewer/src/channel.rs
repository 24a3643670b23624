//! A channel loses packets as a network does, by a seed: what arrives, and when.

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

/// Packets on their way: a two-state model of loss (Gilbert) and a rate.
#[derive(Clone, Debug)]
pub struct Channel {
    conditions: Conditions,
    random: u64,
    /// Whether the packet before was lost; `None` before the first.
    losing: Option<bool>,
    bits: f64,
}

impl Channel {
    /// A channel under `conditions`, brought within their bounds.
    pub fn new(conditions: Conditions) -> Self {
        let conditions = conditions.bounded();
        Self { conditions, random: conditions.seed, losing: None, bits: 0.0 }
    }

    /// Its conditions.
    pub fn conditions(&self) -> Conditions {
        self.conditions
    }

    /// Sends the next packet, of `bytes` bytes; true when it arrives.
    pub fn send(&mut self, bytes: usize) -> bool {
        self.bits += 8.0 * bytes as f64;
        let Conditions { loss, burst, .. } = self.conditions;
        // From one state to the other so often that the share lost is `loss` and runs are `burst` long.
        let chance = match self.losing {
            None => loss,
            Some(true) if burst > 1.0 => 1.0 - 1.0 / burst,
            Some(false) if burst > 1.0 => (loss / (burst * (1.0 - loss))).min(1.0),
            Some(_) => loss,
        };
        let lost = self.uniform() < chance;
        self.losing = Some(lost);
        !lost
    }

    /// When the next packet, of `bytes` bytes, is through: seconds since the first was sent.
    pub fn due_s(&self, bytes: usize) -> f64 {
        let sent_s = self.conditions.rate_bps.map_or(0.0, |rate| (self.bits + 8.0 * bytes as f64) / rate);
        sent_s + self.conditions.delay_s
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
        (0..packets).map(|_| !channel.send(1000)).collect()
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
        let mut channel = Channel::new(Conditions { rate_bps: Some(80_000.0), ..Conditions::default() });
        assert!((channel.due_s(1000) - 0.1).abs() < 1e-12);
        channel.send(1000);
        assert!((channel.due_s(1000) - 0.2).abs() < 1e-12);
        assert_eq!(Channel::new(Conditions::default()).due_s(1000), 0.0);
        let late = Conditions { delay_s: 0.25, ..Conditions::default() };
        assert!(!late.is_perfect());
        assert_eq!(Channel::new(late).due_s(1000), 0.25);
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
