//! Bounds from above what any schedule could show over the same channel.
//!
//! The question is a linear program. Frames are taken in slots of three, and also one by one where that
//! makes no large program; y(i, s) in 0..=1 says how much of piece i is there by slot s:
//!
//! - maximise Σ v(i, s) y(i, s);
//! - y(i, s) ≤ y(j, s) where i needs j; y(i, s) ≤ y(i, s + 1);
//! - Σ_i b(i) y(i, min(s, last slot of i)) ≤ C(s), over the pieces needed by slot s: what the link carries
//!   until the last frame of slot s, less the manifest; or, of one run, what had arrived by then.
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

use self::linear_program::{DATAGRAM_OVERHEAD, LinearProgram};
use crate::{clock::Nanos, graph::PacketGraph, link::PathConfig, report::Report};

pub use self::linear_program::UpperBound;

/// Frames per slot.
const COARSE_SLOT: u32 = 3;
/// Most variables of a program with a slot for every frame: beyond it slots save more time than they cost
/// in tightness.
const MAX_FINE: usize = 1 << 15;
/// Largest program of [`UpperBound::in_bounded_time`], as [`linear_program::size`] counts: about a second of
/// one core.
const MAX_SIZE: usize = 400_000;
/// Steps of the solver there.
const STEPS: u32 = 300;
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
    solve(graph, &link_bytes(graph, path, start), steps)
}

impl UpperBound {
    /// The bound that [`upper_bound`] gives after 300 steps, of graphs of any size: where slots of three
    /// frames make too large a program, slots are longer, and where the longest do, steps are fewer. Either
    /// makes the bound looser, and it holds. The solver takes about a second of one core and some fifty
    /// megabytes at most.
    pub fn in_bounded_time(graph: &PacketGraph, path: &PathConfig, start: Nanos) -> Self {
        bounded(graph, &link_bytes(graph, path, start), MAX_SIZE, STEPS)
    }

    /// The bound for `graph` of the bytes that arrived in the run that `report` tells of, whatever packets
    /// they had been: each frame shows at most what its share of [`Report::arrived_bytes`] can hold. After
    /// `steps` of the solver, over any transport. The distance to the run is what the order of packets cost
    /// it; the distance from [`upper_bound`] to here, that less arrived than the link could carry.
    ///
    /// Parity counts as bytes, so packets that it recovered are paid for: it is no shorter than any of them
    /// (`codec-core/SPEC.md`, "Repair").
    ///
    /// # Examples
    /// ```
    /// use emulator_host::{SessionConfig, bound::UpperBound, graph::Synthetic, simulate};
    ///
    /// let graph = Synthetic { frames: 60, ..Synthetic::default() }.build(1)?;
    /// let report = simulate(&graph, &SessionConfig::default())?;
    /// assert!(report.utility <= UpperBound::of_arrivals(&graph, &report, 300).utility);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn of_arrivals(graph: &PacketGraph, report: &Report, steps: u32) -> Self {
        let all = report.arrived_bytes.last().copied().unwrap_or(0);
        // Frames that were never shown show nothing in the run: any capacity bounds that.
        let arrived = |frame: u32| report.arrived_bytes.get(frame as usize).copied().unwrap_or(all) as f64;
        solve(graph, &arrived, steps)
    }
}

/// Bytes of media that can be there when a frame is shown, headers included: what `path` carries until then,
/// less the manifest.
fn link_bytes(graph: &PacketGraph, path: &PathConfig, start: Nanos) -> impl Fn(u32) -> f64 {
    let manifest = u64::from(graph.manifest_bytes());
    let control = manifest + manifest.div_ceil(CHUNK_BYTES) * DATAGRAM_OVERHEAD;
    let (interval, delay) = (graph.frame_interval(), path.least_delay());
    move |frame: u32| {
        let shown = start + interval.times(u64::from(frame));
        // What is shown must have left the link one delay earlier.
        path.bytes_until(shown - delay).0.saturating_sub(control) as f64
    }
}

/// The bound of the programs with coarse and, where it is not large, with fine slots.
fn solve(graph: &PacketGraph, capacity: &dyn Fn(u32) -> f64, steps: u32) -> UpperBound {
    let division = graph.division();
    let coarse = LinearProgram::new(graph, &division, COARSE_SLOT, capacity).solve(steps);
    if linear_program::variables(graph, &division.pieces, 1) > MAX_FINE {
        return coarse;
    }
    // Tighter, but slower to solve: after few steps the coarse one may be ahead.
    let fine = LinearProgram::new(graph, &division, 1, capacity).solve(steps);
    if fine.utility < coarse.utility { fine } else { coarse }
}

/// As [`solve`], with slots so long that the program is no larger than `max_size`; where it is larger with
/// one slot for the whole clip, with so many steps fewer.
fn bounded(graph: &PacketGraph, capacity: &dyn Fn(u32) -> f64, max_size: usize, steps: u32) -> UpperBound {
    let division = graph.division();
    let size = |slot_frames| linear_program::size(graph, &division.pieces, slot_frames);
    if size(COARSE_SLOT) <= max_size {
        return solve(graph, capacity, steps);
    }
    let mut slot_frames = COARSE_SLOT;
    while slot_frames < graph.frames() && size(slot_frames) > max_size {
        slot_frames = slot_frames.saturating_mul(2);
    }
    let share = (max_size as f64 / size(slot_frames) as f64).min(1.0);
    let steps = (f64::from(steps) * share) as u32;
    LinearProgram::new(graph, &division, slot_frames, capacity).solve(steps)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        PolicyKind, SessionConfig, Trace,
        clock::{Bytes, Rate},
        graph::{ClosureRule, Synthetic},
        link::{Capacity, LossModel},
        session::{Startup, StartupRule},
        simulate,
        trace::{DelayTrace, Limits, Step},
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

    /// One cluster and one level: with half of the bytes, what shows most is a fractional knapsack of groups.
    fn knapsack() -> PacketGraph {
        let spec = Synthetic {
            frames: 300,
            clusters: 1,
            levels: 1,
            canonical_percent: 0,
            manifest_bytes: 0,
            utilities: crate::graph::Utilities::Flat,
            ..Synthetic::default()
        };
        Synthetic { rate: Rate::from_kbps(8), ..spec }.build(1).unwrap()
    }

    /// Bytes of all groups of the knapsack, and the utility of the best half.
    fn best_half(graph: &PacketGraph) -> (u64, f64) {
        let bytes = |packet: &crate::PacketIndex| u64::from(graph.packets()[packet.at()].wire_bytes) + 58;
        let sizes = graph.groups().iter().map(|group| group.packets.iter().map(bytes).sum::<u64>());
        let frames = graph.groups().iter().map(|group| f64::from(group.last_frame - group.first_frame + 1));
        // Each frame shows two groups, that of its window and the canonical one, so each counts for half.
        let mut items: Vec<(u64, f64)> = sizes.zip(frames.map(|frames| frames / 600.0)).collect();
        items.sort_by(|one, other| (one.0 as f64 / one.1).total_cmp(&(other.0 as f64 / other.1)));
        let total: u64 = items.iter().map(|(bytes, _)| bytes).sum();
        let (mut left, mut most) = ((total / 2) as f64, 0.0);
        for (bytes, gain) in items {
            let part = (left / bytes as f64).min(1.0);
            left -= part * bytes as f64;
            most += part * gain;
        }
        (total, most)
    }

    /// The knapsack over a link that carries half of the bytes cannot be passed, and the solver's own
    /// schedule meets its bound.
    #[test]
    fn it_is_tight_where_the_optimum_is_known() {
        let graph = knapsack();
        let (total, most) = best_half(&graph);
        let rate = Rate::over(Bytes(total / 2), Nanos::from_s(10));
        let path =
            PathConfig { capacity: Capacity::Constant(rate), delay: Nanos::ZERO, ..PathConfig::default() };
        let bound = upper_bound(&graph, &path, Nanos::ZERO, 3000);
        assert!(bound.utility <= most + 1e-3 && bound.utility > most - 0.1, "{bound:?} {most}");
        assert!((bound.utility - bound.estimate).abs() < 1e-3, "{bound:?}");
    }

    /// The whole of it arrives before the first frame: the knapsack of above is the optimum.
    #[test]
    fn of_bytes_that_arrived_it_is_what_the_best_packets_show() {
        let graph = knapsack();
        let (total, most) = best_half(&graph);
        let mut report = simulate(&graph, &SessionConfig::default()).unwrap();
        report.arrived_bytes = vec![total / 2; 300];
        let bound = UpperBound::of_arrivals(&graph, &report, 3000);
        assert!(bound.utility > most - 1e-9 && bound.utility < most + 5e-3, "{bound:?} {most}");
        // No bytes show nothing.
        report.arrived_bytes = vec![0; 300];
        assert!(UpperBound::of_arrivals(&graph, &report, 1000).utility < 0.02);
    }

    #[test]
    fn of_bytes_that_arrived_it_lies_between_the_run_and_the_link() {
        let start = Nanos::from_s(1);
        for (profile, repair) in [(ClosureRule::AllOrNothing, None), (ClosureRule::Sliced, Some(4))] {
            let graph = Synthetic { profile, repair, ..bottleneck() }.build(2).unwrap();
            let trace = Trace::bursty(2, Nanos::from_s(20)).scaled(1, 10).unwrap();
            let loss = LossModel::Iid(0.05);
            let path = PathConfig { capacity: Capacity::Trace(trace), loss, ..PathConfig::default() };
            let link = upper_bound(&graph, &path, start, 400).utility;
            let could = link_bytes(&graph, &path, start);
            for policy in PolicyKind::ALL {
                let report =
                    simulate(&graph, &SessionConfig { policy, ..after_a_second(path.clone()) }).unwrap();
                assert_eq!(report.arrived_bytes.len(), report.frames.len());
                for (frame, bytes) in (0..).zip(&report.arrived_bytes) {
                    assert!(*bytes as f64 <= could(frame), "{}: {bytes} by frame {frame}", policy.name());
                }
                let arrived = UpperBound::of_arrivals(&graph, &report, 400).utility;
                let utility = report.utility;
                assert!(utility <= arrived, "{}: {utility} {arrived}", policy.name());
                assert!(arrived <= link + 1e-2, "{}: {arrived} {link}", policy.name());
            }
        }
    }

    /// Only the least delay of a trace is certain to pass.
    #[test]
    fn a_trace_of_delays_bounds_as_its_least_does() {
        let graph = bottleneck().build(1).unwrap();
        let delays = DelayTrace::load(
            b"900
700
1200
",
            Nanos::from_ms(400),
            &Limits::default(),
        )
        .unwrap();
        let trace = Trace::bursty(4, Nanos::from_s(20)).scaled(1, 10).unwrap();
        let plain = PathConfig { capacity: Capacity::Trace(trace), ..PathConfig::default() };
        let delayed = PathConfig { delay_trace: Some(delays), ..plain.clone() };
        let bound = |path: &PathConfig| upper_bound(&graph, path, Nanos::from_s(1), 400).utility;
        let least = PathConfig { delay: plain.delay + Nanos::from_ms(700), ..plain.clone() };
        let (most, undelayed) = (bound(&delayed), bound(&plain));
        assert_eq!(most, bound(&least));
        assert!(most < undelayed, "{most} {undelayed}");
        for policy in PolicyKind::ALL {
            let config = SessionConfig { policy, ..after_a_second(delayed.clone()) };
            let utility = simulate(&graph, &config).unwrap().utility;
            assert!(utility <= most, "{}: {utility} {most}", policy.name());
        }
    }

    /// Small graphs are bounded as ever; programs that would be too large get longer slots, then fewer steps.
    #[test]
    fn it_holds_in_bounded_time_for_graphs_of_any_size() {
        let graph = bottleneck().build(1).unwrap();
        let trace = Trace::bursty(3, Nanos::from_s(20)).scaled(1, 10).unwrap();
        let path = PathConfig { capacity: Capacity::Trace(trace), ..PathConfig::default() };
        let start = Nanos::from_s(1);
        let tight = upper_bound(&graph, &path, start, STEPS);
        assert_eq!(UpperBound::in_bounded_time(&graph, &path, start), tight);
        let pieces = graph.division();
        let sizes = [3, 6, 192].map(|slot| linear_program::size(&graph, &pieces.pieces, slot));
        assert!(sizes[1] < sizes[0] && sizes[2] < sizes[1], "{sizes:?}");
        let utilities = PolicyKind::ALL.map(|policy| {
            simulate(&graph, &SessionConfig { policy, ..after_a_second(path.clone()) }).unwrap().utility
        });
        for max_size in [sizes[1], sizes[2], sizes[2] / 3, 1] {
            let bound = bounded(&graph, &link_bytes(&graph, &path, start), max_size, STEPS).utility;
            let shown = utilities.iter().copied().fold(0.0, f64::max);
            assert!(shown <= bound && bound <= 1.0 + 1e-6, "{max_size}: {shown} {bound}");
            assert!(max_size != sizes[1] || bound < 1.0 - 1e-3, "longer slots still bound: {bound}");
        }
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
