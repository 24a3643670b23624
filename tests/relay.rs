//! Promises across a real relay of Media over QUIC: who subscribes over a narrow path sees fewer levels and
//! no hole, who publishes may start again.

#![cfg(feature = "moq")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "lab/src/relay/link.rs"]
mod link;
#[path = "lab/src/relay/program.rs"]
mod program;

use std::{
    env,
    path::Path,
    sync::{Mutex, OnceLock, PoisonError},
    time::Duration,
};

use clap::Parser;
use dgs::{
    args::{Cli, Verb},
    pipeline::{self, Quiet},
};
use dgs_player::Player;
use dgs_quic::{
    moq::{PublishConfig, PublishError, PublishEvent, PublishReport, play, publish},
    socket::{
        ClientConfig, FrameSink, Identity, Locator, NullSink, Played, Scheme, ServedStream, Trust,
        message::StreamChoice,
    },
};
use emulator_host::{
    Bytes, Nanos, Rate,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
};
use link::Link;
use program::Program;
use tokio::{
    runtime::Runtime,
    sync::{mpsc, oneshot, watch},
    task::JoinHandle,
    time::{sleep, timeout},
};
use trainer_host::{Stream, encode::Protection, stream::PacketMap};

/// Seconds of the clip.
const CLIP_S: u64 = 3;

/// Three seconds of a scene in windows of one.
fn stream() -> &'static Stream {
    static STREAM: OnceLock<Stream> = OnceLock::new();
    STREAM.get_or_init(|| encoded("30"))
}

/// Nine seconds of it in windows of three.
fn slow() -> &'static Stream {
    static STREAM: OnceLock<Stream> = OnceLock::new();
    STREAM.get_or_init(|| encoded("10"))
}

/// Ninety frames of a scene in windows of thirty.
fn encoded(fps: &str) -> Stream {
    let flags =
        ["dgs", "demo", "--window-frames", "30", "--pictures", "2", "--coarseness", "0.2", "--fps", fps];
    let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
    let scene = pipeline::import("synth:cloth:8000:90", &args.source).unwrap().scene;
    let options = pipeline::encode_options(&args.codec, Protection::STANDARD);
    pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream
}

fn offer() -> ServedStream {
    let map = PacketMap::of(stream()).unwrap();
    let graph = pipeline::graph(stream(), &map, None).unwrap();
    ServedStream::new("figure", stream(), graph).unwrap()
}

/// Bytes of all packets of level 0, and of all.
fn base_and_all() -> (u64, u64) {
    let map = PacketMap::of(stream()).unwrap();
    let graph = pipeline::graph(stream(), &map, None).unwrap();
    let media = graph.packets().iter().enumerate().filter(|(_, packet)| packet.parity_of.is_none());
    media.fold((0, 0), |(base, all), (at, packet)| {
        let bytes = u64::from(packet.wire_bytes);
        let is_base = graph.level(emulator_host::PacketIndex(at as u32)) == 0;
        (base + if is_base { bytes } else { 0 }, all + bytes)
    })
}

/// Runs `test` against a relay, if there is one on this machine; one at a time, because what is shown in time
/// depends on the processor.
fn with_relay(test: impl AsyncFnOnce(&Program)) {
    static ALONE: Mutex<()> = Mutex::new(());
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    Runtime::new().unwrap().block_on(async {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let Some(relay) = Program::start(root).await.unwrap() else {
            assert!(env::var_os("CI").is_none_or(|ci| ci != "true"), "moq-relay is missing");
            eprintln!("no moq-relay here (.ci/run installs it): nothing is tested across a relay");
            return;
        };
        timeout(Duration::from_secs(300), test(&relay)).await.unwrap();
    });
}

fn address(port: u16) -> Locator {
    Locator {
        scheme: Scheme::Moq,
        host: "127.0.0.1".to_owned(),
        port,
        stream: StreamChoice::Name("figure".to_owned()),
        pin: None,
    }
}

/// A publisher in the background.
struct Publisher {
    stop: oneshot::Sender<()>,
    task: JoinHandle<Result<PublishReport, PublishError>>,
}

impl Publisher {
    /// Publishes, and is there once this is through.
    async fn start(relay: &Program) -> Self {
        let (stop, stopped) = oneshot::channel();
        let (tell, mut heard) = mpsc::unbounded_channel();
        let config = PublishConfig::new(address(relay.port), Trust::Pin(relay.pin));
        let task = tokio::spawn(async move {
            let offers = [offer()];
            let news = move |news: &PublishEvent| drop(tell.send(news.clone()));
            publish(&config, &offers, async { drop(stopped.await) }, news).await
        });
        assert!(matches!(heard.recv().await, Some(PublishEvent::Connected { .. })));
        Self { stop, task }
    }

    async fn stop(self) -> PublishReport {
        self.stop.send(()).unwrap();
        self.task.await.unwrap().unwrap()
    }

    async fn kill(self) {
        self.task.abort();
        assert!(self.task.await.unwrap_err().is_cancelled());
    }
}

fn subscriber(relay: &Program, port: u16) -> ClientConfig {
    ClientConfig { loops: true, ..ClientConfig::new(address(port), Trust::Pin(relay.pin)) }
}

/// Decodes every frame in the state in which it is shown, and says how many there were.
#[derive(Default)]
struct Decoding {
    frames: Vec<u32>,
    count: watch::Sender<usize>,
}

impl Decoding {
    /// Ends once so many frames have been shown, however long a busy machine takes until then.
    fn has_shown(&self, count: usize) -> impl Future<Output = ()> + use<> {
        let mut shown = self.count.subscribe();
        async move { drop(shown.wait_for(|shown| *shown >= count).await) }
    }
}

impl FrameSink for Decoding {
    fn show(&mut self, player: &mut Player, frame: u32) -> Result<(), String> {
        self.frames.push(frame);
        self.count.send_replace(self.frames.len());
        player.frame(frame).map(drop).map_err(|error| error.to_string())
    }
}

/// Decodes, and says once when the base of frame 30 has come, which is the first of the second window.
struct Announcing {
    decoding: Decoding,
    second_came: Option<oneshot::Sender<()>>,
}

impl FrameSink for Announcing {
    fn show(&mut self, player: &mut Player, frame: u32) -> Result<(), String> {
        self.decoding.show(player, frame)?;
        let second = player.usable(30).map_err(|error| error.to_string())?;
        if second.motion[0] == second.blocks
            && let Some(came) = self.second_came.take()
        {
            let _ = came.send(());
        }
        Ok(())
    }
}

/// Frames follow each other, and the clip itself.
fn is_in_order(frames: &[u32]) -> bool {
    frames.windows(2).all(|pair| pair[1] == (pair[0] + 1) % stream().manifest().unwrap().head().frames)
}

#[test]
fn two_subscribers_on_different_links_see_what_their_links_carry() {
    with_relay(async |relay| {
        let publisher = Publisher::start(relay).await;
        let (base, all) = base_and_all();
        // Twice what the base needs, and less than the whole.
        assert!(2 * base < all, "base {base} of {all} bytes");
        let rate = Rate::over(Bytes(2 * base), Nanos::from_s(CLIP_S));
        let path = PathConfig {
            capacity: Capacity::Constant(rate),
            queue: QueueLimit { bytes: 30_000, ..QueueLimit::default() },
            loss: LossModel::Iid(0.01),
            delay: Nanos::from_ms(20),
            ..PathConfig::default()
        };
        let link = Link::start(relay.port, &path, 7).await.unwrap();
        let (near, far) = (subscriber(relay, relay.port), subscriber(relay, link.port));
        let (mut at_near, mut at_far) = (Decoding::default(), Decoding::default());
        // Both see most of the clip twice, unless the narrow link takes long to begin.
        let (near_is_over, far_has_begun) = (at_near.has_shown(150), at_far.has_shown(60));
        let both_are_over = {
            let near_is_over = at_near.has_shown(150);
            async move {
                near_is_over.await;
                far_has_begun.await;
            }
        };
        let (near, far) =
            tokio::join!(play(&near, &mut at_near, near_is_over), play(&far, &mut at_far, both_are_over));
        let (near, far) = (near.whole().unwrap(), far.whole().unwrap());
        for (which, report) in [("near", &near), ("far", &far)] {
            let (frames, levels) = (report.shown_count, report.mean_levels);
            eprintln!("{which}: {frames} frames, {levels:.2} levels, {} bytes", report.received_bytes);
        }
        for (report, screen) in [(&near, &at_near), (&far, &at_far)] {
            assert!(report.startup_reached, "{report:?}");
            assert!(is_in_order(&screen.frames), "{:?}", screen.frames);
            assert_eq!((report.refused, report.connections), (0, 1), "{report:?}");
        }
        // Playout starts with nearly all of the base.
        assert!(near.base_miss_rate < 0.01, "{near:?}");
        assert!(near.mean_levels > 3.5, "{}", near.mean_levels);
        // Levels are cut from above: what the path does not carry thins the picture and breaks no frame.
        assert!(far.base_miss_rate < 0.02, "{}", far.base_miss_rate);
        assert!(far.mean_levels < near.mean_levels - 0.5, "{} {}", far.mean_levels, near.mean_levels);
        let report = publisher.stop().await;
        assert_eq!((report.connections, report.broadcasts.len()), (1, 1), "{report:?}");
        assert!(report.broadcasts[0].windows >= 3, "{report:?}");
    });
}

#[test]
fn who_joins_late_gets_what_holds_for_ever_first() {
    with_relay(async |relay| {
        let publisher = Publisher::start(relay).await;
        // The attributes were published once, before all this.
        sleep(Duration::from_secs(2 * CLIP_S)).await;
        let mut screen = Decoding::default();
        let enough = screen.has_shown(150);
        let late = play(&subscriber(relay, relay.port), &mut screen, enough).await.whole().unwrap();
        assert!(late.startup_reached && late.base_miss_rate < 0.01, "{late:?}");
        publisher.stop().await;
    });
}

#[test]
fn a_publisher_that_starts_again_is_gone_on_with_and_one_that_does_not_is_missed() {
    with_relay(async |relay| {
        let publisher = Publisher::start(relay).await;
        let config = subscriber(relay, relay.port);
        let (mut screen, mut other) = (Decoding::default(), Decoding::default());
        // A round before, and more than another after.
        let (round, enough) = (screen.has_shown(90), screen.has_shown(240));
        let again = async {
            round.await;
            publisher.kill().await;
            sleep(Duration::from_millis(500)).await;
            Publisher::start(relay).await
        };
        let (played, publisher) = tokio::join!(play(&config, &mut screen, enough), again);
        let report = played.whole().unwrap();
        assert!(report.connections >= 2 && report.base_miss_rate < 0.02, "{report:?}");

        // Each step of making a connection has so long, too.
        let short = ClientConfig { silence: Duration::from_secs(5), ..config };
        let shown = other.has_shown(1);
        let gone = async {
            shown.await;
            publisher.kill().await;
        };
        let (played, ()) = tokio::join!(play(&short, &mut other, std::future::pending()), gone);
        let Played { report, error, .. } = played;
        let said = error.unwrap().to_string();
        assert!(report.shown_count > 0 && said.contains("nobody publishes figure there"), "{said}");
    });
}

/// Windows come one by one; who comes late begins with the newest, and sees what comes after it.
#[test]
fn a_stream_is_published_while_it_is_made_and_who_joins_late_sees_its_newest_end() {
    with_relay(async |relay| {
        let map = PacketMap::of(slow()).unwrap();
        let there = |windows: u32| {
            // What comes later is there, too: it is the newest window that says what is whole.
            (pipeline::graph(slow(), &map, None).unwrap(), (windows - 1) * 30)
        };
        let (graph, newest) = there(1);
        let (offer, feed) = ServedStream::live("live", slow(), graph, newest).unwrap();
        let (stop, stopped) = oneshot::channel::<()>();
        let config = PublishConfig::new(address(relay.port), Trust::Pin(relay.pin));
        let (tell, mut heard) = mpsc::unbounded_channel();
        let task = tokio::spawn(async move {
            let news = move |news: &PublishEvent| drop(tell.send(news.clone()));
            publish(&config, &[offer], async { drop(stopped.await) }, news).await
        });
        assert!(matches!(heard.recv().await, Some(PublishEvent::Connected { .. })));
        let config = subscriber(relay, relay.port);
        let (second_comes, second_came) = oneshot::channel();
        let announcing = |second_came| Announcing { decoding: Decoding::default(), second_came };
        let (mut at_first, mut at_late) = (announcing(Some(second_comes)), announcing(None));
        let (first_shown, late_shown) = (at_first.decoding.has_shown(1), at_late.decoding.has_shown(1));
        // Each window nearly three seconds before it is shown, however long a busy machine takes for all the
        // rest.
        let making = async {
            first_shown.await;
            let (graph, newest) = there(2);
            feed.renew(slow(), graph, newest).unwrap();
            late_shown.await;
            let (graph, newest) = there(3);
            feed.renew(slow(), graph, newest).unwrap();
        };
        let late = async {
            // Between the second window and the third: the relay has the second.
            second_came.await.unwrap();
            play(&config, &mut at_late, std::future::pending()).await.whole().unwrap()
        };
        let (first, late, ()) =
            tokio::join!(play(&config, &mut at_first, std::future::pending()), late, making);
        let first = first.whole().unwrap();
        for (report, screen, begins) in [(&first, &at_first, 0), (&late, &at_late, 30)] {
            assert_eq!(screen.decoding.frames, (begins..90).collect::<Vec<_>>(), "{report:?}");
            assert!(report.startup_reached && report.base_miss_rate < 0.05, "{report:?}");
            assert_eq!((report.refused, report.connections), (0, 1), "{report:?}");
        }
        stop.send(()).unwrap();
        let report = task.await.unwrap().unwrap();
        assert_eq!(report.broadcasts[0].windows, 3, "each once: {report:?}");
    });
}

#[test]
fn who_relays_is_checked() {
    with_relay(async |relay| {
        let wrong = Identity::self_signed(&["127.0.0.1".to_owned()]).unwrap().pin();
        let config = ClientConfig::new(address(relay.port), Trust::Pin(wrong));
        let played = play(&config, &mut NullSink, std::future::pending()).await;
        let said = played.error.unwrap().to_string();
        assert!(said.contains(&relay.pin.to_string()) && said.contains(&wrong.to_string()), "{said}");
        let config = PublishConfig::new(address(relay.port), Trust::Pin(wrong));
        let error = publish(&config, &[offer()], std::future::pending(), |_| ()).await.unwrap_err();
        assert!(error.to_string().contains(&wrong.to_string()), "{error}");
        let named = publish(&config, &[offer(), offer()], std::future::pending(), |_| ()).await;
        assert!(named.unwrap_err().to_string().contains("leave the name out"));
    });
}
