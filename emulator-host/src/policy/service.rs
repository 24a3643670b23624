//! What a scheduler requires of the sender besides sending its choices.

use crate::clock::Nanos;

/// What a scheduler requires of the sender: a bound on the queue, and who decides on lost packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SenderRequirements {
    /// Longest queue that media may cause on the path: nothing but control is sent while what is in flight
    /// takes longer to arrive than the smallest round trip and this together. At least the smallest round
    /// trip counts as such a queue. `None`: as the congestion window allows.
    pub max_queue_delay: Option<Nanos>,
    /// Whether the longest queue is 9/20 of that on a path that loses hardly anything.
    pub short_queue: bool,
    /// Whether a path that is kept full with such a queue for ten seconds is emptied for about a round trip,
    /// to measure how long it is by itself.
    pub empty_path: bool,
    /// Whether a lost packet waits again and the scheduler decides on it like on any other. Otherwise the
    /// sender repeats it before all else, if its level and the budget say so.
    pub lost_compete: bool,
}

impl SenderRequirements {
    /// No bound on the queue, repetition by level and budget.
    pub const CONVENTIONAL: Self =
        Self { max_queue_delay: None, short_queue: false, empty_path: false, lost_compete: false };
}
