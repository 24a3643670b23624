//! Empties the path for a moment once its smallest round trip is old, as ProbeRTT of BBR does
//! (draft-ietf-ccwg-bbr).
//!
//! A sender that fills the path keeps a queue of its own there all the time. Round trips then never show how
//! long the path itself is, and what a filter over the last seconds says of it grows with the queue, whose
//! bound would grow with it.

use super::view_state::PathFacts;
use crate::{clock::Nanos, congestion::RecentMinimum};

/// Datagrams that may be in flight meanwhile (draft-ietf-ccwg-bbr, BBRMinPipeCwnd).
const DATAGRAMS: u64 = 4;
/// Longest time that one takes: afterwards the old round trip is forgotten.
const LONGEST: Nanos = Nanos::from_s(1);
/// Time from the end of one to the next at the earliest.
const REST: Nanos = Nanos::from_s(9);

/// Whether the path is being emptied.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Idle,
    /// What is in flight is more than [`DATAGRAMS`].
    Draining { until: Nanos },
    /// What leaves finds no queue; a round trip later it has been measured.
    Measuring { until: Nanos },
}

/// The probe.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RoundTripProbe {
    state: State,
    next_at: Nanos,
}

impl RoundTripProbe {
    /// There is news of the path at `now`.
    pub(super) fn look(&mut self, path: &PathFacts, now: Nanos) {
        let is_stale = RecentMinimum::is_stale(path.minimum_rtt_age);
        let is_full = path.in_flight > DATAGRAMS * path.datagram_bytes;
        match self.state {
            // What leaves into an empty path measures it without help.
            State::Idle if is_stale && is_full && now >= self.next_at => {
                self.state = State::Draining { until: now + LONGEST };
            }
            State::Draining { until } | State::Measuring { until } if !is_stale || now >= until => {
                *self = Self { state: State::Idle, next_at: now + REST };
            }
            State::Idle | State::Draining { .. } | State::Measuring { .. } => {}
        }
        if let State::Draining { until } = self.state
            && !is_full
        {
            self.state = State::Measuring { until: until.min(now + path.smoothed_rtt) };
        }
    }

    /// Until when media stay out of a path of which this is known; `None` if they may leave.
    pub(super) fn holds_until(&self, path: &PathFacts, now: Nanos) -> Option<Nanos> {
        let until = match self.state {
            State::Idle => return None,
            State::Draining { until } | State::Measuring { until } => until,
        };
        (path.in_flight >= DATAGRAMS * path.datagram_bytes && now < until).then_some(until)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(in_flight: u64, age_ms: u64) -> PathFacts {
        PathFacts {
            smoothed_rtt: Nanos::from_ms(100),
            minimum_rtt: Nanos::from_ms(60),
            minimum_rtt_age: Nanos::from_ms(age_ms),
            in_flight,
            ..PathFacts::unknown(1200)
        }
    }

    #[test]
    fn an_old_minimum_empties_the_path_for_a_round_trip() {
        let (mut probe, at) = (RoundTripProbe::default(), Nanos::from_ms);
        let mut waits = |in_flight, age_ms, now_ms| {
            let path = path(in_flight, age_ms);
            probe.look(&path, at(now_ms));
            probe.holds_until(&path, at(now_ms))
        };
        assert_eq!(waits(60_000, 9_999, 9_999), None);
        assert_eq!(waits(4_800, 10_000, 10_000), None);
        assert_eq!(waits(60_000, 10_000, 10_000), Some(at(11_000)));
        assert_eq!(waits(30_000, 10_050, 10_050), Some(at(11_000)));
        // Empty enough: four may be out while the round trip is measured.
        assert_eq!(waits(3_000, 10_080, 10_080), None);
        assert_eq!(waits(4_800, 10_081, 10_081), Some(at(10_180)));
        // It is over, and for a while there is no other, whatever it has found.
        assert_eq!(waits(60_000, 10_180, 10_180), None);
        assert_eq!(waits(60_000, 10_500, 15_000), None);
        assert_eq!(waits(60_000, 10_000, 19_180), Some(at(20_180)));
    }

    #[test]
    fn a_round_trip_that_is_measured_meanwhile_ends_it() {
        let (mut probe, now) = (RoundTripProbe::default(), Nanos::from_s(12));
        probe.look(&path(60_000, 10_000), now);
        assert!(probe.holds_until(&path(60_000, 10_000), now).is_some());
        probe.look(&path(60_000, 0), now);
        assert_eq!(probe.holds_until(&path(60_000, 0), now), None);
    }
}
