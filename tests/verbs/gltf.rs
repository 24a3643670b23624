//! Tests glTF that is written as JSON with its buffer beside it.

use std::fs;

use super::run::{names, ok, stopped};

#[test]
fn the_buffer_of_a_gltf_is_never_written_over_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:balls:1000:1", "x.ply"]);
    let named = "mein Fuß #1.gltf";
    let text = ok(at, &["convert", "x.ply", named]);
    assert!(text.contains("wrote mein Fuß #1.gltf and mein Fuß #1.bin: 1000 Gaussians"), "{text}");
    let bytes = |name: &str| fs::read(at.join(name)).unwrap();
    let buffer = bytes("mein Fuß #1.bin");
    // Both are there: they belong together.
    ok(at, &["convert", "x.ply", named]);
    ok(at, &["convert", named, "y.ply"]);
    // The buffer of something else.
    fs::rename(at.join(named), at.join("other.gltf")).unwrap();
    assert!(stopped(at, &["convert", "x.ply", named], 1).contains("#1.bin: is there, and goes beside"));
    assert!(stopped(at, &["convert", "none.ply", named], 1).contains("--overwrite replaces it"));
    fs::rename(at.join("other.gltf"), at.join(named)).unwrap();
    assert!(stopped(at, &["convert", named, named, "--overwrite"], 1).contains("is read or written besides"));
    ok(at, &["convert", "y.ply", named, "--overwrite"]);
    assert!(bytes(named).len() > 1000 && bytes("mein Fuß #1.bin").len() == buffer.len());
    // What is read is never replaced, and neither file appears without the other.
    fs::rename(at.join("y.ply"), at.join("y.bin")).unwrap();
    let refused = stopped(at, &["convert", "y.bin", "y.gltf", "--overwrite"], 1);
    assert!(refused.contains("y.bin: is read or written besides"), "{refused}");
    ok(at, &["encode", "x.ply", "-o", "x.dgs", "--pictures", "0"]);
    fs::create_dir(at.join("z.bin")).unwrap();
    assert!(stopped(at, &["decode", "x.dgs", "-o", "z.gltf", "--overwrite"], 1).contains("is a folder"));
    assert!(ok(at, &["decode", "x.dgs", "-o", "w.gltf"]).contains("w.gltf and w.bin"));
    let left = ["mein Fuß #1.bin", named, "w.bin", "w.gltf", "x.dgs", "x.ply", "y.bin", "z.bin"];
    assert_eq!(names(at), left);
}
