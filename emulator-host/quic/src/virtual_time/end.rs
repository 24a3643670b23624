//! Drives one end of a connection in virtual time: an endpoint and its only connection.

use std::{
    net::{IpAddr, Ipv4Addr, SocketAddr},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use bytes::BytesMut;
use emulator_host::{ControllerKind, Nanos, rng};
use quinn_proto::{
    ClientConfig, Connection, ConnectionHandle, ConnectionId, ConnectionIdGenerator, DatagramEvent, Endpoint,
    EndpointConfig, ServerConfig, TransportConfig, ValidationTokenConfig,
};

use super::{
    VirtualError,
    tls::{self, Tls},
};
use crate::{
    clock::Clock,
    congestion::{CongestionControl, Factory, Watch, WatchedFactory},
};

/// Bytes of a connection id.
const ID_BYTES: usize = 8;
/// Bytes around the payload of a DATAGRAM frame that quinn-proto counts on: short header with a packet number
/// of 4 bytes, tag, frame type and the longest length.
pub(super) const DATAGRAM_OVERHEAD: u64 = 1 + ID_BYTES as u64 + 4 + 16 + 9;
/// Most bytes of media that the transport may hold: one datagram.
const DATAGRAM_BUFFER: usize = 4096;

/// Connection ids that follow from a seed.
struct SeededIds(rng::RandomStream);

impl ConnectionIdGenerator for SeededIds {
    fn generate_cid(&mut self) -> ConnectionId {
        ConnectionId::new(&self.0.bits().to_be_bytes())
    }

    fn cid_len(&self) -> usize {
        ID_BYTES
    }

    fn cid_lifetime(&self) -> Option<Duration> {
        None
    }
}

/// An endpoint and its connection.
pub(super) struct End {
    endpoint: Endpoint,
    connection: Option<(ConnectionHandle, Connection)>,
    clock: Clock,
    peer: SocketAddr,
    buffer: Vec<u8>,
}

impl End {
    /// The end that listens and sends media in datagrams of up to `datagram_bytes`; `watch` sees its
    /// controller.
    pub(super) fn server(
        clock: Clock,
        seed: u64,
        datagram_bytes: u16,
        controller: Factory,
        watch: Watch,
    ) -> Result<Self, VirtualError> {
        let Tls { server, .. } = tls::shared()?;
        let mut transport = transport(datagram_bytes);
        let watched = WatchedFactory { inner: controller, observer: move || watch.clone() };
        transport.congestion_controller_factory(Arc::new(watched));
        let mut config = ServerConfig::with_crypto(server);
        config.transport_config(Arc::new(transport));
        // No tokens for later connections: they would travel with the media.
        let mut tokens = ValidationTokenConfig::default();
        tokens.sent(0);
        config.validation_token_config(tokens);
        let endpoint = Endpoint::new(endpoint_config(seed, "server"), Some(Arc::new(config)), false, None);
        Ok(Self { endpoint, connection: None, clock, peer: address(1), buffer: Vec::new() })
    }

    /// The end that connects.
    pub(super) fn client(clock: Clock, seed: u64, datagram_bytes: u16) -> Result<Self, VirtualError> {
        let Tls { client, .. } = tls::shared()?;
        let mut config = ClientConfig::new(client);
        config.transport_config(Arc::new(transport(datagram_bytes)));
        let first = AtomicU64::new(rng::stream(seed, "quic/first id").bits());
        config.initial_dst_cid_provider(Arc::new(move || {
            ConnectionId::new(&first.fetch_add(1, Ordering::Relaxed).to_be_bytes())
        }));
        let mut endpoint = Endpoint::new(endpoint_config(seed, "client"), None, false, None);
        let peer = address(2);
        let connected = endpoint.connect(clock.instant(Nanos::ZERO), config, peer, tls::SERVER_NAME);
        let connection = connected.map_err(|error| VirtualError::Connect(error.to_string()))?;
        Ok(Self { endpoint, connection: Some(connection), clock, peer, buffer: Vec::new() })
    }

    /// Time counts from `zero` on.
    pub(super) fn restart(&mut self, zero: Nanos) {
        self.clock = self.clock.counting_from(zero);
    }

    pub(super) fn clock(&self) -> Clock {
        self.clock
    }

    pub(super) fn connection(&mut self) -> Option<&mut Connection> {
        self.connection.as_mut().map(|(_, connection)| connection)
    }

    /// Whether data can be sent and received.
    pub(super) fn is_connected(&self) -> bool {
        self.connection.as_ref().is_some_and(|(_, connection)| !connection.is_handshaking())
    }

    /// A UDP payload has arrived.
    pub(super) fn receive(&mut self, bytes: BytesMut, now: Nanos) -> Result<(), VirtualError> {
        let instant = self.clock.instant(now);
        self.buffer.clear();
        match self.endpoint.handle(instant, self.peer, None, None, bytes, &mut self.buffer) {
            Some(DatagramEvent::ConnectionEvent(_, event)) => {
                if let Some((_, connection)) = &mut self.connection {
                    connection.handle_event(event);
                }
            }
            Some(DatagramEvent::NewConnection(incoming)) => {
                let accepted = self.endpoint.accept(incoming, instant, &mut self.buffer, None);
                let accepted = accepted.map_err(|error| VirtualError::Connect(error.cause.to_string()))?;
                self.connection = Some(accepted);
            }
            // Answers to what belongs to no connection; between two ends there is nothing of the kind.
            Some(DatagramEvent::Response(_)) | None => {}
        }
        self.exchange();
        Ok(())
    }

    /// When [`Self::on_time`] has something to do.
    pub(super) fn next_time(&mut self) -> Nanos {
        let clock = self.clock;
        let timeout = self.connection().and_then(|connection| connection.poll_timeout());
        timeout.map_or(Nanos::MAX, |at| clock.nanos(at))
    }

    /// Handles timers that are due.
    pub(super) fn on_time(&mut self, now: Nanos) {
        if self.next_time() > now {
            return;
        }
        let instant = self.clock.instant(now);
        if let Some(connection) = self.connection() {
            connection.handle_timeout(instant);
        }
        self.exchange();
    }

    /// Makes the next UDP payload that leaves at `now`, if there is one; [`Self::sent`] is it.
    pub(super) fn transmit(&mut self, now: Nanos) -> Option<()> {
        let instant = self.clock.instant(now);
        self.buffer.clear();
        let (_, connection) = self.connection.as_mut()?;
        let sent = connection.poll_transmit(instant, 1, &mut self.buffer);
        self.exchange();
        sent.map(|sent| self.buffer.truncate(sent.size))
    }

    /// What [`Self::transmit`] has made.
    pub(super) fn sent(&self) -> &[u8] {
        &self.buffer
    }

    /// Passes events between connection and endpoint.
    fn exchange(&mut self) {
        let Some((handle, connection)) = &mut self.connection else { return };
        while let Some(event) = connection.poll_endpoint_events() {
            if let Some(event) = self.endpoint.handle_event(*handle, event) {
                connection.handle_event(event);
            }
        }
    }
}

/// What stands for this controller over the transport.
pub(super) fn controller(kind: ControllerKind, datagram_bytes: u16) -> Result<Factory, VirtualError> {
    let control = CongestionControl::of(kind).ok_or_else(|| VirtualError::Unsupported {
        field: "controller",
        found: kind.name().to_owned(),
        allowed: "newreno, cubic or scream",
    })?;
    Ok(control.factory(datagram_bytes))
}

fn address(host: u8) -> SocketAddr {
    SocketAddr::new(IpAddr::V4(Ipv4Addr::new(192, 0, 2, host)), 4433)
}

fn endpoint_config(seed: u64, side: &str) -> Arc<EndpointConfig> {
    let mut config = EndpointConfig::default();
    let mut bytes = [0; 32];
    let mut random = rng::stream(seed, &format!("quic/{side}"));
    bytes.chunks_mut(8).for_each(|chunk| chunk.copy_from_slice(&random.bits().to_be_bytes()));
    let label = format!("quic/{side}/ids");
    config
        .rng_seed(Some(bytes))
        .grease_quic_bit(false)
        .cid_generator(move || Box::new(SeededIds(rng::stream(seed, &label))));
    Arc::new(config)
}

/// Datagrams of one size and no search for a larger one, as in the model; silence never ends a connection.
fn transport(datagram_bytes: u16) -> TransportConfig {
    let mut config = TransportConfig::default();
    config
        .initial_mtu(datagram_bytes)
        .min_mtu(datagram_bytes)
        .mtu_discovery_config(None)
        .enable_segmentation_offload(false)
        .allow_spin(false)
        .max_idle_timeout(None)
        .datagram_send_buffer_size(DATAGRAM_BUFFER);
    config
}
