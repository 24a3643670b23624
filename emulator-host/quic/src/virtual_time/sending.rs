//! Sends media over a connection: one datagram at a time is chosen, when the last has left.

use bytes::Bytes;
use emulator_host::{
    Bytes as Size, Nanos, PacketGraph, PacketIndex, Rate, Scheduler, SessionConfig,
    report::{SenderCounts, SenderRow},
    session::{MediaSender, Outstanding, PathFacts},
};
use quinn_proto::{Connection, ConnectionStats, Dir, FrameStats, StreamId};

use super::{end::End, messages::MessageWriter};
use crate::{clock::Clock, congestion::Watch};

/// A receipt leaves so long after what it reports at the latest.
const RECEIPT_DELAY: Nanos = Nanos::from_ms(25);

/// Most bytes of the manifest that are handed over at once.
const CONTROL_BYTES: usize = 16 * 1024;

/// The sender of media and its end of the connection.
pub(super) struct Sending<'a> {
    pub(super) end: End,
    pub(super) media: MediaSender<&'a PacketGraph, &'a mut dyn Scheduler>,
    /// Control messages beside the manifest.
    pub(super) messages: MessageWriter,
    outstanding: Outstanding,
    watch: Watch,
    datagram_bytes: u64,
    /// The datagram that the transport has and has not sent.
    queued: Option<PacketIndex>,
    control: Control,
    /// When the receiver was heard last.
    heard_at: Nanos,
    /// When the sender's own queue on the path may have drained.
    gate_at: Nanos,
    counts: SenderCounts,
    /// What the transport had counted when the session began.
    before: ConnectionStats,
}

/// The manifest on its way into the transport.
enum Control {
    Unopened(usize),
    Open(StreamId, usize),
    Written,
}

impl<'a> Sending<'a> {
    /// The session begins: `end` is connected.
    pub(super) fn new(
        mut end: End,
        watch: Watch,
        graph: &'a PacketGraph,
        config: &SessionConfig,
        scheduler: &'a mut dyn Scheduler,
        datagram_bytes: u64,
    ) -> Self {
        let before = end.connection().map_or_else(ConnectionStats::default, |connection| connection.stats());
        watch.look().restart(end.clock(), config.max_ack_delay);
        let path = facts(&mut end, &watch, datagram_bytes, Nanos::ZERO);
        let manifest = graph.manifest_bytes() as usize;
        Self {
            media: MediaSender::new(graph, scheduler, config.sending(), path, Nanos::ZERO),
            messages: MessageWriter::none(),
            outstanding: Outstanding::new(),
            datagram_bytes,
            queued: None,
            control: if manifest == 0 { Control::Written } else { Control::Unopened(manifest) },
            heard_at: Nanos::ZERO,
            gate_at: Nanos::MAX,
            counts: SenderCounts::default(),
            before,
            end,
            watch,
        }
    }

    pub(super) fn row(&mut self, now: Nanos) -> SenderRow {
        let path = facts(&mut self.end, &self.watch, self.datagram_bytes, now);
        SenderRow {
            time_ns: now,
            window_bytes: self
                .end
                .connection()
                .map_or(0, |connection| connection.congestion_state().window()),
            in_flight_bytes: path.in_flight,
            smoothed_rtt_ns: path.smoothed_rtt,
            rate_bps: path.rate.0,
        }
    }

    /// Counts of datagrams; those of media are [`MediaSender`]'s.
    pub(super) fn counts(&mut self) -> SenderCounts {
        let now =
            self.end.connection().map_or_else(ConnectionStats::default, |connection| connection.stats());
        let lost = now.path.lost_packets - self.before.path.lost_packets;
        let control = now.frame_tx.stream - self.before.frame_tx.stream;
        let pings = now.frame_tx.ping - self.before.frame_tx.ping;
        SenderCounts { lost, control, pings, ..self.counts }
    }

    pub(super) fn next_time(&mut self) -> Nanos {
        let due = self.outstanding.next_time().min(self.expires_at());
        self.end.next_time().min(self.gate_at).min(due).min(self.messages.next_at())
    }

    /// When what is left of a burst is known to be lost: once nothing is out for the transport, an
    /// acknowledgement of something later, which would tell, cannot come.
    fn expires_at(&self) -> Nanos {
        if self.watch.look().in_flight() > 0 {
            Nanos::MAX
        } else {
            self.outstanding.expires_at(self.silence())
        }
    }

    /// What the transport knows to be settled and no receipt names for so long is lost: receipts leave with
    /// acknowledgements, or a moment later.
    fn silence(&self) -> Nanos {
        self.media.path().smoothed_rtt + RECEIPT_DELAY
    }

    /// Takes the receipts that have arrived, and what the transport has learnt or time has shown.
    pub(super) fn learn(&mut self, now: Nanos) {
        let mut news = self.watch.look().take_news();
        let Some(connection) = self.end.connection() else { return };
        // Nothing that the transport tells is news beside what it holds.
        while connection.poll().is_some() {}
        while let Some(receipt) = connection.datagrams().recv() {
            self.media.on_receipt(&receipt);
            news = true;
        }
        let expired = self.expires_at() <= now;
        if news || expired {
            self.heard_at = now;
        }
        if news || expired || self.outstanding.next_time() <= now {
            self.outstanding.settle(&mut self.media, now);
            let silence = self.silence();
            self.outstanding.expire(&mut self.media, silence, self.heard_at, now);
            self.media.look(facts(&mut self.end, &self.watch, self.datagram_bytes, now), now);
        }
    }

    /// The next UDP payload that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<&[u8]> {
        self.write_manifest();
        if let Some(connection) = self.end.connection() {
            self.messages.write(connection, now);
        }
        self.choose(now);
        let before = frames(self.end.connection());
        self.end.transmit(now)?;
        let after = frames(self.end.connection());
        let bytes = self.end.sent();
        self.counts.datagrams += 1;
        if elicits(&before, &after) {
            let mut observed = self.watch.look();
            observed.on_sent(bytes.len() as u64, now);
            let in_flight = observed.in_flight();
            drop(observed);
            self.media.on_datagram_sent(in_flight, now);
        }
        if after.datagram > before.datagram
            && let Some(packet) = self.queued.take()
        {
            self.outstanding.on_sent(&mut self.media, packet, now);
        }
        Some(bytes)
    }

    /// Hands the transport one datagram if it has none. While control waits to be sent, and while what is in
    /// flight fills the path, it gets none.
    fn choose(&mut self, now: Nanos) {
        self.gate_at = Nanos::MAX;
        let Some(connection) = self.end.connection() else { return };
        if self.queued.is_some() || connection.has_pending_retransmits() {
            return;
        }
        if let Some(until) = self.media.full_until(now) {
            self.gate_at = until;
            return;
        }
        self.media.advance(now);
        let packet = self.media.next(now);
        self.watch.look().set_source_limited(packet.is_none());
        if let Some(packet) = packet {
            let bytes = self.media.graph().packets()[packet.at()].wire_bytes;
            let sent = connection.datagrams().send(payload(packet, usize::from(bytes)), false);
            // The path was made wide enough for every packet, and the buffer is empty.
            self.queued = sent.is_ok().then_some(packet);
        }
    }

    fn write_manifest(&mut self) {
        let Some(connection) = self.end.connection() else { return };
        loop {
            match self.control {
                Control::Written => return,
                Control::Unopened(bytes) => match connection.streams().open(Dir::Uni) {
                    Some(stream) => self.control = Control::Open(stream, bytes),
                    None => return,
                },
                Control::Open(stream, 0) => {
                    // A stream that the peer has stopped has nothing left to finish.
                    let _ = connection.send_stream(stream).finish();
                    self.control = Control::Written;
                }
                Control::Open(stream, left) => {
                    let zeros = [0; CONTROL_BYTES];
                    match connection.send_stream(stream).write(&zeros[..left.min(CONTROL_BYTES)]) {
                        Ok(written) => self.control = Control::Open(stream, left - written),
                        Err(_) => return,
                    }
                }
            }
        }
    }
}

/// Bytes that stand for `packet`: its index, then nothing.
fn payload(packet: PacketIndex, bytes: usize) -> Bytes {
    let mut payload = vec![0; bytes.max(4)];
    payload[..4].copy_from_slice(&packet.0.to_be_bytes());
    Bytes::from(payload)
}

fn frames(connection: Option<&mut Connection>) -> FrameStats {
    connection.map_or_else(FrameStats::default, |connection| connection.stats().frame_tx)
}

/// Whether what was sent between the two counts must be acknowledged: it holds more than acknowledgements.
fn elicits(before: &FrameStats, after: &FrameStats) -> bool {
    let others = |frames: &FrameStats| {
        frames.datagram
            + frames.stream
            + frames.ping
            + frames.crypto
            + frames.max_data
            + frames.max_stream_data
            + frames.new_connection_id
            + frames.retire_connection_id
            + u64::from(frames.handshake_done)
    };
    others(after) > others(before)
}

/// What is known of the path at `now`.
fn facts(end: &mut End, watch: &Watch, datagram_bytes: u64, now: Nanos) -> PathFacts {
    let Some(connection) = end.connection() else { return PathFacts::unknown(datagram_bytes) };
    let observed = watch.look();
    let smoothed_rtt = Clock::span(connection.rtt());
    let smoothed_rtt = PathFacts::expected_round_trip(smoothed_rtt, observed.newest_round_trip());
    let window = Rate::over(Size(connection.congestion_state().window()), smoothed_rtt);
    let recent = observed.recent_round_trips();
    // The transport's own also counts samples of the handshake that the observer cannot tell apart.
    let minimum_rtt = if recent.has_forgotten() { recent.get() } else { Clock::span(connection.min_rtt()) };
    PathFacts {
        rate: observed.path_rate().map_or(window, |path| window.min(path)),
        smoothed_rtt,
        rtt_variation: observed.variation().min(smoothed_rtt),
        minimum_rtt,
        minimum_rtt_age: recent.age(now),
        in_flight: observed.in_flight(),
        datagram_bytes,
    }
}
