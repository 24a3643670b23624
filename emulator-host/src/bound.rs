//! Bounds from above what any schedule could show over the same channel.
//!
//! The question is a linear program. Frames are taken in slots of three, and also one by one where that
//! makes no large program; y(i, s) in 0..=1 says how much of piece i is there by slot s:
//!
//! - maximise Σ v(i, s) y(i, s);
//! - y(i, s) ≤ y(j, s) where i needs j; y(i, s) ≤ y(i, s + 1);
//! - Σ_i b(i) y(i, min(s, last slot of i)) ≤ C(s), over the pieces needed by slot s: what the link carries
//!   until the last frame of slot s, less the manifest.
//!
//! What a piece takes from the picture counts against it: a packet that carries groups of positive and of
//! negative utility brings both. Net gains of a frame are credited from the slot in which a piece arrives,
//! net losses from the one after it.
//!
//! Every run is a feasible point: losses and repetitions only use more of the link, and slots credit gains
//! early and losses late. Whole packets, causality and the sender's look-ahead are not asked for. So the
//! optimum is at least what any scheduler can show; and for any multipliers μ, π, ν ≥ 0 so is
//! Σ μ(s) C(s) + Σ max(0, reduced v(i, s)), because no y exceeds 1. The solver may therefore be stopped
//! whenever: the number holds.

mod linear_program;

use self::linear_program::{DATAGRAM_OVERHEAD, LinearProgram, fine_variables};
use crate::{clock::Nanos, graph::PacketGraph, link::PathConfig};

pub use self::linear_program::UpperBound;

/// Frames per slot.
const COARSE_SLOT: u32 = 3;
/// Most variables of a program with a slot for every frame: beyond it slots save more time than they cost
/// in tightness.
const MAX_FINE: usize = 1 << 15;
/// Bytes of the manifest in one datagram.
const CHUNK_BYTES: u64 = 1150;

/// The bound for `graph` over `path`, with playout that starts at `start`, after `steps` of the solver.
///
/// # Examples
/// ```
/// use emulator_host::{Nanos, SessionConfig, bound, graph::Synthetic, simulate};
///
/// let graph = Synthetic { frames: 60, ..Synthetic::default() }.build(1)?;
/// let config = SessionConfig::default();
/// let report = simulate(&graph, &config)?;
/// let start = Nanos((report.startup_ms.unwrap_or(0.0) * 1e6) as u64);
/// assert!(report.utility <= bound::upper_bound(&graph, &config.forward, start, 300).utility);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn upper_bound(graph: &PacketGraph, path: &PathConfig, start: Nanos, steps: u32) -> UpperBound {
    let manifest = u64::from(graph.manifest_bytes());
    let control = manifest + manifest.div_ceil(CHUNK_BYTES) * DATAGRAM_OVERHEAD;
    let capacity = |last_frame: u32| {
        let shown = start + graph.frame_interval().times(u64::from(last_frame));
        // What is shown must have left the link one delay earlier.
        path.bytes_until(shown - path.delay).0.saturating_sub(control) as f64
    };
    let division = graph.division();
    let coarse = LinearProgram::new(graph, &division, COARSE_SLOT, &capacity).solve(steps);
    if fine_variables(graph, &division.pieces) > MAX_FINE {
        return coarse;
    }
    // Tighter, but slower to solve: after few steps the coarse one may be ahead.
    let fine = LinearProgram::new(graph, &division, 1, &capacity).solve(steps);
    if fine.utility < coarse.utility { fine } else { coarse }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        PolicyKind, SessionConfig, Trace,
        clock::{Bytes, Rate},
        graph::{ClosureRule, Synthetic},
        link::Capacity,
        session::{Startup, StartupRule},
        simulate,
        trace::Step,
    };

    fn bottleneck() -> Synthetic {
        Synthetic { frames: 150, clusters: 8, rate: Rate::from_kbps(800), ..Synthetic::default() }
    }

    fn after_a_second(path: PathConfig) -> SessionConfig {
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(1) };
        SessionConfig { startup, forward: path, ..SessionConfig::default() }
    }

    #[test]
    fn no_scheduler_passes_it_at_any_step_and_more_steps_never_raise_it() {
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            for seed in 0..3 {
                let graph = Synthetic { profile, ..bottleneck() }.build(seed).unwrap();
                let trace = Trace::bursty(seed, Nanos::from_s(20)).scaled(1, 10).unwrap();
                let path = PathConfig { capacity: Capacity::Trace(trace), ..PathConfig::default() };
                let bounds =
                    [0, 50, 200, 800].map(|steps| upper_bound(&graph, &path, Nanos::from_s(1), steps));
                assert!(bounds.windows(2).all(|pair| pair[1].utility <= pair[0].utility + 1e-12));
                for policy in PolicyKind::ALL {
                    let config = SessionConfig { policy, seed, ..after_a_second(path.clone()) };
                    let utility = simulate(&graph, &config).unwrap().utility;
                    assert!(utility <= bounds[3].utility, "{}: {utility} {bounds:?}", policy.name());
                }
            }
        }
    }

    /// One cluster, one level and a link that carries half of the bytes: the fractional knapsack of the
    /// smallest groups cannot be passed, and the solver's own schedule meets its bound.
    #[test]
    fn it_is_tight_where_the_optimum_is_known() {
        let spec = Synthetic {
            frames: 300,
            clusters: 1,
            levels: 1,
            canonical_percent: 0,
            manifest_bytes: 0,
            utilities: crate::graph::Utilities::Flat,
            ..Synthetic::default()
        };
        let graph = Synthetic { rate: Rate::from_kbps(8), ..spec }.build(1).unwrap();
        let bytes = |packet: &crate::PacketIndex| u64::from(graph.packets()[packet.at()].wire_bytes) + 58;
        let sizes = graph.groups().iter().map(|group| group.packets.iter().map(bytes).sum::<u64>());
        let frames = graph.groups().iter().map(|group| f64::from(group.last_frame - group.first_frame + 1));
        // Each frame shows two groups, that of its window and the canonical one, so each counts for half.
        let mut items: Vec<(u64, f64)> = sizes.zip(frames.map(|frames| frames / 600.0)).collect();
        items.sort_by(|one, other| (one.0 as f64 / one.1).total_cmp(&(other.0 as f64 / other.1)));
        let total: u64 = items.iter().map(|(bytes, _)| bytes).sum();
        let (mut left, mut most) = (total as f64 / 2.0, 0.0);
        for (bytes, gain) in items {
            let part = (left / bytes as f64).min(1.0);
            left -= part * bytes as f64;
            most += part * gain;
        }
        let rate = Rate::over(Bytes(total / 2), Nanos::from_s(10));
        let path =
            PathConfig { capacity: Capacity::Constant(rate), delay: Nanos::ZERO, ..PathConfig::default() };
        let bound = upper_bound(&graph, &path, Nanos::ZERO, 3000);
        assert!(bound.utility <= most + 1e-3 && bound.utility > most - 0.1, "{bound:?} {most}");
        assert!((bound.utility - bound.estimate).abs() < 1e-3, "{bound:?}");
    }

    /// With everything there, what groups of negative utility take away is not to be had back: packets carry
    /// them beside others, and what stands on them needs them.
    #[test]
    fn what_comes_with_the_rest_and_harms_counts_against_it() {
        let sound = bottleneck().build(1).unwrap();
        let mut parts =
            Synthetic { profile: ClosureRule::Sliced, ..bottleneck() }.build(1).unwrap().parts().clone();
        let bound = |graph: &PacketGraph| {
            let path = PathConfig { capacity: Capacity::Unlimited, ..PathConfig::default() };
            upper_bound(graph, &path, Nanos::from_s(1), 300).utility
        };
        // Level 2 harms, and level 3 makes up for it.
        parts
            .groups
            .iter_mut()
            .for_each(|group| group.utility = [1.0, 0.5, -0.2, 0.3][usize::from(group.level())]);
        let harmed = PacketGraph::new(parts).unwrap();
        assert!(bound(&sound) > 0.999, "{}", bound(&sound));
        assert!((bound(&harmed) - 1.6 / 1.8).abs() < 0.03, "{}", bound(&harmed));
        let trace = Trace::bursty(5, Nanos::from_s(20)).scaled(1, 8).unwrap();
        let path = PathConfig { capacity: Capacity::Trace(trace), ..PathConfig::default() };
        let most = upper_bound(&harmed, &path, Nanos::from_s(1), 800).utility;
        for policy in PolicyKind::ALL {
            let config = SessionConfig { policy, ..after_a_second(path.clone()) };
            let utility = simulate(&harmed, &config).unwrap().utility;
            assert!(utility <= most, "{}: {utility} {most}", policy.name());
        }
    }

    /// Steps of a millisecond in which less than two bytes move: the bound is that of a constant rate.
    #[test]
    fn fine_steps_of_a_trace_are_no_less_than_they_carry() {
        let graph = Synthetic { rate: Rate::from_kbps(40), ..bottleneck() }.build(1).unwrap();
        let rate = Rate(15_900);
        let steps = (0..20_000).map(|at| Step { at: Nanos::from_ms(at), rate }).collect();
        let trace = Trace::steps("fine", steps, Nanos::from_s(20)).unwrap();
        let path = |capacity| PathConfig { capacity, ..PathConfig::default() };
        let bound = |capacity| upper_bound(&graph, &path(capacity), Nanos::from_s(1), 400).utility;
        let fine = bound(Capacity::Trace(trace.clone()));
        assert_eq!(fine, bound(Capacity::Constant(rate)));
        let config = after_a_second(path(Capacity::Trace(trace)));
        let utility = simulate(&graph, &config).unwrap().utility;
        assert!(utility <= fine, "{utility} {fine}");
    }

    #[test]
    fn a_dead_link_shows_nothing_and_an_ample_one_everything() {
        let graph = bottleneck().build(1).unwrap();
        let bound = |capacity| {
            let path = PathConfig { capacity, ..PathConfig::default() };
            upper_bound(&graph, &path, Nanos::from_s(1), 1000).utility
        };
        let (dead, ample) = (bound(Capacity::Constant(Rate(0))), bound(Capacity::Unlimited));
        assert!(dead < 0.02 && ample > 0.999, "{dead} {ample}");
    }
}
