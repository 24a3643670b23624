//! Estimates the probability that data sent now arrives in time.
//!
//! The paper asks for a P_g "from remaining slack, path rate, RTT, and loss". Arrival time is taken as the
//! expected time plus an error with the heavy tail of Student's t with two degrees of freedom: mobile links
//! are late more often than a normal law says, and its distribution function F(z) = ½ (1 + z / √(2 + z²)) and
//! the integral ½ (z + √(2 + z²)) need only + × ÷ √, so they are the same to the bit on every machine.

/// Integral of the distribution function.
fn integral(z: f64) -> f64 {
    // For very negative z the two terms cancel; the exact form keeps what is left: 1 / (√(2 + z²) − z).
    let root = (2.0 + z * z).sqrt();
    if z < 0.0 { 1.0 / (root - z) } else { 0.5 * (z + root) }
}

/// Probability that an error is below `z` scales.
pub(super) fn distribution(z: f64) -> f64 {
    0.5 * (1.0 + z / (2.0 + z * z).sqrt())
}

/// Mean over the playout times from `first` to `last` of the chance to have arrived by then. All in seconds
/// relative to now; `expected` is the expected arrival and `spread` its scale (at least 1 µs is used). For
/// one frame, `first == last`, this is the chance to meet that deadline. Range 0..=1; falls with `expected`,
/// rises with both deadlines.
pub fn mean_arrival(first: f64, last: f64, expected: f64, spread: f64) -> f64 {
    let spread = spread.max(1e-6);
    let (from, to) = ((first - expected) / spread, (last - expected) / spread);
    if to - from < 1e-3 {
        return distribution(0.5 * (from + to));
    }
    ((integral(to) - integral(from)) / (to - from)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_derivative_of_the_integral_is_the_distribution() {
        for z in [-50.0f64, -3.0, -0.5, 0.0, 0.7, 4.0, 60.0] {
            let slope = (integral(z + 1e-3) - integral(z - 1e-3)) / 2e-3;
            assert!((slope - distribution(z)).abs() < 1e-6, "{z}: {slope} {}", distribution(z));
        }
    }

    #[test]
    fn ample_slack_is_sure_none_is_even_and_late_is_hopeless() {
        assert!(mean_arrival(10.0, 10.0, 0.1, 0.05) > 0.999);
        assert!((mean_arrival(1.0, 1.0, 1.0, 0.1) - 0.5).abs() < 1e-9);
        assert!(mean_arrival(0.0, 0.0, 5.0, 0.1) < 1e-3);
        // Arriving in the middle of the interval serves half of it.
        assert!((mean_arrival(0.0, 2.0, 1.0, 1e-4) - 0.5).abs() < 1e-3);
    }

    #[test]
    fn monotone_in_slack() {
        let chance = |expected: f64| mean_arrival(0.5, 1.5, expected, 0.2);
        let falling = (0..100).map(|step| chance(f64::from(step) * 0.03)).collect::<Vec<_>>();
        assert!(falling.windows(2).all(|pair| pair[0] > pair[1]));
    }
}
