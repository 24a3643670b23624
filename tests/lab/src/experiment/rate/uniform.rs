//! Codes, as a peer, by uniform quantisation and rANS with a static table per attribute, for key frames and
//! residuals of later frames each. Tables travel with the stream and are counted.

use anyhow::{Result, ensure};
use trainer_host::{Scene, encode::QuantiserSteps};

use super::{
    coded::{Coded, Timer},
    lattice::{self, ATTRIBUTES, Grids, HEADER_BYTES},
    rans::{self, Decoder, Port, Sink},
};

/// log2 of the sum of a table's frequencies.
const BITS: u32 = 14;
const SCALE: u32 = 1 << BITS;
/// Values beyond this are escaped.
const FAR: i32 = 1 << 15;
/// Most tokens of a table, the escape left out.
const TOKENS: usize = 1024;

/// Codes `scene` with the default steps times `coarseness`.
pub fn code(scene: &Scene, coarseness: f32, _: i32, shown: &[u32]) -> Result<Coded> {
    let timer = Timer::start();
    let grids = lattice::grids(scene, &QuantiserSteps::default().scaled(coarseness));
    let mut residuals = grids.clone();
    let mut how = Vec::new();
    let mut counts = vec![None; 2 * ATTRIBUTES];
    for epoch in &mut residuals {
        for plane in &mut epoch.planes {
            how.push(plane.predict(epoch.count));
            let (key, later) = plane.values.split_at(epoch.count);
            for (late, values) in [key, later].into_iter().enumerate() {
                let counts = counts[2 * plane.attribute + late].get_or_insert_with(Counts::default);
                values.iter().for_each(|&v| counts.add(v));
            }
        }
    }
    let tables: Vec<Table> =
        counts.iter().map(|c| c.as_ref().map_or_else(Table::default, Counts::best)).collect();
    let mut streams = Vec::new();
    for epoch in &mut residuals {
        for plane in &mut epoch.planes {
            let mut sink = Sink::default();
            walk(&mut sink, &tables, plane.attribute, epoch.count, &mut plane.values)?;
            streams.push(rans::encode(&sink.0));
        }
    }
    let bytes = HEADER_BYTES * grids.len()
        + tables.iter().map(Table::wire_len).sum::<usize>()
        + streams.iter().map(|s| 5 + s.len()).sum::<usize>();
    let encode_s = timer.seconds();

    let timer = Timer::start();
    let mut back: Vec<Grids> = grids.iter().map(Grids::emptied).collect();
    let mut parts = streams.iter().zip(how);
    for epoch in &mut back {
        for plane in &mut epoch.planes {
            let Some((stream, how)) = parts.next() else { break };
            let mut decoder = Decoder::new(stream)?;
            walk(&mut decoder, &tables, plane.attribute, epoch.count, &mut plane.values)?;
            decoder.finish()?;
            plane.restore(epoch.count, how);
        }
    }
    lattice::reconstruct_all(&back);
    let decode_s = timer.seconds();
    ensure!(back == grids, "what was decoded is not what was coded");
    Ok(Coded { bytes, encode_s, decode_s, shown: lattice::instants(scene, &back, shown)? })
}

fn walk<P: Port>(
    port: &mut P,
    tables: &[Table],
    attribute: usize,
    count: usize,
    values: &mut [i32],
) -> Result<()> {
    for (i, value) in values.iter_mut().enumerate() {
        let table = &tables[2 * attribute + usize::from(i >= count)];
        *value = table.pass(port, *value)?;
    }
    Ok(())
}

/// How often each value occurs.
#[derive(Clone)]
struct Counts {
    near: Vec<u64>,
    far: u64,
}

impl Default for Counts {
    fn default() -> Self {
        Self { near: vec![0; 2 * FAR as usize], far: 0 }
    }
}

impl Counts {
    fn add(&mut self, value: i32) {
        match self.near.get_mut((i64::from(value) + i64::from(FAR)) as usize) {
            Some(count) => *count += 1,
            None => self.far += 1,
        }
    }

    /// The table that codes these values in the fewest bits, its own included.
    fn best(&self) -> Table {
        let tables = (0..=8).map(|raw| self.table(raw));
        tables.min_by(|a, b| a.1.total_cmp(&b.1)).map_or_else(Table::default, |(table, _)| table)
    }

    fn table(&self, raw: u32) -> (Table, f64) {
        // Tokens around zero; the rest is escaped.
        let half = (TOKENS / 2) as i32;
        let mut counts = vec![0u64; TOKENS + 1];
        counts[TOKENS] = self.far;
        for (v, &count) in self.near.iter().enumerate().filter(|(_, c)| **c > 0) {
            let token = ((v as i32 - FAR) >> raw) + half;
            counts[usize::try_from(token).map_or(TOKENS, |t| t.min(TOKENS))] += count;
        }
        let total: u64 = counts.iter().sum::<u64>().max(1);
        // What is rarer than half a slot is escaped.
        for t in 0..TOKENS {
            if counts[t] * u64::from(2 * SCALE) < total {
                counts[TOKENS] += counts[t];
                counts[t] = 0;
            }
        }
        let table = Table::new(&counts, raw);
        let bits: f64 = counts
            .iter()
            .zip(&table.frequency)
            .enumerate()
            .filter(|(_, (c, _))| **c > 0)
            .map(|(t, (c, f))| {
                let extra = if t == TOKENS { 32 } else { raw };
                *c as f64 * (f64::from(extra) + f64::from(BITS) - f64::from(*f).log2())
            })
            .sum();
        let bits = bits + 8.0 * table.wire_len() as f64;
        (table, bits)
    }
}

/// Frequencies of tokens `-TOKENS / 2 ..` and of the escape, last.
#[derive(Clone, Debug, Default)]
struct Table {
    raw: u32,
    frequency: Vec<u32>,
    start: Vec<u32>,
    token: Vec<u16>,
}

impl Table {
    fn new(counts: &[u64], raw: u32) -> Self {
        let total: u64 = counts.iter().sum::<u64>().max(1);
        let mut frequency: Vec<u32> = counts
            .iter()
            .enumerate()
            .map(|(t, &c)| {
                let share = (c as u128 * u128::from(SCALE) / u128::from(total)) as u32;
                if c > 0 || t == TOKENS { share.max(1) } else { 0 }
            })
            .collect();
        // The most frequent token takes up what rounding left over.
        let sum: u32 = frequency.iter().sum();
        if let Some(most) = (0..frequency.len()).max_by_key(|&t| frequency[t]) {
            frequency[most] = (i64::from(frequency[most]) + i64::from(SCALE) - i64::from(sum)).max(1) as u32;
        }
        let mut start = Vec::with_capacity(frequency.len());
        let mut token = Vec::with_capacity(SCALE as usize);
        for (t, &f) in frequency.iter().enumerate() {
            start.push(token.len() as u32);
            token.extend(std::iter::repeat_n(t as u16, f as usize));
        }
        token.resize(SCALE as usize, TOKENS as u16);
        Self { raw, frequency, start, token }
    }

    /// Bytes of the table: raw bits, span, then two per token of the span.
    fn wire_len(&self) -> usize {
        let first = self.frequency.iter().take(TOKENS).position(|f| *f > 0);
        let last = self.frequency.iter().take(TOKENS).rposition(|f| *f > 0);
        7 + first.zip(last).map_or(0, |(first, last)| 2 * (last - first + 1))
    }

    fn pass<P: Port>(&self, port: &mut P, value: i32) -> Result<i32> {
        let half = (TOKENS / 2) as i32;
        let wanted = usize::try_from((value >> self.raw).saturating_add(half)).unwrap_or(TOKENS).min(TOKENS);
        let wanted = if self.frequency[wanted] == 0 { TOKENS } else { wanted };
        let token = port.pass(
            BITS,
            wanted as u32,
            |t| (self.start[t as usize], self.frequency[t as usize]),
            |slot| u32::from(self.token[slot as usize]),
        )?;
        if token as usize == TOKENS {
            return Ok(port.raw(32, value as u32)? as i32);
        }
        let low = if self.raw == 0 { 0 } else { port.raw(self.raw, value as u32 & ((1 << self.raw) - 1))? };
        Ok(((token as i32 - half) << self.raw) | low as i32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_value_comes_back_and_costs_about_its_entropy() {
        let mut counts = Counts::default();
        let values: Vec<i32> = (0..40_000i32)
            .map(|i| match i % 1000 {
                0 => i32::MAX - i,
                1 => i32::MIN + i,
                2 => 20_000,
                k => (k * k * 31 / 7) % 23 - 9,
            })
            .collect();
        values.iter().for_each(|&v| counts.add(v));
        let table = counts.best();
        let mut sink = Sink::default();
        for &v in &values {
            table.pass(&mut sink, v).unwrap();
        }
        let bytes = rans::encode(&sink.0);
        let mut decoder = Decoder::new(&bytes).unwrap();
        for &v in &values {
            assert_eq!(table.pass(&mut decoder, 0).unwrap(), v);
        }
        decoder.finish().unwrap();
        let mut sorted: Vec<i32> = values.iter().copied().filter(|v| v.abs() < 100).collect();
        sorted.sort_unstable();
        let n = sorted.len() as f64;
        let entropy: f64 =
            sorted.chunk_by(|a, b| a == b).map(|run| run.len() as f64 * (n / run.len() as f64).log2()).sum();
        let bits = 8.0 * bytes.len() as f64;
        assert!(bits > entropy && bits < entropy + 120.0 * (32.0 + 12.0), "{bits} against {entropy}");
    }

    #[test]
    fn a_scene_comes_back() {
        let scene = crate::setup::synth("balls", 1000, 4).unwrap();
        let (fine, coarse) = (code(&scene, 1.0, 0, &[3]).unwrap(), code(&scene, 4.0, 0, &[3]).unwrap());
        assert!(coarse.bytes < fine.bytes && fine.shown[0].gaussians.len() == 1000);
    }
}
