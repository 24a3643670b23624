//! Connects to a relay: QUIC with the checks of every client here, WebTransport, then a choice of version.

use std::time::{Duration, Instant};

use moq_net::{ALPNS, Client, Driver, Session, cache, origin};
use quinn::{Connection, Endpoint};
use tokio::time::timeout;
use url::Url;
use web_transport_proto::ConnectRequest;
use web_transport_quinn::Session as Transport;

use crate::socket::{ClientConfig, Locator, PlayError, Scheme, connect, message::StreamChoice};

/// Bytes of groups that are kept in memory.
const CACHE_BYTES: u64 = 64 << 20;

/// A connection to a relay, before anything is said about broadcasts.
pub(super) struct Relay {
    pub(super) endpoint: Endpoint,
    pub(super) connection: Connection,
    pub(super) session: Session,
    pub(super) driver: Driver<Transport>,
}

impl Relay {
    /// Connects to where `config` says; `client` says what is published or subscribed.
    pub(super) async fn connect(config: &ClientConfig, client: Client) -> Result<Self, PlayError> {
        let (endpoint, connection) = connect(config).await?;
        // The broadcast is named later; a relay takes a path here for the root of all names.
        let root = Locator {
            scheme: Scheme::Https,
            stream: StreamChoice::Index(0),
            pin: None,
            ..config.locator.clone()
        };
        let url = root.to_string();
        let url = Url::parse(&url).map_err(|error| PlayError::Nonsense(format!("{url}: {error}")))?;
        let versions = ALPNS.iter().map(|version| (*version).to_owned());
        let request = ConnectRequest::new(url).with_protocols(versions);
        let silence = || PlayError::Silence { ms: config.silence.as_millis() };
        let transport = timeout(config.silence, Transport::connect(connection.clone(), request)).await;
        let transport = transport.map_err(|_| silence())?;
        let transport = transport.map_err(|error| PlayError::Relay(error.to_string()))?;
        let has_version = transport.protocol().is_some();
        let agreed = timeout(config.silence, client.connect(Instant::now(), transport)).await;
        let agreed = agreed.map_err(|_| silence())?;
        let (session, driver) = agreed.map_err(|error| {
            // Relays of early versions agree on none in the handshake, either; but they know what comes next.
            if has_version { PlayError::Relay(error.to_string()) } else { no_relay(config, &error) }
        })?;
        Ok(Self { endpoint, connection, session, driver })
    }
}

/// That what answers is a server of WebTransport and of something else.
fn no_relay(config: &ClientConfig, error: &moq_net::Error) -> PlayError {
    let Locator { host, port, .. } = &config.locator;
    PlayError::Relay(format!(
        "what answers at {host}:{port} speaks no version of Media over QUIC ({error}); a server of \
         `dgs serve` is played by dgs:// or https://, without moq+"
    ))
}

/// Says that it is over, and waits a moment for that to arrive.
pub(super) async fn close(endpoint: &Endpoint, connection: &Connection) {
    connection.close(0u32.into(), b"bye");
    let _ = timeout(Duration::from_millis(200), endpoint.wait_idle()).await;
}

/// A place for broadcasts that keeps a bounded part of them.
pub(super) fn origin() -> (origin::Producer, origin::Driver) {
    let pool = cache::Config::default().with_capacity(CACHE_BYTES).with_expiry(cache::DEFAULT_EXPIRY);
    let mut config = origin::Config::default();
    config.pool = cache::Pool::new(pool);
    origin::Producer::new(config)
}
