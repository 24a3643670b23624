//! Starts playout, says which frame is due, and writes receipts, over any transport and without a graph.
//!
//! Whoever owns the bytes (a decoder, or a model of one) tells this core what has arrived in the wire's own
//! ids. It knows time and ids, asks no clock and moves no bytes.

use codec_core::internals::{
    ids::{Group as GroupId, PacketId},
    wire::receipt::ViewerPose,
};

use super::feedback::{ReceiptWriter, Reported};
use crate::{clock::Nanos, startup::Startup};

/// How long a clip is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Clip {
    frames: u32,
    frame_interval: Nanos,
}

/// The receiver of one clip.
///
/// # Examples
/// ```
/// use emulator_host::{
///     Nanos,
///     session::{MediaReceiver, Startup, StartupRule},
/// };
///
/// let rule = StartupRule::BaseGroups(0.95);
/// let mut receiver = MediaReceiver::new(Startup { rule, max_wait: Nanos::from_s(5) });
/// // The manifest has come: 90 frames, 30 a second.
/// receiver.on_clip(90, Nanos::from_us(33_333));
/// // Media comes until the share of the rule is usable.
/// let now = Nanos::from_ms(80);
/// assert!(receiver.start_if_ready(now, || true));
/// assert_eq!(receiver.frame_due(now), Some(0));
/// assert_eq!(receiver.frame_due(now), None);
/// assert_eq!(receiver.next_time(), now + Nanos::from_us(33_333));
/// let mut receipt = Vec::new();
/// receiver.receipt(&mut receipt);
/// assert!(!receipt.is_empty());
/// ```
#[derive(Debug)]
pub struct MediaReceiver {
    startup: Startup,
    clip: Option<Clip>,
    changed: bool,
    start: Option<Nanos>,
    /// By how much frames are shown earlier than their time since `start`: frame 0 would have been shown
    /// before time began.
    lead: Nanos,
    reached: bool,
    next_frame: u32,
    receipts: ReceiptWriter,
}

impl MediaReceiver {
    /// Nothing has arrived.
    pub fn new(startup: Startup) -> Self {
        Self {
            startup,
            clip: None,
            changed: true,
            start: None,
            lead: Nanos::ZERO,
            reached: false,
            next_frame: 0,
            receipts: ReceiptWriter::new(),
        }
    }

    /// How long the clip is has become known. Without it nothing plays.
    pub fn on_clip(&mut self, frames: u32, frame_interval: Nanos) {
        self.clip = Some(Clip { frames, frame_interval });
        self.changed = true;
    }

    /// What is before `frame` has been shown already: playout starts with it, as if those before it had been
    /// shown in time. To be said before playout starts.
    pub fn skip_to(&mut self, frame: u32) {
        self.next_frame = frame;
    }

    /// Something came, of whatever kind: what is usable may have grown.
    pub fn on_change(&mut self) {
        self.changed = true;
    }

    /// A packet arrived by itself.
    pub fn on_arrived(&mut self, packet: PacketId) {
        self.receipts.on_arrived(packet);
        self.changed = true;
    }

    /// A packet was recovered from parity.
    pub fn on_recovered(&mut self, packet: PacketId) {
        self.receipts.on_recovered(packet);
        self.changed = true;
    }

    /// A group is complete; to be said once per group.
    pub fn on_complete(&mut self, group: GroupId) {
        self.receipts.on_complete(group);
    }

    /// The viewer looks from `pose`, which receipts say for a while if it has moved.
    pub fn on_pose(&mut self, pose: ViewerPose) {
        self.receipts.on_pose(pose);
    }

    /// Where the viewer is, if it has been said.
    pub fn pose(&self) -> Option<ViewerPose> {
        self.receipts.pose()
    }

    /// Number of a receipt that the caller writes: all receipts of a round count together.
    pub fn next_sequence(&mut self) -> u32 {
        self.receipts.next_sequence()
    }

    /// Starts playout if `is_usable` says that what the rule waits for is there, or the wait is over; whether
    /// it starts now. Asked only after something has changed. The sender needs to know of a start at once.
    pub fn start_if_ready(&mut self, now: Nanos, is_usable: impl FnOnce() -> bool) -> bool {
        let waited = now >= self.startup.max_wait;
        let Some(clip) = self.clip.filter(|_| self.start.is_none() && (self.changed || waited)) else {
            return false;
        };
        self.changed = false;
        self.reached = is_usable();
        if self.reached || waited {
            let skipped = clip.frame_interval.times(self.next_frame.into());
            (self.start, self.lead) = (Some(now - skipped), skipped - now);
        }
        self.start.is_some()
    }

    /// When frame 0 was shown, or would have been; zero if before time began.
    pub fn playout_start(&self) -> Option<Nanos> {
        self.start
    }

    /// Whether playout started because the threshold was reached, and not because the wait was over.
    pub fn threshold_reached(&self) -> bool {
        self.reached
    }

    /// The frame to be shown next.
    pub fn next_frame(&self) -> u32 {
        self.next_frame
    }

    /// Whether the last frame has been shown.
    pub fn is_over(&self) -> bool {
        self.clip.is_some_and(|clip| self.next_frame >= clip.frames)
    }

    /// When playout has something to do next.
    pub fn next_time(&self) -> Nanos {
        match self.clip {
            None => Nanos::MAX,
            Some(_) => self.due(self.next_frame).unwrap_or(self.startup.max_wait),
        }
    }

    /// When `frame` is to be shown, once playout has started.
    pub fn due(&self, frame: u32) -> Option<Nanos> {
        let (start, clip) = self.start.zip(self.clip)?;
        Some(start + clip.frame_interval.times(u64::from(frame)) - self.lead)
    }

    /// The next frame to show, if its time has come.
    pub fn frame_due(&mut self, now: Nanos) -> Option<u32> {
        if self.start.is_none() || self.is_over() || self.next_time() > now {
            return None;
        }
        self.next_frame += 1;
        Some(self.next_frame - 1)
    }

    /// Appends the bytes of the next receipt to `out`. One is due with every second media datagram, and when
    /// playout starts.
    pub fn receipt(&mut self, out: &mut Vec<u8>) {
        self.receipts.compose(self.start);
        out.extend_from_slice(self.receipts.bytes());
    }

    /// The next receipt, for a transport that moves no bytes: its length, and which news it tells.
    pub(super) fn measured_receipt(&mut self) -> (usize, Reported) {
        let reported = self.receipts.compose(self.start);
        (self.receipts.wire_len(), reported)
    }

    /// The bytes of the receipt composed last.
    pub(super) fn receipt_bytes(&mut self) -> &[u8] {
        self.receipts.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::startup::StartupRule;

    #[test]
    fn what_was_shown_before_is_skipped_and_the_rest_follows_at_once() {
        let startup = Startup { rule: StartupRule::BaseGroups(0.95), max_wait: Nanos::from_s(5) };
        let interval = Nanos::from_ms(100);
        for (now, start) in [(Nanos::from_ms(50), Nanos::ZERO), (Nanos::from_s(2), Nanos::from_ms(1300))] {
            let mut receiver = MediaReceiver::new(startup);
            receiver.on_clip(10, interval);
            receiver.skip_to(7);
            assert!(receiver.start_if_ready(now, || true));
            // Frame 0 would have been shown seven frames before, if time had begun by then.
            assert_eq!(receiver.playout_start(), Some(start));
            assert_eq!((receiver.frame_due(now), receiver.frame_due(now)), (Some(7), None));
            assert_eq!((receiver.next_time(), receiver.due(7)), (now + interval, Some(now)));
            assert_eq!(receiver.frame_due(now + interval), Some(8));
            assert!(!receiver.is_over());
        }
    }
}
