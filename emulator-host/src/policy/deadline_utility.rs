//! Sends first what each byte adds most of to the picture, given what the receiver has or will have.
//!
//! What is scored are the pieces that add something by themselves (packets, or whole groups in the paper's
//! profile), by marginal gain per byte over what is there or on its way; a piece is credited with all that
//! stands on it (the plan's text says how). Gains are Σ over frames of utility ÷ positive utility of the
//! frame × chance to have arrived. What it does beyond the paper's S(g), each by name in
//! [`DeadlineUtilityConfig`], and each left out by itself in a row of `dgs bench transport`:
//!
//! - *own queue*: media stays out while what is in flight already fills the path; bytes once sent cannot be
//!   decided again. *Short queue*: sooner where hardly anything is lost. *Empty path*: a path that is kept
//!   full is emptied now and then, so that its round trip is known;
//! - *skip late*: what would come too late for its last frame through the queue that media cause themselves
//!   is not sent;
//! - *lost compete*: a lost packet waits again and is worth the whole rest of its group. So no loss takes
//!   from P_g what waits (*loss repaired*); what is in flight counts as far as it is likely to arrive
//!   (*survival*);
//! - *rest only*: a piece is divided by what of it is still to be sent, where S(g) has U_g and all bytes that
//!   are not acknowledged. *Headers*: these are bytes of datagrams, not of packets alone;
//! - *frame share*: utility is divided by the positive utility of its frame, as reports do;
//! - *delay weight*: what waiting until the next motion window is half over would cost goes first, by cost
//!   per byte; what would cost nothing waits, however much it adds. So the time before playout carries what
//!   frame 0 needs, and windows leave when the one before them plays. *Error growth*: what is sent later is
//!   less certain to be in time;
//! - *credit* (S(g) charges a group with what it needs, and credits nothing), *arrival from queue*, *base
//!   weight*: how else a piece is scored;
//! - *opening*: before playout, what the startup rule counts, by count per byte;
//! - *parity competes*: parity is one more candidate, worth what repetition would come too late for, as far
//!   as losses in bursts leave it enough to repair with (*parity bursts*), if that is not too little beside
//!   what a loss costs (*least saved*);
//! - *viewport*: what is out of the viewer's sight, or far away, waits (the viewport's text has the formula).
//!
//! Two more lie in the graph, and leaving one out takes another graph of the same packets:
//!
//! - *gains*: [`crate::graph::Group::utility`] is of streams what a group adds once everything else is there,
//!   bases scaled to what they gain at once, and at least 0, where S(g) has Ũ
//!   ([`crate::graph::Group::risk_adjusted`]);
//! - *packets*: with [`crate::graph::ClosureRule::Sliced`] the pieces are packets, where S(g) is of groups.
//!
//! The forecast orders and refuses nothing but what is late (*skip late*): its error has a heavy tail, so
//! everything that can still be shown keeps some value, and a policy that is wrong about the path goes on to
//! learn.
//!
//! With a flat table the score is frames per byte and their urgency: windows come in order and, within a
//! window, levels, which is the conventional schedule.

mod bursts;
mod config;
mod forecast;
mod in_flight;
mod opening;
mod plan;
mod untimed;
mod viewport;

use self::{forecast::Forecast, opening::Opening, plan::Plan};
use super::{PacketStatus, Scheduler, SenderRequirements, SenderView};
use crate::{
    clock::Nanos,
    graph::{PacketGraph, PacketIndex},
    viewpoint::Viewpoint,
};

pub use config::DeadlineUtilityConfig;
pub use untimed::{file_order, order_by_utility};
pub use viewport::ViewportConfig;

/// Of so many packets one is forecast: enough for a score, and no cost to speak of.
const FORECAST_EVERY: u32 = 8;

/// The policy's state.
#[derive(Debug)]
pub struct DeadlineUtility {
    config: DeadlineUtilityConfig,
    plan: Plan,
    opening: Opening,
    planned_at: Option<Nanos>,
    /// Where the viewer was then.
    planned_for: Option<Viewpoint>,
    lost_since: bool,
}

impl DeadlineUtility {
    /// For `graph`.
    pub fn new(graph: &PacketGraph, config: DeadlineUtilityConfig) -> Self {
        Self {
            config,
            plan: Plan::new(graph),
            opening: Opening::default(),
            planned_at: None,
            planned_for: None,
            lost_since: false,
        }
    }

    fn is_due(&self, view: &SenderView<'_>, now: Nanos) -> bool {
        let Some(planned_at) = self.planned_at else { return true };
        let age = now - planned_at;
        let has_moved = self.config.viewport.is_some() && view.viewpoint != self.planned_for;
        age >= self.config.refresh
            || (self.lost_since && age >= self.config.refresh_after_loss)
            || (has_moved && age >= self.config.refresh_after_move)
    }

    fn renew(&mut self, view: &SenderView<'_>, now: Nanos) {
        self.plan.renew(view, &self.config, now);
        self.planned_at = Some(now);
        self.planned_for = view.viewpoint;
        self.lost_since = false;
    }
}

impl Scheduler for DeadlineUtility {
    fn name(&self) -> &'static str {
        "deadline-utility"
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        if self.config.opening
            && !view.playing
            && let Some(packet) = self.opening.next(view, now)
        {
            return Some(packet);
        }
        if self.is_due(view, now) {
            self.renew(view, now);
        }
        self.plan.next(view, now).or_else(|| {
            if self.planned_at == Some(now) {
                return None;
            }
            self.renew(view, now);
            self.plan.next(view, now)
        })
    }

    fn service(&self) -> SenderRequirements {
        SenderRequirements {
            max_queue_delay: self.config.max_queue_delay,
            short_queue: self.config.short_queue,
            empty_path: self.config.empty_path,
            lost_compete: self.config.lost_compete,
        }
    }

    fn wants_parity(&mut self, view: &SenderView<'_>, parity: PacketIndex, now: Nanos) -> bool {
        if !self.config.parity_competes {
            return true;
        }
        let forecast = Forecast::new(view, &self.config, now);
        self.plan.parity_rank(view, &self.config, &forecast, parity) > self.plan.best_rank()
    }

    fn forecast(&self, view: &SenderView<'_>, packet: PacketIndex, now: Nanos) -> Option<(f64, u32)> {
        if !packet.0.is_multiple_of(FORECAST_EVERY) {
            return None;
        }
        let forecast = Forecast::new(view, &self.config, now);
        let bytes = u32::from(view.graph.wire_bytes(packet)) + forecast::OVERHEAD_BYTES;
        let needed = view.graph.needed_from(packet);
        let frame = if needed > forecast.next_frame() { needed } else { view.graph.useful_until(packet) };
        Some((forecast.chance(bytes, frame, view.smoothed_rtt.as_s()), frame))
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        self.plan.on_status(packet, graph.wire_bytes(packet), change);
        self.opening.on_status(graph, packet, change);
        self.lost_since |= change[1] == PacketStatus::Waiting;
    }
}

#[cfg(test)]
mod tests {
    use codec_core::internals::wire::receipt::ViewerPose;

    use super::*;
    use crate::{clock::Rate, graph::Synthetic, startup::StartupRule};

    /// What is seen of a graph a second before playout, over 1 Mbit/s and 20 ms one way with an empty queue.
    pub(super) fn view<'a>(
        graph: &'a PacketGraph,
        status: &'a [PacketStatus],
        sent_at: &'a [Nanos],
    ) -> SenderView<'a> {
        SenderView {
            graph,
            status,
            sent_at,
            playout_start: Nanos::from_s(1),
            playing: false,
            horizon_frame: 100,
            rate: Rate::from_mbps(1),
            smoothed_rtt: Nanos::from_ms(50),
            rtt_variation: Nanos::from_ms(5),
            minimum_rtt: Nanos::from_ms(40),
            in_flight: 0,
            loss: 0.01,
            loss_after_loss: 0.01,
            sent_number: &[],
            startup: StartupRule::AfterWait,
            retransmissions: 2,
            viewpoint: None,
        }
    }

    /// Poses may change with every receipt: plans are made at their own pace.
    #[test]
    fn a_viewer_that_moves_all_the_time_renews_the_plan_twenty_times_a_second_at_most() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let status = vec![PacketStatus::Waiting; graph.packets().len()];
        let sent_at = vec![Nanos::ZERO; graph.packets().len()];
        let config = DeadlineUtilityConfig::default();
        let plans = |config: DeadlineUtilityConfig| {
            let mut policy = DeadlineUtility::new(&graph, config);
            let mut plans = 0;
            for ms in 0..1000u32 {
                let pose = ViewerPose { position: [ms as f32, 0.0, 0.0], rotation: [1.0, 0.0, 0.0, 0.0] };
                let view = SenderView {
                    playout_start: Nanos::from_s(2),
                    playing: true,
                    viewpoint: Viewpoint::of(&pose),
                    ..view(&graph, &status, &sent_at)
                };
                let now = Nanos::from_ms(u64::from(ms));
                plans += u32::from(policy.is_due(&view, now));
                assert!(policy.next(&view, now).is_some());
            }
            plans
        };
        assert_eq!(plans(config), 20);
        assert_eq!(plans(DeadlineUtilityConfig { viewport: None, ..config }), 5);
    }
}
