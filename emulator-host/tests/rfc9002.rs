//! RFC 9002 (and RFC 9221, RFC 9000 13.2) by item. The number in a test's name is the item of the list below.
//!
//! Round trip: 1 which acknowledgements give samples; 2 minimum without ack delay; 3 clamping of ack delay; 4
//! first sample; 5 order of A.7. Loss: 6 thresholds; 7 loss timer before probe timer; 8 spurious losses.
//! Probes: 9 timeout and backoff; 10 timed from the last eliciting packet; 11 no loss, no window change, past
//! the window; 12 reset by acknowledgement; 14 initial round trip. Congestion: 15 initial and minimum window;
//! 16 one halving per recovery period; 17 one packet on entry; 18 growth in avoidance; 19 CE as one loss, for
//! controllers; 20 persistent congestion; 21 application-limited; 22, 23 pacing (also in
//! `congestion/pacer.rs`). 25 datagrams; 26 receipts every two packets, and (in `session/client.rs`) within
//! 25 ms or at once behind a gap; 27 receipts cost uplink; 28 what is counted.
//!
//! Exceptions, because packets here start after a completed handshake and have one number space: 13, 24, 30
//! and the parts of 3, 9 and 12 about Initial packets. 29: there is no path-MTU discovery. 19 and 26 as far
//! as they are about acknowledgements of CE: links drop and never mark, so there is none to acknowledge.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use emulator_host::{
    ControllerKind, PolicyKind, SessionConfig,
    clock::Nanos,
    congestion::{AckOutcome, Recovery, Rtt, TimerOutcome, initial_window, minimum_window},
    graph::Synthetic,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    simulate,
};

const MDS: u64 = 1200;
const ACK_DELAY: Nanos = Nanos::from_ms(25);

fn ms(ms: u64) -> Nanos {
    Nanos::from_ms(ms)
}

struct Peer {
    recovery: Recovery,
    out: AckOutcome,
}

impl Peer {
    fn new() -> Self {
        let controller = ControllerKind::NewReno.build(MDS);
        Self { recovery: Recovery::new(controller, MDS, ACK_DELAY), out: AckOutcome::default() }
    }

    fn send(&mut self, at: u64) -> u64 {
        self.recovery.on_sent(MDS as u32, true, ms(at))
    }

    fn burst(&mut self, count: u64, at: u64) -> std::ops::Range<u64> {
        let numbers: Vec<u64> = (0..count).map(|_| self.send(at)).collect();
        numbers[0]..numbers[0] + count
    }

    fn ack(&mut self, first: u64, last: u64, at: u64) -> Vec<u64> {
        self.out.clear();
        self.recovery.on_ack(&[(first, last)], Nanos::ZERO, ms(at), &mut self.out);
        self.out.lost.clone()
    }

    fn timer(&mut self, at: Nanos) -> TimerOutcome {
        self.out.clear();
        self.recovery.on_timer(at, &mut self.out)
    }

    fn window(&self) -> u64 {
        self.recovery.controller().window()
    }
}

#[test]
fn rfc9002_01_a_sample_needs_the_largest_newly_acked_and_something_eliciting() {
    let mut peer = Peer::new();
    peer.burst(3, 0);
    peer.ack(2, 2, 50);
    assert_eq!(peer.recovery.rtt().latest(), ms(50));
    // The largest was acknowledged before: no sample.
    peer.out.clear();
    peer.recovery.on_ack(&[(0, 2)], Nanos::ZERO, ms(90), &mut peer.out);
    assert_eq!(peer.out.acked, [0, 1]);
    assert_eq!(peer.recovery.rtt().latest(), ms(50));
    // Nothing eliciting among the newly acknowledged: no sample.
    let number = peer.recovery.on_sent(40, false, ms(100));
    peer.ack(number, number, 300);
    assert_eq!(peer.recovery.rtt().latest(), ms(50));
}

#[test]
fn rfc9002_02_the_minimum_ignores_ack_delay() {
    let mut rtt = Rtt::new(ACK_DELAY);
    rtt.update(ms(50), Nanos::ZERO, ms(50));
    rtt.update(ms(45), ms(20), ms(100));
    assert_eq!(rtt.minimum(), ms(45));
    rtt.on_persistent_congestion();
    rtt.update(ms(80), Nanos::ZERO, ms(200));
    assert_eq!(rtt.minimum(), ms(45), "the newest sample at that time");
}

#[test]
fn rfc9002_03_ack_delay_is_clamped_and_never_takes_a_sample_below_the_minimum() {
    let mut rtt = Rtt::new(ACK_DELAY);
    rtt.update(ms(100), Nanos::ZERO, ms(0));
    rtt.update(ms(200), ms(90), ms(1));
    assert_eq!(rtt.smoothed(), Nanos((7 * 100_000_000 + 175_000_000) / 8), "90 ms counts as 25");
    let mut rtt = Rtt::new(ACK_DELAY);
    rtt.update(ms(100), Nanos::ZERO, ms(0));
    rtt.update(ms(110), ms(20), ms(1));
    assert_eq!(rtt.smoothed(), Nanos((7 * 100_000_000 + 110_000_000) / 8), "110 - 20 would be below 100");
}

#[test]
fn rfc9002_04_the_first_sample_sets_both() {
    let mut rtt = Rtt::new(ACK_DELAY);
    rtt.update(ms(60), ms(20), ms(0));
    assert_eq!((rtt.smoothed(), rtt.variation(), rtt.minimum()), (ms(60), ms(30), ms(60)));
}

#[test]
fn rfc9002_05_the_variation_uses_the_old_smoothed_value() {
    let mut rtt = Rtt::new(ACK_DELAY);
    rtt.update(ms(100), Nanos::ZERO, ms(0));
    rtt.update(ms(180), Nanos::ZERO, ms(1));
    assert_eq!(rtt.variation(), Nanos((3 * 50_000_000 + 80_000_000) / 4));
    assert_eq!(rtt.smoothed(), ms(110));
}

#[test]
fn rfc9002_06_three_packets_or_nine_eighths_of_a_round_trip() {
    let mut peer = Peer::new();
    peer.burst(4, 0);
    assert_eq!(peer.ack(2, 2, 40), [] as [u64; 0]);
    assert_eq!(peer.ack(3, 3, 41), [0], "three packets behind; 1 is two behind");
    let mut peer = Peer::new();
    peer.send(0);
    peer.send(50);
    assert_eq!(peer.ack(1, 1, 90), [0], "sent 90 ms ago, threshold 45 ms");
    let mut peer = Peer::new();
    peer.send(0);
    peer.send(1);
    assert_eq!(peer.ack(0, 0, 40), [] as [u64; 0], "1 was sent after the acknowledged packet");
}

#[test]
fn rfc9002_07_the_loss_timer_replaces_the_probe_timer() {
    let mut peer = Peer::new();
    peer.burst(2, 0);
    peer.ack(1, 1, 40);
    assert_eq!(peer.recovery.timer(), ms(45), "9/8 of 40 ms after the packet was sent");
    assert_eq!(peer.timer(ms(44)), TimerOutcome::NotDue);
    assert_eq!(peer.timer(ms(45)), TimerOutcome::Loss);
    assert_eq!(peer.out.lost, [0]);
    assert_eq!(peer.recovery.timer(), Nanos::MAX, "nothing in flight");
}

#[test]
fn rfc9002_08_a_spurious_loss_leaves_bytes_in_flight_right() {
    let mut peer = Peer::new();
    peer.burst(5, 0);
    assert_eq!(peer.ack(4, 4, 40), [0, 1]);
    assert_eq!(peer.recovery.in_flight(), 2 * MDS);
    peer.ack(0, 4, 42);
    assert_eq!(peer.out.spurious, [0, 1]);
    assert_eq!(peer.recovery.in_flight(), 0);
    peer.ack(0, 4, 43);
    assert_eq!((peer.out.acked.len(), peer.out.spurious.len(), peer.recovery.in_flight()), (0, 0, 0));
}

#[test]
fn rfc9002_09_timeout_is_srtt_plus_four_variations_plus_ack_delay_and_doubles() {
    let mut rtt = Rtt::new(ACK_DELAY);
    rtt.update(ms(40), Nanos::ZERO, ms(0));
    assert_eq!(rtt.probe_timeout(), ms(40 + 80 + 25));
    for _ in 0..200 {
        rtt.update(ms(40), Nanos::ZERO, ms(0));
    }
    assert_eq!(rtt.probe_timeout(), ms(40 + 1 + 25), "at least a millisecond of variation");
    let mut peer = Peer::new();
    peer.send(0);
    let first = peer.recovery.timer();
    assert_eq!(peer.timer(first), TimerOutcome::Probe);
    assert_eq!(peer.recovery.timer(), first.times(2));
    assert_eq!(peer.timer(first.times(2)), TimerOutcome::Probe);
    assert_eq!(peer.recovery.timer(), first.times(4));
}

#[test]
fn rfc9002_10_timed_from_the_last_eliciting_packet() {
    let mut peer = Peer::new();
    peer.send(0);
    let first = peer.recovery.timer();
    peer.recovery.on_sent(40, false, ms(50));
    assert_eq!(peer.recovery.timer(), first, "a packet that asks for no acknowledgement changes nothing");
    peer.send(70);
    assert_eq!(peer.recovery.timer(), first + ms(70));
}

#[test]
fn rfc9002_11_a_probe_timeout_loses_nothing_and_its_probes_pass_the_window() {
    let mut peer = Peer::new();
    peer.burst(10, 0);
    let (window, flight) = (peer.window(), peer.recovery.in_flight());
    assert!(!peer.recovery.window_allows(MDS));
    assert_eq!(peer.timer(peer.recovery.timer()), TimerOutcome::Probe);
    assert!(peer.out.lost.is_empty());
    assert_eq!((peer.window(), peer.recovery.in_flight()), (window, flight));
    assert_eq!(peer.recovery.probes_owed(), 2);
    peer.send(2000);
    assert_eq!((peer.recovery.probes_owed(), peer.recovery.in_flight()), (1, flight + MDS));
}

#[test]
fn rfc9002_12_an_acknowledgement_resets_the_backoff() {
    let mut peer = Peer::new();
    peer.burst(2, 0);
    peer.timer(peer.recovery.timer());
    peer.timer(peer.recovery.timer());
    assert_eq!(peer.recovery.probe_count(), 2);
    peer.ack(0, 0, 4000);
    assert_eq!((peer.recovery.probe_count(), peer.recovery.probes_owed()), (0, 0));
}

#[test]
fn rfc9002_14_the_initial_round_trip_is_333_ms() {
    let rtt = Rtt::new(ACK_DELAY);
    assert_eq!((rtt.smoothed(), rtt.variation()), (ms(333), Nanos(166_500_000)));
    assert_eq!(rtt.probe_timeout(), ms(333 + 666 + 25));
}

#[test]
fn rfc9002_15_initial_and_minimum_windows() {
    assert_eq!([1200, 1400, 1472, 9000].map(initial_window), [12_000, 14_000, 14_720, 18_000]);
    assert_eq!(minimum_window(MDS), 2400);
    assert_eq!(Peer::new().window(), 12_000);
}

#[test]
fn rfc9002_16_one_halving_per_recovery_period() {
    let mut peer = Peer::new();
    peer.burst(10, 0);
    assert_eq!(peer.ack(4, 4, 40), [0, 1]);
    assert_eq!(peer.window(), 6000);
    assert_eq!(peer.ack(7, 7, 41), [2, 3]);
    assert_eq!(peer.window(), 6000, "sent before the recovery started");
    let after = peer.burst(4, 50);
    peer.ack(8, after.start, 90);
    assert!(peer.window() >= 6000);
    peer.ack(after.start + 3, after.start + 3, 91);
    let later = peer.burst(5, 100);
    peer.ack(later.start + 4, later.start + 4, 150);
    assert!(peer.window() <= 4000, "a new period: {}", peer.window());
}

#[test]
fn rfc9002_17_one_packet_may_leave_on_entry() {
    let mut peer = Peer::new();
    peer.burst(10, 0);
    peer.ack(3, 3, 40);
    assert!(peer.recovery.in_flight() > peer.window());
    assert!(peer.recovery.window_allows(MDS));
    peer.send(41);
    assert!(!peer.recovery.window_allows(MDS));
}

#[test]
fn rfc9002_18_avoidance_adds_one_datagram_per_window_acked() {
    let mut peer = Peer::new();
    peer.burst(4, 0);
    peer.ack(3, 3, 40);
    peer.ack(1, 2, 41);
    let start = peer.window();
    let mut acked = 0;
    let mut at = 100;
    while peer.window() == start {
        let number = peer.send(at);
        peer.ack(number, number, at + 40);
        acked += MDS;
        at += 50;
    }
    assert_eq!(peer.window(), start + MDS);
    assert!(acked >= start && acked < start + 2 * MDS, "{acked} {start}");
}

/// `quinn` hands marks to a controller as losses of nothing.
#[test]
fn rfc9002_19_ce_has_the_effect_of_one_loss() {
    for lost_bytes in [0, MDS] {
        let mut controller = ControllerKind::NewReno.build(MDS);
        assert!(controller.on_congestion(ms(0), lost_bytes, 12_000, ms(40)));
        assert_eq!(controller.window(), 6000);
        assert!(!controller.on_congestion(ms(0), lost_bytes, 12_000, ms(41)), "the same recovery period");
        assert_eq!(controller.window(), 6000);
    }
}

/// A first sample, then packets at the given times, all lost but the last.
fn silence(times: &[u64], acked_between: Option<usize>) -> u64 {
    let mut peer = Peer::new();
    let first = peer.send(0);
    peer.ack(first, first, 40);
    let numbers: Vec<u64> = times.iter().map(|at| peer.send(*at)).collect();
    let end = *times.last().unwrap();
    let last = *numbers.last().unwrap();
    let mut ranges = vec![(last, last)];
    ranges.extend(acked_between.map(|at| (numbers[at], numbers[at])));
    peer.recovery.on_ack(&ranges, Nanos::ZERO, ms(end + 40), &mut peer.out);
    peer.window()
}

#[test]
fn rfc9002_20_persistent_congestion_is_about_durations() {
    // Threshold: 3 x (40 + 80 + 25) = 435 ms, a little different after the last sample.
    // The minimum window, and then the acknowledged packet lets it grow by one (order of A.7).
    assert_eq!(silence(&[100, 300, 700, 900], None), 3 * MDS);
    assert!(silence(&[100, 150, 200, 900], None) > 3 * MDS, "too short");
    assert!(silence(&[100, 400, 700, 900], Some(1)) > 3 * MDS, "acknowledged in between");
    assert!(silence(&[100, 5100], None) > 3 * MDS, "a silent outage with one lost packet");
    let mut peer = Peer::new();
    for at in [0, 300, 700, 900] {
        peer.send(at);
    }
    peer.ack(3, 3, 940);
    assert!(peer.window() > 3 * MDS, "no sample before both");
}

#[test]
fn rfc9002_21_a_window_that_was_not_needed_does_not_grow() {
    let mut peer = Peer::new();
    peer.recovery.on_app_limited();
    let number = peer.send(0);
    peer.recovery.on_window_limited();
    peer.ack(number, number, 40);
    assert_eq!(peer.window(), 12_000, "judged when it was sent");
    let number = peer.send(50);
    peer.ack(number, number, 90);
    assert_eq!(peer.window(), 12_000 + MDS);
}

#[test]
fn rfc9002_21_paced_media_below_the_link_rate_does_not_run_away() {
    // Every frame is a window of its own, so that the source is as smooth as video.
    let rate = emulator_host::Rate::from_mbps(8);
    let graph =
        Synthetic { rate, window_frames: 1, clusters: 4, canonical_percent: 1, ..Synthetic::default() };
    let graph = graph.build(1).unwrap();
    let link = Capacity::Constant(emulator_host::Rate::from_mbps(12));
    let config = SessionConfig {
        forward: PathConfig { capacity: link, ..PathConfig::default() },
        lookahead: ms(100),
        ..SessionConfig::default()
    };
    let report = simulate(&graph, &config).unwrap();
    // Slow start runs into the queue once while the sender catches up; from then on the source is slower than
    // the link, and for 29 s the window must neither grow nor lose anything.
    let settled: Vec<u64> = report.samples.iter().skip(10).map(|row| row.window_bytes).collect();
    assert!(settled.len() > 250 && settled.windows(2).all(|pair| pair[0] == pair[1]), "{settled:?}");
    assert!(report.sender.lost < 50, "{:?}", report.sender);
}

#[test]
fn rfc9002_23_packets_of_acknowledgements_alone_are_neither_paced_nor_in_flight() {
    let mut peer = Peer::new();
    for _ in 0..1000 {
        peer.recovery.on_sent(40, false, ms(0));
    }
    assert_eq!(peer.recovery.in_flight(), 0);
    // A whole burst may still leave at once; what must be acknowledged is taken from it.
    let burst = initial_window(MDS);
    assert_eq!(peer.recovery.pacing_ready_at(burst, ms(0)), ms(0));
    peer.send(0);
    assert!(peer.recovery.pacing_ready_at(burst, ms(0)) > ms(0));
}

fn traffic(loss: LossModel, up: LossModel) -> emulator_host::Report {
    let graph = Synthetic { frames: 150, ..Synthetic::default() }.build(1).unwrap();
    let config = SessionConfig {
        forward: PathConfig {
            loss,
            queue: QueueLimit { bytes: 2_000_000, datagrams: 2000 },
            ..PathConfig::default()
        },
        reverse: PathConfig { loss: up, ..PathConfig::default() },
        retransmissions: 0,
        // A scheduler that leaves lost packets to the sender, which here sends none again.
        policy: PolicyKind::DeadlineUtilityPaper,
        ..SessionConfig::default()
    };
    simulate(&graph, &config).unwrap()
}

#[test]
fn rfc9221_25_lost_datagrams_count_and_the_transport_does_not_send_them_again() {
    let report = traffic(LossModel::Iid(0.02), LossModel::None);
    assert!(report.sender.lost > 10 && report.sender.retransmitted == 0, "{:?}", report.sender);
    assert_eq!(report.sender.spurious, 0);
}

#[test]
fn rfc9000_26_receipts_come_every_two_packets() {
    let report = traffic(LossModel::None, LossModel::None);
    let (down, up) = (report.boxes[0].counts.received, report.boxes[2].counts.received);
    assert!(up.datagrams * 2 <= down.datagrams + 400, "{} {}", up.datagrams, down.datagrams);
    assert!(up.datagrams * 2 >= down.datagrams * 9 / 10, "{} {}", up.datagrams, down.datagrams);
}

#[test]
fn rfc9000_27_receipts_cost_uplink_and_may_be_lost() {
    let report = traffic(LossModel::None, LossModel::Iid(0.3));
    let uplink: Vec<_> = report.boxes.iter().filter(|row| row.label.starts_with("reverse")).collect();
    assert!(uplink[0].counts.received.bytes > 60 * uplink[0].counts.received.datagrams);
    assert!(uplink[1].counts.dropped.datagrams > 100);
    assert_eq!(report.sender.lost, 0, "later receipts repeat what the lost ones said: {:?}", report.sender);
}

#[test]
fn rfc9000_28_the_link_counts_headers_and_the_window_does_not() {
    let report = traffic(LossModel::None, LossModel::None);
    let down = report.boxes[1].counts.delivered;
    let overhead = down.bytes - report.media_bytes - 8192;
    let per_datagram = overhead as f64 / down.datagrams as f64;
    assert!((58.0..62.0).contains(&per_datagram), "{per_datagram}");
}
