//! Evaluates step functions of time that repeat: lists of (time, value).

use crate::clock::Nanos;

/// The value of the last step that is not after `now`; `None` of an empty list.
pub(super) fn at<T: Copy>(steps: &[(Nanos, T)], period: Nanos, now: Nanos) -> Option<T> {
    let inside = Nanos(now.0 % period.0.max(1));
    let place = steps.partition_point(|(at, _)| *at <= inside).max(1) - 1;
    steps.get(place).map(|(_, value)| *value)
}

/// The same function from `offset` on: steps before it come at the end.
pub(super) fn starting_at<T: Copy>(steps: &[(Nanos, T)], period: Nanos, offset: Nanos) -> Vec<(Nanos, T)> {
    let offset = Nanos(offset.0 % period.0.max(1));
    let place = steps.partition_point(|(at, _)| *at <= offset);
    let first = at(steps, period, offset).map(|value| (Nanos::ZERO, value));
    let later = steps[place..].iter().map(|(at, value)| (*at - offset, *value));
    let earlier = steps[..place].iter().map(|(at, value)| (*at + (period - offset), *value));
    let round = later.chain(earlier).filter(|(at, _)| *at < period);
    first.into_iter().chain(round).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_that_starts_elsewhere_says_the_same_later() {
        let ms = Nanos::from_ms;
        let steps = [(ms(0), 'a'), (ms(5), 'b'), (ms(20), 'c')];
        let period = ms(30);
        for offset in [0, 3, 5, 19, 20, 29, 30, 47] {
            let moved = starting_at(&steps, period, ms(offset));
            assert!(moved.windows(2).all(|pair| pair[0].0 < pair[1].0), "{moved:?}");
            for now in 0..70 {
                let expected = at(&steps, period, ms(now + offset));
                assert_eq!(at(&moved, period, ms(now)), expected, "{offset} {now}");
            }
        }
        assert_eq!(at::<u8>(&[], period, ms(1)), None);
    }
}
