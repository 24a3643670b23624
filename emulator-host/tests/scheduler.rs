//! What the default scheduler promises: near the bound, never starved, every loss made good, short queues.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

use emulator_host::{
    ControllerKind, GraphReceiver, PacketGraph, PacketIndex, PolicyKind, Report, SessionConfig, Trace, bound,
    clock::{Nanos, Rate},
    graph::{ClosureRule, Synthetic, Utilities},
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    policy::{
        DeadlineUtility, DeadlineUtilityConfig, PacketStatus, Scheduler, SenderRequirements, SenderView,
    },
    run,
    session::{MediaSender, PathFacts, Startup, StartupRule},
    simulate,
    trace::Step,
};

const FRAMES: u32 = 300;

fn graph(spec: Synthetic, seed: u64) -> PacketGraph {
    Synthetic { frames: FRAMES, clusters: 12, ..spec }.build(seed).unwrap()
}

fn after_a_second(forward: PathConfig, seed: u64) -> SessionConfig {
    let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(1) };
    SessionConfig { seed, forward, startup, sample_interval: Nanos::from_ms(20), ..SessionConfig::default() }
}

fn with(graph: &PacketGraph, config: &SessionConfig, settings: DeadlineUtilityConfig) -> Report {
    let mut receiver = GraphReceiver::new(graph, 4096);
    run(graph, config, &mut DeadlineUtility::new(graph, settings), &mut receiver).unwrap()
}

/// Rates in percent of the mean, half a second each.
fn made(name: &str, percent: &[u64], mean: Rate) -> PathConfig {
    let step = Nanos::from_ms(500);
    let steps = (0u64..).zip(percent);
    let steps = steps.map(|(at, percent)| Step { at: step.times(at), rate: mean.scaled(*percent, 100) });
    let trace = Trace::steps(name, steps.collect(), step.times(percent.len() as u64)).unwrap();
    let queue =
        QueueLimit { bytes: mean.bytes_in(Nanos::from_ms(500)).0.max(15_000), ..QueueLimit::default() };
    let burst = LossModel::GilbertElliott {
        enter_bad: 0.01 / 3.0 / 0.99,
        leave_bad: 1.0 / 3.0,
        loss_good: 0.0,
        loss_bad: 1.0,
    };
    PathConfig { capacity: Capacity::Trace(trace), queue, loss: burst, ..PathConfig::default() }
}

/// Six kinds of link with a mean of `mean`.
fn families(mean: Rate) -> Vec<PathConfig> {
    let sawtooth: Vec<u64> = (0..22).map(|at| 40 + at % 11 * 12).collect();
    let fade: Vec<u64> = (0..22).map(|at| if (8..14).contains(&at) { 20 } else { 130 }).collect();
    let outage: Vec<u64> = (0..22).map(|at| if (9..12).contains(&at) { 0 } else { 116 }).collect();
    let falling: Vec<u64> = (0..22).map(|at| 180 - at * 160 / 21).collect();
    let square: Vec<u64> = (0..22).map(|at| if at / 2 % 2 == 0 { 160 } else { 40 }).collect();
    [vec![100; 22], sawtooth, fade, outage, falling, square]
        .iter()
        .zip(["constant", "sawtooth", "fade", "outage", "falling", "square"])
        .map(|(percent, name)| made(name, percent, mean))
        .collect()
}

/// On links that carry five eighths of the stream: four fifths of what lies between level order and the best
/// that any schedule could do, in every profile; better than all conventional schedulers on every link.
#[test]
fn four_fifths_of_the_distance_to_the_bound_on_six_kinds_of_link() {
    for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
        let graph = graph(Synthetic { profile, rate: Rate::from_mbps(1), ..Synthetic::default() }, 5);
        let (mut ours, mut layered, mut best) = (0.0, 0.0, 0.0);
        let (mut base, mut layered_base) = (0.0, 0.0);
        for (at, path) in families(Rate::from_kbps(625)).into_iter().enumerate() {
            let config = after_a_second(path, 40 + at as u64);
            let of = |policy| simulate(&graph, &SessionConfig { policy, ..config.clone() }).unwrap();
            let [one, two] = [PolicyKind::DeadlineUtility, PolicyKind::Layered].map(of);
            for policy in [PolicyKind::Layered, PolicyKind::Dash, PolicyKind::Dependency] {
                let other = of(policy).utility;
                assert!(one.utility > other, "{profile:?} {at}: {} {} {other}", one.utility, policy.name());
            }
            ours += one.utility;
            layered += two.utility;
            base += one.base_miss_rate;
            layered_base += two.base_miss_rate;
            best += bound::upper_bound(&graph, &config.forward, Nanos::from_s(1), 400).utility;
        }
        let share = (ours - layered) / (best - layered);
        println!("{profile:?}: share {share:.3}, base misses {base:.4}, layered {layered_base:.4}");
        assert!(share >= 0.8, "{profile:?}: {share}");
        assert!(base <= layered_base, "{profile:?}: {base} {layered_base}");
    }
}

/// Two seconds of nothing at the start, then a twentieth of the rate for five: what the sender believes of
/// the path is wrong for long, and it must go on to learn.
#[test]
fn a_wrong_forecast_starves_nobody() {
    for seed in 0..4 {
        let graph = graph(Synthetic { rate: Rate::from_mbps(1), ..Synthetic::default() }, seed);
        let percent: Vec<u64> = (0..24)
            .map(|at| {
                if at < 4 {
                    0
                } else if at < 14 {
                    5
                } else {
                    200
                }
            })
            .collect();
        let config = after_a_second(made("dark start", &percent, Rate::from_mbps(1)), seed);
        let of = |policy| simulate(&graph, &SessionConfig { policy, ..config.clone() }).unwrap();
        let [ours, layered] = [PolicyKind::DeadlineUtility, PolicyKind::Layered].map(of);
        assert!(ours.utility >= layered.utility, "{seed}: {} {}", ours.utility, layered.utility);
        let last = ours.frames.last().unwrap();
        assert!(last.utility > 0.9, "{seed}: {last:?}");
    }
}

/// Refinements are needed to the end of what they refine: on an idle link a loss costs a round trip.
#[test]
fn every_loss_is_made_good_while_it_can_still_show() {
    let graph = graph(Synthetic { rate: Rate::from_kbps(500), ..Synthetic::default() }, 3);
    let ample = PathConfig { loss: LossModel::Iid(0.03), ..PathConfig::default() };
    let config = after_a_second(ample, 3);
    let missed = |settings| {
        let report = with(&graph, &config, settings);
        assert!(report.sender.lost > 4);
        let tail = &report.frames[60..];
        tail.iter().map(|row| row.miss).sum::<f64>() / tail.len() as f64
    };
    let repeated = missed(DeadlineUtilityConfig::default());
    let dropped = missed(DeadlineUtilityConfig { lost_compete: false, ..Default::default() });
    // What stays away is what would do harm: a tenth of the finest of four levels.
    let harmful = graph.groups().iter().filter(|group| group.utility <= 0.0).count();
    let harmful = harmful as f64 / graph.groups().len() as f64;
    println!("missed: {repeated:.4} repeated, {dropped:.4} by level, {harmful:.4} refused");
    assert!(repeated < harmful + 0.005, "{repeated} {harmful}");
    assert!(dropped > repeated + 0.005, "{dropped} {repeated}");
}

#[test]
fn the_sender_bounds_the_queue_that_it_causes() {
    let graph = graph(Synthetic { rate: Rate::from_mbps(3), ..Synthetic::default() }, 3);
    let queue = QueueLimit { bytes: 400_000, datagrams: u32::MAX };
    let path =
        PathConfig { capacity: Capacity::Constant(Rate::from_mbps(1)), queue, ..PathConfig::default() };
    let longest = |max_queue_delay| {
        let settings = DeadlineUtilityConfig { max_queue_delay, ..Default::default() };
        let report = with(&graph, &after_a_second(path.clone(), 1), settings);
        let rows = report.samples.iter().skip(50);
        rows.map(|row| row.smoothed_rtt_ns).max().unwrap()
    };
    let (bounded, free) = (longest(Some(Nanos::from_ms(100))), longest(None));
    assert!(bounded < Nanos::from_ms(40 + 100 + 40), "{bounded}");
    assert!(free > Nanos::from_ms(500), "{free}");
}

/// A datagram takes 0.3 s here, so that one after every fifth of a second without any would be too many.
#[test]
fn a_path_of_three_datagrams_a_second_drains_what_its_first_window_put_there() {
    let spec = Synthetic { rate: Rate::from_kbps(60), clusters: 1, frames: FRAMES, ..Synthetic::default() };
    let graph = spec.build(3).unwrap();
    let link = Rate::from_kbps(30);
    let queue = QueueLimit { bytes: 60_000, ..QueueLimit::default() };
    let path = PathConfig { capacity: Capacity::Constant(link), queue, ..PathConfig::default() };
    let report = with(&graph, &after_a_second(path, 1), DeadlineUtilityConfig::default());
    let settled = || report.samples.iter().filter(|row| row.time_ns >= Nanos::from_s(8));
    let most = settled().map(|row| row.in_flight_bytes).max().unwrap();
    let used = report.boxes[0].counts.delivered.bytes as f64 / link.bytes_in(report.duration_ns).0 as f64;
    println!("at most {most} bytes in flight, {used:.2} of the link used");
    assert!(settled().count() > 50 && most < 4 * 1200 && used > 0.9, "{most}, {used}");
}

/// Twice what the link carries, 100 ms of round trip, room for half a second: full, and hardly a queue.
#[test]
fn a_path_that_loses_nothing_is_filled_with_a_short_queue() {
    let graph = graph(Synthetic { rate: Rate::from_mbps(10), ..Synthetic::default() }, 1);
    let link = Rate::from_mbps(5);
    let (delay, capacity) = (Nanos::from_ms(50), Capacity::Constant(link));
    let queue = QueueLimit { bytes: link.bytes_in(Nanos::from_ms(500)).0, ..QueueLimit::default() };
    let forward = PathConfig { capacity, queue, delay, ..PathConfig::default() };
    let reverse = PathConfig { delay, ..PathConfig::default() };
    for controller in [ControllerKind::NewReno, ControllerKind::Cubic, ControllerKind::Scream] {
        let config =
            SessionConfig { controller, reverse: reverse.clone(), ..after_a_second(forward.clone(), 1) };
        let report = with(&graph, &config, DeadlineUtilityConfig::default());
        let settled = report.samples.iter().filter(|row| row.time_ns >= Nanos::from_s(2));
        let longest = settled.map(|row| row.smoothed_rtt_ns).max().unwrap();
        let used = report.boxes[0].counts.delivered.bytes as f64 / link.bytes_in(report.duration_ns).0 as f64;
        assert!(longest < Nanos::from_ms(150) && used > 0.9, "{controller:?}: {longest}, {used}");
    }
}

/// A link that carries nothing for five seconds and then all that is asked: what is acknowledged first has
/// waited for so long, which says nothing of the way. Nothing is heard for longer than the clip lasts; then
/// all that was sent is found to be lost. Playout that no receipt has reported is still to begin, so all of
/// it is worth sending again.
#[test]
fn what_is_lost_before_playout_is_sent_again_however_long_it_takes() {
    let graph = Synthetic { frames: 60, ..Synthetic::default() }.build(1).unwrap();
    let round_trip = Nanos::from_ms(60);
    let path = PathFacts {
        rate: Rate::from_mbps(2),
        smoothed_rtt: round_trip,
        minimum_rtt: round_trip,
        ..PathFacts::unknown(1200)
    };
    let rules = SessionConfig::default().sending();
    let scheduler = PolicyKind::DeadlineUtility.build(&graph);
    let mut sender = MediaSender::new(&graph, scheduler, rules, path, Nanos::ZERO);
    let sent_until = |sender: &mut MediaSender<_, _>, now: Nanos, first: u64| {
        sender.advance(now);
        let packets: Vec<PacketIndex> = std::iter::from_fn(|| sender.next(now)).take(40).collect();
        for (packet, number) in packets.iter().zip(first..) {
            sender.on_sent(*packet, number, now);
        }
        packets
    };
    let first = sent_until(&mut sender, Nanos::from_ms(1), 0);
    assert_eq!(first.len(), 40);
    // A plan is made meanwhile, too.
    let late = Nanos::from_s(4);
    sent_until(&mut sender, late, 40);
    for (packet, number) in first.iter().zip(0..) {
        sender.on_lost(*packet, number, late);
    }
    sender.look(path, late);
    let mut again: Vec<PacketIndex> =
        (0..4).flat_map(|part| sent_until(&mut sender, late, 100 + 40 * part)).collect();
    again.retain(|packet| first.contains(packet));
    assert_eq!(again.len(), first.len());
}

#[test]
fn a_link_that_was_dead_when_the_session_began_is_used_once_it_wakes() {
    let spec = Synthetic { frames: 100, rate: Rate::from_kbps(300), clusters: 8, ..Synthetic::default() };
    let graph = spec.build(3).unwrap();
    let steps = vec![
        Step { at: Nanos::ZERO, rate: Rate(0) },
        Step { at: Nanos::from_s(5), rate: Rate::from_kbps(500) },
    ];
    let trace = Trace::steps("wakes", steps, Nanos::from_s(60)).unwrap();
    let path = PathConfig { capacity: Capacity::Trace(trace), ..PathConfig::default() };
    for controller in [ControllerKind::NewReno, ControllerKind::Cubic, ControllerKind::Scream] {
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(3) };
        let config = SessionConfig { controller, startup, ..after_a_second(path.clone(), 1) };
        let report = with(&graph, &config, DeadlineUtilityConfig::default());
        // The clip ends 1.3 s after the link has come back, less than half of what the first had waited.
        let end = &report.frames[90..];
        let shown = end.iter().map(|row| row.utility).sum::<f64>() / end.len() as f64;
        assert!(shown > 0.9, "{controller:?}: {shown}");
    }
}

/// Delegates, and notes what is chosen.
struct Noted {
    inner: DeadlineUtility,
    chosen: Vec<PacketIndex>,
}

impl Scheduler for Noted {
    fn name(&self) -> &'static str {
        "noted"
    }

    fn service(&self) -> SenderRequirements {
        self.inner.service()
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        let packet = self.inner.next(view, now);
        self.chosen.extend(packet);
        packet
    }

    fn wants_parity(&mut self, view: &SenderView<'_>, parity: PacketIndex, now: Nanos) -> bool {
        self.inner.wants_parity(view, parity, now)
    }

    fn forecast(&self, view: &SenderView<'_>, packet: PacketIndex, now: Nanos) -> Option<(f64, u32)> {
        self.inner.forecast(view, packet, now)
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        self.inner.on_status(graph, packet, change);
    }
}

/// Nothing in the code asks whether the table is flat: frames per byte make the levels of a window come in
/// order, and what waiting costs the windows.
#[test]
fn a_flat_table_gives_the_conventional_order() {
    let spec = Synthetic { utilities: Utilities::Flat, rate: Rate::from_kbps(400), ..Synthetic::default() };
    let graph = Synthetic { frames: 90, clusters: 6, canonical_percent: 0, ..spec }.build(2).unwrap();
    let ample = PathConfig { capacity: Capacity::Constant(Rate::from_mbps(10)), ..PathConfig::default() };
    let order = |base_weight, table: &PacketGraph| {
        let settings = DeadlineUtilityConfig { base_weight, ..Default::default() };
        let mut noted = Noted { inner: DeadlineUtility::new(table, settings), chosen: Vec::new() };
        let mut receiver = GraphReceiver::new(table, 4096);
        // Everything within the look-ahead is there before playout starts.
        let startup = Startup { rule: StartupRule::AfterWait, max_wait: Nanos::from_s(5) };
        let config = SessionConfig { startup, ..after_a_second(ample.clone(), 1) };
        run(table, &config, &mut noted, &mut receiver).unwrap();
        noted.chosen
    };
    let of_motion = |graph: &PacketGraph, packet: &PacketIndex| {
        let group = &graph.groups()[graph.packets()[packet.at()].groups[0].at()];
        (!group.is_canonical()).then_some((group.level(), group.first_frame))
    };
    // Of one window, neighbours whose levels fall; of how many.
    let inversions = |graph: &PacketGraph, chosen: &[PacketIndex], first: u32| {
        let keys = chosen.iter().filter_map(|packet| of_motion(graph, packet));
        let levels: Vec<u8> = keys.filter(|key| key.1 == first).map(|key| key.0).collect();
        (levels.windows(2).filter(|pair| pair[0] > pair[1]).count(), levels.len())
    };
    let flat = order(0.5, &graph);
    for first in [0, 30] {
        let (inverted, of) = inversions(&graph, &flat, first);
        // Sizes vary by half to either side: the largest of a level may follow the smallest of the next.
        assert!(of > 20 && inverted * 20 < of, "window of frame {first}: {inverted} of {of}");
    }
    // The first window is on its way before most of the second.
    let place = |first: u32| {
        let motion: Vec<u32> = flat.iter().filter_map(|p| of_motion(&graph, p)).map(|key| key.1).collect();
        let places: Vec<usize> = (0..motion.len()).filter(|at| motion[*at] == first).collect();
        places.iter().sum::<usize>() / places.len()
    };
    assert!(place(0) < place(30) && place(30) < place(60), "{} {} {}", place(0), place(30), place(60));
    // The same with a table that says something: levels no longer come in order.
    let unequal = Synthetic { utilities: Utilities::Unequal, ..spec };
    let unequal = Synthetic { frames: 90, clusters: 6, canonical_percent: 0, ..unequal }.build(2).unwrap();
    let (inverted, of) = inversions(&unequal, &order(0.0, &unequal), 0);
    assert!(inverted * 20 > of, "{inverted} of {of}");
}

/// With little loss and a short way, repetition is cheaper than parity; over a long way to a near deadline it
/// comes too late.
#[test]
fn parity_is_sent_only_where_repetition_would_be_late() {
    // Bases only: refinements would be worth more than parity for them, and NewReno's window is small.
    let spec = Synthetic { rate: Rate::from_kbps(60), levels: 1, repair: Some(8), ..Synthetic::default() };
    let sent = |delay, parity_competes| -> u64 {
        let of_seed = |seed| {
            let path = PathConfig { loss: LossModel::Iid(0.05), delay, ..PathConfig::default() };
            // The live edge: nothing may be sent far ahead.
            let config = SessionConfig { lookahead: Nanos::from_ms(100), ..after_a_second(path, seed) };
            let settings = DeadlineUtilityConfig { parity_competes, ..Default::default() };
            with(&graph(spec, seed), &config, settings).sender.parity
        };
        (0..4).map(of_seed).sum()
    };
    let (near, far) = (sent(Nanos::from_ms(5), true), sent(Nanos::from_ms(120), true));
    let always = sent(Nanos::from_ms(5), false);
    println!("parity near {near}, far {far}, always {always}");
    assert!(always > 40 && near * 4 < always, "{near} {always}");
    assert!(far > 2 * near, "{far} {near}");
}

/// Forecasts are scored, and worth more than always saying how often they come true.
#[test]
fn forecasts_are_calibrated() {
    let graph = graph(Synthetic { rate: Rate::from_mbps(1), ..Synthetic::default() }, 5);
    let (mut brier, mut base_rate, mut reliability, mut count) = (0.0, 0.0, 0.0, 0u64);
    for (at, path) in families(Rate::from_kbps(625)).into_iter().enumerate() {
        let report = simulate(&graph, &after_a_second(path, at as u64)).unwrap();
        let forecast = report.forecast.unwrap();
        brier += forecast.brier / 6.0;
        base_rate += forecast.base_rate_brier / 6.0;
        reliability += forecast.reliability / 6.0;
        count += forecast.count;
    }
    println!("Brier {brier:.4}, base rate {base_rate:.4}, reliability {reliability:.4}, {count} forecasts");
    assert!(count > 300 && reliability < 0.01, "{count} {reliability}");
    assert!(brier < base_rate, "{brier} {base_rate}");
}
