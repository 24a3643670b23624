//! A viewer changes the link and the scheduler of its own session, where the server lets it, and of no other.

use std::{
    sync::atomic::{AtomicU32, Ordering},
    time::Instant,
};

use quinn::{RecvStream, SendStream};

use super::{
    servers::{SILENCE, Talk, played},
    *,
};
use crate::socket::message::{
    ClientMessage, Conditions, Granted, Message as _, MessageReader, ServerMessage, ViewerLink,
};

const DELAY: Duration = Duration::from_millis(300);
/// The longest delay that there is: what comes sooner has not taken it, on a busy machine either.
const LONG_DELAY: Duration = Duration::from_secs(1);

/// A session that speaks for itself.
struct Viewer {
    _endpoint: Endpoint,
    connection: Connection,
    send: SendStream,
    receive: RecvStream,
    reader: MessageReader<ServerMessage>,
    /// Bytes that were read and are of the next message.
    rest: Vec<u8>,
}

impl Viewer {
    async fn begin(server: &Running) -> Self {
        let (endpoint, connection) = server.connect().await;
        let (send, receive) = connection.open_bi().await.unwrap();
        let reader = MessageReader::default();
        let mut viewer = Self { _endpoint: endpoint, connection, send, receive, reader, rest: Vec::new() };
        viewer.say(&ClientMessage::Hello { stream: StreamChoice::Index(0), start_us: 0 }).await;
        assert!(matches!(viewer.hear().await, ServerMessage::Manifest(_)));
        viewer
    }

    async fn say(&mut self, message: &ClientMessage) {
        self.send.write_all(&message.to_bytes()).await.unwrap();
    }

    async fn hear(&mut self) -> ServerMessage {
        loop {
            let mut bytes = self.rest.as_slice();
            let message = self.reader.take(&mut bytes).unwrap();
            self.rest = bytes.to_vec();
            if let Some(message) = message {
                return message;
            }
            let chunk = self.receive.read_chunk(4096, true).await.unwrap().unwrap();
            self.rest.extend(&chunk.bytes);
        }
    }

    /// What the server grants in round `round`, and how long that took.
    async fn ask(&mut self, round: u32, conditions: Conditions) -> (Granted, Duration) {
        let start = Instant::now();
        self.say(&ClientMessage::Conditions { round, start_us: 0, conditions }).await;
        match self.hear().await {
            ServerMessage::Granted { round: heard, granted } if heard == round => (granted, start.elapsed()),
            other => panic!("{other:?}"),
        }
    }

    /// As [`Self::ask`] in three rounds from `round` on, and how long the fastest took: a busy machine may
    /// hold one of them up.
    async fn ask_thrice(&mut self, round: u32, conditions: Conditions) -> (Granted, Duration) {
        let (granted, mut least) = self.ask(round, conditions).await;
        for round in round + 1..round + 3 {
            let (again, took) = self.ask(round, conditions).await;
            assert_eq!(again, granted);
            least = least.min(took);
        }
        (granted, least)
    }

    async fn leave(mut self) {
        self.say(&ClientMessage::Bye).await;
        self.connection.closed().await;
    }
}

fn late_by_dash() -> Conditions {
    by_dash(DELAY)
}

fn by_dash(delay: Duration) -> Conditions {
    let link = ViewerLink { delay, ..ViewerLink::default() };
    Conditions::NONE.with_scheduler(PolicyKind::Dash).with_rounds_anew().behind(&link).unwrap()
}

#[test]
fn a_viewer_gets_the_link_and_the_scheduler_that_it_asks_for_and_nobody_else_does() {
    within(async {
        let server = Running::start(ServerLimits::default());
        let (mut viewer, mut other) = (Viewer::begin(&server).await, Viewer::begin(&server).await);
        let all = Granted { link: true, scheduler: true };
        let (granted, took) = viewer.ask(1, by_dash(LONG_DELAY)).await;
        assert!(granted == all && took >= LONG_DELAY, "{granted:?} after {took:?}");
        let (granted, took) = other.ask_thrice(1, Conditions::NONE).await;
        assert!(granted == all && took < LONG_DELAY, "another viewer waits {took:?}");
        let (granted, took) = viewer.ask_thrice(2, Conditions::NONE).await;
        assert!(granted == all && took < LONG_DELAY, "{granted:?} after {took:?}");
        other.leave().await;
        viewer.ask(5, late_by_dash()).await;
        viewer.leave().await;
        server.shows_every_frame().await;
        let (_, viewers) = server.stop().await;
        let schedulers: Vec<_> = viewers.iter().map(|viewer| viewer.scheduler).collect();
        assert_eq!(schedulers, ["layered", "dash", "layered"]);
        assert_eq!((viewers[0].rounds, viewers[1].rounds), (4, 6));
    });
}

#[test]
fn a_server_that_lets_nobody_change_anything_says_so_and_goes_on() {
    within(async {
        let offer = ServedStream::new("everything", &stream(), graph(&stream())).unwrap();
        let server = Running::letting(false, ServerLimits::default(), offer);
        let mut viewer = Viewer::begin(&server).await;
        let (granted, took) = viewer.ask_thrice(1, by_dash(LONG_DELAY)).await;
        assert!(granted == Granted { link: false, scheduler: false } && took < LONG_DELAY, "{granted:?}");
        // The same round cannot begin twice.
        viewer.say(&ClientMessage::Conditions { round: 3, start_us: 0, conditions: late_by_dash() }).await;
        let ServerMessage::Refusal(refusal) = viewer.hear().await else { panic!() };
        assert!(refusal.sentence.contains("allowed above 3"), "{refusal}");
        let (_, viewers) = server.stop().await;
        assert_eq!((viewers[0].scheduler, viewers[0].rounds), ("layered", 4));
    });
}

/// Of a client that asks from the start, what was played and what the server says of the viewer.
async fn played_late(may_change: bool) -> (PlayReport, ViewerReport) {
    let offer = ServedStream::new("everything", &stream(), graph(&stream())).unwrap();
    let server = Running::letting(may_change, ServerLimits::default(), offer);
    let mut config = ClientConfig { conditions: Some(late_by_dash()), ..server.client() };
    config.startup.max_wait = Nanos::from_s(20);
    let report = play(&config, &mut NullSink, std::future::pending()).await.whole().unwrap();
    let (_, mut viewers) = server.stop().await;
    (report, viewers.remove(0))
}

#[test]
fn a_client_plays_under_the_conditions_that_it_asks_for_from_the_start() {
    within(async {
        let (report, viewer) = played_late(true).await;
        assert_eq!(report.granted, Some(Granted { link: true, scheduler: true }));
        assert_eq!((viewer.scheduler, report.rounds, report.shown_count), ("dash", 1, report.frames.into()));
        let startup = report.startup_ms.unwrap();
        assert!(startup >= DELAY.as_secs_f64() * 1e3, "{startup} ms, of which the link is {DELAY:?}");
        let (report, viewer) = played_late(false).await;
        assert_eq!(report.granted, Some(Granted { link: false, scheduler: false }));
        assert_eq!((viewer.scheduler, report.base_miss_rate), ("layered", 0.0));
    });
}

/// Wishes for other conditions in the middle of a clip, and counts how often all that came is forgotten.
#[derive(Default)]
struct Changing {
    shown: u32,
    wished: bool,
    granted: Vec<Granted>,
    forgotten: u32,
    /// Whether nothing was shown since.
    is_first: bool,
}

impl FrameSink for Changing {
    fn show(&mut self, player: &mut dgs_player::Player, frame: u32) -> Result<(), String> {
        self.shown += 1;
        let has_base = player.usable(frame).unwrap_or_default().canonical[0] > 0;
        // Playout waits for the base of its first frame, whatever was there before.
        let is_early = std::mem::take(&mut self.is_first) && !has_base;
        if is_early { Err("shown before its base".to_owned()) } else { Ok(()) }
    }

    fn requested_round(&mut self) -> Option<RoundRequest> {
        let due = self.shown >= 2 && !std::mem::replace(&mut self.wished, self.shown >= 2);
        due.then(|| RoundRequest { start_us: 0, conditions: Some(late_by_dash()) })
    }

    fn granted(&mut self, granted: Granted) {
        self.granted.push(granted);
    }

    fn forget(&mut self) {
        (self.forgotten, self.is_first) = (self.forgotten + 1, true);
    }
}

#[test]
fn a_round_under_other_conditions_begins_with_nothing_if_the_server_grants_them() {
    within(async {
        for may_change in [true, false] {
            let offer = ServedStream::new("everything", &stream(), graph(&stream())).unwrap();
            let server = Running::letting(may_change, ServerLimits::default(), offer);
            let mut screen = Changing::default();
            let mut config = server.client();
            config.startup.max_wait = Nanos::from_s(20);
            let report = play(&config, &mut screen, std::future::pending()).await.whole().unwrap();
            assert_eq!(screen.granted, [Granted { link: may_change, scheduler: may_change }]);
            assert_eq!((screen.forgotten, report.rounds), (u32::from(may_change), 2));
            assert!(report.mean_levels > 0.0 && report.shown_count > report.frames.into());
            server.stop().await;
        }
    });
}

/// A server that counts and, if `answers`, grants all conditions, and closes once the client has heard of
/// that.
fn counting(count: Arc<AtomicU32>, answers: bool) -> impl Fn(Connection, SendStream, RecvStream) -> Talk {
    move |connection, mut send, mut receive| {
        let count = Arc::clone(&count);
        Box::pin(async move {
            let mut reader = MessageReader::<ClientMessage>::default();
            let mut has_granted = false;
            while let Ok(Some(chunk)) = receive.read_chunk(4096, true).await {
                let mut bytes = &chunk.bytes[..];
                while let Ok(Some(message)) = reader.take(&mut bytes) {
                    let answer = match message {
                        ClientMessage::Hello { .. } => ServerMessage::Manifest(stream().message().to_vec()),
                        ClientMessage::Conditions { round, .. } if answers => {
                            count.fetch_add(1, Ordering::Relaxed);
                            has_granted = true;
                            let granted = Granted { link: true, scheduler: true };
                            ServerMessage::Granted { round, granted }
                        }
                        _ => continue,
                    };
                    let _ = send.write_all(&answer.to_bytes()).await;
                }
                if has_granted {
                    // A receipt says that the client has heard of the grant.
                    let _ = connection.read_datagram().await;
                    connection.close(0u32.into(), b"moved");
                }
            }
        })
    }
}

#[test]
fn another_connection_begins_under_the_same_conditions() {
    within(async {
        let count = Arc::new(AtomicU32::new(0));
        let wishing = |config: &mut ClientConfig| {
            (config.conditions, config.reconnects) = (Some(late_by_dash()), 2);
            // A connection that shows something would allow for more of them.
            config.startup.max_wait = Nanos::from_s(20);
        };
        let played = played(counting(Arc::clone(&count), true), wishing).await;
        assert_eq!((played.report.connections, count.load(Ordering::Relaxed)), (3, 3));
        assert_eq!(played.report.granted, Some(Granted { link: true, scheduler: true }));
    });
}

/// A server that grants conditions only after 150 ms, counts receipts of their round until then, and closes
/// after the first that comes later.
fn slow(early: Arc<AtomicU32>, later: Arc<AtomicU32>) -> impl Fn(Connection, SendStream, RecvStream) -> Talk {
    move |connection, mut send, mut receive| {
        let (early, later) = (Arc::clone(&early), Arc::clone(&later));
        Box::pin(async move {
            let mut reader = MessageReader::<ClientMessage>::default();
            while let Ok(Some(chunk)) = receive.read_chunk(4096, true).await {
                let mut bytes = &chunk.bytes[..];
                while let Ok(Some(message)) = reader.take(&mut bytes) {
                    let round = match message {
                        ClientMessage::Hello { .. } => {
                            let manifest = ServerMessage::Manifest(stream().message().to_vec());
                            let _ = send.write_all(&manifest.to_bytes()).await;
                            continue;
                        }
                        ClientMessage::Conditions { round, .. } => round,
                        _ => continue,
                    };
                    let is_of_round = |datagram: &[u8]| datagram.starts_with(&round.to_le_bytes());
                    let waited = tokio::time::sleep(Duration::from_millis(150));
                    tokio::pin!(waited);
                    loop {
                        tokio::select! {
                            () = &mut waited => break,
                            Ok(datagram) = connection.read_datagram() => {
                                early.fetch_add(u32::from(is_of_round(&datagram)), Ordering::Relaxed);
                            }
                        }
                    }
                    let granted = Granted { link: true, scheduler: true };
                    let _ = send.write_all(&ServerMessage::Granted { round, granted }.to_bytes()).await;
                    while let Ok(datagram) = connection.read_datagram().await {
                        if is_of_round(&datagram) {
                            later.fetch_add(1, Ordering::Relaxed);
                            break;
                        }
                    }
                    connection.close(0u32.into(), b"seen");
                }
            }
        })
    }
}

#[test]
fn what_may_be_forgotten_is_not_acknowledged() {
    within(async {
        let (early, later) = (Arc::new(AtomicU32::new(0)), Arc::new(AtomicU32::new(0)));
        let wishing = |config: &mut ClientConfig| config.conditions = Some(late_by_dash());
        played(slow(Arc::clone(&early), Arc::clone(&later)), wishing).await;
        assert_eq!((early.load(Ordering::Relaxed), later.load(Ordering::Relaxed)), (0, 1));
    });
}

#[test]
fn a_server_that_never_answers_is_left() {
    within(async {
        let wishing = |config: &mut ClientConfig| {
            (config.conditions, config.silence) = (Some(late_by_dash()), SILENCE);
        };
        let played = played(counting(Arc::default(), false), wishing).await;
        assert!(matches!(played.error, Some(PlayError::Silence { ms: 400 })), "{:?}", played.error);
    });
}
