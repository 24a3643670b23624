//! Plays what arrives: the decoder of `dgs-player` under the receiver of `emulator-host`, in real time.

mod connections;
mod seen;
mod usable;

use std::time::{Duration, Instant};

use codec_core::{Caps, ErrorKind, internals::limits::MAX_RECEIPT_BYTES};
use dgs_player::{Player, Waiting};
use emulator_host::{
    Nanos,
    session::{MediaReceiver, Startup, StartupRule},
};
use tokio::sync::watch;

use self::{
    seen::Seen,
    usable::{base, has_come, levels},
};
use super::{
    message::{ClientMessage, Conditions, Granted},
    screen::{FrameShown, FrameSink, PlayReport, RoundRequest},
    served_stream::{frame_at, middle_us, start_before, starts, time_us},
    settings::{ClientConfig, PlayError},
};

/// Bytes of media that are stored until the manifest comes.
const EARLY_BYTES: u32 = 1 << 17;
/// A viewer of a stream that grows, to whom nothing of it was there for so long, has run ahead of who makes
/// it: it goes back to the newest window that there is.
const AHEAD: Nanos = Nanos::from_s(1);
/// How long playout of a stream that grows waits once its first base has come: each window comes when the one
/// before it has been shown, and without a lead what is late by any jitter would be missed.
const LIVE_LEAD: Nanos = Nanos::from_ms(300);
/// A stream that grew is served whole, by another server, if nothing says where it begins for so long.
const BEGIN_WAIT: Nanos = Nanos::from_s(2);
/// If there is none that it has not seen for so long, nobody makes the stream any more.
const STALLED: Duration = Duration::from_secs(10);
/// Refused datagrams, besides one for each that was taken, before the server is left.
const SPARE_REFUSALS: u64 = 5000;

/// A stream while it plays.
pub(crate) struct Playback {
    caps: Caps,
    startup: Startup,
    waiting: Option<Waiting>,
    player: Option<Player>,
    message: Vec<u8>,
    starts: Vec<u32>,
    interval: Nanos,
    began: Instant,
    round_began: Instant,
    round: u32,
    /// First frame of the round, and the time that was wanted.
    first: u32,
    start_us: u64,
    /// What is before this frame has been shown before this round.
    resumes_at: u32,
    /// Since when the server has said where this round of a stream that grows begins.
    begun: Option<Instant>,
    receiver: MediaReceiver,
    receipt: Vec<u8>,
    wants_receipt: bool,
    /// What was asked of the server last, for another connection too.
    conditions: Option<Conditions>,
    /// Whether each round begins with nothing.
    anew: bool,
    /// Whether conditions were asked for and not answered yet.
    unanswered: bool,
    report: PlayReport,
    seen: Seen,
    /// Of a stream that grows: where in the clip the last frame ends that had any base, microseconds.
    seen_us: u64,
    /// For how long frames without any have been shown since.
    missing: Nanos,
    /// When the first base of a round of it came.
    base_at: Option<Nanos>,
    /// Since when playout stands and a newer window is asked for.
    ahead_since: Option<Instant>,
    /// Becomes true once the viewer leaves.
    leaves: watch::Sender<bool>,
}

impl Playback {
    pub(super) fn new(config: &ClientConfig, began: Instant) -> Result<Self, PlayError> {
        let caps = Caps { early_bytes: EARLY_BYTES, ..config.caps };
        Ok(Self {
            caps,
            startup: config.startup,
            waiting: Some(Waiting::new(caps).map_err(PlayError::Manifest)?),
            player: None,
            message: Vec::new(),
            starts: Vec::new(),
            interval: Nanos::ZERO,
            began,
            round_began: began,
            round: 0,
            first: 0,
            start_us: config.start_us,
            resumes_at: 0,
            begun: None,
            receiver: MediaReceiver::new(config.startup),
            receipt: Vec::new(),
            wants_receipt: false,
            conditions: config.conditions,
            anew: false,
            unanswered: false,
            report: PlayReport::default(),
            seen: Seen::new(Nanos::ZERO),
            seen_us: 0,
            missing: Nanos::ZERO,
            base_at: None,
            ahead_since: None,
            leaves: watch::channel(false).0,
        })
    }

    /// Where to say that the viewer leaves.
    pub(super) fn leave(&self) -> watch::Sender<bool> {
        self.leaves.clone()
    }

    /// Where to hear that it does.
    pub(super) fn leaving(&self) -> watch::Receiver<bool> {
        self.leaves.subscribe()
    }

    pub(crate) fn has_manifest(&self) -> bool {
        self.player().is_some()
    }

    /// The time that the hello asks for, which begins a round now.
    pub(crate) fn start_us(&mut self) -> u64 {
        self.round_began = Instant::now();
        let handshake = || self.began.elapsed().as_secs_f64() * 1e3;
        self.report.handshake_ms.get_or_insert_with(handshake);
        self.start_us
    }

    /// The stream grows: `round` begins at the time `start_us`, whatever was asked for.
    pub(super) fn begin_at(&mut self, round: u32, start_us: u64) -> Result<(), PlayError> {
        if self.player.is_none() || (self.begun.is_some() && round == self.round) {
            return Err(PlayError::Nonsense("begin before the manifest, or twice in a round".to_owned()));
        }
        self.report.grows = true;
        if round == self.round {
            // Media that was there before the manifest may have been shown: that was not the beginning.
            if self.receiver.playout_start().is_some() {
                self.begin(round, start_us, self.resumes_at);
            }
            self.move_start(start_us);
            self.begun = Some(Instant::now());
            // A server names the middle of a frame.
            let is_new = start_us.saturating_add(self.interval.0 / 1000) >= self.seen_us;
            self.ahead_since = self.ahead_since.filter(|_| !is_new);
        }
        Ok(())
    }

    /// The round to ask for if playout has run ahead of a stream that grows: of what has not been seen.
    ///
    /// # Errors
    /// That nobody makes the stream any more.
    pub(super) fn newest_request(&self) -> Result<Option<RoundRequest>, PlayError> {
        let Some(since) = self.ahead_since else { return Ok(None) };
        if since.elapsed() >= STALLED {
            return Err(PlayError::Stalled { ms: STALLED.as_millis() });
        }
        Ok(Some(RoundRequest { start_us: self.seen_us, conditions: None }))
    }

    /// Without a server that says where rounds begin: the newest window of a stream that grows is at the time
    /// `start_us`. Playout that has not begun begins there, and so does one that has run ahead of the stream.
    ///
    /// # Errors
    /// That nobody makes the stream any more.
    #[cfg(feature = "moq")]
    pub(crate) fn newest_is_at(&mut self, start_us: u64) -> Result<(), PlayError> {
        if let Some(request) = self.newest_request()?
            && start_us >= request.start_us
        {
            self.next_round(request)?;
        }
        if let Some(since) = self.begun {
            self.move_start(start_us);
            // The window is published, and nothing of it can be shown.
            let stalled = self.base_at.is_none() && since.elapsed() >= STALLED;
            let error = PlayError::Stalled { ms: STALLED.as_millis() };
            return if stalled { Err(error) } else { Ok(()) };
        }
        self.begin_at(self.round, start_us)
    }

    /// The round begins at the time `start_us` instead, if none of it has been shown.
    pub(crate) fn move_start(&mut self, start_us: u64) {
        if self.receiver.playout_start().is_none() {
            self.start_us = start_us;
            self.set_clip();
        }
    }

    /// What plays, once the manifest is there.
    pub(crate) fn player(&self) -> Option<&Player> {
        self.player.as_ref()
    }

    /// Whether the stream grows.
    pub(crate) fn grows(&self) -> bool {
        self.report.grows
    }

    /// Begins the next round as it is wished for.
    ///
    /// # Errors
    /// What arrived before cannot be forgotten, for want of memory.
    pub(crate) fn next_round(&mut self, request: RoundRequest) -> Result<ClientMessage, PlayError> {
        self.report.rounds += 1;
        self.begin(self.round + 1, request.start_us, 0);
        self.round_began = Instant::now();
        Ok(match request.conditions {
            Some(conditions) => self.request(conditions),
            None => {
                if self.anew {
                    self.forget()?;
                }
                ClientMessage::Seek { round: self.round, start_us: request.start_us }
            }
        })
    }

    /// Whether what comes now is of the round before, or of none of the conditions that were asked for.
    pub(super) fn awaits_grant(&self) -> bool {
        self.unanswered
    }

    /// Whether each round begins with nothing.
    pub(super) fn begins_anew(&self) -> bool {
        self.anew && !self.unanswered
    }

    fn request(&mut self, conditions: Conditions) -> ClientMessage {
        (self.anew, self.unanswered, self.report.granted) = (conditions.anew, true, None);
        self.conditions = Some(conditions);
        ClientMessage::Conditions { round: self.round, start_us: self.start_us, conditions }
    }

    /// The server says what of the conditions of `round` holds.
    pub(super) fn granted(&mut self, round: u32, granted: Granted) -> Result<(), PlayError> {
        if !self.unanswered || round > self.round {
            return Err(PlayError::Nonsense("conditions that nobody asked for".to_owned()));
        }
        // Answers to earlier rounds are late.
        if round == self.round {
            (self.unanswered, self.report.granted) = (false, Some(granted));
            self.anew &= granted.scheduler;
            if self.anew {
                self.forget()?;
            }
        }
        Ok(())
    }

    /// Forgets every packet.
    fn forget(&mut self) -> Result<(), PlayError> {
        if self.player.is_some() {
            let waiting = Waiting::new(self.caps).map_err(PlayError::Manifest)?;
            self.player =
                Some(waiting.manifest(&self.message).map_err(|(_, error)| PlayError::Manifest(error))?);
        }
        Ok(())
    }

    fn begin(&mut self, round: u32, start_us: u64, resumes_at: u32) {
        (self.round, self.start_us, self.begun, self.base_at) = (round, start_us, None, None);
        self.resumes_at = resumes_at;
        self.receiver = MediaReceiver::new(self.startup);
        self.set_clip();
    }

    /// Says how long the rest of the clip is.
    fn set_clip(&mut self) {
        let Some(player) = &self.player else { return };
        let frames = player.info().frames;
        self.first = start_before(&self.starts, frame_at(self.start_us, self.interval));
        self.receiver.on_clip(frames - self.first, self.interval);
        self.receiver.skip_to(self.resumes_at.saturating_sub(self.first));
    }

    /// The manifest has come, for the first time or again.
    ///
    /// # Errors
    /// One that is refused, or another than before: what has arrived and was shown is of no other stream.
    pub(crate) fn manifest(&mut self, message: &[u8]) -> Result<(), PlayError> {
        if self.player.is_some() {
            return if self.message == message { Ok(()) } else { Err(PlayError::Changed) };
        }
        let waiting = match self.waiting.take() {
            Some(waiting) => waiting,
            None => Waiting::new(self.caps).map_err(PlayError::Manifest)?,
        };
        let player = waiting.manifest(message).map_err(|(_, error)| PlayError::Manifest(error))?;
        let (info, manifest) = (player.info(), player.manifest());
        self.starts = starts(manifest);
        self.interval = Nanos((1e9 / manifest.frames_per_second()).round() as u64);
        self.seen = Seen::new(self.interval);
        self.report.frames = info.frames;
        self.message = message.to_vec();
        self.player = Some(player);
        self.set_clip();
        // Parity may have been among what came early.
        self.wants_receipt = true;
        self.receiver.on_change();
        Ok(())
    }

    /// A datagram of media.
    pub(crate) fn media(&mut self, datagram: &[u8]) -> Result<(), PlayError> {
        self.report.received_bytes += datagram.len() as u64;
        let result = match (&mut self.player, &mut self.waiting) {
            (Some(player), _) => player.push(datagram).map(|accepted| {
                for id in accepted.recovered.iter() {
                    self.receiver.on_recovered(id);
                }
                self.report.recovered += accepted.recovered.iter().count() as u64;
                Some(accepted.id)
            }),
            (None, Some(waiting)) => waiting.push(datagram).map(|()| None),
            (None, None) => return Ok(()),
        };
        match result {
            Ok(id) => {
                self.report.packets += 1;
                id.into_iter().for_each(|id| self.receiver.on_arrived(id));
                Ok(())
            }
            Err(error) if error.kind == ErrorKind::Duplicate => {
                self.report.duplicates += 1;
                Ok(())
            }
            Err(error) => {
                self.report.refused += 1;
                if self.report.refused > SPARE_REFUSALS + self.report.packets {
                    let what = format!("{} datagrams are no media, the last: {error}", self.report.refused);
                    return Err(PlayError::Nonsense(what));
                }
                Ok(())
            }
        }
    }

    /// Time since the round began.
    fn now(&self) -> Nanos {
        Nanos(u64::try_from(self.round_began.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    /// Starts playout if enough is there, and shows what is due.
    pub(crate) fn show_due(&mut self, screen: &mut dyn FrameSink) -> Result<(), PlayError> {
        let now = self.now();
        let awaits_begin = self.report.grows && self.begun.is_none() && now < BEGIN_WAIT;
        let holds = self.unanswered || self.ahead_since.is_some() || awaits_begin;
        let Some(player) = self.player.as_mut().filter(|_| !holds) else { return Ok(()) };
        if let Some(pose) = screen.pose() {
            self.receiver.on_pose(pose);
        }
        let (first, share) = (self.first, share(self.startup));
        let is_usable = || share.is_some_and(|share| base(player, first) >= share);
        // Of a stream that grows, nothing at all may have come yet: its time begins with the first base.
        let waits = self.report.grows && self.receiver.playout_start().is_none() && {
            if self.base_at.is_none() && base(player, first) > 0.0 {
                self.base_at = Some(now);
            }
            let lead = if self.resumes_at > 0 { Nanos::ZERO } else { LIVE_LEAD };
            self.base_at.is_none_or(|at| now < at + lead)
        };
        if !waits && self.receiver.start_if_ready(now, is_usable) {
            self.wants_receipt = true;
            if self.report.grows {
                screen.begun(middle_us(self.first + self.receiver.next_frame(), self.interval));
            }
            if self.report.startup_ms.is_none() {
                self.report.startup_ms = Some(self.began.elapsed().as_secs_f64() * 1e3);
                self.report.startup_reached = self.receiver.threshold_reached();
            }
        }
        while self.ahead_since.is_none()
            && let Some(at) = self.receiver.frame_due(self.now())
        {
            let frame = self.first + at;
            let late_ms = (self.now() - self.receiver.due(at).unwrap_or(now)).as_ms();
            let Some(player) = &mut self.player else { return Ok(()) };
            let usable = player.usable(frame).unwrap_or_default();
            let shown = FrameShown {
                round: self.round,
                frame,
                late_ms,
                base_miss: 1.0 - base(player, frame),
                levels: levels(&usable.canonical, usable.blocks),
                motion_levels: levels(&usable.motion, usable.blocks),
            };
            screen.shown(&shown);
            self.seen.show(shown, &mut self.report);
            screen.show(player, frame).map_err(PlayError::Nonsense)?;
            if self.report.grows {
                let has_come = has_come(player, frame);
                self.note_missing(frame, has_come);
            }
        }
        Ok(())
    }

    pub(crate) fn is_over(&self) -> bool {
        self.receiver.is_over()
    }

    /// Whether playout has run ahead of a stream that grows, or to its end before anything of that has come.
    pub(super) fn is_ahead(&self) -> bool {
        self.ahead_since.is_some()
    }

    /// Finds that a stream that grows is not there yet where it is shown: nothing has come of its window, or
    /// of its epoch where nothing moves.
    fn note_missing(&mut self, frame: u32, has_come: bool) {
        if has_come {
            self.seen_us = time_us(frame + 1, self.interval);
            self.missing = Nanos::ZERO;
            return;
        }
        self.missing += self.interval;
        // After the last frame none shows whether more comes.
        let is_last = frame + 1 >= self.report.frames;
        if self.missing >= AHEAD || is_last {
            (self.missing, self.ahead_since) = (Nanos::ZERO, Some(Instant::now()));
        }
    }

    /// When there is something to show next.
    pub(crate) fn next_time(&self) -> Option<Instant> {
        match self.receiver.next_time() {
            // Until a newer window comes nothing is shown.
            _ if self.unanswered || self.ahead_since.is_some() => None,
            Nanos::MAX => None,
            // What is waited for is media, and then a lead.
            _ if self.report.grows && self.receiver.playout_start().is_none() => {
                let at = self.base_at.filter(|_| self.resumes_at == 0)? + LIVE_LEAD;
                (at > self.now()).then(|| self.round_began + Duration::from_nanos(at.0))
            }
            at => self.round_began.checked_add(Duration::from_nanos(at.0)),
        }
    }

    /// Whether the server needs to know something now.
    pub(super) fn wants_receipt(&self) -> bool {
        self.wants_receipt
    }

    /// The next receipt with its round before it; with `history`, one of all that has arrived.
    pub(super) fn receipt(&mut self, history: bool) -> Vec<u8> {
        self.wants_receipt = false;
        let mut out = self.round.to_le_bytes().to_vec();
        match self.player.as_mut().filter(|_| history) {
            Some(player) => {
                let start = self.receiver.playout_start();
                let playout_us = start.map_or(0, |start| start.0.div_ceil(1000).max(1));
                let (sequence, pose) = (self.receiver.next_sequence(), self.receiver.pose());
                self.receipt.resize(MAX_RECEIPT_BYTES, 0);
                let room = &mut self.receipt;
                let len = player.with_core(|core| core.receipt(sequence, playout_us, pose, room));
                // There is room for the longest, so that nothing is left out.
                out.extend_from_slice(&self.receipt[..len.unwrap_or(0)]);
            }
            None => self.receiver.receipt(&mut out),
        }
        out
    }

    /// What was seen, and what has arrived.
    pub(super) fn end(mut self) -> (PlayReport, Option<Player>) {
        self.seen.end(&mut self.report);
        (self.report, self.player)
    }
}

/// The share of the base that playout waits for.
fn share(startup: Startup) -> Option<f64> {
    match startup.rule {
        StartupRule::BaseGroups(share) | StartupRule::BaseUtility(share) => Some(share),
        StartupRule::AfterWait => None,
    }
}
