//! Tests SCReAMv2 by the cases of its text, and over whole deliveries.

use super::*;
use crate::{
    ControllerKind, PolicyKind, SessionConfig, Trace,
    graph::Synthetic,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    report::Report,
    simulate,
};

const DATAGRAM: u64 = 1200;

/// A controller fed once per 10 ms over a path of 40 ms and a queue.
struct Fed {
    scream: Scream,
    rtt: Rtt,
    now: Nanos,
}

impl Fed {
    fn new() -> Self {
        let mut fed =
            Self { scream: Scream::new(DATAGRAM), rtt: Rtt::new(Nanos::from_ms(25)), now: Nanos::from_s(1) };
        fed.go_on(100, 0, 12_000);
        fed
    }

    /// For `ms` milliseconds the queue delays by `queue_ms`, and a round trip's part of `in_flight` is
    /// acknowledged every 10 ms.
    fn go_on(&mut self, ms: u64, queue_ms: u64, in_flight: u64) {
        for _ in 0..ms / 10 {
            self.now += Nanos::from_ms(10);
            self.rtt.update(Nanos::from_ms(40 + queue_ms), Nanos::ZERO, self.now);
            let bytes = in_flight / 4;
            let acked = Acked { bytes, sent_at: self.now, app_limited: false };
            self.scream.on_ack(acked, &self.rtt, self.now);
            self.scream.on_ack_end(None, in_flight - bytes, &self.rtt, self.now);
        }
    }

    fn lose(&mut self, sent_at: Nanos) -> bool {
        self.scream.on_congestion(sent_at, DATAGRAM, 0, self.now)
    }
}

#[test]
fn a_loss_takes_three_tenths_once_per_recovery_period() {
    let mut fed = Fed::new();
    let before = fed.scream.reference();
    assert!(fed.lose(fed.now));
    assert!(fed.scream.reference().abs_diff(before * 7 / 10) <= 1);
    assert!(!fed.lose(fed.now), "sent before the reduction");
    assert!(fed.scream.reference().abs_diff(before * 7 / 10) <= 1);
    assert!(fed.lose(fed.now + Nanos(1)));
}

#[test]
fn up_to_half_the_target_nothing_shrinks_and_beyond_it_more_the_longer_the_queue() {
    let left = |queue_ms| {
        let mut fed = Fed::new();
        // Long enough for the average, then a round trip.
        fed.go_on(200, queue_ms, 12_000);
        let before = fed.scream.reference();
        fed.go_on(100, queue_ms, 12_000);
        fed.scream.reference() as f64 / before as f64
    };
    assert!(left(25) >= 1.0);
    let (some, more) = (left(40), left(60));
    assert!(some < 0.95 && more < 0.8 * some, "{some} {more}");
}

#[test]
fn the_window_never_outgrows_what_a_limited_source_has_in_flight() {
    let mut fed = Fed::new();
    fed.go_on(60_000, 0, 20_000);
    let most = DATAGRAM + 20_000 * 3 / 2 + 20_000 / 4;
    assert!(fed.scream.reference() <= most, "{} of {most}", fed.scream.reference());
    // A source that then sends a tenth takes the window down with it, to no less than the initial one.
    fed.go_on(60_000, 0, 2_000);
    assert!(fed.scream.reference() <= initial_window(DATAGRAM), "{}", fed.scream.reference());
}

#[test]
fn flows_that_keep_the_queue_long_raise_the_target_and_their_end_lowers_it() {
    let mut fed = Fed::new();
    assert_eq!(fed.scream.target(), TARGET_LOW);
    fed.go_on(60_000, 200, 12_000);
    let among_others = fed.scream.target();
    assert!(among_others > Nanos::from_ms(150) && among_others <= TARGET_HIGH, "{among_others}");
    fed.go_on(60_000, 5, 12_000);
    assert_eq!(fed.scream.target(), TARGET_LOW);
    // A queue of a second has no more effect than the largest target.
    fed.go_on(300_000, 1000, 12_000);
    assert_eq!(fed.scream.target(), TARGET_HIGH);
}

/// 150 rounds at 100 ms, then 50 at 60: the mean is that of the newest 50, the deviation that of all.
#[test]
fn the_target_follows_the_newest_delays_as_far_as_they_vary() {
    let mut others = OtherFlows::default();
    (0..150).for_each(|_| others.take(Nanos::from_ms(100), false));
    (0..50).for_each(|_| others.take(Nanos::from_ms(60), false));
    let deviation = 40.0 * (0.75f64 * 0.25).sqrt();
    let target = others.target(TARGET_LOW).as_ms();
    assert!((target - (60.0 + deviation)).abs() < 0.5, "{target}");
}

#[test]
fn reactions_in_a_row_keep_the_window_of_the_first() {
    let mut fed = Fed::new();
    let before = fed.scream.reference();
    assert!(fed.lose(fed.now) && fed.lose(fed.now + Nanos(1)));
    assert_eq!(fed.scream.inflexion, before);
    fed.go_on(100, 0, 12_000);
    let grown = fed.scream.reference();
    assert!(fed.lose(fed.now));
    assert_eq!(fed.scream.inflexion, grown);
}

/// A window of a hundred datagrams grows by one in a round trip, and by another two after a hundred of them;
/// near the window of the last congestion by a quarter of that, and the two by a tenth of it again; over a
/// round trip of 10 ms by two fifths of that, and a hundred round trips take as long as of 25 ms.
#[test]
fn the_window_grows_as_the_text_has_it() {
    let grown = |round_trip_ms: u64, calm_ms: u64, inflexion: u64| {
        let now = Nanos::from_s(100);
        let mut rtt = Rtt::new(Nanos::from_ms(25));
        rtt.update(Nanos::from_ms(round_trip_ms), Nanos::ZERO, now);
        let window = 100 * DATAGRAM;
        let mut scream = Scream {
            reference: window * PARTS,
            inflexion: inflexion * DATAGRAM,
            starting: false,
            congested_at: now - Nanos::from_ms(calm_ms),
            most_in_flight: [window; 2],
            ..Scream::new(DATAGRAM)
        };
        scream.grow(window, &rtt, now);
        (scream.reference - window * PARTS) as f64 / (DATAGRAM * PARTS) as f64
    };
    for (round_trip_ms, calm_ms, inflexion, expected) in [
        (40, 0, 200, 1.0),
        (40, 4_000, 200, 3.0),
        (40, 2_000, 200, 2.0),
        (40, 0, 100, 0.25),
        (40, 4_000, 100, 0.25 * 1.2),
        (10, 0, 200, 0.4),
        (10, 1_000, 200, 0.4 * 1.8),
        (10, 2_500, 200, 0.4 * 3.0),
    ] {
        let found = grown(round_trip_ms, calm_ms, inflexion);
        assert!((found - expected).abs() < 0.01, "{round_trip_ms} {calm_ms} {inflexion}: {found}");
    }
}

#[test]
fn an_old_base_is_forgotten_after_ten_minutes() {
    let mut base = BaseDelay::default();
    let ms = Nanos::from_ms;
    assert_eq!(base.take(ms(40), Nanos::ZERO), ms(40));
    assert_eq!(base.take(ms(90), Nanos::from_s(300)), ms(40));
    for second in (300..1000).step_by(10) {
        base.take(ms(90), Nanos::from_s(second));
    }
    assert_eq!(base.take(ms(90), Nanos::from_s(1000)), ms(90));
}

#[test]
fn persistent_congestion_leaves_the_least_window() {
    let mut fed = Fed::new();
    fed.scream.on_persistent_congestion();
    assert_eq!(fed.scream.reference(), minimum_window(DATAGRAM));
    assert!(fed.scream.window() >= minimum_window(DATAGRAM));
}

fn delivered(mbps: u64, controller: ControllerKind, forward: PathConfig) -> Report {
    let spec = Synthetic { rate: Rate::from_mbps(mbps), ..Synthetic::default() };
    let config = SessionConfig {
        policy: PolicyKind::Layered,
        controller,
        forward,
        reverse: PathConfig { delay: Nanos::from_ms(50), ..PathConfig::default() },
        // The bounds below are on the controller, and were set with this look-ahead.
        lookahead: Nanos::from_s(2),
        ..SessionConfig::default()
    };
    simulate(&spec.build(1).unwrap(), &config).unwrap()
}

/// Share of the link's bytes, and the 95th percentile of the smoothed round trip after the start.
fn use_and_late(report: &Report, link: Rate) -> (f64, Nanos) {
    let moved = report.boxes[0].counts.delivered.bytes as f64;
    let mut round_trips: Vec<Nanos> = report
        .samples
        .iter()
        .filter(|row| row.time_ns > Nanos::from_s(3))
        .map(|r| r.smoothed_rtt_ns)
        .collect();
    round_trips.sort_unstable();
    let share = moved / link.bytes_in(report.duration_ns).0 as f64;
    (share, round_trips[round_trips.len() * 95 / 100])
}

/// Twice what the link takes, over 100 ms and a queue of 500 ms: the link is full and the queue short.
#[test]
fn a_source_of_twice_the_link_fills_it_without_filling_the_queue() {
    let path = || PathConfig {
        delay: Nanos::from_ms(50),
        queue: QueueLimit { bytes: 312_500, ..QueueLimit::default() },
        ..PathConfig::default()
    };
    let link = Rate::from_mbps(5);
    let (share, late) = use_and_late(&delivered(10, ControllerKind::Scream, path()), link);
    assert!(share >= 0.9 && late <= Nanos::from_ms(165), "{share} {late}");
    let (_, of_loss) = use_and_late(&delivered(10, ControllerKind::Cubic, path()), link);
    assert!(of_loss > Nanos::from_ms(250), "a controller that waits for losses fills the queue: {of_loss}");
}

/// At three fifths of the link nothing is lost, as much shows as without a bound on the queue once the window
/// has grown, and the window stays near what is in flight.
#[test]
fn a_source_below_the_link_loses_nothing_and_hardly_waits() {
    let report = delivered(3, ControllerKind::Scream, PathConfig::default());
    assert_eq!(report.sender.lost, 0);
    let reno = delivered(3, ControllerKind::NewReno, PathConfig::default());
    assert!(report.miss_rate < reno.miss_rate + 0.02, "{} {}", report.miss_rate, reno.miss_rate);
    assert!(report.frames.iter().skip(150).all(|row| row.miss == 0.0), "after five seconds all shows");
    let widest = report.samples.iter().map(|row| row.window_bytes).max().unwrap();
    assert!(widest < 200_000, "{widest}");
}

/// Fades to a few per cent and random loss end neither the run nor the window.
#[test]
fn fades_and_losses_are_survived() {
    let capacity = Capacity::Trace(Trace::bursty(3, Nanos::from_s(60)));
    let forward = PathConfig { capacity, loss: LossModel::Iid(0.02), ..PathConfig::default() };
    let report = delivered(4, ControllerKind::Scream, forward);
    assert_eq!(report.frames.len(), 900);
    assert!(report.goodput_bps > 1e6, "{}", report.goodput_bps);
}
