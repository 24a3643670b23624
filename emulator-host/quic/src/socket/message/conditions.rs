//! Reads and writes the conditions that a viewer asks for in its own session: a scheduler and a link.

use std::time::Duration;

use emulator_host::{
    Nanos, PolicyKind, Rate,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
};

use super::{Fields, MessageError};
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
const MOST_LOSS: u16 = 9000;
const MOST_BURST: u16 = 1000;
const MOST_DELAY: Duration = Duration::from_secs(1);
const RATES: std::ops::RangeInclusive<u64> = 1_000..=1_000_000_000;
/// What the queue of a link with a rate holds.
const QUEUE: Nanos = Nanos::from_ms(250);

/// What a viewer asks for in its own session: how the server shall choose packets, and through which emulated
/// link they shall come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Conditions {
    /// Whether each round begins as if nothing had arrived before, so that a short clip that repeats shows
    /// what a long one would.
    pub(in crate::socket) anew: bool,
    /// The scheduler; `None` is the server's own.
    pub(in crate::socket) scheduler: Option<PolicyKind>,
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
    pub const NONE: Self =
        Self { anew: false, scheduler: None, rate: None, delay: Duration::ZERO, loss: 0, burst: 1, seed: 1 };

    /// A scheduler behind a link of this delay, at most a second, each round anew.
    #[cfg(test)]
    pub(in crate::socket) fn late(scheduler: PolicyKind, delay: Duration) -> Self {
        Self { anew: true, scheduler: Some(scheduler), delay: delay.min(MOST_DELAY), ..Self::NONE }
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
        let illegal =
            |field, found: u64, allowed| MessageError::Field { message: "conditions", field, found, allowed };
        let anew = match fields.byte()? {
            flag @ (0 | 1) => flag == 1,
            other => return Err(illegal("anew", other.into(), "0 or 1")),
        };
        let scheduler = match fields.byte()? {
            0 => None,
            number => {
                let known = SCHEDULERS.iter().find(|entry| entry.0 == number);
                Some(known.ok_or(illegal("scheduler", number.into(), "0 to 5"))?.1)
            }
        };
        let rate = match fields.number(8)? {
            0 => None,
            rate if RATES.contains(&rate) => Some(rate),
            other => return Err(illegal("rate", other, "0, or 1000 to 1000000000 bit/s")),
        };
        let delay_us = fields.word()?;
        let delay = Duration::from_micros(delay_us.into());
        if delay > MOST_DELAY {
            return Err(illegal("delay", delay_us.into(), "0 to 1000000 us"));
        }
        let (loss, burst) = (fields.number(2)? as u16, fields.number(2)? as u16);
        if loss > MOST_LOSS {
            return Err(illegal("loss", loss.into(), "0 to 9000 ten-thousandths"));
        }
        if !(1..=MOST_BURST).contains(&burst) {
            return Err(illegal("burst", burst.into(), "1 to 1000 datagrams"));
        }
        Ok(Self { anew, scheduler, rate, delay, loss, burst, seed: fields.word()? })
    }

    /// Appends them to `out`.
    pub(super) fn write(&self, out: &mut Vec<u8>) {
        let number = |kind| SCHEDULERS.iter().find(|entry| entry.1 == kind).map_or(0, |entry| entry.0);
        out.extend([u8::from(self.anew), self.scheduler.map_or(0, number)]);
        out.extend(self.rate.unwrap_or(0).to_le_bytes());
        out.extend((self.delay.as_micros() as u32).to_le_bytes());
        out.extend(self.loss.to_le_bytes());
        out.extend(self.burst.to_le_bytes());
        out.extend(self.seed.to_le_bytes());
    }
}

/// What a server grants of conditions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
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
