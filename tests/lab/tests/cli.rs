//! The laboratory as typed: what it lists, what it refuses, what it prints.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::process::{Command, Output};

fn lab(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dgs-lab")).args(args).output().unwrap()
}

#[test]
fn benches_are_listed_for_people_and_programs() {
    let text = String::from_utf8(lab(&["--list"]).stdout).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&lab(&["--list", "--json"]).stdout).unwrap();
    let names: Vec<&str> = json.as_array().unwrap().iter().map(|pair| pair[0].as_str().unwrap()).collect();
    assert!(names.contains(&"rate") && names.contains(&"transport"), "{names:?}");
    assert_eq!(text.lines().count(), names.len());
    for (line, name) in text.lines().zip(names) {
        assert_eq!(line.split_whitespace().next(), Some(name));
    }
}

#[test]
fn an_unknown_bench_is_refused_and_no_bench_is_not_a_command() {
    let output = lab(&["nothing"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("\"nothing\"") && text.contains("rate"), "{text}");
    assert_eq!(lab(&[]).status.code(), Some(64));
}

#[test]
fn a_part_is_chosen_of_benches_that_have_parts() {
    let says = |args: &[&str]| {
        let output = lab(args);
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(says(&["rate", "--only", "fox"]).contains("for workloads and erasure; rate is run as a whole"));
    let unknown = says(&["erasure", "--quick", "--only", "balls"]);
    let parts = "sheet.none, sheet.standard, sheet.strong, sheet.full";
    let expected = format!("\"balls\"; part of one of {parts} is allowed with --quick");
    assert!(unknown.contains(&expected), "{unknown}");
}

#[test]
fn a_bench_prints_its_figures_as_json_and_nothing_else() {
    let output = lab(&["repair", "--quick", "--json"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json[0]["name"], "repair");
    assert!(!json[0]["figures"].as_array().unwrap().is_empty());
}
