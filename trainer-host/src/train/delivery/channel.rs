//! Draws which packets of a stream arrive in time: a link's capacity, delay and deadline, and two kinds of
//! erasure.

use rand::RngExt;
use rand_pcg::Pcg64;

/// How a delivery loses packets or groups.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum LossModel {
    /// Nothing is lost.
    None,
    /// Each is lost on its own with this probability, 0..=1.
    Iid {
        /// The probability.
        probability: f64,
    },
    /// Losses come in bursts (Gilbert–Elliott with a good state that loses nothing and a bad one that loses
    /// all).
    Burst {
        /// Share that is lost in the long run, 0 to length / (1 + length).
        share: f64,
        /// Mean length of a burst, at least 1.
        length: f64,
    },
}

impl LossModel {
    /// The largest share that bursts of a mean `length` can take: one arrives between two bursts at least.
    pub(super) fn most_in_bursts(length: f64) -> f64 {
        length / (1.0 + length)
    }

    /// For each of `count` in the order of sending, whether it is lost.
    pub(super) fn lost(&self, count: usize, rng: &mut Pcg64) -> Vec<bool> {
        match *self {
            Self::None => vec![false; count],
            Self::Iid { probability } => (0..count).map(|_| rng.random::<f64>() < probability).collect(),
            Self::Burst { share, length } => {
                let recover = 1.0 / length.max(1.0);
                let fail = (recover * share / (1.0 - share).max(1e-9)).min(1.0);
                let mut is_bad = rng.random::<f64>() < share;
                let mut lost = Vec::with_capacity(count);
                for _ in 0..count {
                    lost.push(is_bad);
                    let flips = rng.random::<f64>() < if is_bad { recover } else { fail };
                    is_bad ^= flips;
                }
                lost
            }
        }
    }
}

/// A link and when its pictures are shown. The stream is sent from its first packet on, at full capacity; a
/// packet that is lost is sent once more, after everything else and at least one round trip after it was
/// sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Link {
    /// Whole streams that it carries per second.
    pub capacity: f64,
    /// Round-trip time, seconds.
    pub round_trip_s: f64,
    /// Time from the first byte sent to the display, seconds.
    pub deadline_s: f64,
    pub loss: LossModel,
}

impl Link {
    /// For each packet of `bytes`, in the order of sending, whether it arrives before the deadline.
    pub(super) fn delivered(&self, bytes: &[usize], rng: &mut Pcg64) -> Vec<bool> {
        let total = bytes.iter().sum::<usize>().max(1) as f64;
        let rate = self.capacity * total;
        let lost = self.loss.lost(bytes.len(), rng);
        let again = self.loss.lost(bytes.len(), rng);
        let mut sent_s = 0.0;
        let mut delivered = Vec::with_capacity(bytes.len());
        let mut known_s = Vec::with_capacity(bytes.len());
        for (&bytes, &lost) in bytes.iter().zip(&lost) {
            sent_s += bytes as f64 / rate;
            known_s.push(sent_s + self.round_trip_s);
            delivered.push(!lost && sent_s + 0.5 * self.round_trip_s <= self.deadline_s);
        }
        for (index, &bytes) in bytes.iter().enumerate() {
            if lost[index] {
                sent_s = sent_s.max(known_s[index]) + bytes as f64 / rate;
                delivered[index] = !again[index] && sent_s + 0.5 * self.round_trip_s <= self.deadline_s;
            }
        }
        delivered
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rng(seed: u64) -> Pcg64 {
        Pcg64::new(u128::from(seed), 7)
    }

    #[test]
    fn shares_and_bursts_are_as_long_as_they_should_be() {
        let count = 200_000;
        let share = |lost: &[bool]| lost.iter().filter(|&&l| l).count() as f64 / count as f64;
        let bursts = |lost: &[bool]| lost.windows(2).filter(|pair| !pair[0] && pair[1]).count() as f64;
        let length = |lost: &[bool]| share(lost) * count as f64 / bursts(lost);
        let iid = LossModel::Iid { probability: 0.1 }.lost(count, &mut rng(1));
        assert!((share(&iid) - 0.1).abs() < 0.005 && (length(&iid) - 1.11).abs() < 0.05);
        let burst = LossModel::Burst { share: 0.1, length: 8.0 }.lost(count, &mut rng(1));
        assert!((share(&burst) - 0.1).abs() < 0.01, "{}", share(&burst));
        assert!((length(&burst) - 8.0).abs() < 0.4, "{}", length(&burst));
        let most = LossModel::most_in_bursts(4.0);
        let burst = LossModel::Burst { share: most, length: 4.0 }.lost(count, &mut rng(1));
        assert!((share(&burst) - most).abs() < 0.01 && (length(&burst) - 4.0).abs() < 0.2);
        assert!(LossModel::None.lost(9, &mut rng(1)).iter().all(|l| !l));
    }

    #[test]
    fn capacity_delay_and_deadline_cut_the_end_off() {
        let bytes = [100; 20];
        let link = Link { capacity: 1.0, round_trip_s: 0.1, deadline_s: 0.55, loss: LossModel::None };
        let count = |link: Link| link.delivered(&bytes, &mut rng(2)).iter().filter(|&&d| d).count();
        // Half a stream's time is left after half a round trip.
        assert_eq!(link.delivered(&bytes, &mut rng(2)), (0..20).map(|i| i < 10).collect::<Vec<_>>());
        assert_eq!(count(Link { capacity: 2.1, ..link }), 20);
        assert_eq!(count(Link { round_trip_s: 0.3, ..link }), 8);
        assert_eq!(count(Link { deadline_s: 0.04, ..link }), 0);
    }

    /// Whether a packet has arrived is known a round trip after it was sent, not before.
    #[test]
    fn nothing_is_sent_again_before_its_loss_is_known() {
        let loss = LossModel::Iid { probability: 0.5 };
        let link = Link { capacity: 1.0, round_trip_s: 0.2, deadline_s: 0.0, loss };
        // Seeds of which the second of two packets alone is lost, and arrives when it is sent again: it is
        // sent by 1.0 s, known to be lost at 1.2 s, sent again by 1.7 s and there at 1.8 s.
        let at = |seed, deadline_s| Link { deadline_s, ..link }.delivered(&[100; 2], &mut rng(seed));
        let is_such = |seed: &u64| at(*seed, 9.0) == [true, true] && at(*seed, 1.2) == [true, false];
        let seeds: Vec<u64> = (0..64).filter(is_such).collect();
        assert!(!seeds.is_empty());
        for seed in seeds {
            assert_eq!((at(seed, 1.75)[1], at(seed, 1.85)[1]), (false, true), "{seed}");
        }
    }

    #[test]
    fn what_is_lost_comes_once_more_if_there_is_time() {
        let bytes = [100; 200];
        let count = |deadline_s| {
            let loss = LossModel::Iid { probability: 0.2 };
            let link = Link { capacity: 1.0, round_trip_s: 0.1, deadline_s, loss };
            link.delivered(&bytes, &mut rng(3)).iter().filter(|&&d| d).count()
        };
        assert!((140..180).contains(&count(1.06)), "{}", count(1.06));
        assert!((185..200).contains(&count(2.0)), "{}", count(2.0));
    }
}
