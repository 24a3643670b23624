//! Weighs worlds for the conditional value at risk: the mean of the worst fraction of their distortions.

/// Weights, one per world and summing to 1, whose weighted sum of `distortions` is their CVaR: the mean over
/// the largest `fraction` of them, the last one counted in part. `fraction` is in 0..=1; a tail of less than
/// one world is the worst world. Ties go to the lower index. Source: paper section 4, CVaR at 0.05.
pub(super) fn weights(distortions: &[f64], fraction: f64) -> Vec<f64> {
    let count = distortions.len();
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by(|&a, &b| distortions[b].total_cmp(&distortions[a]).then(a.cmp(&b)));
    let tail = (fraction * count as f64).max(1.0);
    let mut weights = vec![0.0; count];
    let mut left = tail;
    for world in order {
        let part = left.min(1.0);
        weights[world] = part / tail;
        left -= part;
        if left <= 0.0 {
            break;
        }
    }
    weights
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cvar(distortions: &[f64], fraction: f64) -> f64 {
        weights(distortions, fraction).iter().zip(distortions).map(|(w, d)| w * d).sum()
    }

    /// The definition, in steps of a thousandth of a world: sort, then average the worst.
    fn naive(distortions: &[f64], fraction: f64) -> f64 {
        let mut sorted = distortions.to_vec();
        sorted.sort_by(|a, b| b.total_cmp(a));
        let fine: Vec<f64> = sorted.iter().flat_map(|&d| std::iter::repeat_n(d, 1000)).collect();
        let tail = (fraction * fine.len() as f64).round().max(1000.0) as usize;
        fine[..tail].iter().sum::<f64>() / tail as f64
    }

    fn some(count: usize) -> Vec<f64> {
        (0..count).map(|i| ((i * 7919 + 13) % 101) as f64 / 101.0).collect()
    }

    #[test]
    fn it_is_the_mean_of_the_worst_of_a_sorted_list() {
        for count in [1, 2, 7, 16, 40, 96] {
            for fraction in [0.05, 0.1, 0.2, 0.25, 1.0] {
                let distortions = some(count);
                let (found, expected) = (cvar(&distortions, fraction), naive(&distortions, fraction));
                assert!((found - expected).abs() < 1e-12, "{count} {fraction}: {found} {expected}");
            }
        }
        // A plain mean is another number: the comparison can fail.
        let distortions = some(40);
        let mean = distortions.iter().sum::<f64>() / 40.0;
        assert!((cvar(&distortions, 0.05) - mean).abs() > 0.1);
        assert!((cvar(&distortions, 1.0) - mean).abs() < 1e-12);
    }

    #[test]
    fn weights_sum_to_one_and_ties_go_to_the_lower_index() {
        for count in [1, 5, 96] {
            assert!((weights(&some(count), 0.05).iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
        assert_eq!(weights(&[0.5, 0.5, 0.1], 0.05), [1.0, 0.0, 0.0]);
        assert!(weights(&[], 0.05).is_empty());
    }
}
