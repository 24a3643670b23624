//! Holds figures in the one JSON shape of every bench.

use codec_core::internals::digest::Digest;

pub use dgs::figures::{Machine, mean, number};
use serde::Serialize;

/// One number, beside its error, its peer and its uncertainty.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Figure {
    /// Dotted key, for example `fox.dgs1.psnr_db`.
    pub key: String,
    /// The value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
    /// Error that goes with it (accuracy beside speed).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error: Option<f64>,
    /// Unit of the error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub error_unit: Option<String>,
    /// What it is compared with.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peer: Option<String>,
    /// The peer's value in the same run; `None` if the peer is absent.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub peer_value: Option<f64>,
    /// Value over peer, larger is better.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ratio: Option<f64>,
    /// 95 % confidence interval of the value (or of the ratio if there is one).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ci95: Option<[f64; 2]>,
    /// Repetitions.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runs: Option<usize>,
}

impl Figure {
    /// `value` in `unit` under `key`.
    pub fn new(key: impl Into<String>, value: f64, unit: &str) -> Self {
        Self { key: key.into(), value, unit: unit.to_owned(), ..Self::default() }
    }

    /// With the error that goes with it.
    #[must_use]
    pub fn error(mut self, error: f64, unit: &str) -> Self {
        self.error = Some(error);
        self.error_unit = Some(unit.to_owned());
        self
    }

    /// Beside a peer's value; `ratio` is value over peer, inverted if `smaller_is_better`.
    #[must_use]
    pub fn peer(mut self, name: &str, value: f64, smaller_is_better: bool) -> Self {
        self.peer = Some(name.to_owned());
        self.peer_value = Some(value);
        self.ratio = Some(if smaller_is_better { value / self.value } else { self.value / value });
        self
    }

    /// Median of `runs` repetitions.
    #[must_use]
    pub fn runs(mut self, runs: usize) -> Self {
        self.runs = Some(runs);
        self
    }
}

/// Everything one bench says.
#[derive(Clone, Debug, Serialize)]
pub struct Bench {
    /// Name, as on the command line.
    pub name: String,
    /// Where.
    pub machine: Machine,
    /// How: resolution, background, split, sizes.
    pub protocol: String,
    /// FNV-1a over name and protocol: equal hashes, comparable figures.
    pub config_hash: String,
    /// The figures.
    pub figures: Vec<Figure>,
    /// What could not be measured here, and why; never silently empty.
    pub skipped: Vec<String>,
}

impl Bench {
    /// A bench without figures yet.
    pub fn new(name: &str, protocol: impl Into<String>) -> Self {
        let mut bench = Self {
            name: name.to_owned(),
            machine: Machine::this(),
            config_hash: String::new(),
            protocol: String::new(),
            figures: Vec::new(),
            skipped: Vec::new(),
        };
        bench.also(&protocol.into());
        bench
    }

    /// Adds `words` to the protocol.
    pub fn also(&mut self, words: &str) {
        self.protocol.push_str(words);
        let hash = Digest::new().bytes(format!("{}\n{}", self.name, self.protocol).as_bytes()).get();
        self.config_hash = format!("{hash:016x}");
    }

    /// Adds a figure.
    pub fn push(&mut self, figure: Figure) {
        self.figures.push(figure);
    }

    /// The figures as an aligned table.
    pub fn table(&self) -> String {
        let device = self.machine.device.as_ref().map_or(String::new(), |d| format!(", {d}"));
        let mut out = format!(
            "{} on {} ({} cores){device}\n{}\n",
            self.name, self.machine.cpu, self.machine.cores, self.protocol
        );
        out += &self.rows(0);
        for skipped in &self.skipped {
            out += &format!("  SKIPPED: {skipped}\n");
        }
        out
    }

    /// The figures from the `first` on, a line each.
    pub fn rows(&self, first: usize) -> String {
        let figures = self.figures.get(first..).unwrap_or_default();
        let width = figures.iter().map(|f| f.key.len()).max().unwrap_or(0);
        let mut out = String::new();
        for f in figures {
            out += &format!("  {:width$}  {:>14} {}", f.key, number(f.value), f.unit);
            if let Some(error) = f.error {
                out += &format!("  error {} {}", number(error), f.error_unit.as_deref().unwrap_or(""));
            }
            if let (Some(peer), Some(value)) = (&f.peer, f.peer_value) {
                out += &format!("  ({peer}: {})", number(value));
            }
            if let Some(ratio) = f.ratio {
                out += &format!("  ratio {ratio:.3}");
            }
            if let Some([low, high]) = f.ci95 {
                out += &format!("  95 % CI {}..{}", number(low), number(high));
            }
            if let Some(runs) = f.runs {
                out += &format!("  [{runs} runs]");
            }
            out.push('\n');
        }
        out
    }
}

/// The median of `values`; NaN if there are none.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        n if n % 2 == 1 => sorted[n / 2],
        n => (sorted[n / 2 - 1] + sorted[n / 2]) / 2.0,
    }
}

/// Bootstrap 95 % interval of `statistic` ([`mean`] or [`median`]) of `values`: 2,000 seeded
/// resamples, percentiles.
pub fn bootstrap95(values: &[f64], statistic: fn(&[f64]) -> f64, seed: u64) -> Option<[f64; 2]> {
    if values.len() < 2 {
        return None;
    }
    let mut state = seed | 1;
    let mut pick = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize * n) >> 31
    };
    let mut resampled: Vec<f64> = (0..2000)
        .map(|_| {
            let sample: Vec<f64> = (0..values.len()).map(|_| values[pick(values.len())]).collect();
            statistic(&sample)
        })
        .collect();
    resampled.sort_by(f64::total_cmp);
    Some([resampled[50], resampled[1949]])
}

/// 95 % interval of the mean of `values` by Student's t; `None` for fewer than two.
pub fn student95(values: &[f64]) -> Option<[f64; 2]> {
    /// 97.5 % quantiles for 1, 2, … degrees of freedom.
    const T: [f64; 10] = [12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228];
    let freedom = values.len().checked_sub(1).filter(|&n| n > 0)?;
    // Beyond the table, its last value: a little too wide.
    let t = T[freedom.min(T.len()) - 1];
    let centre = mean(values);
    let variance = values.iter().map(|v| (v - centre).powi(2)).sum::<f64>() / freedom as f64;
    let half = t * (variance / values.len() as f64).sqrt();
    Some([centre - half, centre + half])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn students_interval_is_the_textbooks() {
        let [low, high] = student95(&[9.0, 10.0, 11.0]).unwrap();
        assert!((low - 7.516).abs() < 1e-3 && (high - 12.484).abs() < 1e-3, "{low} {high}");
        assert!(student95(&[1.0]).is_none() && student95(&[]).is_none());
        assert_eq!(student95(&[2.0; 40]), Some([2.0, 2.0]));
    }

    #[test]
    fn medians_and_intervals() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        let values: Vec<f64> = (0..100).map(f64::from).collect();
        let [low, high] = bootstrap95(&values, mean, 1).unwrap();
        assert!(low < 49.5 && 49.5 < high && high - low < 14.0 && high - low > 8.0, "{low} {high}");
        assert_eq!(bootstrap95(&values, mean, 1), bootstrap95(&values, mean, 1));
    }

    #[test]
    fn a_ratio_says_which_way_is_better() {
        assert_eq!(Figure::new("k", 2.0, "ms").peer("naive", 6.0, true).ratio, Some(3.0));
        assert_eq!(Figure::new("k", 6.0, "1/s").peer("naive", 2.0, false).ratio, Some(3.0));
    }
}
