//! Sets the window by NewReno (RFC 9002, 7 and appendix B), counting bytes.

use super::{Acked, Controller, DeliverySample, Rtt, initial_window, minimum_window};
use crate::clock::{Bytes, Nanos, Rate};

/// Slow start, additive increase, one halving per recovery period.
#[derive(Clone, Debug)]
pub struct NewReno {
    datagram: u64,
    window: u64,
    threshold: u64,
    /// Bytes acknowledged since the window last grew in congestion avoidance.
    credit: u64,
    recovery_start: Option<Nanos>,
}

impl NewReno {
    /// Initial window, no threshold.
    pub fn new(datagram_bytes: u64) -> Self {
        Self {
            datagram: datagram_bytes,
            window: initial_window(datagram_bytes),
            threshold: u64::MAX,
            credit: 0,
            recovery_start: None,
        }
    }

    fn in_recovery(&self, sent_at: Nanos) -> bool {
        self.recovery_start.is_some_and(|start| sent_at <= start)
    }
}

impl Controller for NewReno {
    fn name(&self) -> &'static str {
        "newreno"
    }

    fn on_ack(&mut self, acked: Acked, _rtt: &Rtt, _now: Nanos) {
        if acked.app_limited || self.in_recovery(acked.sent_at) {
            return;
        }
        if self.window < self.threshold {
            self.window += acked.bytes;
            return;
        }
        self.credit += acked.bytes;
        if self.credit >= self.window {
            self.credit -= self.window;
            self.window += self.datagram;
        }
    }

    fn on_ack_end(&mut self, _sample: Option<DeliverySample>, _in_flight: u64, _rtt: &Rtt, _now: Nanos) {}

    fn on_congestion(&mut self, sent_at: Nanos, _lost_bytes: u64, _in_flight: u64, now: Nanos) -> bool {
        if self.in_recovery(sent_at) {
            return false;
        }
        self.recovery_start = Some(now);
        self.window = (self.window / 2).max(minimum_window(self.datagram));
        self.threshold = self.window;
        // Bytes acknowledged so far still count towards growth: RFC 9002, B.5 grows with every one of them.
        true
    }

    fn on_persistent_congestion(&mut self) {
        self.window = minimum_window(self.datagram);
        self.recovery_start = None;
        self.credit = 0;
    }

    fn window(&self) -> u64 {
        self.window
    }

    /// 1.25 windows per round trip (RFC 9002, 7.7).
    fn pacing_rate(&self, rtt: &Rtt) -> Rate {
        Rate::over(Bytes(self.window), rtt.smoothed()).scaled(5, 4)
    }

    fn is_probing(&self) -> bool {
        self.window < self.threshold
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_discards_no_growth_that_is_already_earned() {
        let rtt = Rtt::new(Nanos::from_ms(25));
        let mut reno = NewReno::new(1000);
        reno.on_congestion(Nanos::ZERO, 1000, 0, Nanos::from_ms(1));
        assert_eq!(reno.window(), 5000);
        let acknowledge = |reno: &mut NewReno, count: u64, ms: u64| {
            for _ in 0..count {
                let acked = Acked { bytes: 1000, sent_at: Nanos::from_ms(ms), app_limited: false };
                reno.on_ack(acked, &rtt, Nanos::from_ms(ms));
            }
        };
        // Four of the five datagrams that a step of growth takes, then a loss, then the fifth.
        acknowledge(&mut reno, 4, 10);
        reno.on_congestion(Nanos::from_ms(11), 1000, 0, Nanos::from_ms(12));
        assert_eq!(reno.window(), 2500);
        acknowledge(&mut reno, 1, 20);
        assert_eq!(reno.window(), 3500);
    }
}
