//! Measures the packet coder: speed, size and a checked round trip, many different packets in
//! turn, public coders in the same rounds.

mod coders;
mod law;
mod peers;

use anyhow::{Result, ensure};

use self::{
    coders::{Arena, Coder, Decoded, Many, Naive, Scalar, Small},
    law::{Distribution, Packets},
};
use super::clock::seconds;
use crate::{
    figures::{Bench, Figure, median},
    setup::Setup,
};

/// Longest packet body, bytes.
const LIMIT: usize = 1150;
/// Packets decoded before their values are looked at: what they decode to stays in a core's cache.
const BATCH: usize = 64;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (count, runs) = if setup.quick { (40, 3) } else { (1024, 9) };
    let mut bench = Bench::new(
        "entropy",
        format!(
            "{count} different packets of at most {LIMIT} bytes per law (quantised Laplace of 1.5 and 4 bit, \
                quantised Gauss of 8 bit; \
             i.i.d.), one table per law, known beforehand; thread CPU time, medians of {runs} interleaved \
             rounds over all packets, after \
             one checked round; {BATCH} packets at a time into the same memory; Msymbol/s; coders marked u8 \
             code one-byte tokens, raw low bits neither coded nor written (their \
             sizes include them); overhead over the values' information under their law, beside each speed; \
             every round trip is checked"
        ),
    );
    for law in Distribution::all() {
        measure(&mut bench, Packets::draw(law, count, LIMIT, 7)?, runs)?;
    }
    Ok(bench)
}

struct Lane {
    coder: Box<dyn Coder>,
    arena: Arena,
    encodes: bool,
    overhead: f64,
    encode: Vec<f64>,
    decode: Vec<f64>,
}

fn measure(bench: &mut Bench, packets: Packets, runs: usize) -> Result<()> {
    let mut list: Vec<Box<dyn Coder>> =
        vec![Box::new(Scalar::new(&packets.table)), Box::new(Small::new(&packets.table))];
    list.extend(Many::all(&packets.table));
    list.extend(peers::all(&packets)?);
    list.push(Box::new(Naive));
    let total = packets.values.len();
    let room = packets.len * BATCH.min(packets.count);
    let mut out = Decoded { values: vec![0; room], tokens: vec![0; room] };
    let mut lanes = Vec::new();
    for mut coder in list {
        let mut arena = Arena::new(packets.count);
        let encodes = coder.encode(&packets, &mut arena)?;
        if !encodes {
            Scalar::new(&packets.table).encode(&packets, &mut arena)?;
        }
        let name = coder.name();
        let bodies: Vec<&[u8]> = arena.packets().collect();
        for (i, bodies) in bodies.chunks(BATCH).enumerate() {
            out.values.fill(i16::MIN);
            out.tokens.fill(255);
            coder.decode(&packets, bodies, &mut out)?;
            let range = i * BATCH * packets.len..(i * BATCH + bodies.len()) * packets.len;
            if coder.whole() {
                let same = out.values[..range.len()] == packets.values[range];
                ensure!(same, "{name}: the values do not come back");
            } else {
                let same = out.tokens[..range.len()] == packets.tokens[range];
                ensure!(same, "{name}: the tokens do not come back");
            }
        }
        let bytes: usize = arena.packets().map(<[u8]>::len).sum();
        let raw = if coder.whole() { 0 } else { total * usize::from(packets.table.raw_bits()) };
        let overhead = 100.0 * ((8 * bytes + raw) as f64 / packets.information - 1.0);
        lanes.push(Lane { coder, arena, encodes, overhead, encode: Vec::new(), decode: Vec::new() });
    }
    for run in 0..runs {
        for lane in &mut lanes {
            // The naive twin is slow and steady: every third round is enough.
            if lane.coder.name() == "naive" && run % 3 != 0 {
                continue;
            }
            if lane.encodes {
                let start = seconds();
                lane.coder.encode(&packets, &mut lane.arena)?;
                lane.encode.push(total as f64 / (seconds() - start) / 1e6);
            }
            let bodies: Vec<&[u8]> = lane.arena.packets().collect();
            let start = seconds();
            for bodies in bodies.chunks(BATCH) {
                lane.coder.decode(&packets, bodies, &mut out)?;
            }
            lane.decode.push(total as f64 / (seconds() - start) / 1e6);
        }
    }
    let best = |speeds: fn(&Lane) -> &Vec<f64>| {
        let peers = lanes.iter().filter(|l| l.coder.rust() && !l.coder.whole());
        peers.map(|l| median(speeds(l))).fold(0.0, f64::max)
    };
    let best = [best(|l| &l.encode), best(|l| &l.decode)];
    let law = packets.law.name;
    for lane in &lanes {
        let name = format!("{law}.{}{}", lane.coder.name(), if lane.coder.whole() { "" } else { ".u8" });
        for (what, speeds, best) in [("encode", &lane.encode, best[0]), ("decode", &lane.decode, best[1])] {
            if speeds.is_empty() {
                continue;
            }
            let figure =
                Figure::new(format!("{name}.{what}"), median(speeds), "Msymbol/s").runs(speeds.len());
            let figure = figure.error(lane.overhead, "% over entropy");
            bench.push(if best > 0.0 { figure.peer("best Rust peer", best, false) } else { figure });
        }
    }
    Ok(())
}
