//! Warns where the numbers of a trace suggest other units: ms for s, kbit/s for Mbit/s.

use super::{Step, Warning};
use crate::clock::{Nanos, Rate};

/// Rows that are typically further apart look like milliseconds: measured traces step by 0.1 to 5 s, and
/// what a person writes has few rows.
const COARSEST: Nanos = Nanos::from_s(60);
const COARSEST_OF_MANY: Nanos = Nanos::from_s(10);
/// Rates that are typically higher than this look like kbit/s: measured traces stay below it but for seconds.
const FASTEST: Rate = Rate::from_mbps(500);
/// The same where all of many rates are whole: what is measured in Mbit/s has digits behind the point, what
/// is logged in kbit/s has none.
const FASTEST_OF_MANY_WHOLE: Rate = Rate::from_mbps(100);
/// From so many rows on they are many.
const MANY: usize = 10;

/// One-way delays that are typically shorter than this look like seconds: measured paths have milliseconds.
const SHORTEST: Nanos = Nanos::from_ms(1);

/// Warnings about units that are likely wrong, by the median row.
pub(super) fn unit_warnings(rows: &[Step]) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut gaps: Vec<Nanos> = rows.windows(2).map(|pair| pair[1].at - pair[0].at).collect();
    gaps.sort_unstable();
    let coarsest = if rows.len() >= MANY { COARSEST_OF_MANY } else { COARSEST };
    if let Some(gap) = gaps.get(gaps.len() / 2).filter(|gap| **gap > coarsest) {
        warnings.push(Warning::LikelyMilliseconds { seconds: gap.as_s() as u32 });
    }
    let mut rates: Vec<Rate> = rows.iter().map(|row| row.rate).collect();
    rates.sort_unstable();
    let are_whole = rates.iter().all(|rate| rate.0 % 1_000_000 == 0);
    let fastest = if are_whole && rates.len() >= MANY { FASTEST_OF_MANY_WHOLE } else { FASTEST };
    if let Some(rate) = rates.get(rates.len() / 2).filter(|rate| **rate > fastest) {
        warnings.push(Warning::LikelyKilobits { mbps: (rate.0 / 1_000_000) as u32 });
    }
    warnings
}

/// A warning if the unit of delays with this median is likely wrong.
pub(super) fn delay_unit_warning(median: Nanos) -> Option<Warning> {
    let is_short = median > Nanos::ZERO && median < SHORTEST;
    is_short.then(|| Warning::LikelySeconds { ms: median.as_ms() })
}
