//! `dgs train --delivery --choose-rank`: the rank of the shared temporal basis by validation.

use std::fs;

use super::{dgs, ok, refused, train};

/// Every rank is tried with every seed, one is taken by the rule that is written down, and none is measured
/// again.
#[test]
fn the_rank_is_chosen_by_validation() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = r#"{"updates": 1, "worlds": 1, "validation": {"every": 4, "states": 1, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let args = ["-o", "out", "--delivery", "config.json", "--references", "8", "--choose-rank"];
    let text = ok(at, &args);
    let json = |file: &str| -> serde_json::Value {
        serde_json::from_slice(&fs::read(at.join(file)).unwrap()).unwrap()
    };
    let ranks = json("out/ranks.json");
    let results = ranks["results"].as_array().unwrap();
    let seen: Vec<_> =
        results.iter().map(|r| (r["rank"].as_u64().unwrap(), r["seed"].as_u64().unwrap())).collect();
    assert_eq!(seen, (0..=8).flat_map(|rank| (1..=3).map(move |seed| (rank, seed))).collect::<Vec<_>>());
    let rank = ranks["choice"]["rank"].as_u64().unwrap();
    assert!(text.contains(&format!("rank {rank} of 0 to 8, each with three seeds")), "{text}");
    let alone = ["-o", "alone", "--delivery", "config.json", "--references", "8"];
    let of_alone = ok(at, &[&alone[..], &["--rank", &rank.to_string()]].concat());
    let before = |text: &str| {
        text.lines().find(|line| line.contains("all packets, before")).unwrap_or(text).to_owned()
    };
    assert_eq!(before(&text), before(&of_alone), "the scene as it was given has the rank that was chosen");
    let stream = |of: &str| fs::read(at.join(of).join("scene.dgs")).unwrap();
    assert!(stream("out") == stream("alone"), "the same as with this rank typed");

    // What was measured counts: with other results another rank is taken. The fine-tuning begins anew.
    fs::remove_file(at.join("out/delivery.dgst")).unwrap();
    let mut other = ranks.clone();
    for result in other["results"].as_array_mut().unwrap() {
        if result["rank"] == (rank + 1) % 9 {
            result["p10_db"] = 99.0.into();
        }
    }
    fs::write(at.join("out/ranks.json"), other.to_string()).unwrap();
    let text = ok(at, &[&args[..], &["--resume"]].concat());
    assert!(text.contains(&format!("rank {} of 0 to 8", (rank + 1) % 9)), "{text}");
    // Those of others do not, nor those measured on other pictures.
    let error = refused(at, &[&args[..], &["--resume", "--max-side", "32"]].concat());
    assert!(error.contains("ranks.json: without this file ranks are measured anew"), "{error}");
    let error =
        refused(at, &["-o", "out", "--delivery", "iid", "--references", "8", "--choose-rank", "--resume"]);
    assert!(error.contains("ranks.json: without this file ranks are measured anew"), "{error}");
    other["results"][0]["rank"] = 1_000_000.into();
    fs::write(at.join("out/ranks.json"), other.to_string()).unwrap();
    let error = refused(at, &[&args[..], &["--resume"]].concat());
    assert!(error.contains("ranks.json") && error.contains("not of ranks and seeds"), "{error}");
    // Nothing to compare ranks by.
    let config = r#"{"updates": 1, "worlds": 1, "validation": {"every": 9, "states": 1, "candidates": 0}}"#;
    fs::write(at.join("few.json"), config).unwrap();
    let few = ["-o", "x", "--delivery", "few.json", "--references", "6", "--choose-rank"];
    let error = refused(at, &few);
    assert!(error.contains("6 training views; at least 9"), "{error}");
    let both = train(at, &["-o", "x", "--delivery", "iid", "--choose-rank", "--rank", "3"]);
    assert_eq!(both.status.code(), Some(64), "{both:?}");
}

/// A sheet that waves in four modes, not all of them large: a basis that is too short for them costs much,
/// and vectors that show nothing are not taken.
#[test]
fn a_sheet_of_four_modes_takes_as_many_vectors_as_show() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = r#"{"updates": 1, "worlds": 1, "learn_steps": false,
        "validation": {"every": 4, "states": 2, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let args =
        ["train", "synth:cloth:1000:12", "-o", "out", "--delivery", "config.json", "--references", "8"];
    let small = ["--choose-rank", "--side", "32", "--cameras", "2", "--pictures", "0"];
    let output = dgs(at, &[&args[..], &small].concat());
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let ranks: serde_json::Value =
        serde_json::from_slice(&fs::read(at.join("out/ranks.json")).unwrap()).unwrap();
    let rank = ranks["choice"]["rank"].as_u64().unwrap();
    assert!((2..=4).contains(&rank), "{ranks}");
    let quality = |rank: u64| {
        let own = ranks["results"].as_array().unwrap().iter().filter(|result| result["rank"] == rank);
        own.map(|result| result["p10_db"].as_f64().unwrap()).sum::<f64>() / 3.0
    };
    assert!(quality(0) + 2.0 < quality(rank), "{ranks}");
    assert!(quality(1) + 0.2 < quality(rank), "{ranks}");
}
