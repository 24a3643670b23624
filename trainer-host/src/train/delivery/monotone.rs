//! Penalises prefixes that look worse than a shorter one: a hinge on each step, the shorter prefix as it is.

/// Prefixes of a stream: levels up to 0, 1, 2 and 3 of everything.
pub(super) const PREFIXES: usize = 4;

/// `Σ max(0, D(k + 1) − D(k))` over the prefixes of `distortions`, and its derivative by each distortion. The
/// shorter prefix of a step counts as a constant: else making it worse would pay. Source: paper section 4, M.
pub(super) fn hinge(distortions: &[f64; PREFIXES]) -> (f64, [f64; PREFIXES]) {
    let mut value = 0.0;
    let mut slopes = [0.0; PREFIXES];
    for k in 1..PREFIXES {
        let rise = distortions[k] - distortions[k - 1];
        if rise > 0.0 {
            value += rise;
            slopes[k] = 1.0;
        }
    }
    (value, slopes)
}

/// Steps of the prefixes at which distortion rises by more than `tolerance`.
pub(super) fn violations(distortions: &[f64; PREFIXES], tolerance: f64) -> usize {
    distortions.windows(2).filter(|pair| pair[1] > pair[0] + tolerance).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falling_distortions_cost_nothing_and_rises_cost_what_they_rise() {
        assert_eq!(hinge(&[0.4, 0.3, 0.3, 0.1]), (0.0, [0.0; 4]));
        let (value, slopes) = hinge(&[0.1, 0.3, 0.2, 0.25]);
        assert!((value - 0.25).abs() < 1e-12);
        assert_eq!(slopes, [0.0, 1.0, 0.0, 1.0]);
    }

    /// A derivative that also went through the shorter prefix would reward making it worse.
    #[test]
    fn the_shorter_prefix_is_a_constant() {
        let distortions = [0.1, 0.3, 0.35, 0.2];
        let (value, slopes) = hinge(&distortions);
        let h = 1e-6;
        for k in 0..PREFIXES {
            let mut longer = distortions;
            longer[k] += h;
            let full = (hinge(&longer).0 - value) / h;
            let stopped =
                if k + 1 < PREFIXES && distortions[k + 1] > distortions[k] { full + 1.0 } else { full };
            assert!((slopes[k] - stopped).abs() < 1e-6, "prefix {k}: {} {stopped}", slopes[k]);
        }
        assert_eq!(slopes[0], 0.0, "raising the shortest prefix would lower the full derivative");
    }

    #[test]
    fn violations_are_counted_beyond_the_tolerance() {
        assert_eq!(violations(&[0.4, 0.3, 0.2, 0.1], 0.0), 0);
        assert_eq!(violations(&[0.1, 0.2, 0.15, 0.16], 0.0), 2);
        assert_eq!(violations(&[0.1, 0.2, 0.15, 0.16], 0.02), 1);
    }
}
