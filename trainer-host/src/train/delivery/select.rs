//! Chooses among candidates by the rule that is fixed before any is measured.

/// A scene that could be taken, as validation sees it.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Candidate {
    /// Updates made; 0 is the scene as it was given.
    pub updates: usize,
    /// Prefix steps that lose quality.
    pub violations: usize,
    /// The 0.10 quantile of PSNR over validation states, dB.
    pub p10_db: f64,
    /// PSNR of the complete state, dB.
    pub clean_db: f64,
    /// Bytes of packets and manifest.
    pub wire_bytes: u64,
}

/// The rule, as it is registered.
pub(super) const RULE: &str = "of the candidates within the size that was asked for, if one was, those with \
     the fewest prefix violations (none, where there is such a one); of these the highest 0.10 quantile of \
     PSNR over validation states; of equals the fewest wire bytes, then the fewest updates";

/// Index of the candidate that the rule takes where at most so many bytes on the wire are allowed, if any
/// number is; `None` of none. Source: paper section 4, selection.
pub(super) fn select(candidates: &[Candidate], allowed: Option<u64>) -> Option<usize> {
    let order = |&a: &usize, &b: &usize| {
        let (a, b) = (&candidates[a], &candidates[b]);
        let is_too_large = |c: &Candidate| allowed.is_some_and(|allowed| c.wire_bytes > allowed);
        let size = is_too_large(a).cmp(&is_too_large(b));
        let quality = b.p10_db.total_cmp(&a.p10_db);
        let cost = (a.wire_bytes, a.updates).cmp(&(b.wire_bytes, b.updates));
        size.then(a.violations.cmp(&b.violations)).then(quality).then(cost)
    };
    (0..candidates.len()).min_by(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn violations_then_tail_quality_then_bytes() {
        let candidate = |updates, violations, p10_db, wire_bytes| Candidate {
            updates,
            violations,
            p10_db,
            clean_db: 30.0,
            wire_bytes,
        };
        assert_eq!(select(&[], None), None);
        let good = candidate(60, 0, 25.0, 900);
        for (other, taken) in [
            (candidate(120, 1, 29.0, 100), 0),
            (candidate(120, 0, 25.1, 999), 1),
            (candidate(120, 0, 25.0, 899), 1),
            (candidate(120, 0, 25.0, 901), 0),
            (candidate(120, 0, 25.0, 900), 0),
            (candidate(30, 0, 25.0, 900), 1),
        ] {
            assert_eq!(select(&[good, other], None), Some(taken), "{other:?}");
        }
        let bad = [candidate(1, 2, 30.0, 1), candidate(2, 1, 20.0, 1)];
        assert_eq!(select(&bad, None), Some(1), "where all violate, the fewest");
        let better = candidate(120, 0, 29.0, 901);
        assert_eq!(select(&[good, better], Some(901)), Some(1));
        assert_eq!(select(&[good, better], Some(900)), Some(0), "one byte too large");
        assert_eq!(select(&[better, better], Some(900)), Some(0), "where all are too large, as without");
    }
}
