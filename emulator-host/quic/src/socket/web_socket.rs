//! Carries a session in the binary frames of a WebSocket, for browsers whose network lets no UDP through.
//!
//! The first byte of a frame says what follows: bytes of the control stream, or a datagram. TCP repeats what
//! is lost and keeps the order, so nothing may wait in it that could be sent too late: one datagram waits
//! here, and the sender bounds by receipts what is on its way.

use std::{
    net::SocketAddr,
    sync::{
        Arc, Mutex as StdMutex, PoisonError,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use bytes::Bytes;
use emulator_host::congestion::RecentMinimum;
use futures_util::{SinkExt, StreamExt, stream::SplitSink};
use hyper::upgrade::Upgraded;
use hyper_util::rt::TokioIo;
use tokio::{
    sync::{Mutex, mpsc, oneshot},
    time::{MissedTickBehavior, interval, timeout},
};
use tokio_tungstenite::{
    WebSocketStream,
    tungstenite::{
        Message,
        protocol::{CloseFrame, WebSocketConfig, frame::coding::CloseCode},
    },
};

use super::channel::{Closed, Path};
use crate::clock::Clock;

/// First bytes of frames.
const CONTROL: u8 = 0;
const DATAGRAM: u8 = 1;
/// Longest frame of a client: receipts and messages are shorter.
const MAX_CLIENT_BYTES: usize = 4096;
/// Most bytes of the control stream in a frame.
const CONTROL_BYTES: usize = 16 << 10;
/// Frames of a client that wait to be taken: datagrams beyond are dropped, messages make the client wait.
const WAITING: usize = 64;
/// Time between two questions of how long the path is.
const PING: Duration = Duration::from_millis(200);
/// Round trip before anything is known of it.
const FIRST_RTT: Duration = Duration::from_millis(100);
/// Bytes that may be on their way before any are known to have arrived; each that has makes room for another.
const FIRST_WINDOW: u64 = 32 << 10;
/// Bytes of the longest datagram with what stands before it in a frame, and TCP/IP's heads.
const DATAGRAM_BYTES: u64 = 1200;
/// How long the client may take to answer a close.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);
/// Codes for programs begin here; refusals follow by their codes.
const FIRST_CODE: u16 = 4000;
/// Longest reason of a close.
const MAX_REASON_BYTES: usize = 123;

/// A WebSocket that a page's server has granted.
pub(crate) type Socket = WebSocketStream<TokioIo<Upgraded>>;

/// What a client may send, and what may wait towards it.
pub(crate) fn config() -> WebSocketConfig {
    WebSocketConfig::default()
        .read_buffer_size(MAX_CLIENT_BYTES)
        .write_buffer_size(0)
        .max_write_buffer_size(4 * CONTROL_BYTES)
        .max_message_size(Some(MAX_CLIENT_BYTES))
        .max_frame_size(Some(MAX_CLIENT_BYTES))
}

/// A session's datagrams, both ways.
#[derive(Debug)]
pub(super) struct SocketChannel {
    address: SocketAddr,
    out: mpsc::Sender<Bytes>,
    heard: Mutex<mpsc::Receiver<Bytes>>,
    measured: Arc<Measured>,
}

/// How a session on a WebSocket comes to its end.
#[derive(Debug)]
pub(super) struct SocketCloser {
    close: oneshot::Sender<CloseFrame>,
    gone: oneshot::Receiver<()>,
}

/// The writing half of the control stream.
#[derive(Debug)]
pub(super) struct SocketWriter(mpsc::Sender<Bytes>);

/// What the frames show of the path.
#[derive(Debug)]
struct Measured {
    began: Instant,
    sent: AtomicU64,
    /// Round trip: its smoothed mean, and the least of late.
    rtt: StdMutex<Option<(Duration, RecentMinimum)>>,
}

impl Measured {
    /// What a question carries: when it left.
    fn question(&self) -> Bytes {
        let nanos = u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX);
        Bytes::copy_from_slice(&nanos.to_le_bytes())
    }

    /// The answer to a question; whatever else comes means nothing.
    fn answer(&self, question: &[u8]) {
        let Ok(sent_at) = <[u8; 8]>::try_from(question) else { return };
        let sent_at = Duration::from_nanos(u64::from_le_bytes(sent_at));
        let now = self.began.elapsed();
        let Some(rtt) = now.checked_sub(sent_at) else { return };
        let mut known = self.rtt.lock().unwrap_or_else(PoisonError::into_inner);
        let (mean, least) = known.get_or_insert_with(|| (rtt, RecentMinimum::new()));
        // As RFC 6298 smooths it.
        *mean = (7 * *mean + rtt) / 8;
        least.take(Clock::span(rtt), Clock::span(now));
    }
}

impl SocketChannel {
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    pub(super) fn sent_bytes(&self) -> u64 {
        self.measured.sent.load(Ordering::Relaxed)
    }

    /// What is known of the path once `arrived` bytes of media are known to have arrived.
    pub(super) fn path(&self, arrived: u64) -> Path {
        let now = Clock::span(self.measured.began.elapsed());
        let known = self.measured.rtt.lock().unwrap_or_else(PoisonError::into_inner);
        let (rtt, least_rtt, least_rtt_age) =
            known.as_ref().map_or((FIRST_RTT, FIRST_RTT, Duration::ZERO), |(mean, least)| {
                (*mean, Duration::from_nanos(least.get().0), Duration::from_nanos(least.age(now).0))
            });
        drop(known);
        let window_bytes = FIRST_WINDOW.saturating_add(arrived);
        Path {
            rtt,
            least_rtt,
            least_rtt_age,
            newest_rtt: None,
            rtt_variation: None,
            rate: None,
            in_flight: None,
            window_bytes,
            datagram_bytes: DATAGRAM_BYTES,
        }
    }

    /// Becomes ready once the datagram is the next that is written.
    pub(super) async fn send(&self, bytes: Bytes) -> Result<(), Closed> {
        self.out.send(bytes).await.map_err(|_| Closed::Socket)
    }

    /// The next datagram.
    pub(super) async fn read(&self) -> Result<Bytes, Closed> {
        self.heard.lock().await.recv().await.ok_or(Closed::Socket)
    }
}

impl SocketCloser {
    /// Closes with `code`, and says why.
    pub(super) async fn close(self, code: u32, reason: &str) {
        let mut reason = reason.to_owned();
        while reason.len() > MAX_REASON_BYTES {
            reason.pop();
        }
        let code = match u16::try_from(code) {
            Ok(0) | Err(_) => CloseCode::Normal,
            Ok(code) => CloseCode::Library(FIRST_CODE.saturating_add(code)),
        };
        let _ = self.close.send(CloseFrame { code, reason: reason.into() });
        let _ = timeout(2 * CLOSE_TIMEOUT, self.gone).await;
    }
}

impl SocketWriter {
    /// Writes as much of `bytes` as a frame holds; nothing once the WebSocket has ended.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Option<usize> {
        let room = self.0.reserve().await.ok()?;
        let now = &bytes[..bytes.len().min(CONTROL_BYTES)];
        room.send(Bytes::copy_from_slice(now));
        Some(now.len())
    }
}

/// Begins a session on `socket`: the session's parts, its control stream's bytes, and who carries them until
/// the WebSocket has ended, which must be polled.
pub(super) fn open(
    socket: Socket,
    address: SocketAddr,
) -> (SocketChannel, SocketCloser, SocketWriter, mpsc::Receiver<Bytes>, impl Future<Output = ()> + Send) {
    let measured =
        Arc::new(Measured { began: Instant::now(), sent: AtomicU64::new(0), rtt: StdMutex::new(None) });
    let (media, media_out) = mpsc::channel(1);
    let (messages, control_out) = mpsc::channel(1);
    let (heard_sender, heard) = mpsc::channel(WAITING);
    let (control_sender, control) = mpsc::channel(WAITING);
    let (close, closing) = oneshot::channel();
    let (ended, gone) = oneshot::channel();
    let (sink, mut stream) = socket.split();
    let mut writing = Writing { sink, measured: measured.clone(), control: control_out, media: media_out };
    let noted = measured.clone();
    let carrying = async move {
        let mut reading = Box::pin(async move {
            while let Some(Ok(message)) = stream.next().await {
                let taken = match &message {
                    Message::Binary(frame) => take(frame, &control_sender, &heard_sender).await,
                    Message::Pong(question) => {
                        noted.answer(question);
                        true
                    }
                    // Pings are answered below.
                    Message::Ping(_) => true,
                    Message::Text(_) | Message::Close(_) | Message::Frame(_) => false,
                };
                if !taken {
                    break;
                }
            }
        });
        let frame = tokio::select! {
            () = &mut reading => None,
            frame = writing.run(closing) => frame,
        };
        // Who closes first waits for the answer, so that nothing that was written is thrown away.
        if frame.is_some() && writing.sink.send(Message::Close(frame)).await.is_ok() {
            let _ = timeout(CLOSE_TIMEOUT, reading).await;
        } else {
            let _ = timeout(CLOSE_TIMEOUT, writing.sink.close()).await;
        }
        // Whether anybody waits for that does not matter.
        let _ = ended.send(());
    };
    let channel = SocketChannel { address, out: media, heard: Mutex::new(heard), measured };
    (channel, SocketCloser { close, gone }, SocketWriter(messages), control, carrying)
}

/// Takes a frame of the client; false if it is none, or the session is over.
async fn take(frame: &Bytes, control: &mpsc::Sender<Bytes>, heard: &mpsc::Sender<Bytes>) -> bool {
    match frame.first() {
        Some(&CONTROL) => control.send(frame.slice(1..)).await.is_ok(),
        // As a path without room would, this loses what comes too fast.
        Some(&DATAGRAM) => {
            !matches!(heard.try_send(frame.slice(1..)), Err(mpsc::error::TrySendError::Closed(_)))
        }
        _ => false,
    }
}

/// What is written, in the order in which it must leave.
struct Writing {
    sink: SplitSink<Socket, Message>,
    measured: Arc<Measured>,
    control: mpsc::Receiver<Bytes>,
    media: mpsc::Receiver<Bytes>,
}

impl Writing {
    /// Writes until the session closes, with what it says then, or nothing can be written any more.
    async fn run(&mut self, mut closing: oneshot::Receiver<CloseFrame>) -> Option<CloseFrame> {
        let mut pings = interval(PING);
        pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            let (kind, content) = tokio::select! {
                biased;
                Some(message) = self.control.recv() => (CONTROL, message),
                frame = &mut closing => return frame.ok(),
                _ = pings.tick() => {
                    self.sink.send(Message::Ping(self.measured.question())).await.ok()?;
                    continue;
                }
                Some(datagram) = self.media.recv() => (DATAGRAM, datagram),
            };
            let frame = [&[kind], &content[..]].concat();
            self.sink.send(Message::Binary(frame.into())).await.ok()?;
            self.measured.sent.fetch_add(content.len() as u64, Ordering::Relaxed);
        }
    }
}
