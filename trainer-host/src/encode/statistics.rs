//! Chooses entropy tables from the statistics of symbols, and prices symbols in them.

mod histogram;
mod table_set;

use codec_core::internals::{
    rans::{
        family,
        table::{ESCAPE, Table},
    },
    wire::manifest::{TableSet, stream},
};
use rayon::prelude::*;

use self::{
    histogram::{Costs, Histogram},
    table_set::Choice,
};
use super::{
    EncodeError,
    decisions::{Dgs1Decisions, TableForm, TableSetEntry, misfit},
};

/// The runs of all streams: what one choice of table covers.
#[derive(Clone, Debug)]
pub(super) struct Streams<'c>(Vec<Vec<&'c [i16]>>);

impl Default for Streams<'_> {
    fn default() -> Self {
        Self(vec![Vec::new(); stream::COUNT])
    }
}

impl<'c> Streams<'c> {
    pub fn add(&mut self, stream: usize, run: &'c [i16]) {
        self.0[stream].push(run);
    }

    /// Sum of the streams' entropies, bits.
    pub fn entropy_bits(&self) -> f64 {
        self.0.iter().filter(|runs| !runs.is_empty()).map(|runs| Histogram::of(runs).entropy_bits()).sum()
    }

    /// A table set per stream that occurs, of tables of the family or of its own, in at most `most`
    /// choices.
    pub fn model(&self, most: usize) -> Result<Model, EncodeError> {
        let named: Result<Vec<Costs>, EncodeError> = family::indices()
            .filter(|&i| i >= family::THREE || i % 3 == 0)
            .map(|i| Ok(Costs::of(&Table::named(i)?)))
            .collect();
        let named = named?;
        let chosen: Result<Vec<Vec<Choice>>, EncodeError> =
            self.0.par_iter().map(|runs| table_set::choose(runs, &named, most)).collect();
        let mut model =
            Model { table_sets: vec![TableSet::EMPTY; stream::COUNT], tables: Vec::new(), costs: Vec::new() };
        for (table_set, choices) in model.table_sets.iter_mut().zip(chosen?) {
            let mut entries = Vec::new();
            for choice in choices {
                let known = model.tables.iter().position(|t| *t == choice.costs.table);
                let index = known.unwrap_or_else(|| {
                    model.tables.push(choice.costs.table);
                    model.costs.push(choice.costs);
                    model.tables.len() - 1
                });
                entries.push((index as u8, choice.length));
            }
            *table_set = TableSet::new(&entries)?;
        }
        Ok(model)
    }
}

/// Table sets for all streams.
#[derive(Clone, Debug)]
pub(super) struct Model {
    pub table_sets: Vec<TableSet>,
    pub tables: Vec<Table>,
    costs: Vec<Costs>,
}

impl Model {
    /// The tables and table sets of `decisions`.
    ///
    /// # Errors
    /// A table or table set that the format does not hold.
    pub fn of(decisions: &Dgs1Decisions) -> Result<Self, EncodeError> {
        let tables: Result<Vec<Table>, EncodeError> = decisions.tables.iter().map(TableForm::table).collect();
        let tables = tables?;
        if tables.iter().any(|table| table.frequency(ESCAPE) == 0) {
            return Err(misfit("tables", "frequency of the escape", 0, "1..=2048"));
        }
        if decisions.table_sets.len() != stream::COUNT {
            return Err(misfit("all", "number of table_sets", decisions.table_sets.len(), stream::COUNT));
        }
        let mut table_sets = Vec::new();
        for (stream, decided) in decisions.table_sets.iter().enumerate() {
            let entries: Vec<(u8, u8)> = decided.iter().map(|e| (e.table, e.code_bits)).collect();
            if let Some((table, _)) = entries.iter().find(|(table, _)| usize::from(*table) >= tables.len()) {
                let place = format_args!("table set {stream}").to_string();
                return Err(misfit(place, "table", table, format_args!("0..{}", tables.len())));
            }
            table_sets.push(if entries.is_empty() { TableSet::EMPTY } else { TableSet::new(&entries)? });
        }
        let costs = tables.iter().map(Costs::of).collect();
        Ok(Self { table_sets, tables, costs })
    }

    /// Its tables and table sets as plain data.
    pub fn decisions(&self) -> (Vec<TableForm>, Vec<Vec<TableSetEntry>>) {
        let entries = |set: &TableSet| {
            set.choices().map(|(table, code_bits)| TableSetEntry { table, code_bits }).collect()
        };
        (self.tables.iter().map(TableForm::of).collect(), self.table_sets.iter().map(entries).collect())
    }

    /// The choice of `stream`'s table set that codes `run` in the fewest bits.
    pub fn choose(&self, stream: usize, run: &[i16]) -> usize {
        let mut best = (0, f64::INFINITY);
        for choice in 0..self.table_sets[stream].len() {
            let bits = self.bits(stream, choice, run);
            if bits < best.1 {
                best = (choice, bits);
            }
        }
        best.0
    }

    /// Bits that `run` takes in choice `choice` of `stream`, the code word included; infinite if there is
    /// no such choice.
    pub fn bits(&self, stream: usize, choice: usize, run: &[i16]) -> f64 {
        let Some((table, length)) = self.table_sets[stream].choices().nth(choice) else {
            return f64::INFINITY;
        };
        let costs = &self.costs[usize::from(table)];
        f64::from(length) + run.iter().map(|&s| f64::from(costs.bits(s))).sum::<f64>()
    }

    /// Table, code word and its length of choice `choice` of `stream`.
    pub fn code(&self, stream: usize, choice: usize) -> (u8, u32, u8) {
        let set = &self.table_sets[stream];
        let (code, length) = set.code(choice).unwrap_or_default();
        (set.choices().nth(choice).map_or(0, |(table, _)| table), code, length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn symbols(n: i64) -> Vec<i16> {
        (0..n)
            .map(|i| {
                ((i.wrapping_mul(i).wrapping_mul(2_654_435_761) >> 20) % 9 + ((i * 7_919) >> 3) % 5 - 6)
                    as i16
            })
            .collect()
    }

    fn bits(model: &Model, stream: usize, runs: &[&[i16]]) -> f64 {
        runs.iter().map(|run| model.bits(stream, model.choose(stream, run), run)).sum()
    }

    #[test]
    fn a_model_costs_little_more_than_the_entropy() {
        let symbols = symbols(50_000);
        let mut streams = Streams::default();
        let runs: Vec<&[i16]> = symbols.chunks(64).collect();
        runs.iter().for_each(|run| streams.add(3, run));
        let model = streams.model(8).unwrap();
        let (bits, entropy) = (bits(&model, 3, &runs), streams.entropy_bits());
        assert!(bits < entropy * 1.01, "{bits} against {entropy}");
    }

    #[test]
    fn runs_that_differ_get_tables_that_differ_and_cost_less_than_one() {
        let noise = symbols(64_000);
        let quiet: Vec<i16> = noise.iter().map(|s| s / 6).collect();
        let loud: Vec<i16> = noise.iter().map(|s| s * 9).collect();
        let mut streams = Streams::default();
        let runs: Vec<&[i16]> = quiet.chunks(64).zip(loud.chunks(64)).flat_map(|(a, b)| [a, b]).collect();
        runs.iter().for_each(|run| streams.add(40, run));
        let (one, many) = (streams.model(1).unwrap(), streams.model(8).unwrap());
        assert_eq!((one.table_sets[40].len(), one.table_sets[3].len()), (1, 0));
        assert!(many.table_sets[40].len() >= 2);
        let (one, many) = (bits(&one, 40, &runs), bits(&many, 40, &runs));
        assert!(many < 0.9 * one, "{many} against {one}");
    }

    #[test]
    fn rare_large_values_are_escaped_not_tabled() {
        let mut symbols = vec![0i16; 100_000];
        symbols[77] = 30_000;
        symbols[78] = -900;
        let mut streams = Streams::default();
        let runs: Vec<&[i16]> = symbols.chunks(64).collect();
        runs.iter().for_each(|run| streams.add(0, run));
        let model = streams.model(8).unwrap();
        let bits = bits(&model, 0, &runs);
        assert!(bits < 1800.0, "{bits}");
        // A table of its own for all of them would not list what occurs once.
        let table = Histogram::of(&runs).best_table().unwrap();
        assert_eq!((table.code(30_000), table.code(-900)), (ESCAPE, ESCAPE));
    }
}
