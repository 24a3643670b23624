//! Hostile servers: the client refuses them by name within a bound.

use std::{
    pin::Pin,
    sync::atomic::{AtomicU32, Ordering},
};

use dgs_player::{Caps, Player};
use quinn::{RecvStream, SendStream};
use tokio::sync::Notify;

use super::*;
use crate::socket::message::{Message as _, Refusal, RefusalCode, ServerMessage};

pub(super) type Talk = Pin<Box<dyn Future<Output = ()> + Send>>;

/// How long a client waits where a server is to be left for its silence.
pub(super) const SILENCE: Duration = Duration::from_millis(400);

/// How much a client has taken and shown, for servers that wait for that.
#[derive(Default)]
struct Taken {
    manifests: AtomicU32,
    media: AtomicU32,
    frames: AtomicU32,
}

struct Counting(Arc<Taken>);

impl FrameSink for Counting {
    fn show(&mut self, _player: &mut Player, _frame: u32) -> Result<(), String> {
        self.0.frames.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    fn manifest(&mut self, _message: &[u8]) {
        self.0.manifests.fetch_add(1, Ordering::Relaxed);
    }

    fn media(&mut self, _packet: &[u8]) {
        self.0.media.fetch_add(1, Ordering::Relaxed);
    }
}

/// So many so far.
fn so_far(count: &AtomicU32) -> u32 {
    count.load(Ordering::Relaxed)
}

/// Ends once there are `more` than `before`.
async fn until(count: &AtomicU32, before: u32, more: usize) {
    while so_far(count) < before + more as u32 {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
}

/// What the client makes of a server that answers a hello with `talk`. Unless `change` says otherwise the
/// client waits long: a server on a busy machine is not silent because it takes its time.
pub(super) async fn played<F>(talk: F, change: impl FnOnce(&mut ClientConfig)) -> Played
where
    F: Fn(Connection, SendStream, RecvStream) -> Talk + Send + 'static,
{
    played_until(talk, change, &Arc::default(), std::future::pending()).await
}

/// As [`played`], counted in `taken`, until `stop` ends.
async fn played_until<F>(
    talk: F,
    change: impl FnOnce(&mut ClientConfig),
    taken: &Arc<Taken>,
    stop: impl Future<Output = ()>,
) -> Played
where
    F: Fn(Connection, SendStream, RecvStream) -> Talk + Send + 'static,
{
    let identity = Identity::self_signed(&["localhost".to_owned()]).unwrap();
    let trust = Trust::Pin(identity.pin());
    let config = quinn::ServerConfig::with_crypto(Arc::new(identity.server().unwrap()));
    let endpoint = Endpoint::server(config, (Ipv4Addr::LOCALHOST, 0).into()).unwrap();
    let address = endpoint.local_addr().unwrap();
    let task = tokio::spawn(async move {
        while let Some(incoming) = endpoint.accept().await {
            let Ok(connection) = incoming.await else { continue };
            if let Ok((send, receive)) = connection.accept_bi().await {
                talk(connection, send, receive).await;
            }
        }
    });
    let mut config = ClientConfig { reconnects: 0, ..client(address, &trust) };
    change(&mut config);
    let played = play(&config, &mut Counting(Arc::clone(taken)), stop).await;
    task.abort();
    played
}

/// A server that writes `bytes` and then waits.
fn writes(bytes: Vec<u8>) -> impl Fn(Connection, SendStream, RecvStream) -> Talk + Send + 'static {
    move |connection, mut send, receive| {
        let bytes = bytes.clone();
        Box::pin(async move {
            let _ = send.write_all(&bytes).await;
            let _ = connection.closed().await;
            drop(receive);
        })
    }
}

fn manifest() -> Vec<u8> {
    ServerMessage::Manifest(stream().message().to_vec()).to_bytes()
}

#[test]
fn what_is_no_manifest_is_refused_by_name() {
    within(async {
        let garbage = ServerMessage::Manifest((0..200).map(|at| (at * 7) as u8).collect()).to_bytes();
        let mut damaged = manifest();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 1;
        let endless = [&[0x81u8][..], &u32::MAX.to_le_bytes()].concat();
        let unending = [&[0x81u8][..], &(1u32 << 24).to_le_bytes(), &[0; 5000]].concat();
        let twice = [manifest(), manifest()].concat();
        for (bytes, named) in [
            (garbage, "the manifest is refused"),
            (damaged, "the manifest is refused"),
            (endless, "manifest: length is 4294967295"),
            (b"hello".to_vec(), "message kind is 0x68"),
            (unending, "said nothing for 400 ms"),
            (Vec::new(), "said nothing for 400 ms"),
            (twice, "a second manifest"),
        ] {
            let ends_in_silence = named.contains("said nothing");
            let change = |config: &mut ClientConfig| {
                if ends_in_silence {
                    config.silence = SILENCE;
                }
            };
            let error = played(writes(bytes), change).await.whole().unwrap_err().to_string();
            assert!(error.contains(named), "{named}: {error}");
        }
        let small = |config: &mut ClientConfig| config.caps = Caps { blocks: 1, ..Caps::HOST };
        let error = played(writes(manifest()), small).await.whole().unwrap_err();
        assert!(matches!(error, PlayError::Manifest(_)), "{error}");
        let refusal = Refusal { code: RefusalCode::Full, sentence: "no".into() };
        let error = played(writes(ServerMessage::Refusal(refusal.clone()).to_bytes()), |_| ()).await.whole();
        assert!(matches!(error, Err(PlayError::Refused(found)) if found == refusal));
    });
}

#[test]
fn media_that_never_comes_and_media_that_is_none() {
    within(async {
        // Nothing but the manifest: playout starts after its wait and ends with the clip.
        let soon = |config: &mut ClientConfig| config.startup.max_wait = Nanos::from_ms(50);
        let report = played(writes(manifest()), soon).await.whole().unwrap();
        assert_eq!((report.shown_count as u32, report.base_miss_rate), (report.frames, 1.0), "{report:?}");
        assert!(!report.startup_reached);
        // Junk without end, before the manifest and after it.
        for first in [Vec::new(), manifest()] {
            let talk = move |connection: Connection, mut send: SendStream, receive: RecvStream| -> Talk {
                let first = first.clone();
                Box::pin(async move {
                    let _ = send.write_all(&first).await;
                    while connection.send_datagram_wait(vec![0x55; 100].into()).await.is_ok() {}
                    drop(receive);
                })
            };
            let patient = |config: &mut ClientConfig| config.startup.max_wait = Nanos::from_s(20);
            let error = played(talk, patient).await.whole().unwrap_err().to_string();
            assert!(error.contains("datagrams are no media"), "{error}");
        }
    });
}

#[test]
fn a_connection_that_is_lost_is_made_again_and_goes_on_where_it_was() {
    within(async {
        // Each connection ends after the manifest and half of the packets.
        let taken = Arc::new(Taken::default());
        let watched = Arc::clone(&taken);
        let talk = move |connection: Connection, mut send: SendStream, receive: RecvStream| -> Talk {
            let watched = Arc::clone(&watched);
            Box::pin(async move {
                let (manifests, media) = (so_far(&watched.manifests), so_far(&watched.media));
                let _ = send.write_all(&manifest()).await;
                for packet in stream().packets().iter().take(2) {
                    let _ = connection.send_datagram_wait(packet.clone().into()).await;
                }
                // What is on its way when a connection closes is lost.
                until(&watched.manifests, manifests, 1).await;
                until(&watched.media, media, 2).await;
                connection.close(0u32.into(), b"moved");
                drop(receive);
            })
        };
        let twice = |config: &mut ClientConfig| {
            config.reconnects = 2;
            config.startup.max_wait = Nanos::from_s(20);
        };
        let played = played_until(talk, twice, &taken, std::future::pending()).await;
        assert_eq!((played.report.connections, played.report.rounds), (3, 3));
        // Both packets are there once, however often they came.
        assert_eq!((played.report.packets, played.report.duplicates), (2, 4));
        assert!(matches!(played.error, Some(PlayError::Lost(_))), "{:?}", played.error);
    });
}

/// A round begins where a connection is made, not where one is tried.
#[test]
fn tries_to_reconnect_that_fail_are_no_rounds() {
    within(async {
        // Nobody answers whoever comes back.
        let taken = Arc::new(Taken::default());
        let watched = Arc::clone(&taken);
        let talk = move |connection: Connection, mut send: SendStream, receive: RecvStream| -> Talk {
            let watched = Arc::clone(&watched);
            Box::pin(async move {
                let _ = send.write_all(&manifest()).await;
                until(&watched.manifests, 0, 1).await;
                connection.close(0u32.into(), b"moved");
                drop(receive);
                std::future::pending::<()>().await;
            })
        };
        let twice = |config: &mut ClientConfig| {
            config.reconnects = 2;
            config.startup.max_wait = Nanos::from_s(20);
            // The first connection must be made within this, too.
            config.silence = Duration::from_secs(5);
        };
        let played = played_until(talk, twice, &taken, std::future::pending()).await;
        assert!(matches!(played.error, Some(PlayError::Silence { .. })), "{:?}", played.error);
        assert_eq!((played.report.connections, played.report.rounds), (1, 1));
    });
}

#[test]
fn a_stream_that_grows_is_reconnected_to_and_begins_where_the_server_says() {
    within(async {
        let connections = Arc::new(AtomicU32::new(0));
        let counted = Arc::clone(&connections);
        let taken = Arc::new(Taken::default());
        let watched = Arc::clone(&taken);
        let talk = move |connection: Connection, mut send: SendStream, receive: RecvStream| -> Talk {
            let is_first = counted.fetch_add(1, Ordering::Relaxed) == 0;
            let watched = Arc::clone(&watched);
            Box::pin(async move {
                let begin = ServerMessage::Begin { round: 0, start_us: 1 }.to_bytes();
                if is_first {
                    // Together: whoever has taken the one hears of the other.
                    let _ = send.write_all(&[manifest(), begin].concat()).await;
                    let packets = stream().packets().to_vec();
                    let count = packets.len();
                    for packet in packets {
                        let _ = connection.send_datagram_wait(packet.into()).await;
                    }
                    until(&watched.manifests, 0, 1).await;
                    until(&watched.media, 0, count).await;
                    connection.close(0u32.into(), b"moved");
                } else {
                    let _ = send.write_all(&manifest()).await;
                    // All is there by now, and where it begins is not said yet.
                    tokio::time::sleep(Duration::from_millis(100)).await;
                    let _ = send.write_all(&begin).await;
                    let _ = connection.closed().await;
                }
                drop(receive);
            })
        };
        let again = |config: &mut ClientConfig| config.reconnects = 1;
        let played = played_until(talk, again, &taken, std::future::pending()).await;
        let report = played.whole().unwrap();
        assert_eq!((report.connections, connections.load(Ordering::Relaxed)), (2, 2));
        assert!(report.shown_count >= u64::from(report.frames), "{report:?}");
    });
}

/// A server of one stream first, and of another by the same name to whoever comes back.
#[test]
fn another_stream_by_the_same_name_is_not_taken_for_the_one_before() {
    within(async {
        let other = include_bytes!("../../../../../codec-core/tests/conformance/made-extents.dgs");
        let other = Stream::from_bytes(other).unwrap().0;
        let connections = AtomicU32::new(0);
        let taken = Arc::new(Taken::default());
        let watched = Arc::clone(&taken);
        let talk = move |connection: Connection, mut send: SendStream, receive: RecvStream| -> Talk {
            let is_first = connections.fetch_add(1, Ordering::Relaxed) == 0;
            let watched = Arc::clone(&watched);
            let message = if is_first { stream().message().to_vec() } else { other.message().to_vec() };
            Box::pin(async move {
                let _ = send.write_all(&ServerMessage::Manifest(message).to_bytes()).await;
                if is_first {
                    until(&watched.manifests, 0, 1).await;
                    connection.close(0u32.into(), b"moved");
                }
                let _ = connection.closed().await;
                drop(receive);
            })
        };
        let again = |config: &mut ClientConfig| config.reconnects = 1;
        let played = played_until(talk, again, &taken, std::future::pending()).await;
        assert!(matches!(played.error, Some(PlayError::Changed)), "{:?}", played.error);
        assert_eq!(played.report.connections, 2);
        assert_eq!(played.player.unwrap().info().packets as usize, stream().packets().len());
    });
}

/// Connections that are lost now and then are made again, however many they become.
#[test]
fn a_connection_that_has_shown_something_is_one_that_can_be_made_again() {
    within(async {
        let (connections, enough) = (AtomicU32::new(0), Arc::new(Notify::new()));
        let fourth = Arc::clone(&enough);
        let taken = Arc::new(Taken::default());
        let watched = Arc::clone(&taken);
        let talk = move |connection: Connection, mut send: SendStream, receive: RecvStream| -> Talk {
            if connections.fetch_add(1, Ordering::Relaxed) == 3 {
                fourth.notify_one();
            }
            let watched = Arc::clone(&watched);
            Box::pin(async move {
                let frames = so_far(&watched.frames);
                let _ = send.write_all(&manifest()).await;
                for packet in stream().packets() {
                    let _ = connection.send_datagram_wait(packet.clone().into()).await;
                }
                // Two connections in a row that show nothing are the end.
                until(&watched.frames, frames, 1).await;
                connection.close(0u32.into(), b"moved");
                drop(receive);
            })
        };
        let for_long = |config: &mut ClientConfig| {
            (config.reconnects, config.loops) = (1, true);
            config.duration = Some(Duration::from_secs(60));
        };
        let report = played_until(talk, for_long, &taken, enough.notified()).await.whole().unwrap();
        assert!(report.connections > 3, "{} connections", report.connections);
    });
}

#[test]
fn a_time_to_play_ends_with_an_error_where_nobody_was_there_and_may_be_endless() {
    within(async {
        let nobody = std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let pin = Identity::self_signed(&["localhost".to_owned()]).unwrap().pin();
        let config = client(nobody.local_addr().unwrap(), &Trust::Pin(pin));
        let soon = ClientConfig { duration: Some(Duration::from_millis(200)), ..config };
        let played = play(&soon, &mut NullSink, std::future::pending()).await;
        assert!(matches!(played.error, Some(PlayError::TimeUp { .. })), "{:?}", played.error);
        assert_eq!(played.report.connections, 0);
        let server = Running::start(ServerLimits::default());
        let endless = ClientConfig { duration: Some(Duration::MAX), ..server.client() };
        let report = play(&endless, &mut NullSink, std::future::pending()).await.whole().unwrap();
        assert_eq!((report.connections, report.shown_count), (1, report.frames.into()));
        server.stop().await;
    });
}
