//! Bounds what a peer can cost: time, memory, datagrams; and sets up the transport by them.

use std::{sync::Arc, time::Duration};

use quinn::{IdleTimeout, TransportConfig, VarInt};

use super::{media_streams::MEDIA_STREAMS, scheme::Scheme};
use crate::congestion::CongestionControl;

/// Bytes of datagrams that wait in the transport: two, so that the next leaves as soon as congestion control
/// and pacing let it, and nothing is queued ahead of the scheduler.
pub(super) const SEND_BUFFER_BYTES: usize = 2560;
/// Bytes of a datagram on the wire before more of the path is known. A packet of 1150 bytes fits.
const INITIAL_MTU: u16 = 1200;
/// Bytes of datagrams that wait to be read.
const RECEIVE_BUFFER_BYTES: usize = 1 << 20;
/// Bytes of the control stream that wait to be read, at the server: many messages.
const CONTROL_WINDOW: u32 = 4096;
/// Bytes of a stream that wait to be read, at the client; of all its streams four times as many.
const CLIENT_WINDOW: u32 = 1 << 20;
/// Streams that a client may open: the control stream, over WebTransport the CONNECT stream too. One that is
/// opened out of turn is never read, and what it holds of the window is the client's own loss.
const SESSION_STREAMS: u32 = 2;
/// Unidirectional streams, of HTTP/3 alone: settings, and two of QPACK (RFC 9114, section 6.2 wants three).
const WEB_STREAMS: u32 = 3;
/// Streams that a relay may have open towards its client: one per group on its way, and those of HTTP/3.
const MOQ_STREAMS: u32 = 1024;

/// What a server grants.
#[derive(Clone, Debug)]
pub struct ServerLimits {
    /// Viewers at once.
    pub max_viewers: usize,
    /// Viewers at once from one address; of IPv6 addresses the first 64 bits count.
    pub max_viewers_per_address: usize,
    /// Media bits per second for each viewer.
    pub max_rate_bps: Option<u64>,
    /// From the end of the handshake to a whole hello.
    pub hello_wait: Duration,
    /// A viewer from whom nothing comes for so long is gone. At least a millisecond.
    pub idle: Duration,
    /// Bytes that wait to be read or acknowledged, for each viewer: a manifest must fit.
    pub viewer_bytes: u64,
}

impl Default for ServerLimits {
    /// 100 viewers, 32 from one address, no bound on the rate, 5 s for a hello, 10 s of silence, 1 MiB.
    fn default() -> Self {
        Self {
            max_viewers: 100,
            max_viewers_per_address: 32,
            max_rate_bps: None,
            hello_wait: Duration::from_secs(5),
            idle: Duration::from_secs(10),
            viewer_bytes: 1 << 20,
        }
    }
}

impl ServerLimits {
    pub(super) fn transport(&self, congestion: CongestionControl) -> Arc<TransportConfig> {
        let mut config = TransportConfig::default();
        config
            .max_concurrent_bidi_streams(VarInt::from_u32(SESSION_STREAMS))
            .max_concurrent_uni_streams(VarInt::from_u32(WEB_STREAMS))
            .stream_receive_window(VarInt::from_u32(CONTROL_WINDOW))
            .receive_window(VarInt::from_u32(CONTROL_WINDOW))
            .send_window(self.viewer_bytes)
            .initial_mtu(INITIAL_MTU)
            // Packets of media have their size: a wider path would carry the same, and on a slow one each
            // probe holds them up, by a tenth of a second at 120 kbit/s.
            .mtu_discovery_config(None)
            .datagram_receive_buffer_size(Some(RECEIVE_BUFFER_BYTES / 16))
            // Datagrams that leave together are padded to one length, and their sizes are not reported.
            // Hardly two ever wait.
            .enable_segmentation_offload(false)
            .datagram_send_buffer_size(SEND_BUFFER_BYTES)
            .congestion_controller_factory(congestion.watched(INITIAL_MTU))
            .max_idle_timeout(idle_timeout(self.idle));
        Arc::new(config)
    }
}

/// The transport of a client. Its idle timeout is `silence`; without `datagrams` it advertises that it takes
/// none (RFC 9221, section 3).
pub(super) fn client_transport(silence: Duration, scheme: Scheme, datagrams: bool) -> Arc<TransportConfig> {
    let mut config = TransportConfig::default();
    let streams = match scheme {
        Scheme::Dgs => MEDIA_STREAMS,
        Scheme::Https => WEB_STREAMS + MEDIA_STREAMS,
        Scheme::Moq => MOQ_STREAMS,
    };
    let requests = if scheme == Scheme::Moq { MOQ_STREAMS } else { 0 };
    config
        .max_concurrent_bidi_streams(VarInt::from_u32(requests))
        .max_concurrent_uni_streams(VarInt::from_u32(streams))
        .initial_mtu(INITIAL_MTU)
        .datagram_receive_buffer_size(datagrams.then_some(RECEIVE_BUFFER_BYTES))
        .datagram_send_buffer_size(RECEIVE_BUFFER_BYTES / 16)
        .max_idle_timeout(idle_timeout(silence))
        // Who publishes and has no subscriber has nothing to say, nor has a viewer that waits for an answer:
        // only a path that is gone is silent.
        .keep_alive_interval(Some(silence / 3));
    if scheme != Scheme::Moq {
        config
            .mtu_discovery_config(None)
            .stream_receive_window(VarInt::from_u32(CLIENT_WINDOW))
            .receive_window(VarInt::from_u32(4 * CLIENT_WINDOW));
    }
    Arc::new(config)
}

fn idle_timeout(after: Duration) -> Option<IdleTimeout> {
    let after = after.clamp(Duration::from_millis(1), Duration::from_secs(3600));
    after.try_into().ok()
}

/// Allows so many events per second, and a number of them at once.
#[derive(Clone, Copy, Debug)]
pub(super) struct Allowance {
    per_second: f64,
    most: f64,
    left: f64,
    at: Duration,
}

impl Allowance {
    pub(super) const fn new(per_second: f64, most: f64) -> Self {
        Self { per_second, most, left: most, at: Duration::ZERO }
    }

    /// Allows `more` events besides those of time.
    pub(super) fn add(&mut self, more: f64) {
        self.left = (self.left + more).min(self.most);
    }

    /// Takes `count` at `now`, a time since any one moment; nothing and false if there are not so many.
    pub(super) fn take(&mut self, count: f64, now: Duration) -> bool {
        self.renew(now);
        let enough = self.left >= count;
        self.left -= if enough { count } else { 0.0 };
        enough
    }

    /// How long from `now` until `count` can be taken.
    pub(super) fn wait(&mut self, count: f64, now: Duration) -> Duration {
        self.renew(now);
        let missing = (count.min(self.most) - self.left).max(0.0);
        Duration::from_secs_f64((missing / self.per_second.max(1e-9)).min(3600.0))
    }

    fn renew(&mut self, now: Duration) {
        let passed = now.saturating_sub(self.at).as_secs_f64();
        self.left = (self.left + passed * self.per_second).min(self.most);
        self.at = self.at.max(now);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_allowance_is_used_up_and_comes_back_with_time() {
        let mut allowance = Allowance::new(10.0, 2.0);
        let now = Duration::from_secs(5);
        assert!(allowance.take(2.0, now) && !allowance.take(1.0, now));
        assert_eq!(allowance.wait(1.0, now), Duration::from_millis(100));
        assert!(allowance.take(1.0, now + Duration::from_millis(101)));
        assert!(!allowance.take(1.0, now));
        allowance.add(5.0);
        assert!(allowance.take(2.0, now) && !allowance.take(1.0, now));
    }
}
