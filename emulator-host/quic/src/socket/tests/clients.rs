//! Hostile clients: the server names what is wrong, counts it, and goes on serving others.

use quinn::{ConnectionError, VarInt};

use super::*;
use crate::socket::message::{ClientMessage, Message as _, MessageReader, RefusalCode, ServerMessage};

/// The code with which the server closed.
async fn closed_by(connection: &Connection) -> RefusalCode {
    match connection.closed().await {
        ConnectionError::ApplicationClosed(close) => {
            RefusalCode::of(close.error_code.into_inner()).unwrap_or_else(|| panic!("{close:?}"))
        }
        other => panic!("{other:?}"),
    }
}

fn hello() -> Vec<u8> {
    ClientMessage::Hello { stream: StreamChoice::Index(0), start_us: 0 }.to_bytes()
}

fn refusals(report: &ServerReport, code: RefusalCode) -> u64 {
    report.refused.get(&code.to_string()).copied().unwrap_or(0)
}

#[test]
fn bytes_that_are_no_hello_are_refused_by_name() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let seek = ClientMessage::Seek { round: 1, start_us: 0 }.to_bytes();
        let oversize = [&[1u8][..], &u32::MAX.to_le_bytes()].concat();
        let version = [&hello()[..5], &[9], &hello()[6..]].concat();
        for (bytes, named) in [
            (b"GET / HTTP/1.1\r\n\r\n".to_vec(), "message kind is 0x47"),
            (oversize, "hello: length is 4294967295"),
            (version, "hello.version is 9, allowed 0"),
            (seek, "the first message is hello"),
            (hello()[..7].to_vec(), "ends inside a message"),
        ] {
            let (_endpoint, connection) = server.connect().await;
            let (mut send, mut receive) = connection.open_bi().await.unwrap();
            send.write_all(&bytes).await.unwrap();
            send.finish().unwrap();
            let answer = receive.read_to_end(2000).await.unwrap();
            let mut reader = MessageReader::<ServerMessage>::default();
            match reader.take(&mut &answer[..]) {
                Ok(Some(ServerMessage::Refusal(refusal))) => {
                    assert!(refusal.sentence.contains(named), "{refusal}");
                }
                other => panic!("{named}: {other:?}"),
            }
            closed_by(&connection).await;
        }
        server.shows_every_frame().await;
        let (report, viewers) = server.stop().await;
        assert_eq!((refusals(&report, RefusalCode::Message), viewers.len()), (4, 1), "{report:?}");
        assert_eq!(refusals(&report, RefusalCode::Version), 1);
    });
}

#[test]
fn who_leaves_before_a_hello_is_not_refused() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let (endpoint, connection) = server.connect().await;
        connection.close(VarInt::from_u32(0), b"");
        endpoint.wait_idle().await;
        server.shows_every_frame().await;
        let (report, viewers) = server.stop().await;
        assert_eq!((report.refused.len(), viewers.len()), (0, 1), "{report:?}");
    });
}

#[test]
fn who_says_nothing_is_closed_and_who_stops_in_a_hello_too() {
    within(async {
        // Time enough for what is said of a hello, on a busy machine too.
        let hello_wait = Duration::from_secs(5);
        let server = Running::start(ServerLimits { hello_wait, ..ServerLimits::default() });
        let (_silent_endpoint, silent) = server.connect().await;
        let (_slow_endpoint, slow) = server.connect().await;
        let (mut send, _receive) = slow.open_bi().await.unwrap();
        send.write_all(&hello()[..6]).await.unwrap();
        assert_eq!(closed_by(&silent).await, RefusalCode::Silence);
        assert_eq!(closed_by(&slow).await, RefusalCode::Silence);
        let late = server.shows_every_frame_in_the_end().await;
        let (report, _) = server.stop().await;
        assert!((2..=2 + late).contains(&refusals(&report, RefusalCode::Silence)), "{late} late, {report:?}");
    });
}

#[test]
fn floods_end_the_session_and_are_counted() {
    within(async {
        let server = Running::start(ServerLimits::default());
        // Datagrams that are no receipts.
        let (_junk_endpoint, junk) = server.connect().await;
        let (mut send, _receive) = junk.open_bi().await.unwrap();
        send.write_all(&hello()).await.unwrap();
        while junk.close_reason().is_none() {
            let _ = junk.send_datagram_wait(vec![0; 40].into()).await;
        }
        assert_eq!(closed_by(&junk).await, RefusalCode::Flood);
        // Seeks without end.
        let (_endpoint, seeking) = server.connect().await;
        let (mut send, _receive) = seeking.open_bi().await.unwrap();
        send.write_all(&hello()).await.unwrap();
        for round in 1..1000 {
            let seek = ClientMessage::Seek { round, start_us: 0 }.to_bytes();
            if send.write_all(&seek).await.is_err() {
                break;
            }
        }
        assert_eq!(closed_by(&seeking).await, RefusalCode::Flood);
        // A seek that goes back, a second hello, a second stream.
        for bytes in [ClientMessage::Seek { round: 0, start_us: 0 }.to_bytes(), hello()] {
            let (_endpoint, connection) = server.connect().await;
            let (mut send, _receive) = connection.open_bi().await.unwrap();
            send.write_all(&[hello(), bytes].concat()).await.unwrap();
            assert_eq!(closed_by(&connection).await, RefusalCode::Message);
        }
        server.shows_every_frame().await;
        let (report, viewers) = server.stop().await;
        assert_eq!(refusals(&report, RefusalCode::Flood), 2, "{report:?}");
        assert!(viewers.iter().any(|viewer| viewer.refused_receipts > 100), "{viewers:?}");
    });
}

#[test]
fn datagrams_that_are_no_quic_change_nothing_and_are_counted() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let socket = std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let most = 1400;
        for len in 0..most {
            let bytes: Vec<u8> = (0..len).map(|at| (at * 31 + len * 17) as u8).collect();
            socket.send_to(&bytes, server.address).unwrap();
            // A handshake that the server has answered came after them: none is lost for want of room.
            if len % 50 == 0 {
                server.connect().await;
            }
        }
        server.shows_every_frame().await;
        let (report, _) = server.stop().await;
        assert_eq!(report.viewers, 1);
        // What an honest viewer sends is none of them.
        assert!((most as u64 - 5..=most as u64).contains(&report.stray_datagrams), "{report:?}");
    });
}

#[test]
fn a_client_that_is_killed_frees_its_place() {
    let runtime = Runtime::new().unwrap();
    let victims = Runtime::new().unwrap();
    // Short, and yet no bound that a handshake on a busy machine comes near to.
    let limits = ServerLimits { max_viewers: 1, idle: Duration::from_secs(6), ..ServerLimits::default() };
    let server = runtime.block_on(async { Running::start(limits) });
    victims.block_on(async {
        let (endpoint, connection) = server.connect().await;
        let (mut send, mut receive) = connection.open_bi().await.unwrap();
        send.write_all(&hello()).await.unwrap();
        // Once the manifest comes the place is taken.
        receive.read_chunk(100, true).await.unwrap();
        std::mem::forget((endpoint, connection, send, receive));
    });
    let full = runtime.block_on(server.play()).unwrap_err();
    assert!(full.to_string().contains("all 1 places are taken"), "{full}");
    // Without a farewell: its tasks are gone and its socket is silent.
    victims.shutdown_background();
    runtime.block_on(async {
        let freed = async {
            while server.play().await.is_err() {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), freed).await.unwrap();
        let (report, viewers) = server.stop().await;
        // On a busy machine one more may be silent for so long.
        assert!(report.viewers >= 2, "{viewers:?}");
        assert!(viewers[0].end.contains("timed out") || viewers[0].end.contains("nothing was heard"));
    });
}

#[test]
fn one_address_takes_only_its_own_places_and_who_is_there_stays() {
    within(async {
        let limits =
            ServerLimits { max_viewers_per_address: 2, hello_wait: PATIENCE, ..ServerLimits::default() };
        let server = Running::start(limits);
        let mut watching = Vec::new();
        for _ in 0..2 {
            let (endpoint, connection) = server.connect().await;
            let (mut send, mut receive) = connection.open_bi().await.unwrap();
            send.write_all(&hello()).await.unwrap();
            // Once the manifest comes the place is taken.
            receive.read_chunk(100, true).await.unwrap();
            watching.push((endpoint, connection, send, receive));
        }
        let error = server.play().await.unwrap_err().to_string();
        assert!(error.contains("all 2 places for viewers from 127.0.0.1 are taken"), "{error}");
        // Connections on which nothing is said hold no more than a few besides.
        let mut silent = Vec::new();
        for _ in 0..4 {
            silent.push(server.connect().await);
        }
        let error = server.play().await.unwrap_err().to_string();
        assert!(error.contains("no room for another connection"), "{error}");
        assert!(watching.iter().all(|(_, connection, ..)| connection.close_reason().is_none()));
        drop((watching, silent));
        while server.play().await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let (report, _) = server.stop().await;
        assert!(refusals(&report, RefusalCode::Full) >= 1 && report.turned_away >= 1, "{report:?}");
    });
}

#[test]
fn a_full_server_has_addresses_proved_and_turns_the_rest_away() {
    within(async {
        let limits = ServerLimits { max_viewers: 2, hello_wait: PATIENCE, ..ServerLimits::default() };
        let server = Running::start(limits);
        let mut open = Vec::new();
        for _ in 0..18 {
            open.push(server.connect().await);
        }
        let error = server.play().await.unwrap_err().to_string();
        assert!(error.contains("no room for another connection"), "{error}");
        for (_, connection) in &open {
            connection.close(VarInt::from_u32(0), b"");
        }
        drop(open);
        while server.play().await.is_err() {
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
        let (report, _) = server.stop().await;
        assert!(report.retried > 0 && report.turned_away > 0, "{report:?}");
    });
}
