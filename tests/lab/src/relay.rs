//! Starts a relay, and puts links between it and subscribers.

pub mod link;
pub mod program;
