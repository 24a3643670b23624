//! A screen is what shows frames; what a viewer saw is reported.

use codec_core::internals::wire::receipt::ViewerPose;
use dgs_player::Player;
use serde::Serialize;

use super::message::{Conditions, Granted};

/// What shows frames.
pub trait FrameSink {
    /// Frame `frame` is due now and `player` has what has arrived. This must return soon: nothing is received
    /// meanwhile.
    ///
    /// # Errors
    /// What makes it pointless to go on.
    fn show(&mut self, player: &mut Player, frame: u32) -> Result<(), String>;

    /// How late and how complete a frame is, just before [`Self::show`] is asked for it.
    fn shown(&mut self, _frame: &FrameShown) {}

    /// The manifest has come: a DGSM message, which was taken.
    fn manifest(&mut self, _message: &[u8]) {}

    /// Playout of a stream that grows begins, or goes on elsewhere: with the frame that shows at `time_us`,
    /// microseconds of the clip, whatever was asked for.
    fn begun(&mut self, _time_us: u64) {}

    /// A datagram of media has come, whatever became of it.
    fn media(&mut self, _packet: &[u8]) {}

    /// Another round that is wanted; asked often, answered once.
    fn requested_round(&mut self) -> Option<RoundRequest> {
        None
    }

    /// What the server grants of conditions that a round began with.
    fn granted(&mut self, _granted: Granted) {}

    /// A round begins as if no media had come before.
    fn forget(&mut self) {}

    /// Where the viewer is, for receipts: what it sees is then sent first. Asked often.
    fn pose(&mut self) -> Option<ViewerPose> {
        None
    }
}

/// Another round of playout, as a viewer wants it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RoundRequest {
    /// From which time of the clip on, microseconds.
    pub start_us: u64,
    /// Under which conditions from then on; `None` is those that hold.
    pub conditions: Option<Conditions>,
}

/// Shows nothing: frames are only timed and counted.
#[derive(Clone, Copy, Debug, Default)]
pub struct NullSink;

impl FrameSink for NullSink {
    fn show(&mut self, _player: &mut Player, _frame: u32) -> Result<(), String> {
        Ok(())
    }
}

/// One frame as it was shown.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FrameShown {
    /// Round of playout.
    pub round: u32,
    /// The frame.
    pub frame: u32,
    /// When it was shown after its time, milliseconds.
    pub late_ms: f64,
    /// Share of its blocks that lacked their base.
    pub base_miss: f64,
    /// Levels of attributes that were usable, 0 to 4, mean over its blocks.
    pub levels: f64,
    /// Levels of motion that were usable, 0 to 4, mean over its blocks; 0 where nothing moves.
    pub motion_levels: f64,
}

/// What a viewer saw.
#[derive(Clone, Debug, Default, Serialize)]
pub struct PlayReport {
    /// Frames of the clip.
    pub frames: u32,
    /// Whether the stream grows: each round begins at its newest window, and none after its end.
    pub grows: bool,
    /// From the first packet of the handshake to the hello, milliseconds.
    pub handshake_ms: Option<f64>,
    /// From the first packet of the handshake to the first frame, milliseconds.
    pub startup_ms: Option<f64>,
    /// Whether playout started for enough was there, and not because the wait was over.
    pub startup_reached: bool,
    /// Rounds begun: one with each connection made, and those after it.
    pub rounds: u32,
    /// What the server granted of the conditions that were asked for last; `None` where none were, or it has
    /// not answered.
    pub granted: Option<Granted>,
    /// Connections made.
    pub connections: u32,
    /// Every frame shown, in order; of a clip that repeats, those of the last rounds.
    pub shown: Vec<FrameShown>,
    /// Frames shown in all.
    pub shown_count: u64,
    /// Mean of [`FrameShown::base_miss`] over all frames shown.
    pub base_miss_rate: f64,
    /// Mean of [`FrameShown::levels`] over all frames shown.
    pub mean_levels: f64,
    /// Freezes, as [`Freezes`](emulator_host::session::Freezes) counts them.
    pub freezes: u64,
    /// Frames in them.
    pub frozen_frames: u64,
    /// Packets accepted, parity included.
    pub packets: u64,
    /// Bytes of datagrams received.
    pub received_bytes: u64,
    /// Packets recovered from parity.
    pub recovered: u64,
    /// Packets that had arrived before.
    pub duplicates: u64,
    /// Other datagrams that were refused.
    pub refused: u64,
}
