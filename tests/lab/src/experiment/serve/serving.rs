//! Runs a server of one stream in the background.

use std::net::Ipv4Addr;

use anyhow::{Context, Result, bail};
use dgs_quic::{
    CongestionControl,
    socket::{
        ClientConfig, Identity, Locator, Scheme, ServedStream, Server, ServerConfig, ServerLimits,
        ServerReport, Trust, ViewerReport, message::StreamChoice,
    },
};
use emulator_host::PolicyKind;
use tokio::{runtime::Runtime, sync::oneshot, task::JoinHandle};

/// A server on threads of its own, and what plays its stream.
pub struct Serving {
    /// What plays its stream from the start.
    pub client: ClientConfig,
    stop: oneshot::Sender<()>,
    task: JoinHandle<(ServerReport, Vec<ViewerReport>)>,
}

impl Serving {
    /// Starts it on `runtime`, with what `change` makes of the defaults.
    pub fn start(
        runtime: &Runtime,
        offer: ServedStream,
        change: impl FnOnce(&mut ServerConfig),
    ) -> Result<Self> {
        let mut config = ServerConfig {
            bind: (Ipv4Addr::LOCALHOST, 0).into(),
            identity: Identity::self_signed(&["localhost".to_owned()])?,
            limits: ServerLimits::default(),
            policy: PolicyKind::DeadlineUtility,
            congestion: CongestionControl::default(),
            impairment: None,
            viewer_conditions: false,
        };
        change(&mut config);
        let server = runtime.block_on(async { Server::bind(config, vec![offer]) })?;
        let locator = Locator {
            scheme: Scheme::Dgs,
            host: "127.0.0.1".to_owned(),
            port: server.local_addr()?.port(),
            stream: StreamChoice::Index(0),
            pin: None,
        };
        let client = ClientConfig::new(locator, Trust::Pin(server.pin()));
        let (stop, stopped) = oneshot::channel::<()>();
        let task = runtime.spawn(async move {
            let mut viewers = Vec::new();
            let on_end = |viewer: &ViewerReport| viewers.push(viewer.clone());
            let report = server.run(async { drop(stopped.await) }, on_end).await;
            (report, viewers)
        });
        Ok(Self { client, stop, task })
    }

    /// Ends it; what it has counted.
    pub fn stop(self, runtime: &Runtime) -> Result<(ServerReport, Vec<ViewerReport>)> {
        if self.stop.send(()).is_err() {
            bail!("the server ended before its viewers");
        }
        runtime.block_on(self.task).context("the server failed")
    }
}
