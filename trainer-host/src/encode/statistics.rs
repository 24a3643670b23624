//! What symbols look like: histograms per stream, the table each gets, and what it costs.

use codec_core::{
    rans::table::{ESCAPE, MAX_RAW_BITS, PRECISION, Table},
    wire::manifest::{NO_TABLE, stream},
};

use super::EncodeError;

/// Counts of i16 values, exact.
#[derive(Clone, Debug)]
pub(super) struct Histogram {
    counts: Vec<u64>,
    total: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        Self { counts: vec![0; 65_536], total: 0 }
    }
}

impl Histogram {
    pub fn add(&mut self, value: i16) {
        self.counts[value as u16 as usize] += 1;
        self.total += 1;
    }

    fn values(&self) -> impl Iterator<Item = (i16, u64)> + '_ {
        self.counts.iter().enumerate().filter(|(_, c)| **c > 0).map(|(v, &c)| (v as u16 as i16, c))
    }

    /// Shannon entropy of all values seen, bits.
    pub fn entropy_bits(&self) -> f64 {
        let total = self.total as f64;
        self.values().map(|(_, c)| c as f64 * (total / c as f64).log2()).sum()
    }

    /// The table that codes these values in the fewest bits, its own bytes included.
    fn best_table(&self) -> Result<Table, EncodeError> {
        let mut best: Option<(f64, Table)> = None;
        for raw_bits in 0..=MAX_RAW_BITS {
            let mut counts = [0u64; 256];
            for (value, count) in self.values() {
                counts[usize::from(Table::token(value, raw_bits))] += count;
            }
            // A token rarer than a quarter of the least probability is cheaper as an escape.
            for token in 1..256 {
                if counts[token] << (PRECISION + 2) < self.total {
                    counts[usize::from(ESCAPE)] += counts[token];
                    counts[token] = 0;
                }
            }
            let table = Table::from_counts(&counts, raw_bits)?;
            let costs = Costs::of(&table);
            let bits: f64 = self.values().map(|(v, c)| c as f64 * f64::from(costs.bits(v))).sum();
            let bits = bits + 8.0 * table.wire_len() as f64;
            if best.as_ref().is_none_or(|(b, _)| bits < *b) {
                best = Some((bits, table));
            }
        }
        match best {
            Some((_, table)) => Ok(table),
            None => Ok(Table::from_counts(&[0; 256], 0)?),
        }
    }
}

/// Cost of each token of a table, bits.
#[derive(Clone, Debug)]
pub(super) struct Costs {
    table: Table,
    token_bits: [f32; 256],
}

impl Costs {
    fn of(table: &Table) -> Self {
        let scale = (1u32 << PRECISION) as f32;
        let raw = f32::from(table.raw_bits());
        let token_bits = std::array::from_fn(|t| {
            let f = table.frequency(t as u8);
            let escape = if t == usize::from(ESCAPE) { 16.0 } else { 0.0 };
            if f == 0 { f32::INFINITY } else { (scale / f as f32).log2() + raw + escape }
        });
        Self { table: *table, token_bits }
    }

    /// Bits that `value` takes, escapes and raw bits included.
    pub fn bits(&self, value: i16) -> f32 {
        self.token_bits[usize::from(self.table.code(value))]
    }
}

/// Histograms of all streams.
#[derive(Clone, Debug)]
pub(super) struct Streams(Vec<Option<Histogram>>);

impl Default for Streams {
    fn default() -> Self {
        Self(vec![None; stream::COUNT])
    }
}

impl Streams {
    pub fn add(&mut self, stream: usize, symbols: &[i16]) {
        let histogram = self.0[stream].get_or_insert_with(Histogram::default);
        symbols.iter().for_each(|&s| histogram.add(s));
    }

    /// Sum of the streams' entropies, bits.
    pub fn entropy_bits(&self) -> f64 {
        self.0.iter().flatten().map(Histogram::entropy_bits).sum()
    }

    /// One table per stream that occurs, and the map from streams to tables.
    pub fn model(&self) -> Result<Model, EncodeError> {
        let mut model = Model { table_of: [NO_TABLE; stream::COUNT], tables: Vec::new(), costs: Vec::new() };
        for (stream, histogram) in self.0.iter().enumerate() {
            if let Some(histogram) = histogram {
                model.table_of[stream] = model.tables.len() as u8;
                let table = histogram.best_table()?;
                model.costs.push(Costs::of(&table));
                model.tables.push(table);
            }
        }
        Ok(model)
    }
}

/// Tables for all streams.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub table_of: [u8; stream::COUNT],
    pub tables: Vec<Table>,
    pub costs: Vec<Costs>,
}

impl Model {
    /// Bits that `symbols` of `stream` take.
    pub fn bits(&self, stream: usize, symbols: &[i16]) -> f64 {
        match self.costs.get(usize::from(self.table_of[stream])) {
            Some(costs) => symbols.iter().map(|&s| f64::from(costs.bits(s))).sum(),
            None => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_model_costs_little_more_than_the_entropy() {
        let mut streams = Streams::default();
        let symbols: Vec<i16> = (0..50_000i64)
            .map(|i| (((i * i * 2_654_435_761) >> 20) % 9 + ((i * 7_919) >> 3) % 5 - 6) as i16)
            .collect();
        streams.add(3, &symbols);
        let model = streams.model().unwrap();
        let (bits, entropy) = (model.bits(3, &symbols), streams.entropy_bits());
        assert!(bits >= entropy && bits < entropy * 1.01, "{bits} against {entropy}");
    }

    #[test]
    fn rare_large_values_are_escaped_not_tabled() {
        let mut streams = Streams::default();
        let mut symbols = vec![0i16; 100_000];
        symbols[77] = 30_000;
        symbols[78] = -9;
        streams.add(0, &symbols);
        let model = streams.model().unwrap();
        assert_eq!(model.tables[0].code(30_000), ESCAPE);
        assert_eq!(model.tables[0].code(-9), ESCAPE);
        assert!(model.bits(0, &symbols) < 400.0);
    }
}
