//! Warns where the numbers of a trace suggest other units: ms for s, kbit/s for Mbit/s.

use super::{Step, Warning};
use crate::clock::{Nanos, Rate};

/// Rows that are typically further apart look like milliseconds: measured traces step by 0.1 to 5 s, and
/// what a person writes has few rows.
const COARSEST: Nanos = Nanos::from_s(60);
const COARSEST_OF_MANY: Nanos = Nanos::from_s(8);
/// Rows that are typically further apart than this, and last longer than [`LONGEST_OF_COARSE`], look like a
/// log with a row every few milliseconds: measured traces with steps of 3 to 5 s last up to half an hour.
const COARSEST_OF_LONG: Nanos = Nanos::from_ms(2_500);
const LONGEST_OF_COARSE: Nanos = Nanos::from_s(3600);
/// Rates that are typically higher than this look like kbit/s: measured traces stay below it but for seconds.
const FASTEST: Rate = Rate::from_mbps(500);
/// The same where rates look logged in kbit/s, by [`look_logged_in_kilobits`].
const FASTEST_OF_LOGGED: Rate = Rate::from_mbps(100);
/// From so many rows on they are many.
const MANY: usize = 10;
/// Traces of so many rows were written by a program, not by hand.
const LOGGED: usize = 20;
/// A rate of which all rates are multiples has at most one digit behind the point.
const TENTH: u64 = 100_000;
/// Rates of which the highest is at most so many times the lowest are steady: fast wireless links, which
/// traces are measured on, come close to standing still.
const STEADY_RATIO: u64 = 4;

/// One-way delays that are typically shorter than this look like seconds: measured paths have milliseconds.
const SHORTEST: Nanos = Nanos::from_ms(1);

/// Warnings about units that are likely wrong, by the median row.
pub(super) fn unit_warnings(rows: &[Step]) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut gaps: Vec<Nanos> = rows.windows(2).map(|pair| pair[1].at - pair[0].at).collect();
    gaps.sort_unstable();
    let lasts = rows.last().map_or(Nanos::ZERO, |last| last.at);
    let coarsest = if rows.len() < MANY {
        COARSEST
    } else if lasts > LONGEST_OF_COARSE {
        COARSEST_OF_LONG
    } else {
        COARSEST_OF_MANY
    };
    if let Some(gap) = gaps.get(gaps.len() / 2).filter(|gap| **gap > coarsest) {
        warnings.push(Warning::LikelyMilliseconds { seconds: gap.as_s() as u32 });
    }
    let mut rates: Vec<Rate> = rows.iter().map(|row| row.rate).collect();
    rates.sort_unstable();
    let fastest = if look_logged_in_kilobits(&rates) { FASTEST_OF_LOGGED } else { FASTEST };
    if let Some(rate) = rates.get(rates.len() / 2).filter(|rate| **rate > fastest) {
        warnings.push(Warning::LikelyKilobits { mbps: (rate.0 / 1_000_000) as u32 });
    }
    warnings
}

/// Whether sorted rates, read as Mbit/s, have digits or a spread as what is logged in kbit/s has. What is
/// measured in Mbit/s has more digits behind the point, and at 100 Mbit/s and more it is of wireless links
/// whose rate falls close to nothing now and then.
fn look_logged_in_kilobits(rates: &[Rate]) -> bool {
    let are_multiples = |of: u64| rates.iter().all(|rate| rate.0 % of == 0);
    let are_steady =
        || rates.first().zip(rates.last()).is_some_and(|(low, high)| high.0 / STEADY_RATIO <= low.0);
    if rates.len() < LOGGED {
        rates.len() >= MANY && are_multiples(1_000_000)
    } else {
        are_multiples(TENTH) || are_steady()
    }
}

/// A warning if the unit of delays with this median is likely wrong.
pub(super) fn delay_unit_warning(median: Nanos) -> Option<Warning> {
    let is_short = median > Nanos::ZERO && median < SHORTEST;
    is_short.then(|| Warning::LikelySeconds { ms: median.as_ms() })
}
