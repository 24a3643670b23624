//! JSON that programs read, against its schemas: manifest, packets, frames, and what every verb prints.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::{path::Path, process::Command};

use jsonschema::{Registry, Validator};
use serde_json::{Value, json};

/// The validator of schema `name`, which may refer to the others.
fn validator(name: &str) -> Validator {
    let read = |name: &str| -> Value {
        let path = Path::new("tests/schemas").join(format!("{name}.schema.json"));
        serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
    };
    let mut registry = Registry::new();
    for other in ["packet", "frame", "report"] {
        let schema = read(other);
        registry = registry.add(schema["$id"].as_str().unwrap(), schema.clone()).unwrap();
    }
    let registry = registry.prepare().unwrap();
    jsonschema::options().with_registry(&registry).build(&read(name)).unwrap()
}

/// What `validator` has against `value`, with its place.
fn complaints(validator: &Validator, value: &Value) -> Vec<String> {
    validator.iter_errors(value).map(|error| format!("{}: {error}", error.instance_path())).collect()
}

fn dgs(folder: &Path, args: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(folder).args(args).output().unwrap();
    assert!(output.status.success(), "dgs {args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// The manifest documents of a golden stream and of what the encoder writes now.
fn manifest(folder: &Path, stream: &Path) -> Value {
    dgs(folder, &["inspect", stream.to_str().unwrap(), "--manifest", "manifest.json"]);
    serde_json::from_str(&std::fs::read_to_string(folder.join("manifest.json")).unwrap()).unwrap()
}

#[test]
fn manifests_of_golden_streams_are_as_their_schema_says() {
    let folder = tempfile::tempdir().unwrap();
    let manifests = validator("manifest");
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("codec-core/tests/conformance");
    for name in ["everything", "cauchy", "paper", "made-table-sets", "made-extents", "made-levels-left-out"] {
        let document = manifest(folder.path(), &golden.join(format!("{name}.dgs")));
        assert_eq!(complaints(&manifests, &document), [""; 0], "{name}");
        // Each group has the packets that bring it, and each packet is in the groups that it brings.
        let brought =
            document["groups"].as_array().unwrap().iter().map(|g| g["packets"].as_array().unwrap().len());
        let slices =
            document["packets"].as_array().unwrap().iter().map(|p| p["slices"].as_array().unwrap().len());
        let brought: usize = brought.sum();
        assert!(brought > 0 && brought == slices.sum::<usize>(), "{name}");
    }
}

#[test]
fn a_session_is_as_its_schemas_say() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    dgs(at, &["encode", "synth:figure:1000:8", "--out", "a.dgs", "--repair-set", "4"]);
    let document = manifest(at, &at.join("a.dgs"));
    assert_eq!(complaints(&validator("manifest"), &document), [""; 0]);
    let said: Value = serde_json::from_str(&dgs(at, &["--json", "stream", "a.dgs"])).unwrap();
    assert_eq!(complaints(&validator("report"), &said["report"]), [""; 0]);
    assert_eq!(said["report"]["frames"].as_array().unwrap().len(), 8);
}

#[test]
fn a_comparison_is_as_its_schema_says() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    dgs(at, &["encode", "synth:figure:1000:3", "--out", "a.dgs", "--pictures", "0"]);
    let comparisons = validator("compare");
    let small = ["--width", "32", "--height", "32"];
    let same = ["--json", "compare", "synth:figure:1000:3", "synth:figure:1000:3"];
    let other = ["--json", "compare", "a.dgs", "synth:figure:1000:3"];
    for args in [same, other] {
        let said: Value = serde_json::from_str(&dgs(at, &[&args[..], &small].concat())).unwrap();
        assert_eq!(complaints(&comparisons, &said), [""; 0]);
        assert_eq!(said["gaussians"].is_null(), args == other);
        let mut damaged = said;
        damaged["pictures"][0]["flip"] = json!(1.5);
        assert!(complaints(&comparisons, &damaged)[0].starts_with("/pictures/0/flip"));
    }
}

/// The verb of `args` by the binary, with `--json`.
fn said(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&dgs(folder, &[&["--json"], args].concat())).unwrap()
}

#[test]
fn what_verbs_print_is_as_their_schemas_say() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let quick = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/sweeps/quick.toml");
    let few = std::fs::read_to_string(quick).unwrap().replace("replicates = 3", "replicates = 1");
    std::fs::write(at.join("few.toml"), few).unwrap();
    let small = ["--width", "32", "--height", "32"];
    let scene = "synth:figure:1000:4";
    let runs: [(&str, &[&str]); 19] = [
        ("import", &[scene]),
        ("convert", &[scene, "a.gltf"]),
        ("convert", &[scene, "frames"]),
        ("encode", &[scene, "-o", "a.dgs", "--pictures", "0", "--repair-set", "4"]),
        ("encode", &[scene, "-o", "b.dgs", "--pictures", "0", "--utility", "--table"]),
        ("inspect", &["a.dgs"]),
        ("cut", &["a.dgs", "c.dgs", "--frames", "0..1"]),
        ("cut", &["b.dgs", "c.dgs", "--levels", "0"]),
        ("cut", &["b.dgs", "d.dgs", "--bytes", "4000"]),
        ("decode", &["a.dgs", "--digest"]),
        ("decode", &["a.dgs", "--digest", "--frame", "1"]),
        ("decode", &["a.dgs", "-o", "decoded"]),
        ("render", &["a.dgs", "-o", "a.png"]),
        ("stream", &["a.dgs"]),
        ("stream", &["a.dgs", "--out", "s.dgs", "--states", "s.json", "--turntable", "1"]),
        ("demo", &["--scene", scene, "--out", "report", "--contexts", "1", "--pictures", "0"]),
        ("train", &["synth:balls:1000:2", "-o", "trained", "--steps", "4", "--side", "32", "--cameras", "2"]),
        ("sweep", &["few.toml", "-o", "swept"]),
        ("sweep", &["merge", "swept", "-o", "merged"]),
    ];
    for (verb, args) in runs {
        let has_size = verb == "render" || args.contains(&"--turntable");
        let size: &[&str] = if has_size { &small } else { &[] };
        let mut said = said(at, &[&[verb], args, size].concat());
        let schema = validator(verb);
        assert_eq!(complaints(&schema, &said), [""; 0], "{verb} {args:?}: {said}");
        said["undocumented"] = json!(1);
        assert!(!schema.is_valid(&said), "{verb}: a key without a description");
    }
}

/// A server says what it did when it is interrupted, a viewer when the clip has ended.
#[cfg(unix)]
#[test]
fn a_server_and_its_viewer_are_as_their_schemas_say() {
    use std::{
        io::{BufRead, BufReader, Read},
        process::Stdio,
    };

    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    dgs(at, &["encode", "synth:figure:1000:4", "--out", "a.dgs", "--pictures", "0"]);
    let mut server = Command::new(env!("CARGO_BIN_EXE_dgs"))
        .current_dir(at)
        .args(["--json", "serve", "a.dgs", "--listen", "127.0.0.1:0"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // Standard output is for the end: where it is served is on standard error.
    let lines = BufReader::new(server.stderr.take().unwrap()).lines();
    let url =
        lines.map_while(Result::ok).find_map(|line| line.find("dgs://").map(|at| line[at..].to_owned()));
    let played = said(at, &["play", url.unwrap().trim()]);
    let ended = Command::new("kill").args(["-INT", &server.id().to_string()]).status().unwrap();
    assert!(ended.success() && server.wait().unwrap().success());
    let mut served = String::new();
    server.stdout.take().unwrap().read_to_string(&mut served).unwrap();
    for (verb, said) in [("play", played), ("serve", serde_json::from_str(&served).unwrap())] {
        assert_eq!(complaints(&validator(verb), &said), [""; 0], "{verb}: {said}");
    }
}

/// What is wrong in one place is refused there.
#[test]
fn wrong_documents_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("codec-core/tests/conformance/cauchy.dgs");
    let document = manifest(folder.path(), &golden);
    let manifests = validator("manifest");
    for (place, wrong) in [
        ("/version", json!(3)),
        ("/epochs/0/clusters/0/gaussians", json!(0)),
        ("/windows/0/motions/0/track", json!("bent")),
        ("/quantisation_profiles/0/canonical/0/step", json!(0.0)),
        ("/table_sets/0/choices/0/code_length", json!(8)),
        ("/repair_ranges/0/parity", json!(9)),
        ("/groups/0/level", json!(4)),
        ("/packets/0/bytes", json!(1281)),
    ] {
        let mut damaged = document.clone();
        *damaged.pointer_mut(place).unwrap() = wrong;
        let found = complaints(&manifests, &damaged);
        assert!(found.iter().any(|complaint| complaint.starts_with(place)), "{place}: {found:?}");
    }
    let mut unknown = document;
    unknown["surprise"] = json!(1);
    assert!(!manifests.is_valid(&unknown));
    assert!(!validator("frame").is_valid(&json!({ "frame": 1 })));
}
