//! Chooses the few tables that serve the runs of a stream best, code words and table bytes counted.
//!
//! Greedy: from the best single table, add the one that saves most, until it saves less than it
//! costs. Candidates are the family and one table of the stream's own frequencies.

use codec_core::internals::{limits::MAX_TABLE_SET, rans::family};

use super::histogram::{Costs, Histogram};
use crate::encode::EncodeError;

/// One table of a table set with the length of its code word.
#[derive(Clone, Debug)]
pub(super) struct Choice {
    pub costs: Costs,
    pub length: u8,
}

/// A run's distinct values and how often each occurs.
type Sparse = Vec<(i16, f32)>;

/// A table set must save this many bits by a further table: its bytes in the manifest, twice over,
/// for the memory of receivers.
const MIN_SAVED_BITS: f64 = 64.0;
/// … and this share of the stream.
const MIN_SAVED_SHARE: f64 = 4e-4;

/// Bits by which a table outside the family must beat those inside.
const OWN_BITS: f64 = 1000.0;

/// The table set for `runs`, code lengths ascending; empty for no runs.
pub(super) fn choose(runs: &[&[i16]], named: &[Costs], most: usize) -> Result<Vec<Choice>, EncodeError> {
    if runs.is_empty() {
        return Ok(Vec::new());
    }
    let own = Costs::of(&Histogram::of(runs).best_table()?);
    let sparse: Vec<Sparse> = runs.iter().map(|run| self::sparse(run)).collect();
    let candidates: Vec<&Costs> = named.iter().chain([&own]).collect();
    // Per candidate, the cost of every run.
    let costs: Vec<Vec<f32>> =
        candidates.iter().map(|c| sparse.iter().map(|run| cost(c, run)).collect()).collect();
    // A table of its own must earn the memory that receivers keep it in; those of the family are
    // likely there for other streams.
    let wire_bits = |c: usize| {
        let own = if c == named.len() { OWN_BITS } else { 0.0 };
        own + 8.0 * candidates[c].table.wire_len() as f64
    };
    let total = |c: usize| costs[c].iter().map(|&b| f64::from(b)).sum::<f64>() + wire_bits(c);
    let Some(first) = (0..candidates.len()).min_by(|&a, &b| total(a).total_cmp(&total(b))) else {
        return Ok(Vec::new());
    };
    let mut set = vec![(first, 0u8)];
    let mut bits = total(first);
    while set.len() < most.min(MAX_TABLE_SET) {
        let current: Vec<f32> = (0..runs.len())
            .map(|r| set.iter().map(|&(c, l)| costs[c][r] + f32::from(l.max(1))).fold(f32::MAX, f32::min))
            .collect();
        let saves = |c: usize| -> f64 {
            let length = (set.len() as f32 + 1.0).log2();
            let each = costs[c].iter().zip(&current).map(|(&b, &now)| f64::from((now - b - length).max(0.0)));
            each.sum::<f64>() - wire_bits(c)
        };
        let unused = (0..candidates.len()).filter(|c| set.iter().all(|(used, _)| used != c));
        let Some((next, _)) =
            unused.map(|c| (c, saves(c))).reduce(|a, b| if b.1 > a.1 { b } else { a }).filter(|n| n.1 > 0.0)
        else {
            break;
        };
        let mut wider: Vec<usize> = set.iter().map(|(c, _)| *c).collect();
        wider.push(next);
        let (wider, wider_bits) = assign(&wider, &costs);
        let wider_bits = wider_bits + wider.iter().map(|&(c, _)| wire_bits(c)).sum::<f64>();
        if bits - wider_bits < MIN_SAVED_BITS + MIN_SAVED_SHARE * bits {
            break;
        }
        (set, bits) = (wider, wider_bits);
    }
    Ok(set.into_iter().map(|(c, length)| Choice { costs: candidates[c].clone(), length }).collect())
}

fn sparse(run: &[i16]) -> Sparse {
    let mut sorted = run.to_vec();
    sorted.sort_unstable();
    sorted.chunk_by(|a, b| a == b).map(|same| (same[0], same.len() as f32)).collect()
}

fn cost(costs: &Costs, run: &Sparse) -> f32 {
    run.iter().map(|&(value, count)| count * costs.bits(value)).sum()
}

/// Code lengths for `set` by how often each table is the cheapest, ascending, and the bits that all
/// runs then take. Two rounds: lengths move some runs to another table.
fn assign(set: &[usize], costs: &[Vec<f32>]) -> (Vec<(usize, u8)>, f64) {
    // One row per run, one column per table of the set.
    let columns: Vec<&[f32]> = set.iter().map(|&table| costs[table].as_slice()).collect();
    let runs = columns.first().map_or(0, |c| c.len());
    let rows: Vec<Vec<f32>> = (0..runs).map(|run| columns.iter().map(|c| c[run]).collect()).collect();
    let mut lengths = vec![(set.len() as f32).log2().ceil() as u8; set.len()];
    let mut bits = 0.0;
    for round in 0..3 {
        let mut uses = vec![0u64; set.len()];
        bits = 0.0;
        for row in &rows {
            let of = |i: usize| row[i] + f32::from(lengths[i]);
            let best = (0..set.len()).reduce(|a, b| if of(b) < of(a) { b } else { a }).unwrap_or(0);
            uses[best] += 1;
            bits += f64::from(of(best));
        }
        if round < 2 {
            lengths = huffman(&uses);
        }
    }
    let mut entries: Vec<(usize, u8)> = set.iter().copied().zip(lengths).collect();
    entries.sort_by_key(|&(table, length)| (length, table));
    (entries, bits)
}

/// Huffman code lengths for `uses`, at least two; with eight symbols none exceeds seven.
fn huffman(uses: &[u64]) -> Vec<u8> {
    let mut lengths = vec![0u8; uses.len()];
    let mut nodes: Vec<(u64, Vec<usize>)> = uses.iter().enumerate().map(|(i, &u)| (u, vec![i])).collect();
    while nodes.len() > 1 {
        // Rarest last; ties by the symbols they hold, so that equal input gives equal codes.
        nodes.sort_by(|a, b| b.0.cmp(&a.0).then_with(|| a.1.cmp(&b.1)));
        let (Some(a), Some(b)) = (nodes.pop(), nodes.pop()) else { break };
        let members: Vec<usize> = a.1.into_iter().chain(b.1).collect();
        members.iter().for_each(|&i| lengths[i] += 1);
        nodes.push((a.0 + b.0, members));
    }
    lengths
}

/// The family's indices and the stream's own table are all there is to choose from.
const _: () = assert!(family::SCALES as usize * 2 + (family::THREES as usize) < 255);

#[cfg(test)]
mod tests {
    use codec_core::internals::rans::table::Table;

    use super::*;

    #[test]
    fn huffman_codes_are_complete_and_short_for_what_is_frequent() {
        for uses in [vec![5, 5], vec![100, 1, 1], vec![1, 2, 4, 8, 16, 32, 64, 128], vec![0, 0, 0]] {
            let lengths = huffman(&uses);
            let sum: u32 = lengths.iter().map(|&l| 1 << (7 - l)).sum();
            assert_eq!(sum, 128, "{uses:?}: {lengths:?}");
        }
        assert_eq!(huffman(&[100, 1, 1]), [1, 2, 2]);
    }

    #[test]
    fn a_table_that_saves_nothing_is_not_added() {
        let named: Vec<Costs> = family::indices().map(|i| Costs::of(&Table::named(i).unwrap())).collect();
        let run: Vec<i16> = (0..64).map(|i| [0, 1, -1, 0, 0, 2, -2, 0][i % 8]).collect();
        let runs = vec![run.as_slice(); 500];
        assert_eq!(choose(&runs, &named, 8).unwrap().len(), 1);
        assert!(choose(&[], &named, 8).unwrap().is_empty());
    }
}
