//! Streams over emulated links: recorded delays and losses, links in words, and what no schedule passes.

use super::run::{dgs, ok, refused, stopped};

#[test]
fn recorded_delays_and_losses_are_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("phone.txt"), "0 5 80 0\n0.5 4 120 2\n1 5 80 0\n").unwrap();
    std::fs::write(at.join("rate.txt"), "0 5\n1 5\n").unwrap();
    std::fs::write(at.join("leo.txt"), "12\n".repeat(50) + &"40\n".repeat(50)).unwrap();
    ok(at, &["encode", "synth:balls:1000:3", "--out", "a.dgs"]);
    let stream = |options: &[&str]| ok(at, &[&["stream", "a.dgs"], options].concat());
    let text = stream(&["--trace", "phone.txt"]);
    assert!(text.contains("0 ms one way and those of a trace, median 80 ms"), "{text}");
    assert!(text.contains("bursts of loss 0.0 % and those of the trace"), "{text}");
    let text = stream(&["--trace", "rate.txt", "--delay-trace", "leo.txt", "--delay-ms", "5"]);
    assert!(text.contains("5 ms one way and those of a trace, median 40 ms"), "{text}");
    assert!(text.contains("bursts of loss 0.0 %"), "a recording is replayed as it is: {text}");
    let text = stream(&["--trace", "rate.txt", "--burst-loss", "0.02"]);
    assert!(text.contains("bursts of loss 2.0 %"), "{text}");
    let text = stream(&["--delay-trace", "leo.txt"]);
    assert!(text.contains("bursts of loss 2.0 %"), "the built-in link loses: {text}");
    let text = refused(at, &["stream", "a.dgs", "--trace", "phone.txt", "--delay-trace", "leo.txt"]);
    assert!(text.contains("phone.txt has delays, and so has leo.txt"), "{text}");
    let text = refused(at, &["stream", "a.dgs", "--delay-trace", "phone.txt"]);
    assert!(text.contains("phone.txt: not a usable trace of delays") && text.contains("line 1"), "{text}");
    let scream = stream(&["--trace", "rate.txt", "--controller", "scream"]);
    assert!(scream.contains("startup"), "{scream}");
}

/// A link in the words of `dgs serve --impair`, what it lost, and what runs over dead links say.
#[test]
fn a_stream_is_sent_over_a_described_link() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:cloth:3000:20", "--out", "a.dgs", "--pictures", "2"]);
    let stream = |options: &[&str]| ok(at, &[&["stream", "a.dgs"], options].concat());
    let lossy = ["--impair", "loss=20%,burst=4,rate=3mbit,delay=35ms,seed=1"];
    let text = stream(&lossy);
    assert!(
        text.contains("mean 3.00 Mbit/s, 35 ms one way, queue 250 ms (94 kB), loss 20.0 % in bursts"),
        "{text}"
    );
    let json: serde_json::Value = serde_json::from_str(&stream(&[&lossy[..], &["--json"]].concat())).unwrap();
    let (lost, delay) = (&json["lost_datagrams"], &json["one_way_delay_ms"]);
    let count = |key: &str| lost[key].as_u64().unwrap();
    assert!(count("way") > 0, "{json}");
    let said = format!(
        "lost {} datagrams: {} in the queue, {} on",
        count("way") + count("queue"),
        count("queue"),
        count("way")
    );
    assert!(text.contains(&said) && text.contains("; one way "), "{said}: {text}");
    // Without a table all groups count the same, and none of them harms.
    let [positive, all] =
        [&json["positive_miss_rate"], &json["report"]["miss_rate"]].map(|v| v.as_f64().unwrap());
    assert!(
        (positive - all).abs() < 1e-12 && text.contains("(of positive utility "),
        "{positive} {all}: {text}"
    );
    assert!(delay["median"].as_f64() >= Some(35.0) && delay["p95"].as_f64() >= delay["median"].as_f64());
    // What no schedule passes: less where the link carries less; not computed for another transport.
    let bounded = |options: &[&str]| {
        let json: serde_json::Value =
            serde_json::from_str(&stream(&[options, &["--json"]].concat())).unwrap();
        (json["report"]["utility"].as_f64().unwrap(), json["utility_bound"].as_f64())
    };
    let ((shown, most), (shown_slow, most_slow)) = (bounded(&lossy), bounded(&["--impair", "rate=60kbit"]));
    let (most, most_slow) = (most.unwrap(), most_slow.unwrap());
    assert!(shown <= most && most <= 1.0 + 1e-6 && shown_slow <= most_slow, "{most} {most_slow}");
    assert!(most_slow < most - 0.1, "{most_slow} {most}");
    assert!(text.contains(&format!("(at most {most:.3} by any schedule)")), "{text}");
    assert_eq!(bounded(&["--impair", "rate=3mbit", "--transport", "quic"]).1, None);
    assert!(stopped(at, &["stream", "a.dgs", "--impair", "loss=1%", "--load", "2"], 64).contains("--load"));
    assert!(stream(&["--impair", "delay=5ms"]).contains("without a limit of rate, 5 ms one way, no loss"));

    // The manifest does not arrive: nothing is written over what is there.
    std::fs::write(at.join("old.dgs"), b"as before").unwrap();
    std::fs::write(at.join("dead.txt"), "0 0\n3000 1\n").unwrap();
    let output = dgs(at, &["stream", "a.dgs", "--trace", "dead.txt", "--out", "old.dgs"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("the manifest did not arrive complete: old.dgs is not written"), "{text}");
    assert!(text.contains("not reached in 5000 ms") && text.contains("link (it carried nothing)"), "{text}");
    assert_eq!(std::fs::read(at.join("old.dgs")).unwrap(), b"as before");

    let unused = ["--packet-bytes", "900", "--repair", "none", "--width", "9", "--load", "2", "--scale", "1"];
    let output = dgs(at, &[&["stream", "a.dgs"][..], &unused].concat());
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    for words in ["for scenes: --packet-bytes, --repair", "viewer (--eye", ": --width", "--load is not used"]
    {
        assert!(said.contains(words), "{words}: {said}");
    }
}

/// Encoding and measuring take minutes; here there is not even a scene.
#[test]
fn what_a_scene_would_be_encoded_for_in_vain_is_refused_before() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (typed, says) in [
        (&["--trace", "nofile"][..], "nofile: "),
        (&["--delay-trace", "nofile"], "nofile: "),
        (&["--impair", "trace=nofile"], "--impair: \"nofile\" is no trace that can be used"),
        (&["--scale", "1e9"], "--scale 1000000000.0: bursty"),
        (&["--transport", "quic", "--controller", "bbr-model"], "quic: controller is bbr-model; over quinn"),
        (
            &["--impair", "rate=1mbit", "--transport", "quic", "--controller", "bbr-paper"],
            "is bbr-paper; over",
        ),
        (&["--cameras", "nofile.json"], "nofile.json: cannot read"),
        (&["--eye", "1,1,1", "--target", "1,1,1"], "--eye, --target, --up: look_at: "),
    ] {
        let text = refused(at, &[&["stream", "none"], typed].concat());
        assert!(text.contains(says), "{typed:?}: {text}");
    }
    // A viewer of a file is the one that is watched.
    let text = r#"{"camera_angle_x": 0.8, "w": 8, "h": 6, "frames": [{"file_path": "a",
        "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]}]}"#;
    std::fs::write(at.join("transforms.json"), text).unwrap();
    ok(at, &["encode", "synth:figure:1000:2", "--out", "a.dgs", "--pictures", "0"]);
    let text = ok(at, &["stream", "a.dgs", "--cameras", "transforms.json"]);
    assert!(text.contains("seen from there: PSNR"), "{text}");
}
