//! Counts symbols, and prices them in a table.

use codec_core::internals::rans::table::{ESCAPE, MAX_RAW_BITS, PRECISION, Table};

use crate::encode::EncodeError;

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
    /// The values of `runs` together.
    pub fn of(runs: &[&[i16]]) -> Self {
        let mut histogram = Self::default();
        runs.iter().flat_map(|run| run.iter()).for_each(|&s| histogram.add(s));
        histogram
    }

    fn add(&mut self, value: i16) {
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
    pub fn best_table(&self) -> Result<Table, EncodeError> {
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
    pub table: Table,
    token_bits: [f32; 256],
}

impl Costs {
    pub fn of(table: &Table) -> Self {
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
