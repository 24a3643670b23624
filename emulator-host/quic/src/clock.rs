//! Turns times of a session into the instants of the transport, and back.

use std::time::{Duration, Instant};

use emulator_host::Nanos;

/// Turns times into the transport's instants: a base, of which only differences matter, and how long after
/// it the session began.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    base: Instant,
    /// Between the base and the session's zero.
    before: Nanos,
}

impl Clock {
    pub(crate) fn start() -> Self {
        Self { base: Instant::now(), before: Nanos::ZERO }
    }

    /// The same instants, counted from `zero` on.
    pub(crate) fn counting_from(self, zero: Nanos) -> Self {
        Self { before: self.before + zero, ..self }
    }

    pub(crate) fn instant(self, now: Nanos) -> Instant {
        self.base + Duration::from_nanos((self.before + now).0)
    }

    /// Zero for what was before the session.
    pub(crate) fn nanos(self, instant: Instant) -> Nanos {
        Self::span(instant.saturating_duration_since(self.base)) - self.before
    }

    /// A span of the transport's time.
    pub(crate) fn span(duration: Duration) -> Nanos {
        Nanos(u64::try_from(duration.as_nanos()).unwrap_or(u64::MAX))
    }
}
