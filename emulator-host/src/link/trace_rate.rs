//! Serialises datagrams at a capacity that follows a [`Trace`], looping at the trace's period.
//!
//! Delivery opportunities follow mahimahi: each moves up to 1500 bytes at its instant; a datagram larger than
//! what is left straddles into the next; what is left when the queue runs empty is lost; an arrival at the
//! very instant of an opportunity is too late for it. Steps of rate are integrated exactly, in bits ×
//! nanoseconds.

use std::sync::Arc;

use super::{
    Counts, Datagram, LinkBox, QueueLimit,
    light_load::{LightFirst, LightLoad},
    serialiser::{Serialiser, Service},
};
use crate::{
    clock::Nanos,
    trace::{OPPORTUNITY_BYTES, Shape, Step, Trace},
};

/// Serialises at the pace of a trace.
#[derive(Debug)]
pub struct TraceRate {
    label: String,
    inner: Inner,
}

#[derive(Debug)]
enum Inner {
    Opportunities(Serialiser<LightFirst<Opportunities>>),
    Steps(Serialiser<LightFirst<Steps>>),
}

impl TraceRate {
    /// Starts at the beginning of `trace`; use [`Trace::window`] to start elsewhere.
    pub fn new(label: impl Into<String>, trace: &Trace, limit: QueueLimit) -> Self {
        Self::with_light_load(label, trace, limit, None)
    }

    /// The same, but that bursts after a pause pass as `light` says.
    pub(super) fn with_light_load(
        label: impl Into<String>,
        trace: &Trace,
        limit: QueueLimit,
        light: Option<LightLoad>,
    ) -> Self {
        let inner = match trace.shape() {
            Shape::Opportunities(at) => {
                let service = Opportunities {
                    at: Arc::clone(at),
                    period: trace.period(),
                    base: Nanos::ZERO,
                    next: 0,
                    left: 0,
                    now: Nanos::ZERO,
                };
                Inner::Opportunities(Serialiser::new(LightFirst::new(service, light), limit))
            }
            Shape::Steps(steps) => {
                let service = Steps::new(Arc::clone(steps), trace.period());
                Inner::Steps(Serialiser::new(LightFirst::new(service, light), limit))
            }
        };
        Self { label: label.into(), inner }
    }
}

impl LinkBox for TraceRate {
    fn label(&self) -> &str {
        &self.label
    }

    fn put(&mut self, datagram: Datagram, now: Nanos) {
        match &mut self.inner {
            Inner::Opportunities(serialiser) => serialiser.put(datagram, now),
            Inner::Steps(serialiser) => serialiser.put(datagram, now),
        }
    }

    fn take(&mut self, now: Nanos) -> Option<Datagram> {
        match &mut self.inner {
            Inner::Opportunities(serialiser) => serialiser.take(now),
            Inner::Steps(serialiser) => serialiser.take(now),
        }
    }

    fn next_at(&self) -> Nanos {
        match &self.inner {
            Inner::Opportunities(serialiser) => serialiser.next_at(),
            Inner::Steps(serialiser) => serialiser.next_at(),
        }
    }

    fn counts(&self) -> Counts {
        match &self.inner {
            Inner::Opportunities(serialiser) => serialiser.counts(),
            Inner::Steps(serialiser) => serialiser.counts(),
        }
    }
}

#[derive(Debug)]
struct Opportunities {
    at: Arc<[Nanos]>,
    period: Nanos,
    /// Start of the current repetition.
    base: Nanos,
    /// The next opportunity not yet begun.
    next: usize,
    /// Bytes left in the opportunity at `now`.
    left: u32,
    now: Nanos,
}

impl Service for Opportunities {
    fn start(&mut self, now: Nanos) {
        self.left = 0;
        if self.period.0 > 0 && now >= self.base + self.period {
            self.base = Nanos(now.0 / self.period.0 * self.period.0);
            self.next = 0;
        }
        let inside = now - self.base;
        if self.at.get(self.next).is_some_and(|at| *at <= inside) {
            self.next += self.at[self.next..].partition_point(|at| *at <= inside);
        }
    }

    fn finish(&mut self, bytes: u32) -> Nanos {
        let mut need = bytes;
        loop {
            let moved = need.min(self.left);
            self.left -= moved;
            need -= moved;
            if need == 0 {
                return self.now;
            }
            if self.next == self.at.len() {
                self.next = 0;
                self.base += self.period;
            }
            // A trace that exists has an opportunity and a period, so this ends.
            let Some(at) = self.at.get(self.next) else { return Nanos::MAX };
            self.now = self.base + *at;
            self.next += 1;
            self.left = OPPORTUNITY_BYTES;
        }
    }
}

#[derive(Debug)]
struct Steps {
    steps: Arc<[Step]>,
    period: Nanos,
    /// Capacity of one period in bits × 10⁹.
    per_period: u128,
    base: Nanos,
    index: usize,
    now: Nanos,
}

impl Steps {
    fn new(steps: Arc<[Step]>, period: Nanos) -> Self {
        let mut service =
            Self { steps, period, per_period: 0, base: Nanos::ZERO, index: 0, now: Nanos::ZERO };
        service.per_period = (0..service.steps.len())
            .map(|index| {
                u128::from(service.steps[index].rate.0)
                    * u128::from((service.end(index) - service.steps[index].at).0)
            })
            .sum();
        service
    }

    /// End of a step within the period.
    fn end(&self, index: usize) -> Nanos {
        self.steps.get(index + 1).map_or(self.period, |next| next.at)
    }
}

impl Service for Steps {
    fn start(&mut self, now: Nanos) {
        self.now = now;
        if now >= self.base + self.period {
            self.base = Nanos(now.0 / self.period.0 * self.period.0);
            self.index = 0;
        }
        let inside = now - self.base;
        if self.end(self.index) <= inside {
            self.index = self.steps.partition_point(|step| step.at <= inside).saturating_sub(1);
        }
    }

    fn finish(&mut self, bytes: u32) -> Nanos {
        let mut need = u128::from(bytes) * 8_000_000_000;
        if self.per_period == 0 {
            return Nanos::MAX;
        }
        if need > self.per_period {
            let whole = (need - 1) / self.per_period;
            need -= whole * self.per_period;
            let skip = self.period.times(u64::try_from(whole).unwrap_or(u64::MAX));
            self.base += skip;
            self.now += skip;
        }
        loop {
            let end = self.base + self.end(self.index);
            let rate = u128::from(self.steps[self.index].rate.0);
            let room = rate * u128::from((end - self.now).0);
            if room >= need && rate > 0 {
                self.now += Nanos(u64::try_from(need.div_ceil(rate)).unwrap_or(u64::MAX));
                return self.now;
            }
            if end == Nanos::MAX {
                return Nanos::MAX;
            }
            need -= room;
            self.now = end;
            self.index += 1;
            if self.index == self.steps.len() {
                self.index = 0;
                self.base += self.period;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{clock::Rate, link::BoxOutput};

    fn leave_times(link: &mut TraceRate, arrivals: &[(u64, u32)]) -> Vec<u64> {
        let mut out = Vec::new();
        let mut wake = None;
        let drain = |link: &mut TraceRate, until: Nanos, wake: &mut Option<Nanos>, out: &mut Vec<u64>| {
            while let Some(at) = wake.filter(|at| *at <= until) {
                loop {
                    match link.step(None, at) {
                        BoxOutput::Datagram(_) => out.push(at.0),
                        BoxOutput::Wake(next) => break *wake = Some(next),
                        BoxOutput::Idle => break *wake = None,
                    }
                }
            }
        };
        for (tag, (at, bytes)) in arrivals.iter().enumerate() {
            drain(link, Nanos(*at), &mut wake, &mut out);
            if let BoxOutput::Wake(next) =
                link.step(Some(Datagram { tag: tag as u64, bytes: *bytes }), Nanos(*at))
            {
                wake = Some(next);
            }
        }
        drain(link, Nanos::from_s(100), &mut wake, &mut out);
        assert!(link.counts().balanced());
        out.iter().map(|at| at / 1_000_000).collect()
    }

    fn opportunities(text: &str) -> TraceRate {
        let trace = Trace::mahimahi("t", text.as_bytes(), &crate::trace::Limits::default()).unwrap();
        TraceRate::new("down", &trace, QueueLimit { bytes: u64::MAX, datagrams: u32::MAX })
    }

    #[test]
    fn a_large_datagram_straddles_and_a_small_one_shares() {
        // 1000 + 1000 bytes: the second takes 500 of the first opportunity and 500 of the second.
        assert_eq!(
            leave_times(&mut opportunities("5\n9\n20\n"), &[(0, 1000), (0, 1000), (0, 900)]),
            [5, 9, 9]
        );
        assert_eq!(leave_times(&mut opportunities("5\n9\n20\n"), &[(0, 3100)]), [20]);
    }

    #[test]
    fn unused_opportunities_are_lost_and_the_trace_repeats_at_its_last_stamp() {
        let ms = 1_000_000;
        assert_eq!(
            leave_times(&mut opportunities("5\n9\n20\n"), &[(5 * ms, 1500), (9 * ms, 1500), (10 * ms, 100)]),
            [9, 20, 25]
        );
        assert_eq!(
            leave_times(&mut opportunities("0\n10\n"), &[(0, 1500), (0, 1500), (0, 1500)]),
            [10, 10, 20]
        );
        assert_eq!(leave_times(&mut opportunities("0\n10\n"), &[(995 * ms, 1500)]), [1000]);
    }

    #[test]
    fn steps_are_integrated_over_a_fade_and_over_the_loop() {
        let steps = vec![
            Step { at: Nanos::ZERO, rate: Rate::from_mbps(12) },
            Step { at: Nanos::from_ms(10), rate: Rate(0) },
            Step { at: Nanos::from_ms(30), rate: Rate::from_mbps(6) },
        ];
        let trace = Trace::steps("t", steps, Nanos::from_ms(40)).unwrap();
        let mut link = TraceRate::new("down", &trace, QueueLimit { bytes: u64::MAX, datagrams: u32::MAX });
        // 15 kB until 10 ms, nothing until 30 ms, 7.5 kB until 40 ms, then again from the start.
        let times = leave_times(&mut link, &[(0, 15_000), (0, 1500), (0, 6000), (0, 1500)]);
        assert_eq!(times, [10, 32, 40, 41]);
        let mut link = TraceRate::new("down", &trace, QueueLimit { bytes: u64::MAX, datagrams: u32::MAX });
        assert_eq!(leave_times(&mut link, &[(0, 22_500 * 3), (95_000_000, 1500)]), [120, 121]);
    }
}
