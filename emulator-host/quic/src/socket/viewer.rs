//! Serves one viewer: rounds of playout, a datagram whenever the transport takes one, until somebody ends it.

mod end;
#[cfg(test)]
mod tests;

use std::{
    collections::VecDeque,
    sync::Arc,
    time::{Duration, Instant},
};

use emulator_host::{Nanos, PacketIndex, PolicyKind, graph::GraphError};
use tokio::{sync::watch, time::sleep_until};

pub use self::end::ViewerReport;
pub(super) use self::end::{End, end_session};
use super::{
    carrier::{ControlWriter, NotSent, SendFuture, SessionCloser, SessionTransport},
    control::{Control, ControlError},
    impair::{Links, SessionLink},
    limits::{Allowance, ServerLimits},
    message::{ClientMessage, Conditions, Granted, Message as _, Refusal, RefusalCode, ServerMessage},
    round::Round,
    served_stream::{Content, ServedStream},
};

/// Media that may leave before the first receipt: until then the manifest may need the path for repeats,
/// and the client's memory for early packets is small.
const EARLY_PACKETS: u64 = 32;
/// Time between two checks whether the manifest has left; media may leave after it.
const MANIFEST_POLL: Duration = Duration::from_millis(1);
/// Datagrams from a client besides one per packet sent to it: per second, and at once.
const SPARE_DATAGRAMS: (f64, f64) = (50.0, 2000.0);
/// Receipts that cannot be read before the session ends.
const MAX_REFUSED: u64 = 100;
/// Most bytes of answers that wait on the control stream before another is asked for.
const MAX_UNREAD: usize = 4096;
/// Seeks per second, and at once.
const SEEKS: (f64, f64) = (5.0, 20.0);
/// Bytes before the receipt in a datagram of the client: the round.
const ROUND_BYTES: usize = 4;

/// A session that a hello has begun.
pub(super) struct Session {
    pub(super) carrier: SessionTransport,
    pub(super) ending: SessionCloser,
    pub(super) send: ControlWriter,
    pub(super) control: Control<ClientMessage>,
    pub(super) offer: Arc<ServedStream>,
    pub(super) limits: ServerLimits,
    pub(super) policy: PolicyKind,
    /// Links of the server's socket, if it has any.
    pub(super) links: Option<Arc<Links>>,
    /// Whether the viewer may change its conditions.
    pub(super) may_change: bool,
    pub(super) stopping: watch::Receiver<bool>,
}

/// What is counted besides what the round counts.
#[derive(Debug, Default)]
struct Tally {
    rounds: u32,
    packets: u64,
    media_bytes: u64,
    retransmitted: u64,
    parity: u64,
    lost: u64,
    receipts: u64,
    refused: u64,
    located: bool,
}

fn refused(code: RefusalCode, sentence: String) -> End {
    End::Refused(Refusal { code, sentence })
}

/// The moving parts of a session.
struct Viewer<'s> {
    carrier: &'s SessionTransport,
    offer: &'s ServedStream,
    /// The server's scheduler, and the one that chooses.
    own_policy: PolicyKind,
    policy: PolicyKind,
    /// Where the viewer's own link is, if its transport has any.
    link: Option<&'s SessionLink>,
    may_change: bool,
    conditions: Conditions,
    began: Instant,
    round: Round,
    /// Times that the round was renewed.
    renewals: u32,
    content: watch::Receiver<Arc<Content>>,
    /// What of the control stream is still to be written.
    out: VecDeque<u8>,
    /// How many bytes of that are the manifest and the first begin, which are no answers: a client that does
    /// not read is judged by the rest.
    greeting: usize,
    /// By packet id, over all rounds.
    delivered: Vec<bool>,
    tally: Tally,
    rate: Option<Allowance>,
    datagrams: Allowance,
    seeks: Allowance,
    /// Bytes that had left when the manifest was written, and how many more must before media may.
    manifest: (u64, u64),
    manifest_left: bool,
    heard_at: Instant,
}

/// A packet that waits for room in the transport.
struct Sending<'s> {
    /// Number and renewals of its round.
    round: (u32, u32),
    packet: PacketIndex,
    bytes: u64,
    departure: SendFuture<'s>,
}

/// Ends when the packet that waits, if there is one, has left.
async fn departure(sending: &mut Option<Sending<'_>>) -> Result<(), NotSent> {
    match sending {
        Some(sending) => sending.departure.as_mut().await,
        None => std::future::pending().await,
    }
}

impl Session {
    /// Runs the session from `start_us` on.
    pub(super) async fn run(self, start_us: u64) -> (ViewerReport, End) {
        let Self { carrier, mut ending, mut send, mut control, offer, limits, policy, .. } = self;
        let mut stopping = self.stopping;
        let began = Instant::now();
        let address = carrier.address();
        let links = self.links.filter(|_| carrier.is_impaired_by_links());
        let link = links.map(|links| links.begin_session(address));
        let mut tally = Tally::default();
        let mut scheduler = policy;
        let end = match Viewer::new(&carrier, &offer, &limits, policy, start_us) {
            Ok(mut viewer) => {
                (viewer.link, viewer.may_change) = (link.as_ref(), self.may_change);
                let end = viewer.run(&mut ending, &mut send, &mut control, &limits, &mut stopping).await;
                viewer.close_round();
                (tally, scheduler) = (viewer.tally, viewer.policy);
                end
            }
            Err(error) => End::Refused(Refusal { code: RefusalCode::Message, sentence: error.to_string() }),
        };
        end_session(ending, send, &end).await;
        drop(link);
        let report = ViewerReport {
            address,
            stream: offer.name().to_owned(),
            scheduler: scheduler.name(),
            seconds: began.elapsed().as_secs_f64(),
            rounds: tally.rounds,
            packets: tally.packets,
            media_bytes: tally.media_bytes,
            retransmitted: tally.retransmitted,
            parity: tally.parity,
            lost: tally.lost,
            receipts: tally.receipts,
            located: tally.located,
            refused_receipts: tally.refused,
            rtt_ms: carrier.rtt().as_secs_f64() * 1e3,
            end: end.to_string(),
        };
        (report, end)
    }
}

impl<'s> Viewer<'s> {
    fn new(
        carrier: &'s SessionTransport,
        offer: &'s ServedStream,
        limits: &ServerLimits,
        policy: PolicyKind,
        start_us: u64,
    ) -> Result<Self, GraphError> {
        if let Some(watch) = carrier.watch() {
            watch.begin_session();
        }
        let mut content = offer.content();
        let now = content.borrow_and_update().clone();
        let (first, says) = offer.start(&now, start_us);
        let mut out = VecDeque::from(ServerMessage::Manifest(offer.message().to_vec()).to_bytes());
        if says {
            out.extend(ServerMessage::Begin { round: 0, start_us: offer.middle_us(&now, first) }.to_bytes());
        }
        let greeting = out.len();
        let delivered = vec![false; now.count()];
        let began = Instant::now();
        // A tenth of a second of media may leave at once.
        let rate = limits.max_rate_bps.map(|bps| {
            let bytes = bps as f64 / 8.0;
            Allowance::new(bytes, (bytes / 10.0).max(2.0 * super::served_stream::MAX_MEDIA_BYTES as f64))
        });
        Ok(Self {
            carrier,
            offer,
            own_policy: policy,
            policy,
            link: None,
            may_change: false,
            conditions: Conditions::NONE,
            began,
            round: Round::new(0, carrier, (now, first), policy, &delivered)?,
            renewals: 0,
            content,
            out,
            greeting,
            delivered,
            tally: Tally { rounds: 1, ..Tally::default() },
            rate,
            datagrams: Allowance::new(SPARE_DATAGRAMS.0, SPARE_DATAGRAMS.1),
            seeks: Allowance::new(SEEKS.0, SEEKS.1),
            manifest: (0, 0),
            manifest_left: false,
            heard_at: began,
        })
    }

    async fn run(
        &mut self,
        ending: &mut SessionCloser,
        send: &mut ControlWriter,
        control: &mut Control<ClientMessage>,
        limits: &ServerLimits,
        stopping: &mut watch::Receiver<bool>,
    ) -> End {
        let carrier = self.carrier;
        self.manifest = (carrier.sent_bytes(), self.out.len() as u64);
        let mut grows = true;
        let mut sending: Option<Sending<'s>> = None;
        loop {
            if self.round.is_due() {
                self.round.settle(carrier);
            }
            let chooses = sending.is_none() && self.may_send();
            if chooses {
                sending = self.pull();
            }
            let wake = self.wake(chooses && sending.is_none(), limits);
            tokio::select! {
                biased;
                closed = ending.closed() => return closed.into(),
                _ = stopping.changed() => {
                    let sentence = "the server is closing".to_owned();
                    return End::Refused(Refusal { code: RefusalCode::Closing, sentence });
                }
                message = control.next() => match self.on_message(message) {
                    Ok(()) => {}
                    Err(end) => return end,
                },
                written = send.write(self.out.as_slices().0), if !self.out.is_empty() => match written {
                    Some(bytes) => {
                        self.out.drain(..bytes);
                        self.greeting = self.greeting.saturating_sub(bytes);
                    }
                    None => return End::Bye,
                },
                news = self.content.changed(), if grows => {
                    grows = news.is_ok();
                    if let Err(error) = self.renew() {
                        let sentence = error.to_string();
                        return End::Refused(Refusal { code: RefusalCode::Message, sentence });
                    }
                }
                left = departure(&mut sending), if sending.is_some() => match left {
                    Ok(()) => self.on_datagram_sent(&mut sending),
                    Err(NotSent::Closed(closed)) => return closed.into(),
                    Err(NotSent::Refused(error)) => {
                        let sentence = format!("media does not pass as datagrams: {error}");
                        return End::Refused(Refusal { code: RefusalCode::Message, sentence });
                    }
                },
                () = carrier.news() => self.round.hear(carrier),
                datagram = carrier.read() => match datagram {
                    Ok(datagram) => if let Err(refusal) = self.on_datagram(&datagram) {
                        return End::Refused(refusal);
                    },
                    Err(closed) => return closed.into(),
                },
                () = sleep_until(wake.into()) => {
                    if self.heard_at.elapsed() >= limits.idle {
                        let sentence = format!("nothing was heard for {} ms", limits.idle.as_millis());
                        return End::Refused(Refusal { code: RefusalCode::Silence, sentence });
                    }
                }
            }
        }
    }

    /// Whether the manifest is on its way, nothing of it waits to be sent again, and the early packets are
    /// not used up.
    fn may_send(&mut self) -> bool {
        let (before, bytes) = self.manifest;
        let left = self.carrier.sent_bytes() - before >= bytes;
        if left && !std::mem::replace(&mut self.manifest_left, true) {
            if let Some(watch) = self.carrier.watch() {
                watch.on_control_left(Instant::now());
            }
            // It counts against the queue that media may cause.
            self.round.settle(self.carrier);
        }
        let early = self.tally.receipts > 0 || self.tally.packets < EARLY_PACKETS;
        let now = self.began.elapsed();
        let widest = super::served_stream::MAX_MEDIA_BYTES as f64;
        let granted = self.rate.as_mut().is_none_or(|rate| rate.wait(widest, now).is_zero());
        // Datagrams leave before what is in streams, and without the manifest they show nothing.
        let owes = self.tally.receipts == 0 && self.carrier.watch().is_some_and(|watch| watch.owes_control());
        left && early && granted && !owes
    }

    /// The packet that leaves as soon as there is room.
    fn pull(&mut self) -> Option<Sending<'s>> {
        let (packet, bytes) = self.round.next(self.carrier)?;
        let now = self.began.elapsed();
        if let Some(rate) = &mut self.rate {
            rate.take(bytes.len() as f64, now);
        }
        let (round, len) = ((self.round.number, self.renewals), bytes.len() as u64);
        let departure = self.carrier.send_when_there_is_room(bytes);
        Some(Sending { round, packet, bytes: len, departure })
    }

    /// The packet that waited has left.
    fn on_datagram_sent(&mut self, sending: &mut Option<Sending<'s>>) {
        let Some(left) = sending.take() else { return };
        self.carrier.on_media_taken();
        self.tally.packets += 1;
        self.tally.media_bytes += left.bytes;
        self.datagrams.add(1.0);
        // A seek may have begun another round meanwhile, or the stream may have grown.
        if left.round == (self.round.number, self.renewals) {
            self.round.on_sent(left.packet, self.carrier);
        }
    }

    /// When the loop has something to do without being woken. `found_nothing`: there was room for a packet
    /// and none worth sending, which time may change.
    fn wake(&mut self, found_nothing: bool, limits: &ServerLimits) -> Instant {
        let idle = self.heard_at + limits.idle;
        let due = if found_nothing { self.round.next_time() } else { self.round.loss_time() };
        let due = if due == Nanos::MAX { None } else { self.round.instant(due) };
        let mut wake = due.map_or(idle, |due| due.min(idle));
        let now = Instant::now();
        if self.carrier.sent_bytes() - self.manifest.0 < self.manifest.1 {
            wake = wake.min(now + MANIFEST_POLL);
        }
        if let Some(rate) = &mut self.rate {
            let wait = rate.wait(super::served_stream::MAX_MEDIA_BYTES as f64, self.began.elapsed());
            if !wait.is_zero() {
                wake = wake.min(now + wait);
            }
        }
        // Time goes on even if something wants to be woken in the past.
        wake.max(now + Duration::from_micros(100))
    }

    fn on_message(&mut self, message: Result<Option<ClientMessage>, ControlError>) -> Result<(), End> {
        self.heard_at = Instant::now();
        match message {
            Ok(Some(ClientMessage::Seek { round, start_us })) => self.begin_round(round, start_us, None),
            Ok(Some(ClientMessage::Conditions { round, start_us, conditions })) => {
                self.begin_round(round, start_us, Some(conditions))
            }
            Ok(Some(ClientMessage::Bye) | None) | Err(ControlError::Lost(_)) => Err(End::Bye),
            Ok(Some(ClientMessage::Streams)) => {
                self.carrier.send_in_streams();
                Ok(())
            }
            Ok(Some(ClientMessage::Receipt(datagram))) => self.on_datagram(&datagram).map_err(End::Refused),
            Ok(Some(ClientMessage::Hello { .. })) => {
                Err(refused(RefusalCode::Message, "a session has one hello".to_owned()))
            }
            Err(ControlError::Message(error)) => Err(End::Refused(error.refusal())),
            Err(error @ ControlError::Cut) => Err(refused(RefusalCode::Message, error.to_string())),
        }
    }

    /// Goes on from `start_us` as round `round`, under other conditions if they are asked for.
    fn begin_round(&mut self, round: u32, start_us: u64, request: Option<Conditions>) -> Result<(), End> {
        if round <= self.round.number {
            let sentence = format!("round is {round}, allowed above {}", self.round.number);
            return Err(refused(RefusalCode::Message, sentence));
        }
        if !self.seeks.take(1.0, self.began.elapsed()) {
            return Err(refused(RefusalCode::Flood, "too many seeks".to_owned()));
        }
        self.close_round();
        if let Some(request) = request {
            let granted = self.grant(request);
            self.answer(&ServerMessage::Granted { round, granted })?;
        }
        if self.conditions.anew {
            self.delivered.fill(false);
        }
        let content = self.content.borrow_and_update().clone();
        let (first, says) = self.offer.start(&content, start_us);
        if says {
            let start_us = self.offer.middle_us(&content, first);
            self.answer(&ServerMessage::Begin { round, start_us })?;
        }
        let next = Round::new(round, self.carrier, (content, first), self.policy, &self.delivered);
        self.round = next.map_err(|error| refused(RefusalCode::Message, error.to_string()))?;
        self.tally.rounds += 1;
        Ok(())
    }

    /// Puts the session under `conditions`, as far as the server lets it.
    fn grant(&mut self, conditions: Conditions) -> Granted {
        if !self.may_change {
            return Granted { link: false, scheduler: false };
        }
        self.conditions = conditions;
        self.policy = conditions.scheduler.unwrap_or(self.own_policy);
        let impairment = conditions.impairment();
        let link = !conditions.keeps_link
            && self.link.is_some_and(|link| link.set(self.carrier.address(), impairment.as_ref()));
        if link {
            self.carrier.reset_least_rtt();
        }
        Granted { link, scheduler: true }
    }

    /// Writes `message` as soon as the client takes it.
    fn answer(&mut self, message: &ServerMessage) -> Result<(), End> {
        if self.out.len() - self.greeting > MAX_UNREAD {
            return Err(refused(RefusalCode::Flood, "answers are not read".to_owned()));
        }
        self.out.extend(message.to_bytes());
        Ok(())
    }

    fn on_datagram(&mut self, datagram: &[u8]) -> Result<(), Refusal> {
        // One for every packet, and some besides.
        let now = self.began.elapsed();
        if !self.datagrams.take(1.0, now) {
            let sentence = "more datagrams than packets were sent".to_owned();
            return Err(Refusal { code: RefusalCode::Flood, sentence });
        }
        self.heard_at = Instant::now();
        let (round, receipt) = datagram.split_at(datagram.len().min(ROUND_BYTES));
        let round = <[u8; ROUND_BYTES]>::try_from(round).ok().map(u32::from_le_bytes);
        if round == Some(self.round.number) {
            let before = self.round.counts().refused_receipts;
            self.round.on_receipt(receipt, self.carrier);
            let refused = self.round.counts().refused_receipts - before;
            self.tally.refused += refused;
            self.tally.receipts += 1 - refused;
        } else if round.is_none() {
            self.tally.refused += 1;
        }
        // One of a later round has overtaken the message that begins it; what it says will be said again.
        if self.tally.refused > MAX_REFUSED {
            let sentence = format!("more than {MAX_REFUSED} datagrams are no receipts");
            return Err(Refusal { code: RefusalCode::Flood, sentence });
        }
        Ok(())
    }

    /// More of the stream is there: the round goes on with it.
    fn renew(&mut self) -> Result<(), GraphError> {
        let content = self.content.borrow_and_update().clone();
        self.close_round();
        self.renewals += 1;
        self.round.renew(self.carrier, content, self.policy, &self.delivered)
    }

    /// Takes what the round has counted.
    fn close_round(&mut self) {
        self.round.note_delivered(&mut self.delivered);
        let counts = self.round.counts();
        self.tally.retransmitted += counts.retransmitted;
        self.tally.parity += counts.parity;
        self.tally.lost += self.round.take_lost();
        self.tally.located |= self.round.is_located();
    }
}
