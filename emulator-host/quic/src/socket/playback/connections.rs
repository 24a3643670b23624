//! Follows playback over the connections that it takes.

use super::Playback;
use crate::socket::{message::ClientMessage, served_stream::time_us};

impl Playback {
    /// A connection is made, and a round begins with it.
    pub(crate) fn connected(&mut self) {
        self.report.connections += 1;
        self.report.rounds += 1;
    }

    /// Frames shown so far.
    pub(in crate::socket) fn shown_count(&self) -> u64 {
        self.report.shown_count
    }

    /// The connection is gone and another is to be made: playout goes on from the frame that is due, whatever
    /// window it lies in.
    pub(in crate::socket) fn reconnect(&mut self) {
        let frame = self.first + self.receiver.next_frame();
        self.anew = false;
        self.begin(0, time_us(frame, self.interval), frame);
    }

    /// Begins round 0 again under the conditions that are to hold, if any are, as another round: nothing of
    /// it has been shown.
    pub(in crate::socket) fn begin_under_conditions(&mut self) -> Option<ClientMessage> {
        let conditions = self.conditions?;
        self.begin(self.round + 1, self.start_us, self.resumes_at);
        Some(self.request(conditions))
    }
}
