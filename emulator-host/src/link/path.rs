//! Describes one direction of a path as plain data, from which every run builds fresh boxes.
//!
//! Order of the boxes: capacity with its queue, loss, delay, reordering. Loss comes after capacity because a
//! datagram that is lost on the air has used the air.

use super::{
    Chain, ConstantRate, Delay, GilbertElliott, GilbertElliottParams, LightLoad, LinkBox, Loss, QueueLimit,
    Reorder, TraceRate,
};
use crate::{
    clock::{Bytes, Nanos, Rate},
    rng::Probability,
    trace::{DelayTrace, LossTrace, Trace},
};

/// How fast a path is.
#[derive(Clone, Debug)]
pub enum Capacity {
    /// No serialisation at all.
    Unlimited,
    /// A constant rate.
    Constant(Rate),
    /// A trace, looping.
    Trace(Trace),
}

impl Capacity {
    /// Bytes that it moves from the start until `time`.
    pub fn bytes_until(&self, time: Nanos) -> Bytes {
        match self {
            Self::Unlimited => Bytes(u64::MAX / 4),
            Self::Constant(rate) => rate.bytes_in(time),
            Self::Trace(trace) => trace.bytes_until(time),
        }
    }
}

/// How a path loses datagrams besides its full queue. All numbers are probabilities per datagram, 0..=1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LossModel {
    /// Never.
    None,
    /// Independent losses.
    Iid(f64),
    /// Bursts; see [`GilbertElliott`].
    GilbertElliott {
        /// Good to bad.
        enter_bad: f64,
        /// Bad to good.
        leave_bad: f64,
        /// Loss in the good state.
        loss_good: f64,
        /// Loss in the bad state.
        loss_bad: f64,
    },
}

impl LossModel {
    /// The shortest bursts, in datagrams on average, in which the share `loss` of datagrams, below 1, can be
    /// lost: one datagram arrives between two of them.
    ///
    /// # Examples
    /// ```
    /// use emulator_host::link::LossModel;
    ///
    /// assert_eq!(LossModel::least_burst(0.9), 9.0);
    /// assert_eq!(LossModel::least_burst(0.2), 1.0);
    /// ```
    pub fn least_burst(loss: f64) -> f64 {
        // Rounded, so that 0.9 gives 9 and not the least bit more.
        ((loss / (1.0 - loss)).max(1.0) * 1e9).round() / 1e9
    }

    /// Loses the share `loss` of datagrams, 0 to 0.9, `burst` in a row on average, at least
    /// [`Self::least_burst`]: shorter ones lose a smaller share. Where `burst` is 1, losses are independent.
    /// Bursts are those of a Gilbert model, which loses every datagram of its bad state.
    ///
    /// # Examples
    /// ```
    /// use emulator_host::link::LossModel;
    ///
    /// assert_eq!(LossModel::in_bursts(0.05, 1.0), LossModel::Iid(0.05));
    /// let LossModel::GilbertElliott { enter_bad, leave_bad, .. } = LossModel::in_bursts(0.05, 4.0) else {
    ///     panic!()
    /// };
    /// assert!((enter_bad / (enter_bad + leave_bad) - 0.05).abs() < 1e-12);
    /// assert_eq!(leave_bad, 0.25);
    /// ```
    pub fn in_bursts(loss: f64, burst: f64) -> Self {
        if loss == 0.0 {
            return Self::None;
        }
        if burst == 1.0 {
            return Self::Iid(loss);
        }
        // Stationary share of the bad state: enter / (enter + leave). Shorter bursts than the least would
        // need to begin more often than always.
        let enter_bad = (loss / (burst * (1.0 - loss))).min(1.0);
        Self::GilbertElliott { enter_bad, leave_bad: 1.0 / burst, loss_good: 0.0, loss_bad: 1.0 }
    }
}

/// How a path reorders.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reordering {
    /// Probability that a datagram is held back, 0..=1.
    pub probability: f64,
    /// Longest time it is held.
    pub extra: Nanos,
}

/// One direction of a path.
///
/// # Examples
/// A link that follows a trace and loses one datagram in a hundred:
/// ```
/// use emulator_host::{
///     Nanos, SessionConfig, Trace,
///     graph::Synthetic,
///     link::{Capacity, LossModel, PathConfig},
///     simulate,
/// };
///
/// let forward = PathConfig {
///     capacity: Capacity::Trace(Trace::bursty(7, Nanos::from_s(60))),
///     loss: LossModel::Iid(0.01),
///     ..PathConfig::default()
/// };
/// let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1)?;
/// let report = simulate(&graph, &SessionConfig { forward, ..SessionConfig::default() })?;
/// assert!(report.boxes.iter().any(|link| link.counts.dropped.datagrams > 0));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct PathConfig {
    /// How fast.
    pub capacity: Capacity,
    /// How bursts after a pause pass, where `capacity` is that of a saturated link; `None`: as everything.
    pub light: Option<LightLoad>,
    /// What may wait for capacity.
    pub queue: QueueLimit,
    /// Loss on the way.
    pub loss: LossModel,
    /// Loss that varies, after that of `loss`.
    pub loss_trace: Option<LossTrace>,
    /// One-way propagation.
    pub delay: Nanos,
    /// Varying delay, added to `delay`.
    pub delay_trace: Option<DelayTrace>,
    /// Uniform extra delay, order kept.
    pub jitter: Nanos,
    /// Overtaking.
    pub reorder: Option<Reordering>,
}

impl Default for PathConfig {
    /// 5 Mbit/s, 150 kB drop-tail, 20 ms one way, nothing else.
    fn default() -> Self {
        Self {
            capacity: Capacity::Constant(Rate::from_mbps(5)),
            light: None,
            queue: QueueLimit::default(),
            loss: LossModel::None,
            loss_trace: None,
            delay: Nanos::from_ms(20),
            delay_trace: None,
            jitter: Nanos::ZERO,
            reorder: None,
        }
    }
}

/// A number of a path that is no probability.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {found}, allowed 0 to 1")]
pub struct PathError {
    /// Which number.
    pub field: &'static str,
    /// What it is.
    pub found: f64,
}

impl PathConfig {
    /// A path without rate, loss and delay.
    pub fn unimpaired() -> Self {
        Self { capacity: Capacity::Unlimited, delay: Nanos::ZERO, ..Self::default() }
    }

    /// The most that it moves from the start until `time`: what its capacity does and, on top, all that
    /// bursts could have. Either moves whole bytes, so that rounding both down leaves nothing out.
    pub fn bytes_until(&self, time: Nanos) -> Bytes {
        let light = self.light.map_or(Bytes(0), |light| light.most_until(time));
        Bytes(self.capacity.bytes_until(time).0.saturating_add(light.0))
    }

    /// No datagram takes less from one end to the other, capacity aside: the delay and the least of its
    /// trace. Jitter and reordering only add to it.
    pub(crate) fn least_delay(&self) -> Nanos {
        self.delay + self.delay_trace.as_ref().map_or(Nanos::ZERO, DelayTrace::least)
    }

    /// Fresh boxes with labels under `label`, each with its own stream of `seed`.
    ///
    /// # Errors
    /// [`PathError`] names the first probability outside 0..=1.
    pub fn build(&self, label: &str, seed: u64) -> Result<Chain, PathError> {
        let mut boxes: Vec<Box<dyn LinkBox>> = Vec::new();
        match &self.capacity {
            Capacity::Unlimited => {}
            Capacity::Constant(rate) => {
                let label = format!("{label}/rate");
                boxes.push(Box::new(ConstantRate::with_light_load(label, *rate, self.queue, self.light)));
            }
            Capacity::Trace(trace) => {
                let label = format!("{label}/trace-rate");
                boxes.push(Box::new(TraceRate::with_light_load(label, trace, self.queue, self.light)));
            }
        }
        match self.loss {
            LossModel::None => {}
            LossModel::Iid(p) => {
                boxes.push(Box::new(Loss::new(format!("{label}/loss"), chance("loss", p)?, seed)));
            }
            LossModel::GilbertElliott { enter_bad, leave_bad, loss_good, loss_bad } => {
                let params = GilbertElliottParams {
                    enter_bad: chance("enter_bad", enter_bad)?,
                    leave_bad: chance("leave_bad", leave_bad)?,
                    loss_good: chance("loss_good", loss_good)?,
                    loss_bad: chance("loss_bad", loss_bad)?,
                };
                boxes.push(Box::new(Loss::new(
                    format!("{label}/gilbert-elliott"),
                    GilbertElliott::new(params),
                    seed,
                )));
            }
        }
        if let Some(trace) = &self.loss_trace {
            boxes.push(Box::new(Loss::new(format!("{label}/trace-loss"), trace.clone(), seed)));
        }
        if self.delay > Nanos::ZERO || self.jitter > Nanos::ZERO || self.delay_trace.is_some() {
            let mut delay = Delay::new(format!("{label}/delay"), self.delay, self.jitter, seed);
            if let Some(trace) = &self.delay_trace {
                delay = delay.following(trace.clone());
            }
            boxes.push(Box::new(delay));
        }
        if let Some(reorder) = self.reorder {
            let chance = chance("reorder", reorder.probability)?;
            boxes.push(Box::new(Reorder::new(format!("{label}/reorder"), chance, reorder.extra, seed)));
        }
        Ok(Chain::new(label, boxes))
    }
}

fn chance(field: &'static str, probability: f64) -> Result<Probability, PathError> {
    Probability::new(probability).ok_or(PathError { field, found: probability })
}
