//! Where no datagrams pass, media comes in streams, receipts on the control stream, within the same bounds.

use bytes::Bytes;
use quinn::{ReadError, ReadToEndError, RecvStream, SendStream};

use super::{servers::played, *};
use crate::socket::{
    media_streams::{MEDIA_STREAMS, OutgoingMedia},
    message::{ClientMessage, Message as _, MessageReader, RefusalCode, ServerMessage},
    served_stream::MAX_MEDIA_BYTES,
};

/// Bytes that may be on their way before any have arrived: ten datagrams.
const FIRST_WINDOW: usize = 12_000;

fn hello() -> Vec<u8> {
    ClientMessage::Hello { stream: StreamChoice::Index(0), start_us: 0 }.to_bytes()
}

fn packets() -> Vec<Vec<u8>> {
    stream().packets().iter().filter(|packet| !packet.is_empty()).cloned().collect()
}

/// A client that has said hello and `more`.
async fn greeted(server: &Running, more: &[u8]) -> (Endpoint, Connection, SendStream) {
    let (endpoint, connection) = server.connect().await;
    let send = greet(&connection, &[&hello(), more].concat()).await;
    (endpoint, connection, send)
}

/// Says `first` on the control stream, and listens.
async fn greet(connection: &Connection, first: &[u8]) -> SendStream {
    let (mut send, mut receive) = connection.open_bi().await.unwrap();
    send.write_all(first).await.unwrap();
    // The manifest is read, so that media may leave.
    tokio::spawn(
        async move { while receive.read_chunk(4096, true).await.is_ok_and(|chunk| chunk.is_some()) {} },
    );
    send
}

/// A stream of three times the bytes that may be on their way at first; no player takes its packets.
fn large() -> ServedStream {
    let raw = stream().manifest().unwrap().raw().to_vec();
    let packets = vec![vec![0x55; MAX_MEDIA_BYTES]; packets().len()];
    assert!(packets.len() * MAX_MEDIA_BYTES > 3 * FIRST_WINDOW);
    let large = Stream::new(raw, packets).unwrap();
    ServedStream::live("large", &large, graph(&large), 0).unwrap().0
}

#[test]
fn a_client_without_datagrams_sees_the_same() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let plain = server.play().await.unwrap();
        for scheme in [Scheme::Dgs, Scheme::Https] {
            let mut config = ClientConfig { streams: true, ..server.client() };
            config.locator.scheme = scheme;
            let report = play(&config, &mut NullSink, std::future::pending()).await.whole().unwrap();
            assert_eq!(
                (report.shown_count, report.packets),
                (plain.shown_count, plain.packets),
                "{scheme:?}"
            );
            assert!(report.refused == 0 && report.shown_count == u64::from(report.frames), "{report:?}");
        }
        let (report, viewers) = server.stop().await;
        assert!(report.refused.is_empty() && viewers.iter().all(|viewer| viewer.receipts > 0), "{viewers:?}");
    });
}

#[test]
fn who_wishes_for_streams_gets_each_packet_in_one() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let expected = packets();
        let (_endpoint, connection, _send) = greeted(&server, &ClientMessage::Streams.to_bytes()).await;
        let most = expected.len().min(32);
        let (mut found, mut given_up) = (Vec::new(), 0);
        while found.len() + given_up < most {
            let mut stream = connection.accept_uni().await.unwrap();
            match stream.read_to_end(2000).await {
                Ok(packet) => found.push(packet),
                // What has not arrived within a second, on a busy machine.
                Err(ReadToEndError::Read(ReadError::Reset(_))) => given_up += 1,
                Err(error) => panic!("{error}"),
            }
        }
        assert!(
            !found.is_empty() && found.iter().all(|packet| expected.contains(packet)),
            "each is one of the stream's"
        );
        let mut once = found.clone();
        once.sort();
        once.dedup();
        assert_eq!(once.len(), found.len(), "none came twice");
        let datagram = tokio::time::timeout(Duration::from_millis(100), connection.read_datagram()).await;
        assert!(datagram.is_err(), "{datagram:?}");
        // The comparison can fail: who does not ask for them gets no stream.
        let (_endpoint, plain, _send) = greeted(&server, &[]).await;
        let datagram = plain.read_datagram().await.unwrap();
        assert!(expected.contains(&datagram.to_vec()));
        let opened = tokio::time::timeout(Duration::from_millis(100), plain.accept_uni()).await;
        assert!(opened.is_err(), "{opened:?}");
        server.stop().await;
    });
}

/// The transport of a client that takes no datagrams, and of each stream a hundred bytes until it reads.
fn narrow() -> Arc<TransportConfig> {
    let mut transport = TransportConfig::default();
    transport
        .max_concurrent_uni_streams(MEDIA_STREAMS.into())
        .stream_receive_window(100u32.into())
        .datagram_receive_buffer_size(None);
    Arc::new(transport)
}

/// The streams that the peer opens before it pauses for 300 ms, unread. The first may take its time.
async fn opened(connection: &Connection) -> Vec<RecvStream> {
    let mut streams = vec![connection.accept_uni().await.unwrap()];
    let pause = Duration::from_millis(300);
    while let Ok(stream) = tokio::time::timeout(pause, connection.accept_uni()).await {
        streams.push(stream.unwrap());
    }
    streams
}

/// The end at a server of a connection to a client that was killed: nothing is acknowledged.
fn to_nobody(runtime: &Runtime) -> (Endpoint, Connection) {
    let victims = Runtime::new().unwrap();
    let identity = Identity::self_signed(&["localhost".to_owned()]).unwrap();
    let (crypto, _) = Trust::Pin(identity.pin()).client(Scheme::Dgs).unwrap();
    let mut config = quinn::ServerConfig::with_crypto(Arc::new(identity.server().unwrap()));
    config.transport_config(ServerLimits::default().transport(CongestionControl::default()));
    let any = (Ipv4Addr::LOCALHOST, 0).into();
    let server = runtime.block_on(async { Endpoint::server(config, any) }).unwrap();
    let (accepting, address) = (server.clone(), server.local_addr().unwrap());
    let served = runtime.spawn(async move { accepting.accept().await.unwrap().await.unwrap() });
    victims.block_on(async {
        let endpoint = Endpoint::client(any).unwrap();
        let config = quinn::ClientConfig::new(Arc::new(crypto));
        let connection = endpoint.connect_with(config, address, "localhost").unwrap().await.unwrap();
        // Dropped, it would say farewell for as long as its tasks are there.
        std::mem::forget((endpoint, connection));
    });
    let served = runtime.block_on(served).unwrap();
    victims.shutdown_background();
    (server, served)
}

#[test]
fn what_does_not_arrive_is_bounded_by_congestion_control_and_given_up() {
    let runtime = Runtime::new().unwrap();
    let (_server, served) = to_nobody(&runtime);
    runtime.block_on(async {
        let media = OutgoingMedia::new(&served, Bytes::new());
        let packet = [0x55; MAX_MEDIA_BYTES];
        let pause = Duration::from_millis(300);
        let mut bytes = 0;
        while let Ok(sent) = tokio::time::timeout(pause, media.send(&packet)).await {
            sent.unwrap();
            bytes += MAX_MEDIA_BYTES;
        }
        // Acknowledgements of the handshake may have widened the window.
        assert!((FIRST_WINDOW / 2..2 * FIRST_WINDOW).contains(&bytes), "{bytes} bytes are on their way");
        tokio::time::sleep(Duration::from_secs(1)).await;
        let more = tokio::time::timeout(Duration::from_secs(5), media.send(&packet)).await;
        more.expect("what is given up makes no room").unwrap();
    });
}

/// A viewer that reads no stream holds up itself alone, and what is on its way to it is bounded.
#[test]
fn streams_that_are_not_read_hold_up_nobody_else() {
    within(async {
        let everything = ServedStream::new("everything", &stream(), graph(&stream())).unwrap();
        let server = Running::serving(true, ServerLimits::default(), vec![everything, large()]);
        let (_endpoint, connection) = server.connect_with(Scheme::Dgs, narrow()).await;
        let hello = ClientMessage::Hello { stream: StreamChoice::Name("large".to_owned()), start_us: 0 };
        let _send = greet(&connection, &hello.to_bytes()).await;
        let mut unread = opened(&connection).await;
        let bytes = unread.len() * MAX_MEDIA_BYTES;
        assert!((1..2 * FIRST_WINDOW).contains(&bytes), "{bytes} bytes wait");
        // That takes a second: the first is given up meanwhile.
        server.shows_every_frame().await;
        let first = unread[0].read_to_end(MAX_MEDIA_BYTES).await;
        assert!(matches!(first, Err(ReadToEndError::Read(ReadError::Reset(_)))), "{first:?}");
        server.stop().await;
    });
}

#[test]
fn floods_of_receipts_end_the_session_as_those_of_datagrams_do() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let close = |connection: Connection| async move {
            match connection.closed().await {
                quinn::ConnectionError::ApplicationClosed(close) => {
                    RefusalCode::of(close.error_code.into_inner())
                }
                other => panic!("{other:?}"),
            }
        };
        let junk = ClientMessage::Receipt(vec![0; 40]).to_bytes();
        let (_endpoint, connection, mut send) = greeted(&server, &ClientMessage::Streams.to_bytes()).await;
        while send.write_all(&junk).await.is_ok() {}
        assert_eq!(close(connection).await, Some(RefusalCode::Flood));
        // One that is too long, one without a round, and a request with a body.
        let long = [&[5u8][..], &5000u32.to_le_bytes()].concat();
        let short = [&[5u8][..], &3u32.to_le_bytes(), &[0; 3]].concat();
        let request = [&[4u8][..], &1u32.to_le_bytes(), &[0]].concat();
        for bytes in [long, short, request] {
            let (_endpoint, connection, _send) = greeted(&server, &bytes).await;
            assert_eq!(close(connection).await, Some(RefusalCode::Message), "{bytes:?}");
        }
        server.shows_every_frame().await;
        let (report, _) = server.stop().await;
        assert_eq!(report.refused.get("flood"), Some(&1), "{report:?}");
    });
}

/// A path that swallows datagrams: the client wishes for streams once none has come, and hostile ones among
/// them change nothing.
#[test]
fn datagrams_that_never_come_are_replaced_by_streams() {
    within(async {
        let talk = |connection: Connection, mut send: SendStream, mut receive: RecvStream| -> servers::Talk {
            Box::pin(async move {
                let manifest = ServerMessage::Manifest(stream().message().to_vec()).to_bytes();
                send.write_all(&manifest).await.unwrap();
                let mut reader = MessageReader::<ClientMessage>::default();
                'request: loop {
                    let chunk = receive.read_chunk(4096, true).await.unwrap().unwrap();
                    let mut input = &chunk.bytes[..];
                    while let Some(message) = reader.take(&mut input).unwrap() {
                        if message == ClientMessage::Streams {
                            break 'request;
                        }
                    }
                }
                // More than a packet, none at all, and some that never end.
                let mut open = Vec::new();
                for bytes in [vec![0x55; 5000], Vec::new(), vec![0x55; 3]] {
                    let mut stream = connection.open_uni().await.unwrap();
                    let _ = stream.write_all(&bytes).await;
                    let _ = stream.finish();
                }
                for _ in 0..MEDIA_STREAMS / 2 {
                    let mut stream = connection.open_uni().await.unwrap();
                    let _ = stream.write_all(b"never ends").await;
                    open.push(stream);
                }
                for packet in packets() {
                    let mut stream = connection.open_uni().await.unwrap();
                    let _ = stream.write_all(&packet).await;
                    let _ = stream.finish();
                }
                let _ = connection.closed().await;
            })
        };
        let patient = |config: &mut ClientConfig| config.startup.max_wait = Nanos::from_s(20);
        let report = played(talk, patient).await.whole().unwrap();
        assert_eq!(report.packets, packets().len() as u64, "{report:?}");
        assert!(report.base_miss_rate == 0.0 && report.refused <= 2, "{report:?}");
    });
}
