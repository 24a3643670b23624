//! Simulates one delivery in virtual time: sender, path, receiver, feedback, playout.
//!
//! What is the same over any transport lies in cores that know time and packets and no transport:
//! [`MediaSender`] decides what leaves next, [`MediaReceiver`] plays and writes receipts, [`Outstanding`]
//! infers losses where a transport does not tell them, [`Viewer`] measures. Around them lies a model of QUIC,
//! and beside it a transport that could not be better ([`run_ideal`]): it says what the transport costs.
//!
//! Order within one instant: arrivals at the receiver, arrivals at the sender, timers, playout, sending,
//! receipts. So what arrives at the very time of a snapshot is in it.
//!
//! What is modelled: control and media share one congestion budget, control first; media that overtakes the
//! manifest is buffered; receipts cost uplink and may be lost; lost base packets are sent again within a
//! budget while they can still be shown; playout starts at a threshold and never waits after it. Not
//! modelled: handshake, ECN (links drop and never mark), clock offset (the receipt carries the playout time
//! and both ends share a clock), decoding time.

mod client;
mod control;
mod datagram;
mod delivery_log;
mod feedback;
mod forecast;
mod freezes;
mod ideal;
mod loss_bursts;
mod loss_share;
mod media_receiver;
mod media_sender;
mod metrics;
mod outstanding;
mod parity_queue;
mod recent_counts;
mod reported_pose;
mod round_trip_probe;
mod run;
mod sender;
mod threshold;
mod view_state;
mod viewer;
mod viewer_path;

use crate::{
    clock::{Nanos, Rate},
    congestion::ControllerKind,
    graph::PacketGraph,
    link::{Chain, PathConfig, PathError},
    policy::PolicyKind,
    receiver::GraphReceiver,
};

pub use crate::startup::{Startup, StartupRule};
pub use freezes::Freezes;
pub use ideal::run_ideal;
pub use media_receiver::MediaReceiver;
pub use media_sender::{MediaSender, SendingRules};
pub use outstanding::Outstanding;
pub use reported_pose::ReportedPose;
pub use run::{run, simulate};
pub use view_state::PathFacts;
pub use viewer::Viewer;
pub use viewer_path::ViewerPath;

/// Bytes around a DGSP packet inside the UDP payload: QUIC short header 11, DATAGRAM frame 3, authentication
/// tag 16.
pub(crate) const QUIC_OVERHEAD_BYTES: u32 = 30;
/// IPv4 and UDP headers, counted on the link only.
pub const IP_UDP_BYTES: u32 = 28;

/// Everything that a run depends on besides the graph.
///
/// # Examples
/// ```
/// use emulator_host::{ControllerKind, PolicyKind, SessionConfig, graph::Synthetic, simulate};
///
/// let config = SessionConfig {
///     policy: PolicyKind::Layered,
///     controller: ControllerKind::BbrModel,
///     ..SessionConfig::default()
/// };
/// let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1)?;
/// let report = simulate(&graph, &config)?;
/// assert_eq!((report.policy.as_str(), report.controller.as_str()), ("layered", "bbr-model"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct SessionConfig {
    /// Seed of the path's random streams.
    pub seed: u64,
    /// Scheduler used by [`simulate`].
    pub policy: PolicyKind,
    /// Congestion controller.
    pub controller: ControllerKind,
    /// From sender to receiver.
    pub forward: PathConfig,
    /// From receiver to sender.
    pub reverse: PathConfig,
    /// Rate of the sender's own serialiser; loss timers start when it is through. `None`: instantly.
    pub access_rate: Option<Rate>,
    /// Round trip that the handshake has measured, before the session's time begins, at most an hour; `None`
    /// if there was no handshake.
    pub handshake_rtt: Option<Nanos>,
    /// How far ahead of playout media may be sent.
    pub lookahead: Nanos,
    /// When playout starts.
    pub startup: Startup,
    /// Times that one lost packet of the base may be sent again.
    pub retransmissions: u32,
    /// Ack-eliciting datagrams per receipt, at least 1.
    pub ack_every: u32,
    /// Longest time that a receipt is held back.
    pub max_ack_delay: Nanos,
    /// Where the viewer is, which its receipts tell the sender; `None`: they do not say.
    pub viewer: Option<ViewerPath>,
    /// Media packets that the receiver of [`simulate`] keeps before the manifest is complete.
    pub buffer_limit: usize,
    /// Time between [`crate::report::SenderRow`]s, at least 1 ms; zero for none.
    pub sample_interval: Nanos,
    /// The run ends here if playout has not ended before; `None`: after an hour, or a minute after the latest
    /// end of playout if that is later.
    pub cap: Option<Nanos>,
}

impl Default for SessionConfig {
    /// Deadline-utility over NewReno on 5 Mbit/s down and 2 Mbit/s up, 20 ms each way.
    fn default() -> Self {
        let up = PathConfig {
            capacity: crate::link::Capacity::Constant(Rate::from_mbps(2)),
            ..PathConfig::default()
        };
        Self {
            seed: 1,
            policy: PolicyKind::DeadlineUtility,
            controller: ControllerKind::NewReno,
            forward: PathConfig::default(),
            reverse: up,
            access_rate: None,
            handshake_rtt: None,
            lookahead: Nanos::from_s(4),
            startup: Startup { rule: StartupRule::BaseGroups(0.95), max_wait: Nanos::from_s(5) },
            retransmissions: 2,
            ack_every: 2,
            max_ack_delay: Nanos::from_ms(25),
            viewer: None,
            buffer_limit: GraphReceiver::BUFFER_LIMIT,
            sample_interval: Nanos::from_ms(100),
            cap: None,
        }
    }
}

/// Longest round trip that a handshake may have measured.
const LONGEST_HANDSHAKE: Nanos = Nanos::from_s(3600);

impl SessionConfig {
    /// Refuses numbers that no run can use.
    ///
    /// # Errors
    /// [`SessionError::Config`] names the first.
    pub fn check(&self) -> Result<(), SessionError> {
        if let Some(share) = self.startup.rule.share().filter(|share| !(0.0..=1.0).contains(share)) {
            return Err(SessionError::Config { field: "startup share", found: share, allowed: "0 to 1" });
        }
        if self.ack_every == 0 {
            return Err(SessionError::Config { field: "ack_every", found: 0.0, allowed: "at least 1" });
        }
        let (shortest, found) = (Nanos::from_ms(1), self.sample_interval.0 as f64 / 1e6);
        if self.sample_interval > Nanos::ZERO && self.sample_interval < shortest {
            let allowed = "0 or at least 1 ms";
            return Err(SessionError::Config { field: "sample_interval, ms,", found, allowed });
        }
        if let Some(found) = self.handshake_rtt.filter(|&round_trip| round_trip > LONGEST_HANDSHAKE) {
            let (found, allowed) = (found.0 as f64 / 1e9, "at most 3600 s");
            return Err(SessionError::Config { field: "handshake_rtt, s,", found, allowed });
        }
        Ok(())
    }

    /// When a run of `graph` ends at the latest.
    pub fn end(&self, graph: &PacketGraph) -> Nanos {
        let clip = graph.frame_interval().times(u64::from(graph.frames()));
        let playout = self.startup.max_wait + clip + Nanos::from_s(60);
        self.cap.unwrap_or_else(|| playout.max(Nanos::from_s(3600)))
    }

    /// Fresh boxes of both directions, forward first.
    ///
    /// # Errors
    /// [`SessionError::Path`] names the direction and what is wrong with it.
    pub fn paths(&self) -> Result<[Chain; 2], SessionError> {
        let path = |direction, path: &PathConfig| {
            path.build(direction, self.seed).map_err(|error| SessionError::Path { direction, error })
        };
        Ok([path("forward", &self.forward)?, path("reverse", &self.reverse)?])
    }

    /// What the sender of media may do, whatever the transport.
    pub fn sending(&self) -> SendingRules {
        SendingRules {
            lookahead: self.lookahead,
            startup: self.startup,
            retransmissions: self.retransmissions,
        }
    }
}

/// Why a run cannot be made.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SessionError {
    /// A direction of the path is illegal.
    #[error("{direction}: {error}")]
    Path {
        /// `forward` or `reverse`.
        direction: &'static str,
        /// What is wrong.
        error: PathError,
    },
    /// A number of the configuration is illegal.
    #[error("{field} is {found}, allowed {allowed}")]
    Config {
        /// Which.
        field: &'static str,
        /// What it is.
        found: f64,
        /// What it may be.
        allowed: &'static str,
    },
}
