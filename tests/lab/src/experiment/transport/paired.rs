//! Compares schedulers window by window, with intervals that respect that windows of one trace are alike.

use dgs::figures::mean;

use crate::figures::student95;

/// One window: its family, its trace, and one value per scheduler.
#[derive(Clone, Debug)]
pub(super) struct Window<T> {
    pub family: &'static str,
    /// Number of the trace.
    pub trace: usize,
    pub runs: Vec<T>,
}

/// Resamples drawn for an interval.
const RESAMPLES: usize = 1000;

/// `statistic` of all windows, and its 95 % interval: traces are drawn with replacement, then their windows.
pub(super) fn clustered<T>(
    windows: &[Window<T>],
    statistic: &dyn Fn(&[&Window<T>]) -> f64,
) -> (f64, [f64; 2]) {
    let mut traces: Vec<Vec<&Window<T>>> = Vec::new();
    for window in windows {
        match traces.iter_mut().find(|trace| trace[0].trace == window.trace) {
            Some(trace) => trace.push(window),
            None => traces.push(vec![window]),
        }
    }
    let all: Vec<&Window<T>> = windows.iter().collect();
    let mut state = 0x9e37_79b9_7f4a_7c15u64;
    let mut below = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize * n) >> 31
    };
    let mut drawn: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let mut sample = Vec::with_capacity(windows.len());
            for _ in 0..traces.len() {
                let trace = &traces[below(traces.len())];
                sample.extend((0..trace.len()).map(|_| trace[below(trace.len())]));
            }
            statistic(&sample)
        })
        .filter(|value| value.is_finite())
        .collect();
    drawn.sort_by(f64::total_cmp);
    let at = |share: f64| drawn.get((share * drawn.len() as f64) as usize).copied().unwrap_or(f64::NAN);
    (statistic(&all), [at(0.025), at(0.975)])
}

/// Families in which scheduler `one` is better than `other`, those in which it is so beyond doubt (the whole
/// interval above 0), and those in which it is worse beyond doubt, which nothing is of one window; and all.
pub(super) fn families<T: Clone>(windows: &[Window<T>], gain: &dyn Fn(&Window<T>) -> f64) -> [usize; 4] {
    let mut names: Vec<&str> = windows.iter().map(|window| window.family).collect();
    names.sort_unstable();
    names.dedup();
    let mut counts = [0, 0, 0, names.len()];
    for name in names {
        let own: Vec<Window<T>> = windows.iter().filter(|window| window.family == name).cloned().collect();
        // Within a family windows are what is drawn: few have more than one trace. Student's t, as a
        // bootstrap of a few values is too narrow.
        let gains: Vec<f64> = own.iter().map(gain).collect();
        counts[0] += usize::from(mean(&gains) > 0.0);
        if let Some([low, high]) = student95(&gains) {
            counts[1] += usize::from(low > 0.0);
            counts[2] += usize::from(high < 0.0);
        }
    }
    counts
}

/// Spearman's rank correlation; `NaN` if either side does not vary.
pub(super) fn rank_correlation(one: &[f64], other: &[f64]) -> f64 {
    let (a, b) = (ranks(one), ranks(other));
    let mean = (one.len() as f64 - 1.0) / 2.0;
    let sum = |f: &dyn Fn(usize) -> f64| (0..one.len()).map(f).sum::<f64>();
    let products = sum(&|i| (a[i] - mean) * (b[i] - mean));
    products / (sum(&|i| (a[i] - mean).powi(2)) * sum(&|i| (b[i] - mean).powi(2))).sqrt()
}

/// Ranks from 0; equal values share the mean of theirs.
fn ranks(values: &[f64]) -> Vec<f64> {
    let rank = |value: &f64| {
        let below = values.iter().filter(|other| *other < value).count();
        let equal = values.iter().filter(|other| *other == value).count();
        below as f64 + (equal as f64 - 1.0) / 2.0
    };
    values.iter().map(rank).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(values: &[(usize, f64)]) -> Vec<Window<f64>> {
        let window = |(trace, value): &(usize, f64)| Window {
            family: ["a", "b", "c"][trace % 3],
            trace: *trace,
            runs: vec![*value],
        };
        values.iter().map(window).collect()
    }

    fn mean_of(sample: &[&Window<f64>]) -> f64 {
        sample.iter().map(|window| window.runs[0]).sum::<f64>() / sample.len() as f64
    }

    #[test]
    fn windows_of_one_trace_do_not_pass_for_independent() {
        // Three traces, each with ten equal windows: thirty draws would look certain.
        let alike: Vec<(usize, f64)> = (0..30).map(|at| (at / 10, (at / 10) as f64)).collect();
        let apart: Vec<(usize, f64)> = (0..30).map(|at| (at, (at / 10) as f64)).collect();
        let width = |values| {
            let (centre, [low, high]) = clustered(&windows(values), &mean_of);
            assert!((centre - 1.0).abs() < 1e-12 && low <= centre && centre <= high);
            high - low
        };
        assert!(width(&alike) > 2.0 * width(&apart));
    }

    #[test]
    fn families_are_counted_by_sign_and_certainty() {
        let values: Vec<(usize, f64)> =
            (0..30).map(|at| (at % 3, [1.0, -1.0, if at % 2 == 0 { 2.0 } else { -1.9 }][at % 3])).collect();
        let counts = |values: &[(usize, f64)]| families(&windows(values), &|window| window.runs[0]);
        assert_eq!(counts(&values), [2, 1, 1, 3]);
        // One window of each says nothing for certain.
        assert_eq!(counts(&values[..3]), [2, 0, 0, 3]);
    }

    #[test]
    fn ranks_correlate_whatever_the_scale_and_not_by_chance() {
        let one = [1.0, 2.0, 3.0, 4.0, 5.0];
        assert!((rank_correlation(&one, &[1.0, 10.0, 11.0, 50.0, 51.0]) - 1.0).abs() < 1e-12);
        assert!((rank_correlation(&one, &[5.0, 4.0, 3.0, 2.0, 1.0]) + 1.0).abs() < 1e-12);
        assert!(rank_correlation(&one, &[3.0, 1.0, 4.0, 1.0, 5.0]) < 0.8);
    }
}
