//! Loaders against arbitrary bytes, and against measured traces where they are at hand.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use std::path::{Path, PathBuf};

use emulator_host::{
    SessionConfig, Trace,
    clock::Nanos,
    graph::Synthetic,
    link::{Capacity, PathConfig},
    simulate,
    trace::{self, DelayTrace, Direction, HoldDirection, Limits, Replay, Warning},
};
use proptest::prelude::*;

fn all_loaders(bytes: &[u8]) {
    let limits = Limits { points: 5000, ..Limits::default() };
    let traces = [
        Trace::mahimahi("t", bytes, &limits),
        Trace::two_column("t", bytes, HoldDirection::Forward, &limits),
        Trace::two_column("t", bytes, HoldDirection::Backward, &limits),
        Trace::ucc("t", bytes, Direction::Down, &limits),
    ];
    for trace in traces.into_iter().flatten() {
        let _ = trace.window(Nanos(trace.period().0 / 3), trace.period());
        let _ = trace.mean_rate();
    }
    let _ = DelayTrace::load(bytes, Nanos::from_ms(10), &limits);
    if let Ok(replay) = Replay::load("t", bytes, &limits) {
        let _ = replay.starting_at(Nanos(replay.capacity.period().0 / 3));
    }
}

proptest! {
    #[test]
    fn no_bytes_make_a_loader_panic(bytes in proptest::collection::vec(any::<u8>(), 0..400)) {
        all_loaders(&bytes);
    }

    #[test]
    fn nor_does_text_that_looks_right(
        rows in proptest::collection::vec(("[0-9.e-]{0,9}", "[ ,\t]", "[0-9.einfa-]{0,9}"), 0..40),
    ) {
        all_loaders(rows.iter().map(|(a, b, c)| format!("{a}{b}{c}\n")).collect::<String>().as_bytes());
    }

    #[test]
    fn nor_do_logs(
        rows in proptest::collection::vec((0u32..3, 0u32..61, "[0-9-]{1,9}", "[DI]", "[0-9.-]{1,5}"), 0..60),
    ) {
        let mut text = "Timestamp,DL_bitrate,State,PINGAVG,UL_bitrate\n".to_owned();
        for (minute, second, rate, state, ping) in rows {
            text += &format!("2020.02.14_09.{minute:02}.{second:02},{rate},{state},{ping},1\n");
        }
        all_loaders(text.as_bytes());
    }
}

/// The folder of measured traces. Without it these tests say so and pass, unless DGS_REQUIRE_DATA=1.
fn data() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/traces");
    if folder.is_dir() {
        return Some(folder);
    }
    assert!(std::env::var_os("DGS_REQUIRE_DATA").is_none_or(|value| value != "1"), "no traces at {folder:?}");
    println!("SKIPPED: no traces at {}", folder.display());
    None
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    found.sort();
    found
}

fn bytes(path: &Path) -> Vec<u8> {
    trace::read(path, &Limits::default()).unwrap()
}

fn mbps(trace: &Trace) -> f64 {
    trace.mean_rate().0 as f64 / 1e6
}

#[test]
fn measured_opportunities_have_their_published_means() {
    let Some(folder) = data() else { return };
    for (file, mean) in [
        ("mahimahi_lte/ATT-LTE-driving-2016.down", 4.56),
        ("mahimahi_lte/ATT-LTE-driving-2016.up", 1.91),
        ("mahimahi_lte/TMobile-LTE-short.down", 16.70),
        ("mahimahi_lte/TMobile-LTE-short.up", 13.32),
        ("mahimahi_lte/Verizon-LTE-short.down", 5.03),
        ("mahimahi_lte/Verizon-LTE-short.up", 5.95),
        ("starlink_leocc/bw_example.0-60s.txt", 48.24),
    ] {
        let trace = Trace::mahimahi(file, &bytes(&folder.join(file)), &Limits::default()).unwrap();
        assert!((mbps(&trace) - mean).abs() < 0.02 * mean, "{file}: {}", mbps(&trace));
    }
    let delays = bytes(&folder.join("starlink_leocc/delay_example.0-60s.txt"));
    let delays = DelayTrace::load(&delays, Nanos::from_ms(10), &Limits::default()).unwrap();
    assert_eq!(delays.at(Nanos::ZERO), Nanos::from_ms(12));
}

#[test]
fn measured_two_column_traces_all_load_and_no_unit_of_theirs_is_doubted() {
    let Some(folder) = data() else { return };
    let undoubted =
        |path: &Path, trace: &Trace| assert!(trace.warnings().is_empty(), "{path:?}: {:?}", trace.warnings());
    for path in files(&folder.join("wireless_zhuge")) {
        let trace = Trace::two_column("zhuge", &bytes(&path), HoldDirection::Backward, &Limits::default());
        undoubted(&path, &trace.unwrap());
    }
    for family in ["fcc", "hsdpa", "oboe", "puffer"] {
        for path in files(&folder.join("broadband_merina").join(family)) {
            let trace = Trace::two_column(family, &bytes(&path), HoldDirection::Forward, &Limits::default());
            undoubted(&path, &trace.unwrap_or_else(|error| panic!("{path:?}: {error}")));
        }
    }
    let office = bytes(&folder.join("wireless_zhuge/office-wifi_0.pitree-trace"));
    let office = Trace::two_column("office", &office, HoldDirection::Backward, &Limits::default()).unwrap();
    // 27.53 is the mean of the rows; the mean over time weighs each row by how long it holds.
    assert!((mbps(&office) - 27.53).abs() < 0.4, "{}", mbps(&office));
}

#[test]
fn measured_5g_logs_lose_their_ping_dips_and_the_idle_one_is_flagged() {
    let Some(folder) = data() else { return };
    for family in ["driving", "static"] {
        for path in files(&folder.join("ucc5g").join(family)) {
            let trace = Trace::ucc("ucc", &bytes(&path), Direction::Down, &Limits::default()).unwrap();
            let flagged = |warning: &Warning| matches!(warning, Warning::ApplicationLimited { .. });
            assert!(!trace.warnings().iter().any(flagged), "{path:?}: {:?}", trace.warnings());
            let repaired =
                |warning: &Warning| matches!(warning, Warning::PingDipsRepaired { seconds } if *seconds > 5);
            assert!(trace.warnings().iter().any(repaired), "{path:?}: {:?}", trace.warnings());
            let rtt = trace.base_rtt().unwrap().as_ms();
            assert!((40.0..200.0).contains(&rtt), "{path:?}: {rtt}");
        }
    }
    let netflix = files(&folder.join("ucc5g/app_limited")).remove(0);
    let trace = Trace::ucc("netflix", &bytes(&netflix), Direction::Down, &Limits::default()).unwrap();
    let warnings = trace.warnings();
    assert!(
        warnings.iter().any(|warning| matches!(warning, Warning::ApplicationLimited { idle } if *idle > 0.5))
    );
    assert!(
        warnings.iter().any(|warning| matches!(warning, Warning::LongZeroRun { seconds } if *seconds > 30))
    );
}

#[test]
fn a_delivery_over_a_measured_trace_repeats_to_the_bit() {
    let Some(folder) = data() else { return };
    let load = |file: &str| Trace::mahimahi(file, &bytes(&folder.join(file)), &Limits::default()).unwrap();
    let (down, up) = (load("mahimahi_lte/Verizon-LTE-short.down"), load("mahimahi_lte/Verizon-LTE-short.up"));
    let graph = Synthetic { frames: 300, ..Synthetic::default() }.build(1).unwrap();
    for offset in [0, 40, 90] {
        let offset = Nanos::from_s(offset);
        let path = |trace: &Trace| PathConfig {
            capacity: Capacity::Trace(trace.starting_at(offset).unwrap()),
            ..PathConfig::default()
        };
        let config = SessionConfig { forward: path(&down), reverse: path(&up), ..SessionConfig::default() };
        let (one, two) = (simulate(&graph, &config).unwrap(), simulate(&graph, &config).unwrap());
        assert_eq!(one.digest, two.digest);
        assert!(one.usable_goodput_bps > 0.0);
    }
}
