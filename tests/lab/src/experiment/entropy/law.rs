//! Draws packets from distributions of values, and makes one table per distribution.

use anyhow::{Result, bail};
use codec_core::internals::rans::{
    lanes::{self, Symbols, TableRun},
    table::{ESCAPE, PRECISION, Table},
};

/// Bytes reserved for each packet in an arena: no power of two, so that packets spread over a cache.
pub const PACKET_ROOM: usize = 4096 + 192;

/// A law of i16 values: the probability of every value from `-half` to `half`.
pub struct Distribution {
    pub name: &'static str,
    /// Raw low bits that its table gives away.
    raw_bits: u8,
    probability: Vec<f64>,
    half: i32,
}

impl Distribution {
    /// The three laws: quantised Laplace of 1.5 and 4 bit, quantised Gauss of 8 bit.
    pub fn all() -> [Self; 3] {
        let laplace = |width: f64| {
            move |x: f64| if x < 0.0 { (x / width).exp() / 2.0 } else { 1.0 - (-x / width).exp() / 2.0 }
        };
        let gauss = |width: f64| move |x: f64| 0.5 * (1.0 + erf(x / (width * std::f64::consts::SQRT_2)));
        [
            Self::tuned("laplace-1.5", 1.5, 0, 400, laplace),
            Self::tuned("laplace-4", 4.0, 0, 400, laplace),
            Self::tuned("gauss-8", 8.0, 2, 1200, gauss),
        ]
    }

    /// The law of `family` whose entropy is `bits`, by bisection of its width.
    fn tuned<F: Fn(f64) -> f64>(
        name: &'static str,
        bits: f64,
        raw_bits: u8,
        half: i32,
        family: impl Fn(f64) -> F,
    ) -> Self {
        let of = |width: f64| {
            let cdf = family(width);
            (-half..=half)
                .map(|v| (cdf(f64::from(v) + 0.5) - cdf(f64::from(v) - 0.5)).max(0.0))
                .collect::<Vec<f64>>()
        };
        let (mut low, mut high) = (0.01, 1000.0);
        for _ in 0..80 {
            let middle = (low + high) / 2.0;
            if entropy(&of(middle)) < bits { low = middle } else { high = middle }
        }
        let mut probability = of(low);
        let sum: f64 = probability.iter().sum();
        probability.iter_mut().for_each(|p| *p /= sum);
        Self { name, raw_bits, probability, half }
    }

    /// Entropy, bits per value.
    pub fn entropy(&self) -> f64 {
        entropy(&self.probability)
    }

    /// The table of 11-bit probabilities with the fewest expected bits over all escape thresholds.
    pub fn table(&self) -> Result<Table> {
        let mut best: Option<(f64, Table)> = None;
        for threshold in [0.0, 2e-5, 5e-5, 1e-4, 2e-4, 4e-4, 8e-4] {
            let mut counts = [0u64; 256];
            let tokens = self.tokens();
            for (token, p) in tokens.iter().enumerate() {
                let slot = if *p < threshold { usize::from(ESCAPE) } else { token };
                counts[slot] += (p * 1e12) as u64;
            }
            let table = Table::from_counts(&counts, self.raw_bits)?;
            let bits: f64 = (-self.half..=self.half)
                .zip(&self.probability)
                .map(|(v, p)| {
                    let token = table.code(v as i16);
                    let escape = if token == ESCAPE { 16.0 } else { 0.0 };
                    let cost = f64::from(PRECISION) - f64::from(table.frequency(token)).log2();
                    if *p > 0.0 { p * (cost + escape + f64::from(self.raw_bits)) } else { 0.0 }
                })
                .sum();
            if best.as_ref().is_none_or(|(b, _)| bits < *b) {
                best = Some((bits, table));
            }
        }
        best.map(|b| b.1).ok_or_else(|| anyhow::anyhow!("no table"))
    }

    /// Probability of each token.
    fn tokens(&self) -> [f64; 256] {
        let mut tokens = [0.0; 256];
        for (v, p) in (-self.half..=self.half).zip(&self.probability) {
            tokens[usize::from(Table::token(v as i16, self.raw_bits))] += p;
        }
        tokens
    }
}

fn entropy(probability: &[f64]) -> f64 {
    probability.iter().filter(|p| **p > 0.0).map(|p| -p * p.log2()).sum()
}

/// Error function to 1e-7 (Abramowitz and Stegun 7.1.26 with one more digit is not needed here).
fn erf(x: f64) -> f64 {
    let t = 1.0 / (1.0 + 0.327_591_1 * x.abs());
    let poly = t
        * (0.254_829_592
            + t * (-0.284_496_736 + t * (1.421_413_741 + t * (-1.453_152_027 + t * 1.061_405_429))));
    (1.0 - poly * (-x * x).exp()).copysign(x)
}

/// Many different packets of one law, and its table.
pub struct Packets {
    pub law: Distribution,
    pub table: Table,
    /// Values per packet.
    pub len: usize,
    /// Packets.
    pub count: usize,
    /// All values, packet after packet.
    pub values: Vec<i16>,
    /// Tokens of the values without an escape threshold, for coders of bytes; their raw low bits
    /// are not coded.
    pub tokens: Vec<u8>,
    /// Information of all values under the law, bits.
    pub information: f64,
}

impl Packets {
    /// `count` packets of at most `limit` bytes.
    pub fn draw(law: Distribution, count: usize, limit: usize, seed: u64) -> Result<Self> {
        let table = law.table()?;
        let symbols = [Symbols::new(&table)];
        let mut cumulative = Vec::with_capacity(law.probability.len());
        let mut sum = 0.0;
        for p in &law.probability {
            sum += p;
            cumulative.push(sum);
        }
        let mut state = seed;
        let mut draw = || {
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ z >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ z >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
            let u = ((z ^ z >> 31) >> 11) as f64 / (1u64 << 53) as f64;
            cumulative.partition_point(|&c| c <= u).min(cumulative.len() - 1)
        };
        // As many values as fit into each of the packets.
        let mut len = (limit as f64 * 8.0 * 1.02 / law.entropy()) as usize;
        let drawn: Vec<usize> = (0..len * count).map(|_| draw()).collect();
        let value = |&i: &usize| (i as i32 - law.half) as i16;
        let mut room = vec![0u8; PACKET_ROOM];
        loop {
            let fits = drawn.chunks(len).take(count).all(|packet| {
                let values: Vec<i16> = packet.iter().map(value).collect();
                lanes::encode(&values, &[TableRun { table: 0, len }], &symbols, &mut room)
                    .is_ok_and(|e| e.len <= limit)
            });
            if fits {
                break;
            }
            len -= (len / 200).max(1);
            if len < 8 {
                bail!("packets of {limit} bytes hold nothing");
            }
        }
        let drawn = &drawn[..len * count];
        let values: Vec<i16> = drawn.iter().map(value).collect();
        let tokens = values.iter().map(|&v| Table::token(v, law.raw_bits)).collect();
        let information = drawn.iter().map(|&i| -law.probability[i].log2()).sum();
        Ok(Self { law, table, len, count, values, tokens, information })
    }

    /// Token probabilities over `1 << bits`, at least one for every token that occurs.
    pub fn frequencies(&self, bits: u32) -> [u32; 256] {
        let mut seen = [false; 256];
        self.tokens.iter().for_each(|&t| seen[usize::from(t)] = true);
        let tokens = self.law.tokens();
        let scale = f64::from(1u32 << bits);
        let mut frequency: [u32; 256] =
            std::array::from_fn(|t| if seen[t] { (tokens[t] * scale).round().max(1.0) as u32 } else { 0 });
        while let sum = frequency.iter().sum::<u32>()
            && sum != 1 << bits
        {
            // The largest frequency bears the rounding: it costs least there.
            if let Some(most) = frequency.iter_mut().max() {
                *most = (*most + (1 << bits)).saturating_sub(sum).max(1);
            }
        }
        frequency
    }
}
