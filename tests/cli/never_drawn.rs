//! Tests scenes of which some Gaussians, or all of some frames, are never drawn.

use super::{ok, refused};

/// A PLY of Gaussians in a row, of these opacity logits.
fn row_of(logits: &[f32]) -> Vec<u8> {
    let names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"];
    let mut ply = format!("ply\nformat binary_little_endian 1.0\nelement vertex {}\n", logits.len());
    for name in names.into_iter().chain(["rot_0", "rot_1", "rot_2", "rot_3"]) {
        ply += &format!("property float {name}\n");
    }
    let mut bytes = (ply + "end_header\n").into_bytes();
    for (i, &logit) in logits.iter().enumerate() {
        let values = [i as f32, 0.0, 0.0, 0.5, 0.2, 0.1, logit, -2.0, -2.0, -2.0, 1.0, 0.0, 0.0, 0.0];
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    bytes
}

/// Gaussians that are never drawn are in no decision and are no other scene; where all are such, it is said.
#[test]
fn decisions_replay_where_gaussians_are_never_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let write = |name: &str, logits: &[f32]| std::fs::write(at.join(name), row_of(logits)).unwrap();
    write("a.ply", &[2.0, -8.0, 3.0, 2.0, -8.0]);
    write("other.ply", &[2.0, -8.0, 3.0, 2.0]);
    write("none.ply", &[-8.0; 4]);
    ok(at, &["encode", "a.ply", "-o", "a.dgs", "--pictures", "0", "--decisions-out", "a.json"]);
    ok(at, &["encode", "a.ply", "-o", "b.dgs", "--decisions", "a.json"]);
    assert_eq!(std::fs::read(at.join("a.dgs")).unwrap(), std::fs::read(at.join("b.dgs")).unwrap());
    let error = refused(at, &["encode", "other.ply", "-o", "c.dgs", "--decisions", "a.json"]);
    assert!(error.contains("the scene has 4 Gaussians; the decisions are for 5"), "{error}");
    // Files that do not say of how many Gaussians they are know those in clusters.
    let text = std::fs::read_to_string(at.join("a.json")).unwrap();
    let mut json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["made_from"]["epoch_gaussians"], serde_json::json!([5]));
    json["made_from"].as_object_mut().unwrap().remove("epoch_gaussians");
    std::fs::write(at.join("old.json"), json.to_string()).unwrap();
    ok(at, &["encode", "a.ply", "-o", "b.dgs", "--decisions", "old.json"]);
    assert_eq!(std::fs::read(at.join("a.dgs")).unwrap(), std::fs::read(at.join("b.dgs")).unwrap());
    write("few.ply", &[2.0, -8.0]);
    let error = refused(at, &["encode", "few.ply", "-o", "c.dgs", "--decisions", "old.json"]);
    assert!(error.contains("the scene has 2 Gaussians; the decisions are for 3"), "{error}");
    let error = refused(at, &["encode", "none.ply", "-o", "c.dgs", "--pictures", "0"]);
    assert!(error.contains("every Gaussian stays below opacity 1/255"), "{error}");
}

/// Frames that show nothing are read again; Gaussians of different epochs are never taken for the same.
#[test]
fn frames_of_a_stream_come_back_as_what_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("in")).unwrap();
    for (i, logits) in [[2.0, 3.0, 2.0], [2.5, 3.0, 1.0], [-8.0; 3]].into_iter().enumerate() {
        std::fs::write(at.join(format!("in/f{i}.ply")), row_of(&logits)).unwrap();
    }
    let json = |args: &[&str]| -> serde_json::Value { serde_json::from_str(&ok(at, args)).unwrap() };
    let index = |folder: &str| -> serde_json::Value {
        serde_json::from_slice(&std::fs::read(at.join(folder).join("sequence.json")).unwrap()).unwrap()
    };
    let counts = |folder: &str| -> Vec<u64> {
        let said = json(&["--json", "import", folder]);
        said["epochs"].as_array().unwrap().iter().map(|e| e["gaussians"].as_u64().unwrap()).collect()
    };
    // Three epochs of a frame, the last of which shows nothing.
    ok(at, &["encode", "in", "-o", "a.dgs", "--pictures", "0", "--fps", "5"]);
    for (verb, out) in [("decode", "decoded"), ("convert", "converted")] {
        let to: &[&str] = if verb == "decode" { &["-o", out] } else { &[out] };
        ok(at, &[&[verb, "a.dgs"], to].concat());
        assert_eq!(index(out)["identity_stored"], serde_json::Value::Null, "{verb}");
        assert_eq!(index(out)["frames_per_second"], 5.0, "{verb}");
        assert_eq!(counts(out), [3, 3, 0], "{verb}");
    }
    // A file of one frame needs something in it; nothing is written.
    for name in ["x.ply", "x.spz", "x.compressed.ply", "x.glb"] {
        let error = refused(at, &["convert", "a.dgs", name, "--frame", "2"]);
        assert!(error.contains(name) && error.contains("no Gaussian is left"), "{error}");
        assert!(!at.join(name).exists(), "{name}");
    }
    // One epoch, of whose Gaussians all are there at each frame.
    ok(at, &["encode", "in", "-o", "b.dgs", "--pictures", "0", "--identity-stored"]);
    ok(at, &["decode", "b.dgs", "-o", "b"]);
    assert_eq!(counts("b").len(), if index("b")["identity_stored"] == true { 1 } else { 3 });
    // A Gaussian that some frames lack: rows are others, and the folder does not say that they are the same.
    ok(at, &["encode", "synth:births:1000:6", "-o", "c.dgs", "--pictures", "0"]);
    ok(at, &["decode", "c.dgs", "-o", "c"]);
    ok(at, &["import", "c"]);
}
