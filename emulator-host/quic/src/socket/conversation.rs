//! A conversation is what a viewer and a server say to each other over one connection, from the hello on.

use std::time::{Duration, Instant};

use quinn::{SendStream, WriteError};
use tokio::time::{sleep_until, timeout};

use super::{
    channel::{Channel, QuicCloser},
    control::{Control, ControlError},
    message::{ClientMessage, Message as _, ServerMessage},
    playback::Playback,
    screen::{FrameSink, RoundRequest},
    settings::{ClientConfig, PlayError},
};

/// A receipt leaves with every so many datagrams.
const RECEIPT_EVERY: u32 = 2;
/// And so long after any datagram at the latest.
const RECEIPT_DELAY: Duration = Duration::from_millis(25);
/// And at least so often: what was repeated enough and lost all the same is said again, and the server sees
/// that somebody is there.
const RECEIPT_INTERVAL: Duration = Duration::from_millis(100);
/// Rounds of a clip that repeats are this far apart at least: a server takes five seeks a second.
const ROUND_INTERVAL: Duration = Duration::from_millis(200);
/// How often a viewer who is ahead of a stream that grows asks for its newest window.
const NEWEST_INTERVAL: Duration = Duration::from_millis(500);
/// Without any media for so long after the manifest, the client asks for it in streams.
const NO_DATAGRAMS: Duration = Duration::from_secs(1);
/// How long the reason may take that follows the end of the control stream.
const END_TIMEOUT: Duration = Duration::from_secs(1);

/// One conversation.
pub(super) struct Conversation<'c> {
    config: &'c ClientConfig,
    playback: &'c mut Playback,
    screen: &'c mut dyn FrameSink,
    channel: &'c Channel,
    ending: &'c mut QuicCloser,
    send: &'c mut SendStream,
    /// Whether media comes in streams.
    in_streams: bool,
    /// When to conclude that the path drops datagrams; `None` once a packet has come.
    streams_at: Option<Instant>,
    had_manifest: bool,
    /// Until when the server may say nothing, while something is expected of it.
    deadline: Instant,
    /// When the next receipt of all that has arrived is due.
    history_at: Instant,
    /// When the packets that no receipt has acknowledged need one, and how many there are.
    receipt_at: Option<Instant>,
    unacknowledged: u32,
    /// When the last round of a clip that repeats began.
    round_at: Instant,
    /// When the newest window of a stream that grows may be asked for again.
    newest_at: Instant,
}

/// What follows when a conversation has looked at the time.
enum Next {
    /// The clip is over.
    Bye,
    /// Another round has begun: look again.
    Again,
    /// Nothing until then, unless something comes.
    Wait(Instant),
}

impl<'c> Conversation<'c> {
    /// Says hello.
    ///
    /// # Errors
    /// A connection that is gone.
    pub(super) async fn begin(
        config: &'c ClientConfig,
        playback: &'c mut Playback,
        screen: &'c mut dyn FrameSink,
        (channel, ending, send): (&'c Channel, &'c mut QuicCloser, &'c mut SendStream),
    ) -> Result<Self, PlayError> {
        let stream = config.locator.stream.clone();
        let hello = ClientMessage::Hello { stream, start_us: playback.start_us() };
        let conditions = playback.begin_under_conditions();
        let now = Instant::now();
        let mut begun = Self {
            config,
            playback,
            screen,
            channel,
            ending,
            send,
            in_streams: config.streams,
            streams_at: None,
            had_manifest: false,
            deadline: now + config.silence,
            history_at: now + RECEIPT_INTERVAL,
            receipt_at: None,
            unacknowledged: 0,
            round_at: now,
            newest_at: now,
        };
        begun.say(&hello).await?;
        if let Some(conditions) = conditions {
            begun.say(&conditions).await?;
        }
        if begun.in_streams {
            begun.say(&ClientMessage::Streams).await?;
        }
        Ok(begun)
    }

    /// Plays until the clip is over or the viewer leaves.
    ///
    /// # Errors
    /// What ends it before.
    pub(super) async fn run(mut self, mut control: Control<ServerMessage>) -> Result<(), PlayError> {
        let mut leave = self.playback.leaving();
        loop {
            let wake = match self.look(Instant::now()).await? {
                Next::Bye => return self.say(&ClientMessage::Bye).await,
                Next::Again => continue,
                Next::Wait(wake) => wake,
            };
            tokio::select! {
                // What the server says before media holds of that media, where both have come.
                biased;
                _ = leave.wait_for(|leaves| *leaves) => return self.say(&ClientMessage::Bye).await,
                message = control.next() => self.hear(message).await?,
                datagram = self.channel.read() => {
                    self.take(&datagram.map_err(|error| PlayError::Lost(error.into()))?)?;
                }
                () = sleep_until(wake.into()) => {}
            }
        }
    }

    /// Shows and says what is due at `now`.
    async fn look(&mut self, now: Instant) -> Result<Next, PlayError> {
        self.playback.show_due(self.screen)?;
        let is_over = self.playback.is_over() && !self.playback.is_ahead();
        // A stream that grows has no begin to go back to.
        if is_over && (!self.config.loops || self.playback.grows()) {
            return Ok(Next::Bye);
        }
        // Its last frame is shown as long as the others.
        let over_at = self.playback.next_time().map_or(now, |ends| ends.max(self.round_at + ROUND_INTERVAL));
        if is_over && now >= over_at {
            self.round_at = now;
            self.begin_round(RoundRequest::default()).await?;
            return Ok(Next::Again);
        }
        if let Some(request) = self.requested_round(now)? {
            self.begin_round(request).await?;
            return Ok(Next::Again);
        }
        self.acknowledge(now).await?;
        if self.streams_at.is_some_and(|at| now >= at) {
            (self.in_streams, self.streams_at) = (true, None);
            self.say(&ClientMessage::Streams).await?;
        }
        if !self.had_manifest || self.playback.awaits_grant() {
            if now >= self.deadline {
                return Err(PlayError::Silence { ms: self.config.silence.as_millis() });
            }
            return Ok(Next::Wait(self.deadline));
        }
        let receipt_due = self.receipt_at.map_or(self.history_at, |at| self.history_at.min(at));
        let due = if is_over { Some(over_at) } else { self.playback.next_time() };
        Ok(Next::Wait(due.map_or(receipt_due, |due| due.min(receipt_due))))
    }

    /// The round that playback or the viewer asks for in place of this one.
    fn requested_round(&mut self, now: Instant) -> Result<Option<RoundRequest>, PlayError> {
        if !self.had_manifest {
            return Ok(None);
        }
        if now >= self.newest_at
            && let Some(request) = self.playback.newest_request()?
        {
            self.newest_at = now + NEWEST_INTERVAL;
            return Ok(Some(request));
        }
        // A stream that grows is shown at its newest end.
        let request = self.screen.requested_round();
        let request = request.filter(|request| request.conditions.is_some() || !self.playback.grows());
        if request.is_some() {
            self.deadline = now + self.config.silence;
        }
        Ok(request)
    }

    async fn begin_round(&mut self, request: RoundRequest) -> Result<(), PlayError> {
        let message = self.playback.next_round(request)?;
        self.say(&message).await?;
        if self.playback.begins_anew() {
            self.screen.forget();
        }
        Ok(())
    }

    /// Sends a receipt if one is due.
    async fn acknowledge(&mut self, now: Instant) -> Result<(), PlayError> {
        let history = now >= self.history_at;
        let late = self.receipt_at.is_some_and(|at| now >= at);
        let is_due = history || late || self.unacknowledged >= RECEIPT_EVERY || self.playback.wants_receipt();
        // Until conditions are granted it is not known whether what is there still counts.
        if !self.had_manifest || self.playback.awaits_grant() || !is_due {
            return Ok(());
        }
        let receipt = self.playback.receipt(history);
        if self.in_streams {
            self.say(&ClientMessage::Receipt(receipt)).await?;
        } else {
            // A receipt that finds no room is as lost as one that is dropped on the way.
            let _ = self.channel.send(receipt.into());
        }
        (self.unacknowledged, self.receipt_at) = (0, None);
        self.history_at = now + RECEIPT_INTERVAL;
        Ok(())
    }

    /// Heeds what the server says.
    async fn hear(&mut self, message: Result<Option<ServerMessage>, ControlError>) -> Result<(), PlayError> {
        match message {
            Ok(Some(ServerMessage::Manifest(message))) if !self.had_manifest => {
                self.playback.manifest(&message)?;
                self.screen.manifest(&message);
                let now = Instant::now();
                self.had_manifest = true;
                self.streams_at = (!self.in_streams).then_some(now + NO_DATAGRAMS);
                self.history_at = now;
                Ok(())
            }
            Ok(Some(ServerMessage::Manifest(_))) => Err(PlayError::Nonsense("a second manifest".to_owned())),
            Ok(Some(ServerMessage::Begin { round, start_us })) => self.playback.begin_at(round, start_us),
            Ok(Some(ServerMessage::Granted { round, granted })) => {
                self.playback.granted(round, granted)?;
                self.screen.granted(granted);
                if self.playback.begins_anew() {
                    self.screen.forget();
                }
                Ok(())
            }
            Ok(Some(ServerMessage::Refusal(refusal))) => Err(PlayError::Refused(refusal)),
            Ok(None) | Err(ControlError::Lost(_)) => Err(gone(self.ending).await),
            Err(error) => Err(PlayError::Nonsense(error.to_string())),
        }
    }

    /// Takes a datagram of media.
    fn take(&mut self, datagram: &[u8]) -> Result<(), PlayError> {
        self.streams_at = None;
        if self.playback.awaits_grant() {
            return Ok(());
        }
        self.playback.media(datagram)?;
        self.screen.media(datagram);
        self.unacknowledged += 1;
        self.receipt_at = self.receipt_at.or(Some(Instant::now() + RECEIPT_DELAY));
        Ok(())
    }

    async fn say(&mut self, message: &ClientMessage) -> Result<(), PlayError> {
        let written = self.send.write_all(&message.to_bytes()).await;
        written.map_err(|error| match error {
            WriteError::ConnectionLost(error) => PlayError::Lost(error.into()),
            other => PlayError::Nonsense(other.to_string()),
        })
    }
}

/// The server has ended the stream: why, once the connection has ended too.
async fn gone(ending: &mut QuicCloser) -> PlayError {
    match timeout(END_TIMEOUT, ending.closed()).await {
        Ok(error) => PlayError::Lost(error),
        Err(_) => PlayError::Nonsense("the control stream ended".to_owned()),
    }
}
