//! Judges what is in flight and what is sent next: whether it arrives, and whether in time.

use super::forecast::OVERHEAD_BYTES;
use crate::{
    clock::{Bytes, Nanos},
    graph::PacketIndex,
    policy::{SenderView, probability::distribution},
};

/// Whether `packet`, sent at `now` behind what is in flight, comes before its last frame is shown. Of the
/// queue no more is counted on than `max_queue_delay`, which media cause themselves: a longer one is a
/// forecast. With zero of it, whatever comes in time over an empty path does.
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

/// Probability that `packet`, which waits, is not lost, counting the times that one of the base may be sent
/// again; `loss` is that of one datagram.
pub(super) fn arrives_at_all(view: &SenderView<'_>, packet: PacketIndex, loss: f64) -> f64 {
    let sendings = if view.graph.level(packet) == 0 { 1 + view.retransmissions } else { 1 };
    1.0 - (0..sendings).fold(1.0, |lost, _| lost * loss)
}
