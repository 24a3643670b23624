//! Computes Bjøntegaard rates: how many bits one codec needs against another at equal PSNR, averaged over the
//! PSNR that both reach.
//!
//! The logarithm of the rate is interpolated over PSNR, by a monotone piecewise cubic through the points
//! (PCHIP, as the common test conditions of video coding do it) or by the one cubic polynomial of the
//! original proposal (VCEG-M33, least squares), and the difference of the two curves is averaged over the
//! interval of PSNR that both cover. Nothing is extrapolated.

/// Bits per Gaussian and PSNR in dB.
pub type RatePoint = (f64, f64);

/// Why two curves cannot be compared.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refused {
    /// Too few points.
    #[error("{found} points; at least {least} are needed")]
    Few {
        /// Points there are.
        found: usize,
        /// Points needed.
        least: usize,
    },
    /// A rate that is not positive, or a number that is not finite.
    #[error("a point of {rate} bits at {psnr} dB; positive finite rates and finite PSNR are allowed")]
    Value {
        /// Its rate.
        rate: f64,
        /// Its PSNR.
        psnr: f64,
    },
    /// More bits give less PSNR.
    #[error("not monotone: {rate} bits give {psnr} dB, and fewer bits give as much or more")]
    NotMonotone {
        /// Rate of the point that is worse than one of lower rate.
        rate: f64,
        /// Its PSNR.
        psnr: f64,
    },
    /// The curves share too little PSNR.
    #[error("the curves overlap over {0:.2} dB; at least {MIN_OVERLAP_DB} are needed")]
    NoOverlap(f64),
}

/// Least shared interval of PSNR, dB.
pub const MIN_OVERLAP_DB: f64 = 1.0;

/// A rate–distortion curve: at least two points, rising strictly in rate and PSNR.
#[derive(Clone, Debug, PartialEq)]
pub struct RateCurve {
    psnr: Vec<f64>,
    log_rate: Vec<f64>,
    slope: Vec<f64>,
}

/// A comparison of two curves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// Mean of ln(rate of the test / rate of the anchor).
    pub log_ratio: f64,
    /// The shared interval of PSNR, dB.
    pub overlap: [f64; 2],
}

impl Difference {
    /// As a change of rate in percent: −20 says that the test needs a fifth fewer bits.
    pub fn percent(&self) -> f64 {
        100.0 * (self.log_ratio.exp() - 1.0)
    }
}

/// The points that no other beats: of `points`, those with more PSNR than every point of at most their
/// rate, in order of rate. A knob that costs bits and brings nothing does not count against a codec.
pub fn efficient(points: &[RatePoint]) -> Vec<RatePoint> {
    let mut sorted = points.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1)));
    let mut best = f64::NEG_INFINITY;
    sorted.retain(|p| {
        let better = p.1 > best;
        best = best.max(p.1);
        better
    });
    sorted
}

impl RateCurve {
    /// The curve through `points`, in any order.
    ///
    /// # Errors
    /// Fewer than two points, values out of range, or points that are not strictly monotone.
    pub fn new(points: &[RatePoint]) -> Result<Self, Refused> {
        if points.len() < 2 {
            return Err(Refused::Few { found: points.len(), least: 2 });
        }
        let mut sorted = points.to_vec();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
        for &(rate, psnr) in &sorted {
            if !(rate > 0.0 && rate.is_finite() && psnr.is_finite()) {
                return Err(Refused::Value { rate, psnr });
            }
        }
        if let Some(pair) = sorted.windows(2).find(|w| w[1].1 <= w[0].1 || w[1].0 <= w[0].0) {
            return Err(Refused::NotMonotone { rate: pair[1].0, psnr: pair[1].1 });
        }
        let psnr: Vec<f64> = sorted.iter().map(|p| p.1).collect();
        let log_rate: Vec<f64> = sorted.iter().map(|p| p.0.ln()).collect();
        let slope = slopes(&psnr, &log_rate);
        Ok(Self { psnr, log_rate, slope })
    }

    /// Lowest and highest PSNR, dB.
    pub fn range(&self) -> [f64; 2] {
        [self.psnr[0], self.psnr[self.psnr.len() - 1]]
    }

    /// The rate at `psnr`; `None` outside the range.
    pub fn rate_at(&self, psnr: f64) -> Option<f64> {
        let [low, high] = self.range();
        if !(low..=high).contains(&psnr) {
            return None;
        }
        let i = self.psnr.partition_point(|&x| x <= psnr).clamp(1, self.psnr.len() - 1) - 1;
        let (x0, x1) = (self.psnr[i], self.psnr[i + 1]);
        let (h, t) = (x1 - x0, (psnr - x0) / (x1 - x0));
        let (t2, t3) = (t * t, t * t * t);
        let value = (2.0 * t3 - 3.0 * t2 + 1.0) * self.log_rate[i]
            + (t3 - 2.0 * t2 + t) * h * self.slope[i]
            + (3.0 * t2 - 2.0 * t3) * self.log_rate[i + 1]
            + (t3 - t2) * h * self.slope[i + 1];
        Some(value.exp())
    }

    /// Integral of ln(rate) from `low` to `high`, both inside the range.
    fn integral(&self, low: f64, high: f64) -> f64 {
        // Simpson's rule is exact for cubics, so one step per piece is the integral itself.
        let value = |x: f64| self.rate_at(x.clamp(self.range()[0], self.range()[1])).map_or(0.0, f64::ln);
        let inside = self.psnr.iter().copied().filter(|x| (low..high).contains(x) && *x > low);
        let ends: Vec<f64> = std::iter::once(low).chain(inside).chain([high]).collect();
        let piece =
            |w: &[f64]| (w[1] - w[0]) / 6.0 * (value(w[0]) + 4.0 * value((w[0] + w[1]) / 2.0) + value(w[1]));
        ends.windows(2).map(piece).sum()
    }
}

/// Slopes of the monotone piecewise cubic (Fritsch and Butland's weighted harmonic means; three-point
/// formula at the ends, limited so that the curve keeps its shape).
fn slopes(x: &[f64], y: &[f64]) -> Vec<f64> {
    let n = x.len();
    let h: Vec<f64> = x.windows(2).map(|w| w[1] - w[0]).collect();
    let d: Vec<f64> = y.windows(2).zip(&h).map(|(w, h)| (w[1] - w[0]) / h).collect();
    if n == 2 {
        return vec![d[0]; 2];
    }
    let end = |h0: f64, h1: f64, d0: f64, d1: f64| {
        let slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1);
        if slope * d0 <= 0.0 {
            0.0
        } else if d0 * d1 <= 0.0 && slope.abs() > 3.0 * d0.abs() {
            3.0 * d0
        } else {
            slope
        }
    };
    let mut out = vec![end(h[0], h[1], d[0], d[1])];
    for i in 1..n - 1 {
        let (before, after) = (d[i - 1], d[i]);
        out.push(if before * after <= 0.0 {
            0.0
        } else {
            let (w0, w1) = (2.0 * h[i] + h[i - 1], h[i] + 2.0 * h[i - 1]);
            (w0 + w1) / (w0 / before + w1 / after)
        });
    }
    out.push(end(h[n - 2], h[n - 3], d[n - 2], d[n - 3]));
    out
}

fn overlap(a: [f64; 2], b: [f64; 2]) -> Result<[f64; 2], Refused> {
    let (low, high) = (a[0].max(b[0]), a[1].min(b[1]));
    if high - low < MIN_OVERLAP_DB {
        return Err(Refused::NoOverlap(high - low));
    }
    Ok([low, high])
}

/// `test` against `anchor`, by monotone piecewise cubics.
///
/// # Errors
/// If the curves share less than [`MIN_OVERLAP_DB`].
pub fn difference(anchor: &RateCurve, test: &RateCurve) -> Result<Difference, Refused> {
    let overlap @ [low, high] = overlap(anchor.range(), test.range())?;
    let log_ratio = (test.integral(low, high) - anchor.integral(low, high)) / (high - low);
    Ok(Difference { log_ratio, overlap })
}

/// `test` against `anchor`, by one cubic polynomial each (VCEG-M33): a cross-check, unreliable for curves
/// with a bend.
///
/// # Errors
/// Fewer than four points in a curve, or too little in common.
pub fn difference_cubic(anchor: &RateCurve, test: &RateCurve) -> Result<Difference, Refused> {
    for found in [anchor.psnr.len(), test.psnr.len()] {
        if found < 4 {
            return Err(Refused::Few { found, least: 4 });
        }
    }
    let overlap @ [low, high] = overlap(anchor.range(), test.range())?;
    // Centred and scaled, or the normal equations lose all digits.
    let (middle, half) = ((low + high) / 2.0, (high - low) / 2.0);
    let mean = |curve: &RateCurve| {
        let x: Vec<f64> = curve.psnr.iter().map(|p| (p - middle) / half).collect();
        let c = cubic(&x, &curve.log_rate);
        // Over −1..=1 the odd powers vanish.
        c[0] + c[2] / 3.0
    };
    Ok(Difference { log_ratio: mean(test) - mean(anchor), overlap })
}

/// Coefficients, lowest power first, of the least-squares cubic through (x, y).
fn cubic(x: &[f64], y: &[f64]) -> [f64; 4] {
    let mut rows = [[0.0f64; 5]; 4];
    for (x, y) in x.iter().zip(y) {
        let powers = [1.0, *x, x * x, x * x * x];
        for (row, p) in rows.iter_mut().zip(powers) {
            for (cell, q) in row.iter_mut().zip(powers) {
                *cell += p * q;
            }
            row[4] += p * y;
        }
    }
    for i in 0..4 {
        let pivot = (i..4).max_by(|&a, &b| rows[a][i].abs().total_cmp(&rows[b][i].abs())).unwrap_or(i);
        rows.swap(i, pivot);
        let lead = rows[i];
        for row in rows.iter_mut().skip(i + 1) {
            let factor = row[i] / lead[i];
            row.iter_mut().zip(lead).for_each(|(cell, l)| *cell -= factor * l);
        }
    }
    let mut out = [0.0; 4];
    for i in (0..4).rev() {
        let known: f64 = (i + 1..4).map(|j| rows[i][j] * out[j]).sum();
        out[i] = (rows[i][4] - known) / rows[i][i];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(rates: &[f64], psnr: &[f64]) -> RateCurve {
        RateCurve::new(&rates.iter().copied().zip(psnr.iter().copied()).collect::<Vec<_>>()).unwrap()
    }

    /// Rates and PSNR of two encoders as published with the `bjontegaard` Python package; expected values
    /// from `scipy.interpolate.PchipInterpolator` and `numpy.polyfit`.
    #[test]
    fn published_examples_come_out() {
        let anchor = curve(&[9487.76, 4593.60, 2486.44, 1358.24], &[40.037, 38.615, 36.845, 34.851]);
        let test = curve(&[9787.80, 4469.00, 2451.52, 1356.24], &[40.121, 38.651, 36.970, 34.987]);
        let found = difference(&anchor, &test).unwrap();
        assert!((found.percent() + 4.417_485_350_589_11).abs() < 1e-9, "{}", found.percent());
        assert_eq!(found.overlap, [34.987, 40.037]);
        let found = difference_cubic(&anchor, &test).unwrap();
        assert!((found.percent() + 4.420_462_706_047_17).abs() < 1e-6, "{}", found.percent());

        let anchor = curve(&[40.0, 75.0, 150.0, 290.0, 700.0], &[33.0, 37.5, 42.0, 46.0, 52.0]);
        let test = curve(&[30.0, 60.0, 110.0, 230.0, 500.0, 900.0], &[34.0, 38.0, 41.0, 47.0, 51.5, 54.0]);
        let found = difference(&anchor, &test).unwrap();
        assert!((found.percent() + 25.984_851_266_612).abs() < 1e-9, "{}", found.percent());
        let found = difference_cubic(&anchor, &test).unwrap();
        assert!((found.percent() + 25.639_258_173_247).abs() < 1e-6, "{}", found.percent());
    }

    #[test]
    fn half_the_rate_everywhere_is_minus_fifty_percent() {
        let psnr = [30.0, 36.0, 41.0, 47.0];
        let anchor = curve(&[50.0, 100.0, 200.0, 400.0], &psnr);
        let test = curve(&[25.0, 50.0, 100.0, 200.0], &psnr);
        for found in [difference(&anchor, &test).unwrap(), difference_cubic(&anchor, &test).unwrap()] {
            assert!((found.percent() + 50.0).abs() < 1e-9);
        }
        let back = difference(&test, &anchor).unwrap();
        assert!((back.percent() - 100.0).abs() < 1e-9, "the way back doubles");
    }

    #[test]
    fn curves_that_cannot_be_compared_are_refused() {
        let low = curve(&[10.0, 20.0, 30.0, 40.0], &[20.0, 22.0, 24.0, 26.0]);
        let high = curve(&[10.0, 20.0, 30.0, 40.0], &[25.5, 28.0, 30.0, 33.0]);
        assert_eq!(difference(&low, &high), Err(Refused::NoOverlap(0.5)));
        let apart = curve(&[10.0, 20.0], &[40.0, 42.0]);
        assert!(matches!(difference(&low, &apart), Err(Refused::NoOverlap(gap)) if gap < 0.0));
        assert_eq!(difference_cubic(&high, &apart), Err(Refused::Few { found: 2, least: 4 }));
        let falling = RateCurve::new(&[(10.0, 30.0), (20.0, 32.0), (30.0, 31.0)]);
        assert_eq!(falling, Err(Refused::NotMonotone { rate: 30.0, psnr: 31.0 }));
        let flat = RateCurve::new(&[(10.0, 30.0), (20.0, 30.0)]);
        assert!(matches!(flat, Err(Refused::NotMonotone { .. })));
        assert_eq!(RateCurve::new(&[(10.0, 30.0)]), Err(Refused::Few { found: 1, least: 2 }));
        assert!(matches!(RateCurve::new(&[(0.0, 30.0), (1.0, 31.0)]), Err(Refused::Value { .. })));
        assert!(matches!(RateCurve::new(&[(1.0, f64::NAN), (2.0, 31.0)]), Err(Refused::Value { .. })));
    }

    #[test]
    fn rates_between_points_follow_the_curve_and_end_with_it() {
        let c = curve(&[10.0, 40.0, 160.0], &[30.0, 40.0, 50.0]);
        assert!((c.rate_at(35.0).unwrap() - 20.0).abs() < 1e-9, "a straight line in log rate");
        assert_eq!((c.rate_at(29.9), c.rate_at(50.1)), (None, None));
        assert!((c.rate_at(50.0).unwrap() - 160.0).abs() < 1e-9);
    }

    #[test]
    fn what_costs_more_and_brings_nothing_is_left_out() {
        let points = [(30.0, 41.0), (10.0, 30.0), (20.0, 42.0), (20.0, 35.0), (40.0, 42.0), (50.0, 45.0)];
        assert_eq!(efficient(&points), [(10.0, 30.0), (20.0, 42.0), (50.0, 45.0)]);
    }
}
