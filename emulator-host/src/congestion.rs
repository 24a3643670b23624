//! Implements RFC 9002 without a packet format: round-trip times, loss detection, probes, windows, pacing.
//!
//! [`Recovery`] owns the bookkeeping of what was sent; a [`Controller`] owns the window. One packet-number
//! space, entered after a completed handshake: rules about Initial and Handshake packets, anti-amplification
//! and key discard have no place here. All state is integers.

mod bbr_model;
mod cubic;
mod delivery;
mod kind;
mod newreno;
mod pacer;
mod recent_minimum;
mod recovery;
mod rtt;
mod scream;

use std::fmt::Debug;

use crate::clock::{Nanos, Rate};

pub use bbr_model::BbrModel;
pub use cubic::Cubic;
pub use delivery::{DeliveryRate, DeliverySample};
pub use kind::ControllerKind;
pub use newreno::NewReno;
pub use pacer::Pacer;
pub use recent_minimum::RecentMinimum;
pub use recovery::{AckOutcome, Recovery, Sent, TimerOutcome};
pub use rtt::Rtt;
pub use scream::Scream;

/// Initial congestion window in bytes: ten datagrams, at most 14 720 bytes or two datagrams (RFC 9002, 7.2).
pub fn initial_window(datagram_bytes: u64) -> u64 {
    (10 * datagram_bytes).min((2 * datagram_bytes).max(14_720))
}

/// Minimum congestion window in bytes: two datagrams (RFC 9002, 7.2).
pub fn minimum_window(datagram_bytes: u64) -> u64 {
    2 * datagram_bytes
}

/// One acknowledged packet, for a controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Acked {
    /// Its UDP payload bytes.
    pub bytes: u64,
    /// When it was sent.
    pub sent_at: Nanos,
    /// Whether, when it was sent, the application had too little to fill the window (RFC 9002, 7.8).
    pub app_limited: bool,
}

/// What governs the congestion window. Bytes are UDP payload.
pub trait Controller: Debug + Send {
    /// Name in reports.
    fn name(&self) -> &'static str;

    /// One packet was acknowledged.
    fn on_ack(&mut self, acked: Acked, rtt: &Rtt, now: Nanos);

    /// All packets of one acknowledgement were handed over; `sample` measures the path, `in_flight` is what
    /// is left.
    fn on_ack_end(&mut self, sample: Option<DeliverySample>, in_flight: u64, rtt: &Rtt, now: Nanos);

    /// Packets were lost, or marked; `sent_at` is when the latest of them was sent. Returns whether a new
    /// recovery period starts.
    fn on_congestion(&mut self, sent_at: Nanos, lost_bytes: u64, in_flight: u64, now: Nanos) -> bool;

    /// Persistent congestion was established (RFC 9002, 7.6).
    fn on_persistent_congestion(&mut self);

    /// Congestion window.
    fn window(&self) -> u64;

    /// Rate at which the window may be spread, before the cap by the path's estimated rate.
    fn pacing_rate(&self, rtt: &Rtt) -> Rate;

    /// Whether the window still grows fast, so that a cap by the path's estimated rate must leave it room.
    fn is_probing(&self) -> bool;

    /// By how much the pace may exceed the path's estimated rate, as numerator and denominator. The estimate
    /// never exceeds what was sent, so that a cap without headroom could never learn that the path is faster:
    /// 3 while the controller probes, for the estimate is a round trip old and the window doubles in one, and
    /// 5/4 afterwards.
    fn headroom(&self) -> (u64, u64) {
        if self.is_probing() { (3, 1) } else { (5, 4) }
    }
}
