//! Datagrams that come again, and an address that never answers: QUIC drops the former, and bounds what the
//! latter gets.

use std::{
    net::UdpSocket,
    sync::{
        Mutex,
        atomic::{AtomicU32, Ordering},
    },
};

use super::*;
use crate::socket::{
    FrameShown,
    message::{ClientMessage, Message as _},
};

/// Longest datagram that is carried.
const MAX_BYTES: usize = 2048;
/// Times that a datagram is sent again, from each address.
const REPEATS: usize = 150;
/// Bytes of the datagram that is no receipt: in QUIC's packet longer than all else that a viewer sends once
/// its session is there.
const JUNK_BYTES: usize = 400;
/// QUIC version 1: bits of a first byte that say Initial, or a short header (RFC 9000, section 17), and the
/// bits that say it.
const INITIAL: (u8, u8) = (0xf0, 0xc0);
const SHORT: (u8, u8) = (0x80, 0x00);
/// When a handshake that nobody goes on with is given up: late enough for those that a busy machine goes on
/// with.
const IDLE: Duration = Duration::from_secs(6);

/// Stands between one client and a server, carries datagrams both ways, and remembers those of the client.
struct Forwarder {
    address: SocketAddr,
    /// As which the server sees the client.
    far: Arc<tokio::net::UdpSocket>,
    seen: Arc<Mutex<Vec<Vec<u8>>>>,
    task: JoinHandle<()>,
}

impl Forwarder {
    async fn start(server: SocketAddr) -> Self {
        let near = tokio::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let far = Arc::new(tokio::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap());
        far.connect(server).await.unwrap();
        let (address, seen) = (near.local_addr().unwrap(), Arc::new(Mutex::new(Vec::new())));
        let task = tokio::spawn(carry(near, far.clone(), seen.clone()));
        Self { address, far, seen, task }
    }

    /// The first datagram of the client that begins with `(mask, bits)` and has more than `len` bytes, once
    /// there is one.
    async fn first(&self, (mask, bits): (u8, u8), len: usize) -> Vec<u8> {
        let fits = |datagram: &&Vec<u8>| datagram.len() > len && datagram[0] & mask == bits;
        loop {
            let found = self.seen.lock().unwrap().iter().find(fits).cloned();
            if let Some(datagram) = found {
                return datagram;
            }
            tokio::time::sleep(Duration::from_millis(2)).await;
        }
    }
}

impl Drop for Forwarder {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Carries datagrams both ways, for ever.
async fn carry(near: tokio::net::UdpSocket, far: Arc<tokio::net::UdpSocket>, seen: Arc<Mutex<Vec<Vec<u8>>>>) {
    let mut client = None;
    let (mut up, mut down) = (vec![0; MAX_BYTES], vec![0; MAX_BYTES]);
    loop {
        tokio::select! {
            received = near.recv_from(&mut up) => {
                let Ok((len, from)) = received else { continue };
                client = Some(from);
                seen.lock().unwrap().push(up[..len].to_vec());
                let _ = far.send(&up[..len]).await;
            }
            received = far.recv(&mut down) => {
                let (Ok(len), Some(client)) = (received, client) else { continue };
                let _ = near.send_to(&down[..len], client).await;
            }
        }
    }
}

/// Sends `datagrams` again to `server` and, by `far`, as the client: slowly enough that the server's socket
/// has room for all. How many bytes came back to the other address.
async fn replay(datagrams: &[Vec<u8>], server: SocketAddr, far: &tokio::net::UdpSocket) -> usize {
    let stranger = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    for _ in 0..REPEATS {
        for datagram in datagrams {
            far.send(datagram).await.unwrap();
            stranger.send_to(datagram, server).unwrap();
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    tokio::time::sleep(Duration::from_millis(100)).await;
    waiting_bytes(&stranger)
}

/// Bytes of all datagrams that wait to be read.
fn waiting_bytes(socket: &UdpSocket) -> usize {
    socket.set_nonblocking(true).unwrap();
    let mut buffer = [0; MAX_BYTES];
    std::iter::from_fn(|| socket.recv(&mut buffer).ok()).sum()
}

/// A datagram that was taken twice would count twice: a hundred of these end a session.
#[test]
fn datagrams_that_come_again_are_not_taken_again() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let (address, trust) = (server.address, server.trust.clone());
        let forwarder = Forwarder::start(address).await;
        let server = Running { address: forwarder.address, ..server };
        let (endpoint, connection) = server.connect().await;
        let (mut send, mut receive) = connection.open_bi().await.unwrap();
        let hello = ClientMessage::Hello { stream: StreamChoice::Index(0), start_us: 0 }.to_bytes();
        send.write_all(&hello).await.unwrap();
        // Once the manifest comes the session is there.
        receive.read_chunk(100, true).await.unwrap();
        connection.send_datagram_wait(vec![0; JUNK_BYTES].into()).await.unwrap();
        let both = [forwarder.first(INITIAL, 0).await, forwarder.first(SHORT, JUNK_BYTES).await];
        let answered = replay(&both, address, &forwarder.far).await;
        assert_eq!(answered, 0, "bytes to an address that has no connection");
        assert!(connection.close_reason().is_none(), "{:?}", connection.close_reason());
        let honest = play(&client(address, &trust), &mut NullSink, std::future::pending()).await;
        let honest = honest.whole().unwrap();
        assert_eq!(honest.shown_count, u64::from(honest.frames));
        connection.close(0u32.into(), b"");
        endpoint.wait_idle().await;
        let (report, viewers) = server.stop().await;
        assert_eq!((report.viewers, report.failed_handshakes, report.turned_away), (2, 0, 0), "{report:?}");
        assert_eq!((report.retried, report.stray_datagrams), (0, 0), "{report:?}");
        let refused: u64 = viewers.iter().map(|viewer| viewer.refused_receipts).sum();
        assert_eq!(refused, 1, "{viewers:?}");
    });
}

/// Says which round is shown.
struct Showing(Arc<AtomicU32>);

impl FrameSink for Showing {
    fn show(&mut self, _player: &mut dgs_player::Player, _frame: u32) -> Result<(), String> {
        Ok(())
    }

    fn shown(&mut self, frame: &FrameShown) {
        self.0.store(frame.round, Ordering::Relaxed);
    }
}

#[test]
fn a_viewer_whose_datagrams_are_sent_again_goes_on_watching() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let forwarder = Forwarder::start(server.address).await;
        let mut config = client(forwarder.address, &server.trust);
        config.loops = true;
        config.startup.max_wait = Nanos::from_s(20);
        let round = Arc::new(AtomicU32::new(0));
        let (finished, is_finished) = oneshot::channel::<()>();
        let replaying = async {
            let both = [forwarder.first(INITIAL, 0).await, forwarder.first(SHORT, 0).await];
            // By now the viewer has said more: these are not the latest.
            tokio::time::sleep(Duration::from_millis(300)).await;
            let answered = replay(&both, server.address, &forwarder.far).await;
            drop(finished);
            answered
        };
        // The clip is served to its end, and again after all of that.
        let goes_on = async {
            drop(is_finished.await);
            let last = round.load(Ordering::Relaxed);
            while round.load(Ordering::Relaxed) == last {
                tokio::time::sleep(Duration::from_millis(20)).await;
            }
        };
        let mut screen = Showing(Arc::clone(&round));
        let watching = play(&config, &mut screen, goes_on);
        let (played, answered) = tokio::join!(watching, replaying);
        let report = played.whole().unwrap();
        assert_eq!((report.connections, report.refused, answered), (1, 0, 0), "{report:?}");
        assert!(report.rounds > 1 && report.base_miss_rate < 0.5, "{report:?}");
        let (report, viewers) = server.stop().await;
        assert_eq!(
            (report.viewers, report.failed_handshakes, report.stray_datagrams),
            (1, 0, 0),
            "{report:?}"
        );
        assert!(viewers[0].receipts > 0 && viewers[0].refused_receipts == 0, "{viewers:?}");
    });
}

/// Once a connection is forgotten, its first datagram begins a handshake that nobody goes on with.
#[test]
fn a_first_datagram_that_comes_after_its_connection_is_counted() {
    within(async {
        let server = Running::start(ServerLimits { idle: IDLE, ..ServerLimits::default() });
        let address = server.address;
        let forwarder = Forwarder::start(address).await;
        let server = Running { address: forwarder.address, ..server };
        server.shows_every_frame().await;
        let first = forwarder.first(INITIAL, 0).await;
        let stranger = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        // As long as the connection is known, none is answered.
        while waiting_bytes(&stranger) == 0 {
            stranger.send_to(&first, address).unwrap();
            tokio::time::sleep(Duration::from_millis(100)).await;
        }
        tokio::time::sleep(IDLE + Duration::from_millis(500)).await;
        let (report, _) = server.stop().await;
        assert_eq!(
            (report.viewers, report.failed_handshakes, report.stray_datagrams),
            (1, 1, 0),
            "{report:?}"
        );
    });
}

/// RFC 9000, section 8.1: three times what came. `quinn` lets a whole datagram out as long as any of that is
/// left, so that the last one may pass the bound by less than its length.
#[test]
fn an_address_that_never_answers_gets_little_and_is_counted() {
    within(async {
        let server = Running::start(ServerLimits { idle: IDLE, ..ServerLimits::default() });
        let nobody = tokio::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
        let config = client(nobody.local_addr().unwrap(), &server.trust);
        let (mut screen, mut initial) = (NullSink, vec![0; MAX_BYTES]);
        let (len, _) = tokio::select! {
            received = nobody.recv_from(&mut initial) => received.unwrap(),
            _ = play(&config, &mut screen, std::future::pending()) => panic!("nobody serves"),
        };
        initial.truncate(len);
        assert!(initial.len() >= 1200 && initial[0] & INITIAL.0 == INITIAL.1, "{} bytes", initial.len());
        let silent = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        silent.send_to(&initial, server.address).unwrap();
        // Past the first probe timeout, a second, and until the handshake is given up.
        tokio::time::sleep(IDLE + Duration::from_millis(500)).await;
        server.shows_every_frame().await;
        let (report, _) = server.stop().await;
        let back = waiting_bytes(&silent);
        assert!(back > 0 && back < 3 * initial.len() + 1200, "{back} bytes for {}", initial.len());
        assert_eq!((report.viewers, report.failed_handshakes), (1, 1), "{report:?}");
    });
}
