//! Every box, alone and in chains, keeps its books: received = delivered + dropped + held.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use emulator_host::{
    clock::{Bytes, Nanos, Rate},
    link::{
        BoxOutput, Capacity, Chain, Datagram, LightLoad, LinkBox, LossModel, PathConfig, QueueLimit,
        Reordering,
    },
    trace::{DelayTrace, Limits, Replay, Trace},
};
use proptest::prelude::*;

fn capacity() -> impl Strategy<Value = Capacity> {
    prop_oneof![
        Just(Capacity::Unlimited),
        (0u64..20_000).prop_map(|kbps| Capacity::Constant(Rate::from_kbps(kbps))),
        any::<u64>().prop_map(|seed| Capacity::Trace(Trace::bursty(seed, Nanos::from_s(3)))),
        proptest::collection::vec(0u64..500, 1..80).prop_map(|at| {
            let at = at.into_iter().map(Nanos::from_ms).collect();
            Capacity::Trace(Trace::opportunities("t", at, Nanos::from_ms(500)).unwrap())
        }),
    ]
}

fn path() -> impl Strategy<Value = PathConfig> {
    let loss = prop_oneof![
        Just(LossModel::None),
        (0.0..1.0f64).prop_map(LossModel::Iid),
        (0.0..1.0f64, 0.0..1.0f64).prop_map(|(enter_bad, leave_bad)| LossModel::GilbertElliott {
            enter_bad,
            leave_bad,
            loss_good: 0.01,
            loss_bad: 0.7,
        }),
    ];
    let reorder = proptest::option::of(
        (0.0..1.0f64, 0u64..30_000)
            .prop_map(|(probability, us)| Reordering { probability, extra: Nanos::from_us(us) }),
    );
    let recorded = Replay::load("t", b"0 1 0 0\n0.1 1 0 30\n", &Limits::default());
    let fading = recorded.ok().and_then(|replay| replay.loss).unwrap();
    let varying = DelayTrace::load(b"12\n9\n43\n", Nanos::from_ms(10), &Limits::default()).unwrap();
    (capacity(), 0u64..20_000, 0u32..20, loss, reorder, 0u64..40, 0u64..5, any::<bool>()).prop_map(
        move |(capacity, bytes, datagrams, loss, reorder, delay, jitter, follow)| PathConfig {
            capacity,
            light: (bytes % 3 == 0).then(|| LightLoad {
                rate: Rate::from_kbps(bytes),
                burst: Bytes(bytes),
                pause: Nanos::from_ms(delay),
            }),
            queue: QueueLimit { bytes, datagrams },
            loss,
            delay: Nanos::from_ms(delay),
            delay_trace: follow.then(|| varying.clone()),
            loss_trace: follow.then(|| fading.clone()),
            jitter: Nanos::from_ms(jitter),
            reorder,
        },
    )
}

/// Feeds arrivals and wakes in time order; returns (time, tag) of what comes out.
fn drive(chain: &mut Chain, arrivals: &[(Nanos, u32)], until: Nanos) -> Vec<(Nanos, u64)> {
    let mut out = Vec::new();
    let mut arrivals = arrivals.iter().enumerate().peekable();
    let mut now = Nanos::ZERO;
    loop {
        let mut input = arrivals
            .next_if(|(_, (at, _))| *at <= now)
            .map(|(tag, (_, bytes))| Datagram { tag: tag as u64, bytes: *bytes });
        let more = input.is_some();
        let wake = loop {
            match chain.step(input.take(), now) {
                BoxOutput::Datagram(datagram) => out.push((now, datagram.tag)),
                BoxOutput::Wake(at) => break at,
                BoxOutput::Idle => break Nanos::MAX,
            }
        };
        assert!(wake > now, "a box asked to be woken at {wake}, and it is {now}");
        for (label, counts) in chain.box_counts() {
            assert!(counts.balanced(), "{label}: {counts:?}");
        }
        assert!(chain.counts().balanced());
        if !more {
            now = arrivals.peek().map_or(Nanos::MAX, |(_, (at, _))| *at).min(wake);
            if now > until {
                return out;
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn carrying_is_stepping_until_nothing_comes_out(
        path in path(),
        seed: u64,
        calls in proptest::collection::vec((0u64..20_000, proptest::option::of(1u32..1500)), 1..200),
    ) {
        let [mut quick, mut plain] = [(); 2].map(|()| path.build("path", seed).unwrap());
        let mut now = Nanos::ZERO;
        for (tag, (us, bytes)) in (0u64..).zip(&calls) {
            now += Nanos::from_us(*us);
            let mut input = bytes.map(|bytes| Datagram { tag, bytes });
            let mut carried = Vec::new();
            quick.carry(input, now, |datagram| carried.push(datagram));
            let mut stepped = Vec::new();
            let expected = loop {
                match plain.step(input.take(), now) {
                    BoxOutput::Datagram(datagram) => stepped.push(datagram),
                    BoxOutput::Wake(at) => break at,
                    BoxOutput::Idle => break Nanos::MAX,
                }
            };
            prop_assert_eq!((quick.next_wake(), carried), (expected, stepped));
            prop_assert_eq!(quick.counts(), plain.counts());
        }
    }

    #[test]
    fn every_datagram_is_delivered_dropped_or_held(
        path in path(),
        seed: u64,
        mut arrivals in proptest::collection::vec((0u64..400_000, 1u32..1500), 1..120),
    ) {
        arrivals.sort_unstable();
        let arrivals: Vec<_> = arrivals.into_iter().map(|(us, bytes)| (Nanos::from_us(us), bytes)).collect();
        let run = || {
            let mut chain = path.build("path", seed).unwrap();
            let out = drive(&mut chain, &arrivals, Nanos::from_s(60));
            (out, chain.counts())
        };
        let (out, counts) = run();
        prop_assert_eq!(counts.received.datagrams, arrivals.len() as u64);
        prop_assert_eq!(counts.delivered.datagrams, out.len() as u64);
        let mut tags: Vec<u64> = out.iter().map(|(_, tag)| *tag).collect();
        prop_assert!(out.windows(2).all(|pair| pair[0].0 <= pair[1].0));
        if path.reorder.is_none() {
            prop_assert!(tags.is_sorted(), "only the reordering box may reorder");
        }
        tags.sort_unstable();
        tags.dedup();
        prop_assert_eq!(tags.len(), out.len(), "nothing comes out twice");
        prop_assert_eq!(run(), (out, counts), "the same seed gives the same run");
    }
}

#[test]
fn a_box_more_changes_no_other_boxs_draws() {
    let lossy = PathConfig {
        capacity: Capacity::Unlimited,
        loss: LossModel::Iid(0.3),
        delay: Nanos::ZERO,
        ..PathConfig::default()
    };
    let jittery = PathConfig { jitter: Nanos::from_ms(3), ..lossy.clone() };
    let arrivals: Vec<_> = (0..500).map(|ms| (Nanos::from_ms(ms), 100)).collect();
    let survivors = |path: &PathConfig| -> Vec<u64> {
        let mut chain = path.build("p", 9).unwrap();
        drive(&mut chain, &arrivals, Nanos::from_s(10)).into_iter().map(|(_, tag)| tag).collect()
    };
    assert_eq!(survivors(&lossy), survivors(&jittery));
}

#[test]
fn a_full_queue_drops_at_the_tail_and_illegal_chances_are_named() {
    let path = PathConfig {
        capacity: Capacity::Constant(Rate::from_mbps(12)),
        queue: QueueLimit { bytes: 3000, datagrams: 10 },
        delay: Nanos::ZERO,
        ..PathConfig::default()
    };
    let mut chain = path.build("p", 1).unwrap();
    let out = drive(&mut chain, &[(Nanos::ZERO, 1500); 5], Nanos::from_s(1));
    assert_eq!(out, [(1, 0), (2, 1), (3, 2)].map(|(ms, tag)| (Nanos::from_ms(ms), tag)));
    let error = PathConfig { loss: LossModel::Iid(1.5), ..path }.build("p", 1).err().unwrap();
    assert_eq!(error.to_string(), "loss is 1.5, allowed 0 to 1");
}
