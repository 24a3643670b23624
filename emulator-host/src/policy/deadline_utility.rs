//! Sends first what each byte adds most of to the picture, given what the receiver has or will have.
//!
//! What is scored are the pieces that add something by themselves (packets, or whole groups in the paper's
//! profile), by marginal gain per byte over what is there or on its way; a piece is credited with all that
//! stands on it (the plan's text says how). Gains are Σ over frames of utility ÷ positive utility of the
//! frame × chance to have arrived. What it does beyond the paper's S(g), each by name in
//! [`DeadlineUtilityConfig`]:
//!
//! - *own queue*: media stays out while what is in flight already fills the path; bytes once sent cannot be
//!   decided again;
//! - *lost compete*: a lost packet waits again and is worth the whole rest of its group;
//! - *credit*, *arrival from queue*, *base weight*, *delay weight*: how a piece is scored;
//! - *opening*: before playout, what the startup rule counts, by count per byte;
//! - *parity competes*: parity is one more candidate, worth what repetition would come too late for.
//!
//! The forecast orders and never refuses: its error has a heavy tail, so everything that can still be shown
//! keeps some value, and a policy that is wrong about the path goes on to learn.
//!
//! With a flat table the score is frames per byte, so that levels come in order and, within a level, windows:
//! the conventional schedule.

mod config;
mod opening;
mod outlook;
mod plan;

use self::{opening::Opening, outlook::Outlook, plan::Plan};
use super::{PacketStatus, Scheduler, SenderView, Service};
use crate::{
    clock::Nanos,
    graph::{PacketGraph, PacketIndex},
};

pub use config::DeadlineUtilityConfig;

/// Of so many packets one is forecast: enough for a score, and no cost to speak of.
const FORECAST_EVERY: u32 = 8;

/// The policy's state.
#[derive(Debug)]
pub struct DeadlineUtility {
    config: DeadlineUtilityConfig,
    plan: Plan,
    opening: Opening,
    planned_at: Option<Nanos>,
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
            lost_since: false,
        }
    }

    fn is_due(&self, now: Nanos) -> bool {
        let Some(planned_at) = self.planned_at else { return true };
        let age = now - planned_at;
        age >= self.config.refresh || (self.lost_since && age >= self.config.refresh_after_loss)
    }

    fn renew(&mut self, view: &SenderView<'_>, now: Nanos) {
        self.plan.renew(view, &self.config, now);
        self.planned_at = Some(now);
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
        if self.is_due(now) {
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

    fn service(&self) -> Service {
        Service { own_queue: self.config.own_queue, lost_compete: self.config.lost_compete }
    }

    fn wants_parity(&mut self, view: &SenderView<'_>, parity: PacketIndex, now: Nanos) -> bool {
        if !self.config.parity_competes {
            return true;
        }
        let outlook = Outlook::new(view, &self.config, now);
        self.plan.parity_rank(view, &outlook, parity) > self.plan.best_rank()
    }

    fn forecast(&self, view: &SenderView<'_>, packet: PacketIndex, now: Nanos) -> Option<(f64, u32)> {
        if !packet.0.is_multiple_of(FORECAST_EVERY) {
            return None;
        }
        let outlook = Outlook::new(view, &self.config, now);
        let bytes = u32::from(view.graph.packets()[packet.at()].wire_bytes) + outlook::OVERHEAD_BYTES;
        let needed = view.graph.needed_from(packet);
        let frame = if needed > outlook.next_frame() { needed } else { view.graph.useful_until(packet) };
        Some((outlook.chance(bytes, frame, view.smoothed_rtt.as_s()), frame))
    }

    fn on_status(&mut self, view: &SenderView<'_>, packet: PacketIndex, before: PacketStatus) {
        let after = view.status[packet.at()];
        self.plan.on_status(packet, view.graph.packets()[packet.at()].wire_bytes, before, after);
        self.lost_since |= after == PacketStatus::Waiting;
    }
}
