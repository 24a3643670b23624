//! Promises across bytes, time and sockets: what is served is what is played. That neither side can be hurt
//! by the other is tested in `dgs-quic`.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "sockets/growing.rs"]
mod growing;
#[path = "sockets/reconnected.rs"]
mod reconnected;
#[path = "sockets/served.rs"]
mod served;

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::{Arc, OnceLock},
    time::Duration,
};

use clap::Parser;
use codec_core::internals::wire::receipt::ViewerPose;
use dgs::{
    args::{Cli, Verb},
    pipeline::{self, Quiet},
};
use dgs_player::Player;
use dgs_quic::{
    CongestionControl,
    socket::{
        ClientConfig, FrameSink, Identity, Impairment, Locator, NullSink, PlayError, PlayReport, Scheme,
        ServedStream, Server, ServerConfig, ServerError, ServerLimits, ServerReport, Trust, ViewerReport,
        message::StreamChoice, play,
    },
};
use emulator_host::{
    Nanos, PolicyKind, Rate,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
};
use tokio::{
    runtime::Runtime,
    sync::{Semaphore, oneshot},
    task::JoinHandle,
};
use trainer_host::{Stream, encode::Protection, stream::PacketMap};

/// Six seconds of a small scene in windows of two: what a busy machine sends or takes a second late is still
/// there in time.
fn stream() -> &'static Stream {
    static STREAM: OnceLock<Stream> = OnceLock::new();
    STREAM.get_or_init(|| {
        let flags =
            ["dgs", "demo", "--window-frames", "10", "--pictures", "2", "--coarseness", "0.2", "--fps", "5"];
        let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
        let scene = pipeline::import("synth:cloth:4000:30", &args.source).unwrap().scene;
        let options = pipeline::encode_options(&args.codec, Protection::STANDARD);
        pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream
    })
}

fn offer(name: &str) -> ServedStream {
    let map = PacketMap::of(stream()).unwrap();
    let graph = pipeline::graph(stream(), &map, None).unwrap();
    ServedStream::new(name, stream(), graph).unwrap()
}

/// Runs `test` where sockets have a runtime, and not for ever. The stream is encoded before: on a busy
/// machine that takes long, and everything else would wait for it.
fn within<T>(test: impl Future<Output = T>) -> T {
    stream();
    let runtime = Runtime::new().unwrap();
    runtime.block_on(async { tokio::time::timeout(Duration::from_secs(300), test).await.unwrap() })
}

/// A server on any free port.
fn config(identity: Identity, limits: ServerLimits, impairment: Option<Impairment>) -> ServerConfig {
    ServerConfig {
        bind: (Ipv4Addr::LOCALHOST, 0).into(),
        identity,
        limits,
        policy: PolicyKind::DeadlineUtility,
        congestion: CongestionControl::default(),
        impairment,
        viewer_conditions: false,
    }
}

/// A server in the background.
struct Running {
    address: SocketAddr,
    trust: Trust,
    stop: Option<oneshot::Sender<()>>,
    task: JoinHandle<(ServerReport, Vec<ViewerReport>)>,
}

impl Running {
    fn start(limits: ServerLimits, impairment: Option<Impairment>) -> Self {
        Self::with(Identity::self_signed(&["127.0.0.1".to_owned()]).unwrap(), limits, impairment)
    }

    fn with(identity: Identity, limits: ServerLimits, impairment: Option<Impairment>) -> Self {
        Self::serving(identity, limits, impairment, vec![offer("figure"), offer("again")])
    }

    fn offering(offer: ServedStream) -> Self {
        let identity = Identity::self_signed(&["127.0.0.1".to_owned()]).unwrap();
        Self::serving(identity, ServerLimits::default(), None, vec![offer])
    }

    fn serving(
        identity: Identity,
        limits: ServerLimits,
        impairment: Option<Impairment>,
        offers: Vec<ServedStream>,
    ) -> Self {
        Self::bound(config(identity, limits, impairment), offers).unwrap()
    }

    fn governed(congestion: CongestionControl, impairment: Impairment) -> Self {
        let identity = Identity::self_signed(&["127.0.0.1".to_owned()]).unwrap();
        let config = config(identity, ServerLimits::default(), Some(impairment));
        Self::bound(ServerConfig { congestion, ..config }, vec![offer("figure")]).unwrap()
    }

    fn bound(config: ServerConfig, offers: Vec<ServedStream>) -> Result<Self, ServerError> {
        let server = Server::bind(config, offers)?;
        let (address, trust) = (server.local_addr().unwrap(), Trust::Pin(server.pin()));
        let (stop, stopped) = oneshot::channel();
        let task = tokio::spawn(async move {
            let mut viewers = Vec::new();
            let ended = |viewer: &ViewerReport| viewers.push(viewer.clone());
            let report = server.run(async { drop(stopped.await) }, ended).await;
            (report, viewers)
        });
        Ok(Self { address, trust, stop: Some(stop), task })
    }

    fn client(&self) -> ClientConfig {
        let locator = Locator {
            scheme: Scheme::Dgs,
            host: self.address.ip().to_string(),
            port: self.address.port(),
            stream: StreamChoice::Index(0),
            pin: None,
        };
        let mut config = ClientConfig::new(locator, self.trust.clone());
        // Playout does not begin without what it waits for, however long a busy machine takes for that.
        config.startup.max_wait = Nanos::from_s(20);
        config
    }

    /// Plays without pictures.
    async fn play(&self, config: &ClientConfig) -> Result<PlayReport, PlayError> {
        play(config, &mut NullSink, std::future::pending()).await.whole()
    }

    async fn stop(mut self) -> (ServerReport, Vec<ViewerReport>) {
        self.stop.take().unwrap().send(()).unwrap();
        self.task.await.unwrap()
    }
}

/// Ten megabits, twenty milliseconds, and losses drawn from a seed.
fn lossy(loss: f64) -> Impairment {
    let path = PathConfig {
        capacity: Capacity::Constant(Rate::from_mbps(10)),
        queue: QueueLimit { bytes: 150_000, ..QueueLimit::default() },
        loss: LossModel::Iid(loss),
        delay: Nanos::from_ms(20),
        ..PathConfig::default()
    };
    Impairment { path, seed: 5 }
}

/// Remembers which frames were shown, and the player's state at the last.
#[derive(Default)]
struct Watching {
    frames: Vec<u32>,
    packets: usize,
}

impl FrameSink for Watching {
    fn show(&mut self, player: &mut Player, frame: u32) -> Result<(), String> {
        self.frames.push(frame);
        let ids = (0..player.info().packets).filter_map(codec_core::internals::ids::PacketId::new);
        self.packets = ids.filter(|id| player.has(*id)).count();
        player.frame(frame).map(drop).map_err(|error| error.to_string())
    }
}

/// Says when its first frame is shown.
struct FirstFrame {
    shown: Arc<Semaphore>,
    said: bool,
}

impl FirstFrame {
    fn new(shown: &Arc<Semaphore>) -> Self {
        Self { shown: shown.clone(), said: false }
    }
}

impl FrameSink for FirstFrame {
    fn show(&mut self, _player: &mut Player, _frame: u32) -> Result<(), String> {
        if !std::mem::replace(&mut self.said, true) {
            self.shown.add_permits(1);
        }
        Ok(())
    }
}
