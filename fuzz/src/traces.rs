//! Network traces: any bytes give an ordered trace with capacity, or an error that says why not.

use emulator_host::{
    Nanos, Trace,
    trace::{DelayTrace, Direction, HoldDirection, Limits, Replay, Shape},
};

/// All loaders over the same bytes.
pub fn trace(data: &[u8]) {
    let limits = Limits { points: 5000, ..Limits::default() };
    let loaded = [
        Trace::mahimahi("t", data, &limits),
        Trace::two_column("t", data, HoldDirection::Forward, &limits),
        Trace::two_column("t", data, HoldDirection::Backward, &limits),
        Trace::ucc("t", data, Direction::Down, &limits),
        Trace::ucc("t", data, Direction::Up, &limits),
    ];
    for trace in loaded {
        match trace {
            Ok(trace) => {
                assert_ordered(&trace);
                let third = Nanos(trace.period().0 / 3);
                if let Ok(window) = trace.window(third, trace.period()) {
                    assert_ordered(&window);
                }
                let _ = trace.starting_at(Nanos(u64::MAX));
            }
            Err(error) => assert!(!error.to_string().is_empty()),
        }
    }
    match Replay::load("t", data, &limits) {
        Ok(replay) => {
            assert_ordered(&replay.capacity);
            let Ok(moved) = replay.starting_at(Nanos(replay.capacity.period().0 / 3)) else { return };
            assert_ordered(&moved.capacity);
            for time in [Nanos::ZERO, Nanos::from_s(1), Nanos(u64::MAX)] {
                assert!(moved.delay.as_ref().is_some_and(|delay| delay.at(time) <= Nanos::from_s(60)));
                let _ = moved.loss.as_ref().map(|loss| loss.at(time));
            }
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
    match DelayTrace::load(data, Nanos::from_ms(10), &limits) {
        Ok(delays) => {
            let most = Nanos::from_s(60);
            assert!(delays.at(Nanos::ZERO) <= most && delays.at(Nanos(u64::MAX)) <= most);
        }
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn assert_ordered(trace: &Trace) {
    assert!(trace.period() >= Nanos::from_ms(1));
    match trace.shape() {
        Shape::Opportunities(at) => {
            assert!(!at.is_empty() && at.is_sorted());
            assert!(at.iter().all(|&t| t <= trace.period()));
        }
        Shape::Steps(steps) => {
            assert!(steps.first().is_some_and(|s| s.at == Nanos::ZERO));
            assert!(steps.windows(2).all(|pair| pair[0].at < pair[1].at));
            assert!(steps.iter().all(|s| s.at < trace.period()));
            assert!(steps.iter().any(|s| s.rate.0 > 0));
        }
    }
    let _ = trace.mean_rate();
}
