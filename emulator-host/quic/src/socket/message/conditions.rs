//! Reads and writes the conditions that a viewer asks for in its own session: a scheduler and a link.

use std::time::Duration;

use emulator_host::{
    Nanos, PolicyKind, Rate,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
};
use serde::Serialize;

use super::fields::{Fields, MessageError};
use crate::socket::impair::Impairment;

/// Bytes of conditions on the wire.
pub(super) const BYTES: usize = 22;
/// Schedulers by their number on the wire; 0 is the server's own.
const SCHEDULERS: [(u8, PolicyKind); 5] = [
    (1, PolicyKind::Layered),
    (2, PolicyKind::Dash),
    (3, PolicyKind::Dependency),
    (4, PolicyKind::DeadlineUtility),
    (5, PolicyKind::DeadlineUtilityPaper),
];
/// Parts of one, of which loss is counted.
const LOSS_PARTS: f64 = 1e4;
const MAX_LOSS: u16 = 9000;
const MAX_BURST: u16 = 1000;
const MAX_DELAY: Duration = Duration::from_secs(1);
const RATES: std::ops::RangeInclusive<u64> = 1_000..=1_000_000_000;
/// What the queue of a link with a rate holds.
const QUEUE: Nanos = Nanos::from_ms(250);

/// An emulated link that a viewer asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewerLink {
    /// 1 kbit/s to 1 Gbit/s; `None` is without limit. With a rate comes a queue of 250 ms.
    pub rate: Option<Rate>,
    /// One way, towards the viewer, at most a second.
    pub delay: Duration,
    /// Share of datagrams lost, 0 to 0.9, counted in ten-thousandths.
    pub loss: f64,
    /// Mean number of datagrams lost in a row, 1 to 1000, at least loss / (1 - loss); at 1 losses are
    /// independent.
    pub burst: f64,
    /// Seed of the losses.
    pub seed: u32,
}

impl Default for ViewerLink {
    /// A perfect one.
    fn default() -> Self {
        Self { rate: None, delay: Duration::ZERO, loss: 0.0, burst: 1.0, seed: 1 }
    }
}

/// What a viewer asks for in its own session: how the server shall choose packets, and through which emulated
/// link they shall come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conditions {
    /// Whether each round begins as if nothing had arrived before, so that a short clip that repeats shows
    /// what a long one would.
    pub(in crate::socket) anew: bool,
    /// The scheduler; `None` is the server's own.
    pub(in crate::socket) scheduler: Option<PolicyKind>,
    /// Whether the link stays as it is, whatever the fields below say.
    pub(in crate::socket) keeps_link: bool,
    /// Bits per second; `None` is without limit.
    rate: Option<u64>,
    /// One way, towards the viewer.
    delay: Duration,
    /// Ten-thousandths of datagrams lost.
    loss: u16,
    /// Mean number of datagrams lost in a row.
    burst: u16,
    seed: u32,
}

impl Conditions {
    /// No emulated link, the server's scheduler.
    pub const NONE: Self = Self {
        anew: false,
        scheduler: None,
        keeps_link: false,
        rate: None,
        delay: Duration::ZERO,
        loss: 0,
        burst: 1,
        seed: 1,
    };

    /// The same with the scheduler `kind`.
    pub fn with_scheduler(self, kind: PolicyKind) -> Self {
        Self { scheduler: Some(kind), ..self }
    }

    /// The same behind whatever link the session is behind: that of the server, if it has one.
    pub fn with_link_as_it_is(self) -> Self {
        Self { keeps_link: true, ..self }
    }

    /// The same behind `link`.
    ///
    /// # Errors
    /// The first field of the link that is out of range.
    ///
    /// # Examples
    /// ```
    /// use dgs_quic::socket::{Conditions, ViewerLink};
    ///
    /// let lossy = ViewerLink { loss: 0.05, burst: 4.0, ..ViewerLink::default() };
    /// assert_ne!(Conditions::NONE.behind(&lossy).unwrap(), Conditions::NONE);
    /// assert!(Conditions::NONE.behind(&ViewerLink { loss: 0.95, ..lossy }).is_err());
    /// ```
    pub fn behind(self, link: &ViewerLink) -> Result<Self, MessageError> {
        let rate = link.rate.map_or(0, |rate| rate.0);
        // A rate of 0 is refused: on the wire it would be none.
        let rate = if link.rate.is_some() { rate.max(1) } else { 0 };
        let delay_us = u32::try_from(link.delay.as_micros()).unwrap_or(u32::MAX);
        let count = |number: f64| if number >= 0.0 { number.round() as u64 } else { u64::MAX };
        let behind = Self { keeps_link: false, ..self };
        behind.checked(rate, delay_us, [count(link.loss * LOSS_PARTS), count(link.burst)], link.seed)
    }

    /// The same, with each round as if nothing had arrived before, so that a short clip that repeats shows
    /// what a long one would.
    pub fn with_rounds_anew(self) -> Self {
        Self { anew: true, ..self }
    }

    /// With the numbers of a link as they are on the wire, `parts` loss and burst; every one is checked.
    fn checked(self, rate: u64, delay_us: u32, parts: [u64; 2], seed: u32) -> Result<Self, MessageError> {
        let rate = match rate {
            0 => None,
            rate if RATES.contains(&rate) => Some(rate),
            other => return Err(illegal("rate", other, "0, or 1000 to 1000000000 bit/s")),
        };
        let delay = Duration::from_micros(delay_us.into());
        if delay > MAX_DELAY {
            return Err(illegal("delay", u64::from(delay_us).div_ceil(1000), "0 to 1000 ms"));
        }
        let [loss, burst] = parts;
        if loss > MAX_LOSS.into() {
            return Err(illegal("loss", loss, "0 to 9000 ten-thousandths"));
        }
        if !(1..=MAX_BURST.into()).contains(&burst) {
            return Err(illegal("burst", burst, "1 to 1000 datagrams"));
        }
        if burst > 1 && (burst as f64) < LossModel::least_burst(loss as f64 / LOSS_PARTS) {
            return Err(illegal("burst", burst, "1, or at least loss / (1 - loss) datagrams"));
        }
        Ok(Self { rate, delay, loss: loss as u16, burst: burst as u16, seed, ..self })
    }

    /// The link; `None` is a perfect one.
    pub(in crate::socket) fn impairment(&self) -> Option<Impairment> {
        if self.rate.is_none() && self.delay.is_zero() && self.loss == 0 {
            return None;
        }
        let rate = self.rate.map(Rate);
        let path = PathConfig {
            capacity: rate.map_or(Capacity::Unlimited, Capacity::Constant),
            queue: rate.map_or_else(QueueLimit::default, |rate| QueueLimit::lasting(QUEUE, rate)),
            loss: LossModel::in_bursts(f64::from(self.loss) / LOSS_PARTS, f64::from(self.burst)),
            delay: Nanos::from_us(self.delay.as_micros() as u64),
            ..PathConfig::unimpaired()
        };
        Some(Impairment { path, seed: self.seed.into() })
    }

    /// Reads them; every field is checked.
    pub(super) fn parse(fields: &mut Fields<'_>) -> Result<Self, MessageError> {
        let (anew, keeps_link) = match fields.byte()? {
            flags @ 0..=3 => (flags & 1 != 0, flags & 2 != 0),
            other => return Err(illegal("flags", other.into(), "0 to 3")),
        };
        let scheduler = match fields.byte()? {
            0 => None,
            number => {
                let known = SCHEDULERS.iter().find(|entry| entry.0 == number);
                Some(known.ok_or(illegal("scheduler", number.into(), "0 to 5"))?.1)
            }
        };
        let (rate, delay_us) = (fields.number(8)?, fields.word()?);
        let parts = [fields.number(2)?, fields.number(2)?];
        Self { anew, scheduler, keeps_link, ..Self::NONE }.checked(rate, delay_us, parts, fields.word()?)
    }

    /// Appends them to `out`.
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        let number = |kind| SCHEDULERS.iter().find(|entry| entry.1 == kind).map_or(0, |entry| entry.0);
        let flags = u8::from(self.anew) | u8::from(self.keeps_link) << 1;
        out.extend([flags, self.scheduler.map_or(0, number)]);
        out.extend(self.rate.unwrap_or(0).to_le_bytes());
        out.extend((self.delay.as_micros() as u32).to_le_bytes());
        out.extend(self.loss.to_le_bytes());
        out.extend(self.burst.to_le_bytes());
        out.extend(self.seed.to_le_bytes());
    }
}

fn illegal(field: &'static str, found: u64, allowed: &'static str) -> MessageError {
    MessageError::Field { message: "conditions", field, found, allowed }
}

/// What a server grants of conditions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Granted {
    /// Whether media goes through the link. A WebSocket has none: it repeats what is lost by itself.
    pub link: bool,
    /// Whether the scheduler chooses, and rounds begin anew if that was asked for.
    pub scheduler: bool,
}

impl Granted {
    /// Reads what was granted.
    pub(super) fn parse(fields: &mut Fields<'_>) -> Result<Self, MessageError> {
        match fields.byte()? {
            flags @ 0..=3 => Ok(Self { link: flags & 1 != 0, scheduler: flags & 2 != 0 }),
            other => Err(MessageError::Field {
                message: "granted",
                field: "flags",
                found: other.into(),
                allowed: "0 to 3",
            }),
        }
    }

    /// As a byte of flags.
    pub(super) fn flags(self) -> u8 {
        u8::from(self.link) | u8::from(self.scheduler) << 1
    }
}
