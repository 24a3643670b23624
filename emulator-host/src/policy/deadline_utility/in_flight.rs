//! Judges what is in flight: whether it arrives, and what still comes in time behind it.

use super::forecast::OVERHEAD_BYTES;
use crate::{
    clock::{Bytes, Nanos},
    graph::PacketIndex,
    policy::{SenderView, probability::distribution},
};

/// Whether `packet`, sent at `now` behind what is in flight, comes before its last frame is shown. Of the
/// queue no more is counted on than `max_queue_delay`, which media cause themselves: a longer one is a
/// forecast.
pub(super) fn arrives_in_time(
    view: &SenderView<'_>,
    packet: PacketIndex,
    max_queue_delay: Nanos,
    now: Nanos,
) -> bool {
    let bytes = view.in_flight + u64::from(view.graph.wire_bytes(packet)) + u64::from(OVERHEAD_BYTES);
    let behind = view.rate.time_for(Bytes(bytes)) - view.minimum_rtt;
    !view.is_past(view.graph.useful_until(packet), now + behind.min(max_queue_delay))
}

/// Probability that a packet in flight arrives, given that no receipt has named it: a loss grows likely as
/// its age passes what receipts take.
pub(super) fn survival(view: &SenderView<'_>, packet: PacketIndex, loss: f64, now: Nanos) -> f64 {
    let age = (now - view.sent_at[packet.at()]).as_s();
    let spread = view.rtt_variation.as_s().max(1e-3);
    let silent = 1.0 - distribution((age - view.smoothed_rtt.as_s()) / spread);
    1.0 - loss / (loss + (1.0 - loss) * silent.max(1e-9))
}
