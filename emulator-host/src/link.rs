//! Emulates a network as a chain of small boxes.
//!
//! A datagram goes in with [`LinkBox::put`], and [`LinkBox::take`] gives what has come through at `now`;
//! [`LinkBox::next_at`] says when that may be. [`LinkBox::step`] is all of it in one call. Time never runs
//! backwards.
//!
//! In every box, at every moment, received = delivered + dropped + inside ([`Counts::balanced`]).
//! Every box that draws has its own random stream, so how often one draws does not change another.

mod chain;
mod delay;
mod gilbert_elliott;
mod light_load;
mod loss;
mod path;
mod queue;
mod rate;
mod reorder;
mod serialiser;
mod trace_rate;

use serde::Serialize;

use crate::clock::Nanos;

pub use chain::Chain;
pub use delay::Delay;
pub use gilbert_elliott::{GilbertElliott, GilbertElliottParams};
pub use light_load::LightLoad;
pub use loss::{Loss, LossProcess};
pub use path::{Capacity, LossModel, PathConfig, PathError, Reordering};
pub use queue::QueueLimit;
pub use rate::ConstantRate;
pub use reorder::Reorder;
pub use trace_rate::TraceRate;

/// What travels: a size, and a tag that only its sender and receiver understand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Datagram {
    /// Opaque to the network.
    pub tag: u64,
    /// Bytes on the link, IP and UDP headers included.
    pub bytes: u32,
}

/// Result of one step of a box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BoxOutput {
    /// A datagram leaves now; ask again.
    Datagram(Datagram),
    /// Nothing until this time.
    Wake(Nanos),
    /// Nothing until a datagram comes in.
    Idle,
}

/// One box.
pub trait LinkBox: Send {
    /// Name of the box in reports, and key of its random stream.
    fn label(&self) -> &str;

    /// A datagram comes in at `now`. What is due is taken out first.
    fn put(&mut self, datagram: Datagram, now: Nanos);

    /// The next datagram that is through at `now`.
    fn take(&mut self, now: Nanos) -> Option<Datagram>;

    /// When [`Self::take`] may give a datagram, in the past if it may now; [`Nanos::MAX`]: not before one
    /// comes in.
    fn next_at(&self) -> Nanos;

    /// Takes a datagram or nothing at `now`. The caller goes on with nothing until no datagram comes out.
    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        let due = self.take(now);
        if let Some(datagram) = input {
            self.put(datagram, now);
        }
        match due.or_else(|| self.take(now)) {
            Some(datagram) => BoxOutput::Datagram(datagram),
            None if self.next_at() == Nanos::MAX => BoxOutput::Idle,
            None => BoxOutput::Wake(self.next_at()),
        }
    }

    /// The books.
    fn counts(&self) -> Counts;
}

/// A number of datagrams and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Tally {
    /// Datagrams.
    pub datagrams: u64,
    /// Their bytes on the link.
    pub bytes: u64,
}

impl Tally {
    pub(crate) fn add(&mut self, datagram: Datagram) {
        self.datagrams += 1;
        self.bytes += u64::from(datagram.bytes);
    }
}

/// What a box has received, delivered and dropped; the rest is inside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Counts {
    /// Came in.
    pub received: Tally,
    /// Went out.
    pub delivered: Tally,
    /// Will never go out.
    pub dropped: Tally,
    /// Inside, counted by itself and not by subtraction.
    #[serde(rename = "held")]
    pub inside: Tally,
}

impl Counts {
    /// Whether received = delivered + dropped + inside, in datagrams and in bytes.
    pub fn balanced(&self) -> bool {
        let parts = [self.delivered, self.dropped, self.inside];
        self.received.datagrams == parts.iter().map(|part| part.datagrams).sum::<u64>()
            && self.received.bytes == parts.iter().map(|part| part.bytes).sum::<u64>()
    }
}
