//! Solves the linear program of the bound by the primal-dual hybrid gradient method.
//!
//! Steps are diagonal (one over the sums of rows and columns), iterates are averaged, and every so often the
//! method starts again from the better of the current and the mean multipliers. A step is linear in the size
//! of the program.

use std::ops::Range;

use crate::graph::{
    PacketGraph,
    pieces::{Contribution, Division, FrameSums, Pieces},
};

/// Bytes that the link spends on every datagram beside the packet.
pub(super) const DATAGRAM_OVERHEAD: u64 =
    crate::session::QUIC_OVERHEAD_BYTES as u64 + crate::session::IP_UDP_BYTES as u64;
/// Steps between two evaluations of the bound.
const ROUND: u32 = 50;

/// What bounds every schedule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpperBound {
    /// No run has a larger [`crate::Report::utility`].
    pub utility: f64,
    /// What the solver's own schedule, in fractions of pieces, shows: the optimum lies between, up to the
    /// little by which that schedule breaks its limits.
    pub estimate: f64,
}

/// Variables of one piece: one per slot from `first` on.
#[derive(Clone, Copy, Debug)]
struct Span {
    /// Index of the first variable.
    at: usize,
    first: usize,
    slots: usize,
    /// Bytes, in units of the largest piece.
    bytes: f64,
}

/// y(above + k) ≤ y(below + k) for k below `slots`.
#[derive(Clone, Copy, Debug)]
struct Need {
    above: usize,
    below: usize,
    slots: usize,
    /// Index of the first multiplier.
    at: usize,
}

/// The program.
#[derive(Debug)]
pub(super) struct LinearProgram {
    spans: Vec<Span>,
    needs: Vec<Need>,
    need_count: usize,
    /// Values of all variables, frames.
    value: Vec<f64>,
    capacity: Vec<f64>,
    frames: f64,
    /// Frames of no positive utility count as shown whatever arrives.
    given: f64,
}

/// Multipliers: of capacity, of needs, of order in time.
#[derive(Clone, Debug)]
struct Multipliers {
    capacity: Vec<f64>,
    needs: Vec<f64>,
    order: Vec<f64>,
}

impl Multipliers {
    fn zero(program: &LinearProgram) -> Self {
        Self {
            capacity: vec![0.0; program.capacity.len()],
            needs: vec![0.0; program.need_count],
            order: vec![0.0; program.value.len()],
        }
    }

    fn all(&mut self) -> [&mut Vec<f64>; 3] {
        [&mut self.capacity, &mut self.needs, &mut self.order]
    }

    /// Root of the summed squares of the differences.
    fn distance(&self, other: &Self) -> f64 {
        let parts = [
            distance(&self.capacity, &other.capacity),
            distance(&self.needs, &other.needs),
            distance(&self.order, &other.order),
        ];
        parts.iter().map(|part| part * part).sum::<f64>().sqrt()
    }

    /// Adds `weight` × `other`.
    fn add(&mut self, other: &mut Self, weight: f64) {
        for (sum, part) in self.all().into_iter().zip(other.all()) {
            sum.iter_mut().zip(part.iter()).for_each(|(sum, part)| *sum += weight * part);
        }
    }
}

impl LinearProgram {
    /// Frames of `graph`, which `division` divides, in slots of `slot_frames`. `capacity`: bytes that can be
    /// there when a frame is shown.
    pub(super) fn new(
        graph: &PacketGraph,
        division: &Division,
        slot_frames: u32,
        capacity: &dyn Fn(u32) -> f64,
    ) -> Self {
        let Division { pieces, sums, .. } = division;
        let slots = graph.frames().div_ceil(slot_frames);
        let mut capacity: Vec<f64> = (1..=slots)
            .map(|slot| capacity(slot.saturating_mul(slot_frames).min(graph.frames()) - 1))
            .collect();
        let of_frame = |frame: u32| (frame / slot_frames) as usize;
        let (mut spans, mut value) = (vec![None; pieces.len()], Vec::new());
        for (piece, span) in spans.iter_mut().enumerate() {
            if pieces.needed_from(piece) >= graph.frames() {
                continue;
            }
            let first = of_frame(pieces.needed_from(piece));
            let slots = of_frame(pieces.useful_until(piece)) + 1 - first;
            let bytes: u64 = pieces
                .packets(piece)
                .map(|packet| u64::from(graph.packets()[packet.at()].wire_bytes) + DATAGRAM_OVERHEAD)
                .sum();
            let at = value.len();
            *span = Some(Span { at, first, slots, bytes: bytes as f64 });
            value.resize(at + slots, 0.0);
            for slot in 0..slots {
                let start = (first + slot) as u32 * slot_frames;
                let frames = start..start.saturating_add(slot_frames).min(graph.frames());
                let (gains, losses) = net_gains(pieces, sums, piece, frames);
                value[at + slot] += gains;
                if slot > 0 {
                    // Whoever has it by the end of the slot before has it in the whole of this one.
                    value[at + slot - 1] += losses;
                }
            }
        }
        let (mut needs, mut need_count) = (Vec::new(), 0);
        for (piece, span) in spans.iter().enumerate() {
            let Some(span) = span else { continue };
            for need in pieces.needs(piece) {
                // What something of value needs has a value itself, so the span is there.
                let Some(below) = &spans[*need as usize] else { continue };
                let below = below.at + span.first - below.first;
                needs.push(Need { above: span.at, below, slots: span.slots, at: need_count });
                need_count += span.slots;
            }
        }
        let mut spans: Vec<Span> = spans.into_iter().flatten().collect();
        let largest = spans.iter().map(|span| span.bytes).fold(1.0, f64::max);
        spans.iter_mut().for_each(|span| span.bytes /= largest);
        capacity.iter_mut().for_each(|bytes| *bytes /= largest);
        let (frames, given) = (f64::from(graph.frames()), sums.frames_without_utility() as f64);
        Self { spans, needs, need_count, value, capacity, frames, given }
    }

    /// Solves.
    pub(super) fn solve(&self, steps: u32) -> UpperBound {
        let mean_value = self.value.iter().sum::<f64>() / self.value.len().max(1) as f64;
        // How large multipliers are beside the variables: a guess, and from then on what was seen.
        let mut balance = (10.0 * mean_value).max(1e-9);
        let (columns, rows) = self.step_sizes();
        let mut y = vec![0.0; self.value.len()];
        let mut multipliers = Multipliers::zero(self);
        let mut mean = Multipliers::zero(self);
        let mut mean_y = y.clone();
        let (mut best, mut shown) = (self.bound(&multipliers), 0.0);
        let mut reduced = vec![0.0; y.len()];
        let mut start = (multipliers.clone(), y.clone());
        for step in 1..=steps {
            self.reduce(&multipliers, &mut reduced);
            let ahead: Vec<f64> = (0..y.len())
                .map(|at| {
                    let next = (y[at] + columns[at] / balance * reduced[at]).clamp(0.0, 1.0);
                    let ahead = 2.0 * next - y[at];
                    y[at] = next;
                    ahead
                })
                .collect();
            self.ascend(&ahead, &rows, balance, &mut multipliers);
            mean.add(&mut multipliers, 1.0);
            mean_y.iter_mut().zip(&y).for_each(|(sum, y)| *sum += y);
            if step % ROUND == 0 || step == steps {
                let weight = 1.0 / f64::from(if step % ROUND == 0 { ROUND } else { step % ROUND });
                mean.all().into_iter().flatten().for_each(|value| *value *= weight);
                mean_y.iter_mut().for_each(|value| *value *= weight);
                let (current, averaged) = (self.bound(&multipliers), self.bound(&mean));
                shown = self.value.iter().zip(&mean_y).map(|(value, y)| value * y).sum();
                if averaged < current {
                    multipliers = mean;
                    y = mean_y;
                }
                best = best.min(current).min(averaged);
                let moved = multipliers.distance(&start.0) / distance(&y, &start.1).max(1e-12);
                if moved.is_finite() && moved > 0.0 {
                    balance = (balance * moved.clamp(0.01 * balance, 100.0 * balance)).sqrt();
                }
                start = (multipliers.clone(), y.clone());
                mean = Multipliers::zero(self);
                mean_y = vec![0.0; y.len()];
            }
        }
        let share = |gain: f64| (self.given + gain) / self.frames;
        UpperBound { utility: share(best), estimate: share(shown) }
    }

    /// Σ multiplier × capacity + Σ max(0, reduced value): at least the optimum, whatever the multipliers.
    fn bound(&self, multipliers: &Multipliers) -> f64 {
        let mut reduced = vec![0.0; self.value.len()];
        self.reduce(multipliers, &mut reduced);
        let paid: f64 = self.capacity.iter().zip(&multipliers.capacity).map(|(c, m)| c * m).sum();
        paid + reduced.iter().map(|value| value.max(0.0)).sum::<f64>()
    }

    /// Values less what the constraints charge.
    fn reduce(&self, multipliers: &Multipliers, reduced: &mut [f64]) {
        reduced.copy_from_slice(&self.value);
        let slots = self.capacity.len();
        // Σ of the capacity multipliers from a slot to the end: a piece stays sent after its last slot.
        let mut rest = vec![0.0; slots + 1];
        for slot in (0..slots).rev() {
            rest[slot] = rest[slot + 1] + multipliers.capacity[slot];
        }
        for span in &self.spans {
            let last = span.slots - 1;
            for k in 0..last {
                reduced[span.at + k] -= span.bytes * multipliers.capacity[span.first + k];
                let order = multipliers.order[span.at + k];
                reduced[span.at + k] -= order;
                reduced[span.at + k + 1] += order;
            }
            reduced[span.at + last] -= span.bytes * rest[span.first + last];
        }
        for need in &self.needs {
            for k in 0..need.slots {
                let charge = multipliers.needs[need.at + k];
                reduced[need.above + k] -= charge;
                reduced[need.below + k] += charge;
            }
        }
    }

    /// Raises the multipliers of what `y` breaks.
    fn ascend(&self, y: &[f64], rows: &Multipliers, balance: f64, multipliers: &mut Multipliers) {
        // Bytes sent by each slot: changes, then their running sum.
        let mut change = vec![0.0; self.capacity.len() + 1];
        for span in &self.spans {
            let mut before = 0.0;
            for k in 0..span.slots {
                change[span.first + k] += span.bytes * (y[span.at + k] - before);
                before = y[span.at + k];
            }
            for k in 0..span.slots - 1 {
                let at = span.at + k;
                let broken = y[at] - y[at + 1];
                multipliers.order[at] = (multipliers.order[at] + balance * rows.order[at] * broken).max(0.0);
            }
        }
        let mut sent = 0.0;
        for (slot, capacity) in self.capacity.iter().enumerate() {
            sent += change[slot];
            let multiplier = &mut multipliers.capacity[slot];
            *multiplier = (*multiplier + balance * rows.capacity[slot] * (sent - capacity)).max(0.0);
        }
        for need in &self.needs {
            for k in 0..need.slots {
                let broken = y[need.above + k] - y[need.below + k];
                let multiplier = &mut multipliers.needs[need.at + k];
                *multiplier = (*multiplier + balance * rows.needs[need.at + k] * broken).max(0.0);
            }
        }
    }

    /// One over the sum of each column and of each row.
    fn step_sizes(&self) -> (Vec<f64>, Multipliers) {
        let slots = self.capacity.len();
        let mut columns = vec![0.0; self.value.len()];
        let mut capacity = vec![0.0; slots];
        for span in &self.spans {
            for k in 0..span.slots {
                let last = k + 1 == span.slots;
                let used = if last { slots - span.first - k } else { 1 };
                columns[span.at + k] += span.bytes * used as f64 + if last { 1.0 } else { 2.0 };
            }
            (span.first..slots).for_each(|slot| capacity[slot] += span.bytes);
        }
        for need in &self.needs {
            for k in 0..need.slots {
                columns[need.above + k] += 1.0;
                columns[need.below + k] += 1.0;
            }
        }
        let columns = columns.into_iter().map(|sum| 1.0 / f64::max(sum, 1e-9)).collect();
        let rows = Multipliers {
            capacity: capacity.into_iter().map(|sum: f64| 1.0 / sum.max(1e-9)).collect(),
            needs: vec![0.5; self.need_count],
            order: vec![0.5; self.value.len()],
        };
        (columns, rows)
    }
}

fn distance(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

/// Variables of a program with slots of `slot_frames`.
pub(super) fn variables(graph: &PacketGraph, pieces: &Pieces, slot_frames: u32) -> usize {
    spans(graph, pieces, slot_frames).map(|(_, slots)| slots).sum()
}

/// Variables and multipliers of needs of a program with slots of `slot_frames`: time and memory of a step
/// grow with them.
pub(super) fn size(graph: &PacketGraph, pieces: &Pieces, slot_frames: u32) -> usize {
    spans(graph, pieces, slot_frames).map(|(piece, slots)| slots * (1 + pieces.needs(piece).len())).sum()
}

/// Pieces that something needs, and in how many slots.
fn spans(graph: &PacketGraph, pieces: &Pieces, slot_frames: u32) -> impl Iterator<Item = (usize, usize)> {
    let needed = (0..pieces.len()).filter(move |piece| pieces.needed_from(*piece) < graph.frames());
    needed.map(move |piece| {
        let [first, last] = [pieces.needed_from(piece), pieces.useful_until(piece)].map(|f| f / slot_frames);
        (piece, (last + 1 - first) as usize)
    })
}

/// What `piece` adds to those of `frames` to which it brings more than it takes from them, and what it takes
/// from the others.
fn net_gains(pieces: &Pieces, sums: &FrameSums, piece: usize, frames: Range<u32>) -> (f64, f64) {
    let parts = || pieces.parts(piece).iter().chain(pieces.negative_contributions(piece));
    let (mut gains, mut losses) = (0.0, 0.0);
    let mut from = frames.start;
    while from < frames.end {
        // Until a part begins or has ended, the piece adds to every frame or takes from every frame.
        let ends = parts().flat_map(|part| [part.first, part.last + 1]).filter(|end| *end > from);
        let until = ends.fold(frames.end, u32::min);
        let shown = parts().filter(|part| (part.first..=part.last).contains(&from));
        let net: f64 = shown.map(|part| sums.gain(&Contribution { last: until - 1, ..*part }, from).0).sum();
        if net > 0.0 {
            gains += net;
        } else {
            losses += net;
        }
        from = until;
    }
    (gains, losses)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::{ClosureRule, Synthetic};

    /// Frame by frame, which is slow and obvious.
    #[test]
    fn gains_of_spans_are_those_of_their_frames() {
        let spec =
            Synthetic { frames: 90, clusters: 4, profile: ClosureRule::Sliced, ..Synthetic::default() };
        let mut parts = spec.build(2).unwrap().parts().clone();
        for (at, group) in parts.groups.iter_mut().enumerate() {
            group.utility = [1.0, 0.4, -0.3, 0.2][at % 4];
        }
        let graph = PacketGraph::new(parts).unwrap();
        let division = graph.division();
        let Division { pieces, sums, .. } = &*division;
        for slot_frames in [1, 3, 7, 24, 90] {
            for piece in 0..pieces.len() {
                for start in (0..90).step_by(slot_frames) {
                    let frames = start..(start + slot_frames as u32).min(90);
                    let (mut gains, mut losses) = (0.0, 0.0);
                    for frame in frames.clone() {
                        let net = net_gains(pieces, sums, piece, frame..frame + 1);
                        gains += net.0;
                        losses += net.1;
                    }
                    let found = net_gains(pieces, sums, piece, frames);
                    assert!(
                        (found.0 - gains).abs() < 1e-9 && (found.1 - losses).abs() < 1e-9,
                        "{piece} {start}"
                    );
                }
            }
        }
    }
}
