//! What a scheduler requires of the sender besides sending its choices.

use crate::clock::Nanos;

/// What a scheduler requires of the sender: a bound on the queue, and who decides on lost packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SenderRequirements {
    /// Longest queue that media may cause on the path: nothing but control is sent while what is in flight
    /// takes longer to arrive than the smallest round trip and this together. At least the smallest round
    /// trip counts as such a queue; on a path that loses hardly anything, 9/20 of the longer of both.
    /// `None`: as the congestion window allows.
    pub max_queue_delay: Option<Nanos>,
    /// Whether a lost packet waits again and the scheduler decides on it like on any other. Otherwise the
    /// sender repeats it before all else, if its level and the budget say so.
    pub lost_compete: bool,
}

impl SenderRequirements {
    /// No bound on the queue, repetition by level and budget.
    pub const CONVENTIONAL: Self = Self { max_queue_delay: None, lost_compete: false };
}
