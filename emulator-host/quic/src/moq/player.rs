//! Plays a broadcast of a relay: the same playback as over a server's own sockets, fed from groups.

use std::time::{Duration, Instant};

use bytes::Bytes;
use codec_core::internals::limits::MAX_PACKET_BYTES;
use dgs_player::Player;
use moq_net::{Client, broadcast, group, origin, time, track};
use tokio::{
    sync::mpsc,
    task::JoinSet,
    time::{sleep_until, timeout},
};

use super::{
    numbering::{LEAD, Spans},
    relay::{Relay, close, origin},
    track::Track,
};
use crate::socket::{
    ClientConfig, FrameSink, PlayError, Playback, Played, RoundRequest,
    message::{MAX_MANIFEST_BYTES, StreamChoice},
    play_over,
};

/// What has come and was not played yet, packets of all tracks.
const MAX_WAITING: usize = 1024;
/// Groups that are older than the newest by more than this are not wanted, whatever the publisher keeps.
const MAX_AGE: Duration = Duration::from_secs(30);
/// How often a player of a live stream checks whether the stream has stalled.
const NEWEST_INTERVAL: Duration = Duration::from_millis(500);
/// Groups of one track that are read at once; more wait in the relay.
const MAX_GROUPS: usize = 16;

/// Plays the broadcast that `config` names on `screen`, until the clip or its time is over or `stop` ends.
/// It begins with what is shown there now, and ends with the clip unless that is to be repeated.
pub async fn play(
    config: &ClientConfig,
    screen: &mut dyn FrameSink,
    stop: impl Future<Output = ()>,
) -> Played {
    play_over(config, screen, stop, session).await
}

/// What comes from the tracks.
enum Arrival {
    Manifest(Bytes),
    /// The motion of the window of this number begins to come.
    Window(u64),
    Packet(Bytes),
    /// A track says no more.
    Ended(String),
}

/// One connection, from the handshake to the end of the clip.
async fn session(
    config: &ClientConfig,
    playback: &mut Playback,
    screen: &mut dyn FrameSink,
) -> Result<(), PlayError> {
    let StreamChoice::Name(name) = &config.locator.stream else {
        let sentence = "the address names no broadcast: moq+https://HOST:PORT/NAME";
        return Err(PlayError::Relay(sentence.to_owned()));
    };
    let (origin, driver) = origin();
    let consumer = origin.consume();
    let relay = Relay::connect(config, Client::new().with_subscriber(origin)).await?;
    playback.connected();
    let Relay { endpoint, connection, session: _session, driver: machine } = relay;
    // Whoever reads runs beside; all of it ends with this.
    let mut tasks = JoinSet::new();
    tasks.spawn(async { drop(time::run(driver).await) });
    let result = tokio::select! {
        error = time::run(machine) => Err(match connection.close_reason() {
            Some(reason) => PlayError::Lost(reason.into()),
            None => PlayError::Relay(error.to_string()),
        }),
        result = watch(config, playback, screen, (&consumer, name, &mut tasks)) => result,
    };
    tasks.abort_all();
    close(&endpoint, &connection).await;
    result
}

/// Waits for the broadcast and plays it.
async fn watch(
    config: &ClientConfig,
    playback: &mut Playback,
    screen: &mut dyn FrameSink,
    (consumer, name, tasks): (&origin::Consumer, &str, &mut JoinSet<()>),
) -> Result<(), PlayError> {
    let unpublished = || PlayError::Unpublished { name: name.to_owned(), ms: config.silence.as_millis() };
    let found = timeout(config.silence, consumer.routed_broadcast(name)).await;
    let broadcast = found.map_err(|_| unpublished())?.map_err(|error| PlayError::Relay(error.to_string()))?;
    // Packets that are not read hold back who sends them. So they wait for the manifest: attributes are
    // published once, and none may be lost for coming early.
    let (send_manifest, mut manifests) = mpsc::channel(1);
    let (send_media, mut media) = mpsc::channel(MAX_WAITING);
    for track in Track::all() {
        let send = if track == Track::Manifest { &send_manifest } else { &send_media };
        let (broadcast, send) = (broadcast.clone(), send.clone());
        tasks.spawn(async move {
            let why = follow(&broadcast, track, &send).await;
            let what = why.map_or_else(|error| error.to_string(), |()| "its end".to_owned());
            let _ = send.send(Arrival::Ended(what)).await;
        });
    }
    drop((send_manifest, send_media));
    playback.start_us();
    let deadline = Instant::now() + config.silence;
    let (mut has_manifest, mut newest, mut spans) = (false, None, None);
    loop {
        playback.show_due(screen)?;
        if playback.is_over() {
            // A stream that grows has no begin to go back to.
            if !config.loops || playback.grows() {
                return Ok(());
            }
            // Its last frame is shown as long as the others.
            if playback.next_time().is_none_or(|ends| Instant::now() >= ends) {
                playback.next_round(RoundRequest::default())?;
                continue;
            }
        }
        if playback.grows() {
            // Says so once nobody makes the stream any more.
            begin(playback, spans.as_ref(), newest)?;
        }
        let wake = if has_manifest {
            playback.next_time().unwrap_or_else(|| Instant::now() + NEWEST_INTERVAL)
        } else {
            deadline
        };
        let arrival = async {
            tokio::select! {
                arrival = manifests.recv() => arrival,
                arrival = media.recv(), if has_manifest => arrival,
            }
        };
        tokio::select! {
            arrival = arrival => match arrival {
                Some(Arrival::Manifest(message)) => {
                    playback.manifest(&message)?;
                    screen.manifest(&message);
                    has_manifest = true;
                    spans = playback.player().and_then(windows);
                    begin(playback, spans.as_ref(), newest)?;
                }
                Some(Arrival::Window(number)) if newest.is_none_or(|newest| newest < number) => {
                    newest = Some(number);
                    begin(playback, spans.as_ref(), newest)?;
                }
                Some(Arrival::Window(_)) => {}
                Some(Arrival::Packet(packet)) => {
                    playback.media(&packet)?;
                    screen.media(&packet);
                }
                Some(Arrival::Ended(why)) => return Err(PlayError::Ended(why)),
                None => return Err(PlayError::Ended("all tracks".to_owned())),
            },
            () = sleep_until(wake.into()) => {
                if !has_manifest && Instant::now() >= deadline {
                    return Err(unpublished());
                }
            }
        }
    }
}

fn windows(player: &Player) -> Option<Spans> {
    Spans::of(player.manifest()).map(|(windows, _)| windows)
}

/// Playout that has not begun begins in the window that is shown elsewhere, if what was published last is
/// the window `newest`; of a stream that grows in that window itself, and again after a pause.
fn begin(playback: &mut Playback, spans: Option<&Spans>, newest: Option<u64>) -> Result<(), PlayError> {
    let (Some(spans), Some(newest)) = (spans, newest) else { return Ok(()) };
    if spans.is_shown_once(newest) {
        return playback.newest_is_at(spans.middle_us(spans.first(newest)));
    }
    let now = spans.begins(newest) - LEAD;
    playback.move_start(spans.middle_us(spans.first(spans.at(now))));
    Ok(())
}

/// Reads what comes on `track`, for ever.
async fn follow(
    broadcast: &broadcast::Consumer,
    track: Track,
    arrivals: &mpsc::Sender<Arrival>,
) -> Result<(), moq_net::Error> {
    // The publisher bounds the age: it knows how long its windows are.
    let subscription = track::Subscription::default().with_priority(track.priority()).with_max_age(MAX_AGE);
    let mut groups = broadcast.track(&track.name())?.subscribe(subscription).await?;
    let mut readers = JoinSet::new();
    while let Some(group) = groups.recv_group().await? {
        if track == Track::Motion(0) && arrivals.send(Arrival::Window(group.sequence)).await.is_err() {
            return Ok(());
        }
        while readers.len() >= MAX_GROUPS {
            readers.join_next().await;
        }
        readers.spawn(read(group, track, arrivals.clone()));
    }
    while readers.join_next().await.is_some() {}
    Ok(())
}

/// Reads one group to its end, or to where it is cut.
async fn read(mut group: group::Consumer, track: Track, arrivals: mpsc::Sender<Arrival>) {
    let most = if track == Track::Manifest { MAX_MANIFEST_BYTES } else { MAX_PACKET_BYTES };
    while let Ok(Some(mut frame)) = group.next_frame().await {
        // What is longer than any packet is none, and is not stored.
        if frame.size > most as u64 {
            return;
        }
        let Ok(bytes) = frame.read_all().await else { return };
        let arrival = match track {
            Track::Manifest => Arrival::Manifest(bytes),
            Track::Canonical(_) | Track::Motion(_) => Arrival::Packet(bytes),
        };
        if arrivals.send(arrival).await.is_err() {
            return;
        }
    }
}
