//! Measures how well one list of numbers ranks as another does.

/// Kendall's τ-b of the pairs; NaN when one list is constant or shorter than 2.
pub(super) fn kendall(a: &[f64], b: &[f64]) -> f64 {
    let (mut both, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
    for i in 0..a.len().min(b.len()) {
        for j in 0..i {
            let sign = |v: &[f64]| if v[i] == v[j] { 0.0 } else { (v[i] - v[j]).signum() };
            let (x, y) = (sign(a), sign(b));
            both += x * y;
            of_a += x * x;
            of_b += y * y;
        }
    }
    both / f64::sqrt(of_a * of_b)
}

/// Spearman's ρ: correlation of ranks, ties sharing their mean rank.
pub(super) fn spearman(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (ranks(a), ranks(b));
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (ma, mb) = (mean(&a), mean(&b));
    let (mut both, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
    for (x, y) in a.iter().zip(&b) {
        both += (x - ma) * (y - mb);
        of_a += (x - ma) * (x - ma);
        of_b += (y - mb) * (y - mb);
    }
    both / f64::sqrt(of_a * of_b)
}

/// Share of the `k` largest of `a` that are among the `k` largest of `b`.
pub(super) fn overlap(a: &[f64], b: &[f64], k: usize) -> f64 {
    let best = |v: &[f64]| {
        let mut order: Vec<usize> = (0..v.len()).collect();
        order.sort_by(|&i, &j| v[j].total_cmp(&v[i]));
        order.truncate(k);
        order
    };
    let (a, b) = (best(a), best(b));
    a.iter().filter(|i| b.contains(i)).count() as f64 / k.min(a.len()).max(1) as f64
}

fn ranks(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let mut out = vec![0.0; values.len()];
    let mut first = 0;
    while first < order.len() {
        let same = order[first..].iter().take_while(|&&i| values[i] == values[order[first]]).count().max(1);
        for &i in &order[first..first + same] {
            out[i] = first as f64 + (same - 1) as f64 / 2.0;
        }
        first += same;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_1_for_one_order_and_less_for_another() {
        let a = [3.0, 1.0, 2.0, 5.0];
        let same = [30.0, 1.0, 2.5, 31.0];
        assert_eq!((kendall(&a, &same), spearman(&a, &same), overlap(&a, &same, 2)), (1.0, 1.0, 1.0));
        let turned = a.map(|v| -v);
        assert_eq!((kendall(&a, &turned), spearman(&a, &turned), overlap(&a, &turned, 2)), (-1.0, -1.0, 0.0));
        // One swap of neighbours out of six pairs.
        let swapped = [3.0, 2.0, 1.0, 5.0];
        assert!((kendall(&a, &swapped) - 4.0 / 6.0).abs() < 1e-12);
        assert!((spearman(&a, &swapped) - 0.8).abs() < 1e-12);
        assert_eq!(ranks(&[1.0, 0.0, 1.0]), [1.5, 0.0, 1.5]);
        assert!(kendall(&a, &[1.0; 4]).is_nan() && spearman(&[], &[]).is_nan());
    }
}
