//! Names what the default scheduler does beyond the paper's score; each can be switched off by itself.

use super::viewport::ViewportConfig;
use crate::{clock::Nanos, graph::pieces::Contribution, policy::SenderView};

/// Settings. [`Default`] is what measured best on windows that were not used to report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadlineUtilityConfig {
    /// Longest queue that media may cause on the path
    /// ([`super::super::SenderRequirements::max_queue_delay`]); `None`: as the congestion window allows.
    pub max_queue_delay: Option<Nanos>,
    /// On a path that loses hardly anything that queue is 9/20 as long
    /// ([`super::super::SenderRequirements::short_queue`]); otherwise it is the same on every path.
    pub short_queue: bool,
    /// A path that was never empty for ten seconds is emptied for about a round trip
    /// ([`super::super::SenderRequirements::empty_path`]); otherwise never.
    pub empty_path: bool,
    /// What would come after its last frame through the queue that media cause themselves is not sent;
    /// otherwise whatever comes in time over an empty path may be. Without [`Self::max_queue_delay`] no queue
    /// is counted on.
    pub skip_late: bool,
    /// Every lost packet competes again for as long as it can show; otherwise lost base packets are repeated
    /// within a budget and nothing else is.
    pub lost_compete: bool,
    /// A piece counts as if none of its packets could be lost, since what is lost may be sent again;
    /// otherwise, as in P_g, with the chance that none is, counting the times that a base packet is repeated.
    pub loss_repaired: bool,
    /// What needs something in flight counts with the chance that it arrives, which falls while no receipt
    /// tells of it; otherwise as if it were there.
    pub survival: bool,
    /// A piece is scored per byte of it that is still to be sent; otherwise, as in S(g), per byte that is not
    /// acknowledged, and with U_g.
    pub rest_only: bool,
    /// Scores are per byte of whole datagrams, with their headers; otherwise, as in S(g), per byte of packets
    /// alone. Arrival is predicted with headers either way.
    pub headers: bool,
    /// Utility counts as a share of all positive utility of its frame; otherwise a unit of it counts the same
    /// in every frame.
    pub frame_share: bool,
    /// A packet is credited with what stands on it; otherwise with what it adds by itself.
    pub credit: bool,
    /// Arrival is predicted from the bytes in flight; otherwise from the last measured round trip.
    pub arrival_from_queue: bool,
    /// What all level-0 groups of a frame count together, beside all utility of the frame, which counts 1: a
    /// picture with holes looks worse than its utility says.
    pub base_weight: f64,
    /// How much a byte that could as well be sent later gives way to one that could not: weight of what is
    /// lost by waiting until the next motion window is half over, relative to what is gained at all.
    pub delay_weight: f64,
    /// Growth of the scale of the forecast's error, seconds for every second that sending waits, at least 0.
    pub error_growth: f64,
    /// Before playout, first what the startup rule counts, by count per byte.
    pub opening: bool,
    /// Parity is sent where it saves more than the same bytes of something else; otherwise always.
    pub parity_competes: bool,
    /// Parity that saves less than this share of what a loss of its members costs is never sent, 0..=1; with
    /// 0 any may be.
    pub least_saved: f64,
    /// Parity is valued by how losses cluster; otherwise as if each were independent of the others.
    pub parity_bursts: bool,
    /// What the viewer sees of a piece, once it has said where it is, weighs what the piece adds; `None`: as
    /// if nobody had said.
    pub viewport: Option<ViewportConfig>,
    /// Longest time that a plan is used.
    pub refresh: Nanos,
    /// A loss renews the plan, but not sooner than this after the last.
    pub refresh_after_loss: Nanos,
    /// A viewer that has moved renews the plan, but not sooner than this after the last, however often it
    /// says so.
    pub refresh_after_move: Nanos,
}

impl DeadlineUtilityConfig {
    /// The viewport weight of a piece that adds `parts`: 1 without a viewer's word.
    pub(super) fn viewport_weight(&self, view: &SenderView<'_>, parts: &[Contribution]) -> f64 {
        match (&self.viewport, &view.viewpoint) {
            (Some(config), Some(viewpoint)) => config.weight(viewpoint, view.graph, parts),
            _ => 1.0,
        }
    }
}

impl Default for DeadlineUtilityConfig {
    fn default() -> Self {
        Self {
            max_queue_delay: Some(Nanos::from_ms(100)),
            short_queue: true,
            empty_path: true,
            skip_late: true,
            lost_compete: true,
            loss_repaired: true,
            survival: true,
            rest_only: true,
            headers: true,
            frame_share: true,
            credit: true,
            arrival_from_queue: true,
            base_weight: 0.3,
            delay_weight: 300.0,
            error_growth: 0.03,
            opening: true,
            parity_competes: true,
            least_saved: 0.1,
            parity_bursts: true,
            viewport: Some(ViewportConfig::default()),
            refresh: Nanos::from_ms(200),
            refresh_after_loss: Nanos::from_ms(20),
            refresh_after_move: Nanos::from_ms(50),
        }
    }
}
