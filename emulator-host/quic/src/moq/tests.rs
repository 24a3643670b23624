//! A player is not hurt by what a relay gives it: garbage, oversize, numbers out of reach, silence.

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
    time::{Duration, Instant},
};

use bytes::Bytes;
use dgs_player::Stream;
use emulator_host::{
    Nanos,
    session::{Startup, StartupRule},
};
use moq_net::{Server, Timestamp, broadcast, group, origin, time, track};
use quinn::Endpoint;
use tokio::{
    runtime::Runtime,
    time::{sleep, timeout},
};
use web_transport_proto::ConnectResponse;
use web_transport_quinn::Request;

use super::{play, relay::origin, track::Track};
use crate::socket::{
    ClientConfig, Identity, Locator, NullSink, PlayError, Played, Scheme, Trust, message::StreamChoice,
};

/// How long a test may take.
const LIMIT: Duration = Duration::from_secs(120);
/// How long a player waits for what is meant to come, seconds: a busy machine takes its time.
const PATIENCE_S: u64 = 20;
/// How long it waits for media where nothing of use is meant to come: then playout begins without any.
const SHORT_WAIT: Nanos = Nanos::from_s(6);

/// A small stream of a few frames.
fn stream() -> Stream {
    let file = include_bytes!("../../../../codec-core/tests/conformance/everything.dgs");
    Stream::from_bytes(file).unwrap().0
}

/// What a relay gives on one track: a group of this number with these frames.
type Given = (Track, u64, Vec<Vec<u8>>);

/// A relay in the background that has one broadcast with these groups and nothing else.
struct Hostile {
    address: SocketAddr,
    trust: Trust,
    // What is dropped ends for subscribers.
    _broadcast: broadcast::Producer,
    /// In the order of [`Track::all`].
    tracks: Vec<track::Producer>,
}

/// Writes a whole group.
fn give(track: &track::Producer, sequence: u64, frames: &[Vec<u8>]) {
    let mut group = track.create_group(group::Info { sequence }).unwrap();
    for frame in frames {
        group.write_frame(Timestamp::ZERO, Bytes::copy_from_slice(frame)).unwrap();
    }
    group.finish().unwrap();
}

impl Hostile {
    fn start(given: &[Given]) -> Self {
        let identity = Identity::self_signed(&["127.0.0.1".to_owned()]).unwrap();
        let trust = Trust::Pin(identity.pin());
        let config = quinn::ServerConfig::with_crypto(Arc::new(identity.server().unwrap()));
        let endpoint = Endpoint::server(config, (Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let address = endpoint.local_addr().unwrap();
        let (origin, driver) = origin();
        tokio::spawn(time::run(driver));
        let broadcast = origin.create_broadcast("figure").unwrap();
        let mut tracks = Vec::new();
        for track in Track::all() {
            let producer = broadcast.create_track(track.name(), None).unwrap();
            for (_, sequence, frames) in given.iter().filter(|(of, ..)| *of == track) {
                give(&producer, *sequence, frames);
            }
            tracks.push(producer);
        }
        broadcast.announce(origin::Route::default()).unwrap();
        tokio::spawn(async move {
            while let Some(incoming) = endpoint.accept().await {
                tokio::spawn(relay(incoming, origin.clone()));
            }
        });
        Self { address, trust, _broadcast: broadcast, tracks }
    }

    fn client(&self) -> ClientConfig {
        let locator = Locator {
            scheme: Scheme::Moq,
            host: self.address.ip().to_string(),
            port: self.address.port(),
            stream: StreamChoice::Name("figure".to_owned()),
            pin: None,
        };
        let startup = Startup { rule: StartupRule::BaseGroups(0.95), max_wait: Nanos::from_s(PATIENCE_S) };
        let silence = Duration::from_secs(PATIENCE_S);
        ClientConfig { startup, silence, reconnects: 0, ..ClientConfig::new(locator, self.trust.clone()) }
    }
}

/// Speaks the protocol to one client.
async fn relay(incoming: quinn::Incoming, origin: origin::Producer) {
    let request = Request::accept(incoming.await.unwrap()).await.unwrap();
    let version = request.connect().protocols[0].clone();
    let transport = request.respond(ConnectResponse::OK.with_protocol(version)).await.unwrap();
    let server = Server::new().with_publisher(&origin);
    let (_session, driver) = server.accept(Instant::now(), transport).await.unwrap();
    time::run(driver).await;
}

/// Plays from a relay that gives `given`.
fn played(given: &[Given]) -> Played {
    played_by(given, |_| ())
}

/// As [`played`] where nothing of what is given can be shown.
fn played_empty(given: &[Given]) -> Played {
    played_by(given, |config| config.startup.max_wait = SHORT_WAIT)
}

fn played_by(given: &[Given], change: impl FnOnce(&mut ClientConfig)) -> Played {
    Runtime::new().unwrap().block_on(async {
        let relay = Hostile::start(given);
        let mut config = relay.client();
        change(&mut config);
        timeout(LIMIT, play(&config, &mut NullSink, std::future::pending())).await.unwrap()
    })
}

fn manifest() -> Given {
    (Track::Manifest, 0, vec![stream().message().to_vec()])
}

#[test]
fn what_a_relay_gives_is_played() {
    let packets: Vec<Vec<u8>> = stream().packets().to_vec();
    let count = packets.len() as u64;
    let report = played(&[manifest(), (Track::Motion(0), 0, packets)]).whole().unwrap();
    assert_eq!((report.refused, report.packets), (0, count), "{report:?}");
    assert!(report.shown_count > 0 && report.startup_reached && report.base_miss_rate == 0.0, "{report:?}");
}

/// Attributes are published once: none is lost for coming before the manifest, however many they are.
#[test]
fn packets_that_come_before_the_manifest_wait_for_it() {
    let packets: Vec<Vec<u8>> = stream().packets().to_vec();
    let count = packets.len() as u64;
    // As much as four times what a receiver of datagrams keeps that early.
    let filler = vec![packets[0].clone(); (1 << 19) / packets[0].len()];
    let frames = [filler, packets].concat();
    let repeated = frames.len() as u64 - count;
    let report = Runtime::new().unwrap().block_on(async {
        let relay = Hostile::start(&[(Track::Canonical(0), 0, frames)]);
        let config = relay.client();
        let late = async {
            sleep(Duration::from_millis(300)).await;
            give(&relay.tracks[0], 0, &[stream().message().to_vec()]);
        };
        let mut screen = NullSink;
        let playing = timeout(LIMIT, play(&config, &mut screen, std::future::pending()));
        tokio::join!(playing, late).0.unwrap().whole().unwrap()
    });
    assert_eq!((report.refused, report.packets, report.duplicates), (0, count, repeated), "{report:?}");
    assert!(report.startup_reached && report.base_miss_rate == 0.0, "{report:?}");
}

#[test]
fn what_is_no_manifest_is_refused_by_name() {
    let error = played(&[(Track::Manifest, 0, vec![b"DGSM and nothing".to_vec()])]).whole().unwrap_err();
    assert!(matches!(error, PlayError::Manifest(_)), "{error}");
}

#[test]
fn what_is_no_packet_is_counted_and_too_much_of_it_ends_the_session() {
    let garbage = |count: usize| (Track::Motion(1), 0, vec![vec![0x5a; 100]; count]);
    let report = played_empty(&[manifest(), garbage(50)]).whole().unwrap();
    assert_eq!((report.refused, report.packets), (50, 0), "{report:?}");
    assert!(report.shown_count > 0 && report.base_miss_rate == 1.0, "{report:?}");
    let error = played(&[manifest(), garbage(5100)]).whole().unwrap_err();
    assert!(error.to_string().contains("datagrams are no media"), "{error}");
}

#[test]
fn a_published_window_of_which_nothing_can_be_shown_is_not_waited_for_for_ever() {
    let error = played(&[manifest(), (Track::Motion(0), 0, vec![vec![0x5a; 100]])]).whole().unwrap_err();
    assert!(matches!(error, PlayError::Stalled { .. }), "{error}");
}

#[test]
fn what_is_longer_than_any_packet_is_not_read_and_numbers_out_of_reach_do_no_harm() {
    let long = (Track::Motion(1), 0, vec![vec![0x5a; 1 << 20]]);
    let far = (Track::Motion(0), (1 << 62) - 2, Vec::new());
    let report = played_empty(&[manifest(), long, far]).whole().unwrap();
    assert_eq!((report.refused, report.packets, report.received_bytes), (0, 0, 0), "{report:?}");
    assert!(report.shown_count > 0, "{report:?}");
}

#[test]
fn a_broadcast_without_a_manifest_is_as_good_as_none() {
    let error = played_by(&[], |config| config.silence = Duration::from_secs(6)).whole().unwrap_err();
    assert!(matches!(error, PlayError::Unpublished { .. }), "{error}");
}
