//! Serves the first bytes after a pause faster than a saturated link would.
//!
//! A recording of a saturated cellular link says what a lasting load gets. A short burst after a pause is
//! scheduled otherwise and comes through sooner: CellReplay (Sentosa et al., NSDI 2025) records both, replays
//! the light one until a burst outlives it, and returns to it after a pause. Video is such a load, a burst
//! per window; over the saturated recording alone its delay is overstated.

use super::serialiser::Service;
use crate::clock::{Bytes, Nanos, Rate};

/// What a link does for a burst that begins after a pause, before its own capacity holds.
///
/// # Examples
/// The first 15 kB after a tenth of a second without traffic pass at 40 Mbit/s:
/// ```
/// use emulator_host::{
///     Bytes, Nanos, Rate, SessionConfig,
///     graph::Synthetic,
///     link::{Capacity, LightLoad, PathConfig},
///     simulate,
/// };
///
/// let light = LightLoad { rate: Rate::from_mbps(40), burst: Bytes(15_000), pause: Nanos::from_ms(100) };
/// let capacity = Capacity::Constant(Rate::from_mbps(1));
/// let forward = PathConfig { capacity, light: Some(light), ..PathConfig::default() };
/// let slow = PathConfig { light: None, ..forward.clone() };
/// let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1)?;
/// let utility = |forward| {
///     simulate(&graph, &SessionConfig { forward, ..SessionConfig::default() }).map(|report| report.utility)
/// };
/// assert!(utility(forward)? > utility(slow)?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightLoad {
    /// Rate of the burst.
    pub rate: Rate,
    /// Bytes on the link that pass at this rate.
    pub burst: Bytes,
    /// How long nothing was sent before a burst begins.
    pub pause: Nanos,
}

impl LightLoad {
    /// The most that passes at this rate until `time`: as if every pause were followed by a whole burst.
    pub(super) fn most_until(&self, time: Nanos) -> Bytes {
        let bursts = (time.0 / self.pause.0.max(1)).saturating_add(1);
        Bytes(bursts.saturating_mul(self.burst.0).min(self.rate.bytes_in(time).0))
    }
}

/// `lasting`, but for bursts after a pause.
#[derive(Debug)]
pub(super) struct LightFirst<S> {
    lasting: S,
    light: Option<LightLoad>,
    /// Bytes of the burst that have not begun.
    left: u64,
    /// When the last datagram was through.
    through_at: Nanos,
}

impl<S> LightFirst<S> {
    /// A link that is idle at the start.
    pub(super) fn new(lasting: S, light: Option<LightLoad>) -> Self {
        let left = light.map_or(0, |light| light.burst.0);
        Self { lasting, light, left, through_at: Nanos::ZERO }
    }
}

impl<S: Service> Service for LightFirst<S> {
    fn start(&mut self, now: Nanos) {
        if let Some(light) = self.light.filter(|light| now - self.through_at >= light.pause) {
            self.left = light.burst.0;
        }
        self.through_at = now;
        self.lasting.start(now);
    }

    fn finish(&mut self, bytes: u32) -> Nanos {
        let size = u64::from(bytes);
        self.through_at = match self.light.filter(|_| self.left >= size) {
            Some(light) => {
                self.left -= size;
                let through = self.through_at + light.rate.time_for(Bytes(size));
                // What the link could have carried meanwhile is lost, as by an idle one.
                self.lasting.start(through);
                through
            }
            None => {
                self.left = 0;
                self.lasting.finish(bytes)
            }
        };
        self.through_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Trace,
        link::{Capacity, Datagram, LossModel, PathConfig, QueueLimit},
        trace::Limits,
    };

    /// When datagrams of 1500 bytes that are sent at `sent`, in ms, are through, in tenths of a ms.
    fn through(capacity: Capacity, light: Option<LightLoad>, sent: &[u64]) -> Vec<u64> {
        let path = PathConfig {
            capacity,
            light,
            queue: QueueLimit { bytes: u64::MAX, datagrams: u32::MAX },
            loss: LossModel::None,
            delay: Nanos::ZERO,
            ..PathConfig::default()
        };
        let mut chain = path.build("down", 1).unwrap();
        let mut left = Vec::new();
        for at in (0..200_000).map(|at| Nanos(at * 50_000)) {
            let due = sent.iter().filter(|sent| Nanos::from_ms(**sent) == at);
            let inputs: Vec<_> = due.map(|_| Some(Datagram { tag: 0, bytes: 1500 })).chain([None]).collect();
            inputs.into_iter().for_each(|input| chain.carry(input, at, |_| left.push(at.0 / 100_000)));
        }
        assert!(chain.box_counts().all(|(_, counts)| counts.balanced()));
        left
    }

    /// Three datagrams at 12 Mbit/s, a millisecond each, after 50 ms.
    const LIGHT: LightLoad =
        LightLoad { rate: Rate::from_mbps(12), burst: Bytes(4500), pause: Nanos::from_ms(50) };

    #[test]
    fn a_burst_is_fast_until_it_outlives_the_light_load() {
        let slow = || Capacity::Constant(Rate::from_kbps(1200));
        assert_eq!(through(slow(), None, &[0, 0, 0]), [100, 200, 300]);
        assert_eq!(through(slow(), Some(LIGHT), &[0, 0, 0]), [10, 20, 30]);
        assert_eq!(through(slow(), Some(LIGHT), &[0, 0, 0, 0, 0]), [10, 20, 30, 130, 230]);
    }

    #[test]
    fn the_light_load_comes_back_after_a_pause_and_not_before() {
        let slow = || Capacity::Constant(Rate::from_kbps(1200));
        // Through at 3 and 13 ms; the next comes 49 and 50 ms after that.
        assert_eq!(through(slow(), Some(LIGHT), &[0, 0, 0, 0, 62]), [10, 20, 30, 130, 720]);
        assert_eq!(through(slow(), Some(LIGHT), &[0, 0, 0, 0, 63]), [10, 20, 30, 130, 640]);
    }

    #[test]
    fn what_a_trace_offers_during_a_burst_is_lost() {
        let text = b"1\n2\n3\n20\n40\n";
        let trace = || Capacity::Trace(Trace::mahimahi("t", text, &Limits::default()).unwrap());
        assert_eq!(through(trace(), None, &[0, 0, 0, 0]), [10, 20, 30, 200]);
        assert_eq!(through(trace(), Some(LIGHT), &[0, 0, 0, 0]), [10, 20, 30, 200]);
        assert_eq!(through(trace(), Some(LIGHT), &[4, 4, 4, 4]), [50, 60, 70, 200]);
    }

    #[test]
    fn no_more_passes_than_is_said_to_be_possible() {
        for light in [LIGHT, LightLoad { pause: Nanos::ZERO, ..LIGHT }] {
            let capacity = Capacity::Constant(Rate::from_kbps(1200));
            let path = PathConfig { capacity: capacity.clone(), light: Some(light), ..PathConfig::default() };
            let sent: Vec<u64> = (0..100).map(|at| 70 * (at / 4)).collect();
            for (passed, at) in through(capacity, Some(light), &sent).into_iter().enumerate() {
                let bytes = 1500 * (passed as u64 + 1);
                assert!(Bytes(bytes) <= path.bytes_until(Nanos(at * 100_000)), "{bytes} by {at}");
            }
        }
    }
}
