//! Measures repair: what is still lost behind XOR and the Cauchy code at equal overhead, and how fast the
//! code runs beside its slow twin and public peers.

use anyhow::{Context, Result, ensure};
use codec_core::internals::{
    repair::{
        Combine, HEAD_BYTES, LENGTH_BYTES, MAX_CODED_BYTES, Sums, cauchy::coefficient, gf256, set_bytes,
    },
    wire::manifest::Repair,
};

use super::clock;
use crate::{
    figures::{Bench, Figure, median},
    setup::Setup,
};

/// (packets in a set, parity packets): equal overhead in each list.
const QUARTER: [(u8, u8); 4] = [(4, 1), (8, 2), (16, 4), (20, 5)];
const EIGHTH: [(u8, u8); 4] = [(8, 1), (16, 2), (32, 4), (64, 8)];
/// Bytes of a packet in the timings.
const PACKET_BYTES: usize = 1150;
/// Sets in the timings.
const SETS: usize = 32;
/// How long a round of one coder lasts, about.
const ROUND_SECONDS: f64 = 2e-3;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (trips, runs) = if setup.quick { (200, 3) } else { (5000, 9) };
    let mut bench = Bench::new(
        "repair",
        format!(
            "share of protected packets that are neither received nor repaired: IID by the formula; bursts \
                (Gilbert-Elliott, mean burst 5 \
             packets, all lost inside one) over {trips} ranges of 320 packets in id order, sets interleaved \
             as on the wire, each draw the same for \
             all; times of one set of {PACKET_BYTES}-byte packets in processor time of one thread, median of \
             {runs} interleaved runs, {SETS} sets in turn; MB of \
             protected packets per second; own coder: the fastest arithmetic of this machine, which gives \
             the bytes of the slow twin; senders have \
             all packets of a set at hand, receivers get one after the other; aims: encode 16+4 at least as \
             fast as reed-solomon-simd, recover \
             faster"
        ),
    );
    for (overhead, strengths) in [(25, QUARTER), (12, EIGHTH)] {
        for percent in [1u32, 5, 10, 20] {
            let loss = f64::from(percent) / 100.0;
            let iid = |(k, r): (u8, u8)| residual(loss, k.into(), r.into());
            let burst = |strength| bursts(loss, 5.0, strength, trips);
            for &(k, r) in &strengths[1..] {
                for (name, of) in [("iid", &iid as &dyn Fn((u8, u8)) -> f64), ("burst", &burst)] {
                    let (code, xor) = (100.0 * of((k, r)), 100.0 * of(strengths[0]));
                    let key = format!("residual.{name}.{percent}.overhead_{overhead}.{k}+{r}");
                    let peer = format!("XOR {}+1", strengths[0].0);
                    bench.push(Figure {
                        ratio: None,
                        ..Figure::new(key, code, "% of packets").peer(&peer, xor, true)
                    });
                }
            }
        }
    }
    for (k, r) in [(4, 1), (16, 4), (64, 8)] {
        speed(&mut bench, k, r, runs)?;
    }
    Ok(bench)
}

/// The share of a set's members that stays lost where each packet of set and parity is lost with
/// `loss`: a member is lost for good if it is lost and at least `parity` others are.
fn residual(loss: f64, members: u32, parity: u32) -> f64 {
    let others = members + parity - 1;
    let mut term = (1.0 - loss).powi(others as i32);
    let mut fewer = 0.0;
    for lost in 0..parity {
        fewer += term;
        term *= loss / (1.0 - loss) * f64::from(others - lost) / f64::from(lost + 1);
    }
    loss * (1.0 - fewer).max(0.0)
}

/// The same over `trips` ranges behind a channel that loses runs of `burst` packets on average.
fn bursts(loss: f64, burst: f64, (set_len, parity): (u8, u8), trips: u32) -> f64 {
    let range = Repair { packets: 320, first_parity: 320, set_len, parity, longest: 1, ..Repair::default() };
    let last = 320 + range.parity_packets() as u32;
    let (mut seed, mut bad) = (1u64, false);
    let mut lost_for_good = 0u64;
    let mut lost = vec![false; last as usize];
    for _ in 0..trips {
        for (id, lost) in lost.iter_mut().enumerate() {
            // The same draws for the same packet, however much parity follows the others.
            seed = if id == 0 { seed.wrapping_add(0x9e37_79b9_7f4a_7c15) } else { seed };
            let draw = draw(seed, id as u64);
            let leave = 1.0 / burst;
            let enter = leave * loss / (1.0 - loss);
            bad = if bad { draw >= leave } else { draw < enter };
            *lost = bad;
        }
        for set in 0..range.sets() {
            let members = (0..range.members(set)).filter(|&p| lost[range.member(set, p) as usize]).count();
            let rows = (0..u32::from(parity)).filter(|&i| !lost[range.parity_id(set, i) as usize]).count();
            lost_for_good += if members > rows { members as u64 } else { 0 };
        }
    }
    lost_for_good as f64 / f64::from(trips) / 320.0
}

/// A repeatable draw in 0..1.
fn draw(seed: u64, at: u64) -> f64 {
    let mut x = seed ^ at.wrapping_mul(0xd134_2543_de82_ef95);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

/// Sets of packets in turn, and what to do with them.
struct Case {
    k: usize,
    r: usize,
    combine: Combine,
    sets: Vec<Vec<Vec<u8>>>,
    parity: Vec<Vec<(u16, Vec<u8>)>>,
    memory: Vec<u8>,
    coded: Box<[u8; MAX_CODED_BYTES]>,
}

impl Case {
    fn new(k: usize, r: usize, combine: Combine) -> Result<Self> {
        let byte = |seed: usize, i: usize| (draw(seed as u64, i as u64) * 256.0) as u8;
        let packet = |s: usize, p: usize| (0..PACKET_BYTES).map(|i| byte(s * 99 + p, i)).collect::<Vec<u8>>();
        let sets = (0..SETS).map(|s| (0..k).map(|p| packet(s, p)).collect()).collect();
        let memory = vec![0u8; set_bytes(r, PACKET_BYTES)];
        let mut this =
            Self { k, r, combine, sets, parity: Vec::new(), memory, coded: Box::new([0; MAX_CODED_BYTES]) };
        for set in 0..this.sets.len() {
            this.encode(set);
            let sums = Sums::over(&mut this.memory, r, PACKET_BYTES).context("a set's memory")?;
            let rows = (0..r as u32).filter_map(|row| sums.parity(row, PACKET_BYTES));
            let rows = rows.map(|(length, content)| (length, content.to_vec())).collect();
            this.parity.push(rows);
        }
        Ok(this)
    }

    /// All rows of set `set`, in `memory`.
    fn encode(&mut self, set: usize) {
        self.memory.fill(0);
        if let Some(sums) = Sums::over(&mut self.memory, self.r, PACKET_BYTES) {
            sums.with_combine(self.combine).add_all(0, self.sets[set].iter().map(Vec::as_slice));
        }
    }

    /// The same rows by the definition of the product.
    fn encode_slowly(&mut self, set: usize) {
        self.memory.fill(0);
        let rows = self.memory[HEAD_BYTES..].chunks_exact_mut(LENGTH_BYTES + PACKET_BYTES);
        for (row, sum) in (0u32..).zip(rows) {
            let (head, tail) = sum.split_at_mut(LENGTH_BYTES);
            for (position, packet) in (0u32..).zip(&self.sets[set]) {
                // A place that the code has not makes every row wrong, which the bench counts.
                let Some(factor) = coefficient(row, position) else { return };
                gf256::slow::mul_add(head, &(packet.len() as u16).to_le_bytes(), factor);
                gf256::slow::mul_add(tail, packet, factor);
            }
        }
    }

    /// Bytes of all sets' rows that are not those of the definition.
    fn wrong(&mut self) -> usize {
        let mut wrong = 0;
        for set in 0..self.sets.len() {
            self.encode(set);
            let found = self.memory.clone();
            self.encode_slowly(set);
            wrong +=
                found[HEAD_BYTES..].iter().zip(&self.memory[HEAD_BYTES..]).filter(|(a, b)| a != b).count();
        }
        wrong
    }

    /// All of set `set` but its first `r` packets arrives, then its parity; returns how many bytes
    /// come back otherwise.
    fn recover(&mut self, set: usize) -> usize {
        self.memory.fill(0);
        let sums = Sums::over(&mut self.memory, self.r, PACKET_BYTES);
        let Some(mut sums) = sums.map(|sums| sums.with_combine(self.combine)) else { return usize::MAX };
        for (position, packet) in (0u32..).zip(&self.sets[set]).skip(self.r) {
            sums.add(position, packet);
        }
        for (row, (length, content)) in (0u32..).zip(&self.parity[set]) {
            sums.add_parity(row, *length, content);
        }
        let Some(solution) = sums.solution(self.k as u32) else { return usize::MAX };
        let mut wrong = 0;
        for (index, lost) in self.sets[set].iter().take(self.r).enumerate() {
            let found = sums.recover(&solution, index, &mut self.coded).unwrap_or(&[]);
            if lost != found {
                wrong +=
                    lost.len().abs_diff(found.len()) + lost.iter().zip(found).filter(|(a, b)| a != b).count();
            }
        }
        wrong
    }
}

/// A name, and what it does with a set: how many bytes come out wrong.
type Task<'t> = (String, Box<dyn FnMut(usize) -> Result<usize> + 't>);

fn speed(bench: &mut Bench, k: usize, r: usize, runs: usize) -> Result<()> {
    let sets = Case::new(k, r, codec_simd::combine())?.sets;
    let mut tasks: Vec<Task<'_>> = Vec::new();
    for (place, (name, combine)) in codec_simd::combines().into_iter().rev().enumerate() {
        let (mut sender, mut receiver) = (Case::new(k, r, combine)?, Case::new(k, r, combine)?);
        let wrong = sender.wrong();
        ensure!(wrong == 0, "{name}, {k}+{r}: {wrong} bytes of parity are wrong");
        let named = |word: &str| if place == 0 { word.to_owned() } else { format!("{name}, {word}") };
        let encode = move |set| {
            sender.encode(set);
            Ok(0)
        };
        tasks.push((named("encode"), Box::new(encode)));
        tasks.push((named("recover"), Box::new(move |set| Ok(receiver.recover(set)))));
    }
    let mut slow = Case::new(k, r, codec_simd::combine())?;
    let encode = move |set| {
        slow.encode_slowly(set);
        Ok(0)
    };
    tasks.push(("slow twin, encode".into(), Box::new(encode)));
    peers::add(&mut tasks, &sets, k, r)?;
    // Passes over all sets in a round: a first one, then as many as fill the time.
    let mut passes = vec![1.0; tasks.len()];
    let mut seconds = vec![Vec::new(); tasks.len()];
    for run in 0..=runs {
        for (((name, task), seconds), passes) in tasks.iter_mut().zip(&mut seconds).zip(&mut passes) {
            let start = clock::seconds();
            for _ in 0..*passes as usize {
                for set in 0..sets.len() {
                    let wrong = task(set)?;
                    ensure!(wrong == 0, "{name}, {k}+{r}: {wrong} bytes come back wrong");
                }
            }
            let each = (clock::seconds() - start) / *passes;
            if run == 0 {
                *passes = (ROUND_SECONDS / each.max(1e-6)).ceil().min(200.0);
            } else {
                seconds.push(each);
            }
        }
    }
    let bytes = (sets.len() * k * PACKET_BYTES) as f64;
    let rate = |of: &[f64]| bytes / median(of) / 1e6;
    let named: Vec<(&str, f64)> =
        tasks.iter().map(|t| t.0.as_str()).zip(seconds.iter().map(|s| rate(s))).collect();
    for (word, own) in [("encode", named[0].1), ("recover", named[1].1)] {
        for (name, other) in named.iter().filter(|(name, _)| name.ends_with(word)) {
            let mut figure = Figure::new(format!("{word}.{k}+{r}.vs {name}"), own, "MB/s")
                .error(0.0, "bytes differ")
                .runs(runs);
            if *name == word {
                figure.key = format!("{word}.{k}+{r}");
            } else {
                figure = figure.peer(name, *other, false);
            }
            bench.push(figure);
        }
    }
    Ok(())
}

mod peers {
    use anyhow::Error;
    use reed_solomon_erasure::galois_8::ReedSolomon;

    use super::{PACKET_BYTES, Result, Task};

    /// Public coders over the same sets.
    pub fn add<'t>(tasks: &mut Vec<Task<'t>>, sets: &'t [Vec<Vec<u8>>], k: usize, r: usize) -> Result<()> {
        let coder = ReedSolomon::new(k, r).map_err(Error::msg)?;
        let mut parity = vec![vec![0u8; PACKET_BYTES]; r];
        let encoder = coder.clone();
        tasks.push((
            "reed-solomon-erasure 6, encode".into(),
            Box::new(move |set| {
                encoder.encode_sep(&sets[set], &mut parity).map_err(Error::msg)?;
                Ok(0)
            }),
        ));
        let mut rows = Vec::new();
        for set in sets {
            let mut parity = vec![vec![0u8; PACKET_BYTES]; r];
            coder.encode_sep(set, &mut parity).map_err(Error::msg)?;
            rows.push(parity);
        }
        // The peer repairs in place, so that each run can lose the same packets again.
        let mut shards: Vec<Vec<Option<Vec<u8>>>> = sets
            .iter()
            .zip(&rows)
            .map(|(set, rows)| set.iter().chain(rows).cloned().map(Some).collect())
            .collect();
        tasks.push((
            "reed-solomon-erasure 6, recover".into(),
            Box::new(move |set| {
                shards[set].iter_mut().take(r).for_each(|shard| *shard = None);
                coder.reconstruct_data(&mut shards[set]).map_err(Error::msg)?;
                let wrong = shards[set].iter().zip(&sets[set]).filter(|(a, b)| a.as_ref() != Some(b));
                Ok(wrong.count())
            }),
        ));
        let mut encoder = reed_solomon_simd::ReedSolomonEncoder::new(k, r, PACKET_BYTES)?;
        tasks.push((
            "reed-solomon-simd 3, encode".into(),
            Box::new(move |set| {
                for packet in &sets[set] {
                    encoder.add_original_shard(packet)?;
                }
                let result = encoder.encode()?;
                Ok(r - result.recovery_iter().count())
            }),
        ));
        let rows: Result<Vec<_>, _> = sets.iter().map(|set| reed_solomon_simd::encode(k, r, set)).collect();
        let rows = rows?;
        let mut decoder = reed_solomon_simd::ReedSolomonDecoder::new(k, r, PACKET_BYTES)?;
        tasks.push((
            "reed-solomon-simd 3, recover".into(),
            Box::new(move |set| {
                for (index, packet) in sets[set].iter().enumerate().skip(r) {
                    decoder.add_original_shard(index, packet)?;
                }
                for (index, row) in rows[set].iter().enumerate() {
                    decoder.add_recovery_shard(index, row)?;
                }
                let result = decoder.decode()?;
                let wrong =
                    result.restored_original_iter().filter(|(index, shard)| *shard != sets[set][*index]);
                Ok(wrong.count())
            }),
        ));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_formula_gives_the_known_shares() {
        for (loss, k, r, percent) in
            [(0.05, 4, 1, 0.93), (0.05, 20, 5, 0.03), (0.0, 4, 1, 0.0), (1.0, 4, 1, 100.0)]
        {
            let found = 100.0 * residual(loss, k, r);
            assert!((found - percent).abs() < 0.005, "{k}+{r}: {found}");
        }
        // At equal overhead larger sets repair more below the code's rate, and less above it.
        assert!(residual(0.05, 8, 1) > residual(0.05, 16, 2));
        assert!(residual(0.2, 8, 1) < residual(0.2, 64, 8));
    }

    #[test]
    fn bursts_of_one_are_like_independent_losses() {
        // A burst of 1 / (1 - loss) packets on average has no memory.
        let (loss, strength) = (0.1, (8, 2));
        let drawn = bursts(loss, 1.0 / (1.0 - loss), strength, 2000);
        let exact = residual(loss, 8, 2);
        assert!((drawn / exact - 1.0).abs() < 0.1, "{drawn} {exact}");
        let long = bursts(loss, 40.0, strength, 500);
        assert!(long > 1.3 * exact, "long bursts are worse: {long} {exact}");
    }

    #[test]
    fn sets_come_back_whole_and_damage_is_seen() {
        let mut case = Case::new(6, 2, codec_simd::combine()).unwrap();
        assert_eq!((case.recover(3), case.wrong()), (0, 0));
        case.parity[3][1].1[500] ^= 1;
        assert!(case.recover(3) > 0);
        // Arithmetic of another field is seen.
        case.combine = |rows, stride, terms| {
            codec_core::internals::repair::combine(rows, stride, terms);
            rows.iter_mut().for_each(|byte| *byte ^= 1);
        };
        assert!(case.wrong() > 0);
    }
}
