//! WebTransport carries the same session, and a client that speaks it badly is refused by name.

use quinn::{ConnectionError, RecvStream, SendStream};
use web_transport_proto::{
    Capsule, ConnectRequest, ConnectResponse, Frame, Http3CapsuleReader, Settings, StreamUni, VarInt,
    error_from_http3,
};

use super::*;
use crate::socket::message::{ClientMessage, Message as _, RefusalCode};

fn over_web(server: &Running) -> ClientConfig {
    let mut config = server.client();
    config.locator.scheme = Scheme::Https;
    config
}

fn hello(index: u16) -> Vec<u8> {
    ClientMessage::Hello { stream: StreamChoice::Index(index), start_us: 0 }.to_bytes()
}

fn settings() -> Vec<u8> {
    let mut settings = Settings::default();
    settings.enable_webtransport(1);
    let mut bytes = Vec::new();
    settings.encode(&mut bytes);
    bytes
}

/// A request for a session.
fn connect() -> Vec<u8> {
    let url = url::Url::parse("https://localhost/x").unwrap();
    let mut bytes = Vec::new();
    ConnectRequest::new(url).encode(&mut bytes).unwrap();
    bytes
}

/// What stands before a stream of `session`.
fn head(kind: Frame, session: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    kind.0.encode(&mut bytes);
    VarInt::from_u32(session).encode(&mut bytes);
    bytes
}

/// The code with which the server closed.
async fn closed_by(connection: &Connection) -> RefusalCode {
    match connection.closed().await {
        ConnectionError::ApplicationClosed(close) => {
            let code = error_from_http3(close.error_code.into_inner()).unwrap_or_else(|| panic!("{close:?}"));
            RefusalCode::of(code.into()).unwrap_or_else(|| panic!("{close:?}"))
        }
        other => panic!("{other:?}"),
    }
}

/// A client that says settings and asks for a session; its streams of settings and of the request.
async fn session(connection: &Connection) -> (SendStream, SendStream, RecvStream) {
    let mut control = connection.open_uni().await.unwrap();
    control.write_all(&settings()).await.unwrap();
    let (mut send, mut receive) = connection.open_bi().await.unwrap();
    send.write_all(&connect()).await.unwrap();
    assert!(ConnectResponse::read(&mut receive).await.unwrap().status.is_success());
    (control, send, receive)
}

#[test]
fn a_session_over_webtransport_is_the_same_session() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let played = play(&over_web(&server), &mut NullSink, std::future::pending()).await.whole().unwrap();
        let plain = server.play().await.unwrap();
        assert_eq!((played.shown_count, played.packets), (plain.shown_count, plain.packets));
        assert!(played.shown_count > 0 && played.refused == 0, "{played:?}");
        let mut unknown = over_web(&server);
        unknown.locator.stream = StreamChoice::Name("other".to_owned());
        let error = play(&unknown, &mut NullSink, std::future::pending()).await.whole().unwrap_err();
        assert!(error.to_string().contains("no stream called other; there are everything"), "{error}");
        let mut wrong = over_web(&server);
        wrong.trust = Trust::Pin(Identity::self_signed(&["localhost".to_owned()]).unwrap().pin());
        let error = play(&wrong, &mut NullSink, std::future::pending()).await.whole().unwrap_err();
        assert!(error.to_string().contains("the pin is"), "{error}");
        let (report, viewers) = server.stop().await;
        assert_eq!((report.viewers, report.refused.len()), (2, 1), "{report:?}");
        assert!(viewers.iter().all(|viewer| viewer.refused_receipts == 0), "{viewers:?}");
    });
}

#[test]
fn a_refusal_is_the_code_with_which_the_session_closes() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let (_endpoint, connection) = server.connect_by(Scheme::Https).await;
        let (_control, _request, capsules) = session(&connection).await;
        let (mut send, _receive) = connection.open_bi().await.unwrap();
        send.write_all(&[head(Frame::WEBTRANSPORT, 0), hello(9)].concat()).await.unwrap();
        match Http3CapsuleReader::new(capsules).read().await.unwrap() {
            Some(Capsule::CloseWebTransportSession { code, reason }) => {
                assert_eq!(RefusalCode::of(code.into()), Some(RefusalCode::UnknownStream));
                assert!(reason.contains("no stream of number 9"), "{reason}");
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(closed_by(&connection).await, RefusalCode::UnknownStream);
        server.stop().await;
    });
}

#[test]
fn what_is_no_webtransport_is_refused_by_name() {
    within(async {
        // Who says nothing must not wait long, and whoever says something must not be late.
        let limits = |hello_wait| ServerLimits { hello_wait, ..ServerLimits::default() };
        let impatient = Running::start(limits(Duration::from_secs(5)));
        let server = Running::start(limits(PATIENCE));
        let mut bare = Vec::new();
        Settings::default().encode(&mut bare);
        let mut qpack = Vec::new();
        StreamUni::QPACK_ENCODER.encode(&mut qpack);
        let endless = [&head(Frame::SETTINGS, u32::MAX >> 2)[..], &[0; 100]].concat();
        let huge = head(Frame::HEADERS, 1 << 20);
        let get = [&head(Frame::HEADERS, 3)[..], &[0, 0, 0xd1]].concat();
        let (agreed, none) = (settings(), Vec::new());
        // Those that are to be closed for their silence wait for it together.
        let mut silent = Vec::new();
        // The settings stream, the request, and what begins the first stream of the session.
        for (settings, request, begin, code) in [
            (&none, &none, &none, RefusalCode::Silence),
            (&b"GET / HTTP/1.1\r\n\r\n".to_vec(), &none, &none, RefusalCode::Message),
            (&bare, &none, &none, RefusalCode::Message),
            (&qpack, &none, &none, RefusalCode::Message),
            (&endless, &none, &none, RefusalCode::Message),
            (&agreed, &b"\x01\x05hello".to_vec(), &none, RefusalCode::Message),
            (&agreed, &get, &none, RefusalCode::Message),
            (&agreed, &huge, &none, RefusalCode::Message),
            (&agreed, &none, &none, RefusalCode::Silence),
            (&agreed, &connect(), &none, RefusalCode::Silence),
            (&agreed, &connect(), &hello(0), RefusalCode::Message),
            (&agreed, &connect(), &head(Frame::WEBTRANSPORT, 4), RefusalCode::Message),
            (&agreed, &connect(), &head(Frame::DATA, 0), RefusalCode::Message),
        ] {
            let addressed = if code == RefusalCode::Silence { &impatient } else { &server };
            let (endpoint, connection) = addressed.connect_by(Scheme::Https).await;
            let mut control = connection.open_uni().await.unwrap();
            control.write_all(settings).await.unwrap();
            let mut streams = Vec::new();
            for bytes in [request, begin].into_iter().filter(|bytes| !bytes.is_empty()) {
                let (mut send, receive) = connection.open_bi().await.unwrap();
                send.write_all(bytes).await.unwrap();
                streams.push((send, receive));
            }
            if code == RefusalCode::Silence {
                silent.push((endpoint, connection, control, streams));
                continue;
            }
            assert_eq!(closed_by(&connection).await, code, "{settings:?} {request:?} {begin:?}");
        }
        for (_, connection, ..) in &silent {
            assert_eq!(closed_by(connection).await, RefusalCode::Silence);
        }
        server.shows_every_frame().await;
        let (report, viewers) = server.stop().await;
        assert_eq!((report.refused.values().sum::<u64>(), viewers.len()), (10, 1), "{report:?}");
        let late = impatient.shows_every_frame_in_the_end().await;
        let (report, viewers) = impatient.stop().await;
        let refused = report.refused.values().sum::<u64>();
        assert!((3..=3 + late).contains(&refused) && !viewers.is_empty(), "{late} late, {report:?}");
    });
}

#[test]
fn a_session_that_is_closed_or_flooded_ends_and_datagrams_of_others_are_counted() {
    within(async {
        let server = Running::start(ServerLimits::default());
        // Closed by a capsule before and after hello; then its stream just ends, or has no capsules.
        let mut capsule = Vec::new();
        Capsule::CloseWebTransportSession { code: 0, reason: "enough".to_owned() }.encode(&mut capsule);
        let close = [head(Frame::DATA, capsule.len() as u32), capsule].concat();
        for (says_hello, bytes) in
            [(false, close.clone()), (true, close), (true, Vec::new()), (true, vec![0xff; 3000])]
        {
            let (_endpoint, connection) = server.connect_by(Scheme::Https).await;
            let (_control, mut request, _capsules) = session(&connection).await;
            let (mut send, mut receive) = connection.open_bi().await.unwrap();
            send.write_all(&head(Frame::WEBTRANSPORT, 0)).await.unwrap();
            if says_hello {
                send.write_all(&hello(0)).await.unwrap();
                receive.read_chunk(10, true).await.unwrap();
            }
            request.write_all(&bytes).await.unwrap();
            request.finish().unwrap();
            assert!(matches!(connection.closed().await, ConnectionError::ApplicationClosed(_)));
        }
        // Datagrams that are of no session.
        let (_endpoint, connection) = server.connect_by(Scheme::Https).await;
        let _streams = session(&connection).await;
        let (mut send, _receive) = connection.open_bi().await.unwrap();
        send.write_all(&[head(Frame::WEBTRANSPORT, 0), hello(0)].concat()).await.unwrap();
        while connection.close_reason().is_none() {
            let _ = connection.send_datagram_wait(vec![7; 40].into()).await;
        }
        assert_eq!(closed_by(&connection).await, RefusalCode::Flood);
        server.shows_every_frame().await;
        let (report, viewers) = server.stop().await;
        assert_eq!(viewers.len(), 5, "{viewers:?}");
        assert_eq!(report.refused.values().sum::<u64>(), 1, "{report:?}");
        assert!(viewers[..3].iter().all(|viewer| viewer.end.contains("is through")), "{viewers:?}");
    });
}
