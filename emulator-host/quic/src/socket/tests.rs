//! Neither side can be hurt by the other: garbage, oversize, silence and floods end in a named refusal.

mod browser;
mod clients;
mod conditions;
mod controllers;
mod live;
#[cfg(feature = "moq")]
mod relay;
mod replayed;
mod servers;
mod streams;
mod web;
mod web_socket;

use std::{
    net::{Ipv4Addr, SocketAddr},
    sync::Arc,
    time::Duration,
};

use codec_core::internals::ids::{ClusterId, EpochId, Group as GroupId, Level, PacketId, Span};
use dgs_player::Stream;
use emulator_host::{
    GroupIndex, Nanos, PacketGraph, PacketIndex, PolicyKind,
    graph::{ClosureRule, GraphParts, Group, Packet},
};
use quinn::{Connection, Endpoint, TransportConfig};
use tokio::{runtime::Runtime, sync::oneshot, task::JoinHandle};

use super::{
    ClientConfig, FrameSink, Identity, Locator, NullSink, PlayError, PlayReport, Played, RoundRequest,
    Scheme, ServedStream, Server, ServerConfig, ServerLimits, ServerReport, Trust, ViewerReport,
    WebSocketAcceptor, limits::client_transport, message::StreamChoice, play,
};
use crate::CongestionControl;

/// For how long connections may stand on which nothing is said, until all of a test are made: a busy machine
/// takes its time for handshakes.
const PATIENCE: Duration = Duration::from_secs(60);

/// A connection over loopback, without any session.
pub(super) struct Loopback {
    pub(super) served: Connection,
    pub(super) viewer: Connection,
    _ends: [Endpoint; 2],
}

impl Loopback {
    /// To a server of this `transport`.
    pub(super) async fn new(transport: Arc<TransportConfig>) -> Self {
        let identity = Identity::self_signed(&["localhost".to_owned()]).unwrap();
        let trust = Trust::Pin(identity.pin());
        let mut config = quinn::ServerConfig::with_crypto(Arc::new(identity.server().unwrap()));
        config.transport_config(transport);
        let server = Endpoint::server(config, (Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let address = server.local_addr().unwrap();
        let (crypto, _) = trust.client(Scheme::Dgs).unwrap();
        let client = Endpoint::client((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let config = quinn::ClientConfig::new(Arc::new(crypto));
        let connecting = client.connect_with(config, address, "localhost").unwrap();
        let (served, viewer) =
            tokio::join!(async { server.accept().await.unwrap().await.unwrap() }, connecting);
        Self { served, viewer: viewer.unwrap(), _ends: [server, client] }
    }
}

/// A small stream of a few frames.
pub(super) fn stream() -> Stream {
    let file = include_bytes!("../../../../codec-core/tests/conformance/everything.dgs");
    Stream::from_bytes(file).unwrap().0
}

/// Its packets as a graph in which nothing needs anything: what matters here is that they are sent.
pub(super) fn graph(stream: &Stream) -> PacketGraph {
    let manifest = stream.manifest().unwrap();
    let frames = manifest.head().frames;
    let indices = 0..stream.packets().len() as u32;
    let group = |at: u32| Group {
        id: GroupId { span: Span::Canonical(EpochId(0)), cluster: ClusterId(at as u16), level: Level::BASE },
        first_frame: 0,
        last_frame: frames - 1,
        needs: Vec::new(),
        packets: vec![PacketIndex(at)],
        utility: 1.0,
        risk_adjusted: 1.0,
        place: None,
    };
    let packet = |at: u32| Packet {
        id: PacketId::new(at).unwrap(),
        wire_bytes: stream.packets()[at as usize].len() as u16,
        groups: vec![GroupIndex(at)],
        needs_packets: Vec::new(),
        parity_of: None,
    };
    PacketGraph::new(GraphParts {
        packets: indices.clone().map(packet).collect(),
        groups: indices.map(group).collect(),
        repair_sets: Vec::new(),
        frames,
        frame_interval: Nanos((1e9 / manifest.frames_per_second()) as u64),
        manifest_bytes: stream.message().len() as u32,
        profile: ClosureRule::Sliced,
    })
    .unwrap()
}

/// Runs `test` where sockets have a runtime, and not for ever.
fn within<T>(test: impl Future<Output = T>) -> T {
    let limit = Duration::from_secs(120);
    Runtime::new().unwrap().block_on(async { tokio::time::timeout(limit, test).await.unwrap() })
}

/// A server in the background.
struct Running {
    address: SocketAddr,
    trust: Trust,
    entrance: WebSocketAcceptor,
    stop: oneshot::Sender<()>,
    task: JoinHandle<(ServerReport, Vec<ViewerReport>)>,
}

impl Running {
    fn start(limits: ServerLimits) -> Self {
        Self::offering(limits, ServedStream::new("everything", &stream(), graph(&stream())).unwrap())
    }

    fn offering(limits: ServerLimits, offer: ServedStream) -> Self {
        Self::letting(true, limits, offer)
    }

    /// A server that lets viewers change the conditions of their sessions, or does not.
    fn letting(viewer_conditions: bool, limits: ServerLimits, offer: ServedStream) -> Self {
        Self::serving(viewer_conditions, limits, vec![offer])
    }

    fn serving(viewer_conditions: bool, limits: ServerLimits, offers: Vec<ServedStream>) -> Self {
        let identity = Identity::self_signed(&["localhost".to_owned()]).unwrap();
        let (bind, policy) = ((Ipv4Addr::LOCALHOST, 0).into(), PolicyKind::Layered);
        let congestion = CongestionControl::default();
        let config =
            ServerConfig { bind, identity, limits, policy, congestion, impairment: None, viewer_conditions };
        let server = Server::bind(config, offers).unwrap();
        let entrance = server.entrance();
        let (address, trust) = (server.local_addr().unwrap(), Trust::Pin(server.pin()));
        let (stop, stopped) = oneshot::channel::<()>();
        let task = tokio::spawn(async move {
            let mut viewers = Vec::new();
            let on_end = |viewer: &ViewerReport| viewers.push(viewer.clone());
            let report = server.run(async { drop(stopped.await) }, on_end).await;
            (report, viewers)
        });
        Self { address, trust, entrance, stop, task }
    }

    async fn stop(self) -> (ServerReport, Vec<ViewerReport>) {
        self.stop.send(()).unwrap();
        self.task.await.unwrap()
    }

    fn client(&self) -> ClientConfig {
        client(self.address, &self.trust)
    }

    /// Plays to the end.
    async fn play(&self) -> Result<PlayReport, PlayError> {
        play(&self.client(), &mut NullSink, std::future::pending()).await.whole()
    }

    /// An honest client sees all of the clip.
    async fn shows_every_frame(&self) {
        let report = self.play().await.unwrap();
        assert!(report.frames > 0 && report.shown_count == u64::from(report.frames), "{report:?}");
    }

    /// An honest client sees all of the clip, if not at once: where a server waits only shortly for a hello,
    /// a busy machine may make that one late as well. How many tries failed.
    async fn shows_every_frame_in_the_end(&self) -> u64 {
        let mut failed = 0;
        loop {
            match self.play().await {
                Ok(report) => {
                    assert!(
                        report.frames > 0 && report.shown_count == u64::from(report.frames),
                        "{report:?}"
                    );
                    return failed;
                }
                Err(_) => failed += 1,
            }
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    }

    /// A connection on which nothing has been said.
    async fn connect(&self) -> (Endpoint, Connection) {
        self.connect_by(Scheme::Dgs).await
    }

    async fn connect_by(&self, scheme: Scheme) -> (Endpoint, Connection) {
        self.connect_with(scheme, client_transport(Duration::from_secs(10), scheme, true)).await
    }

    async fn connect_with(&self, scheme: Scheme, transport: Arc<TransportConfig>) -> (Endpoint, Connection) {
        let (crypto, _) = self.trust.client(scheme).unwrap();
        let mut config = quinn::ClientConfig::new(Arc::new(crypto));
        config.transport_config(transport);
        let endpoint = Endpoint::client((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let connecting = endpoint.connect_with(config, self.address, "localhost").unwrap();
        let connection = connecting.await.unwrap();
        (endpoint, connection)
    }
}

fn client(address: SocketAddr, trust: &Trust) -> ClientConfig {
    let locator = Locator {
        scheme: Scheme::Dgs,
        host: address.ip().to_string(),
        port: address.port(),
        stream: StreamChoice::Index(0),
        pin: None,
    };
    // On a busy machine a server may say nothing for long.
    ClientConfig { silence: Duration::from_secs(20), ..ClientConfig::new(locator, trust.clone()) }
}
