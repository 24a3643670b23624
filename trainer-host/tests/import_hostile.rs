//! Files made to be slow: geometry on which a neighbour search can degenerate. Each is legal, small, and
//! read at the sizes people use; that the work grows as n log n is counted beside the search itself.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::{
    io::{Cursor, Write},
    path::{Path, PathBuf},
};

use trainer_host::{
    Scene,
    import::{ImportOptions, Limits, gltf, import, points_npz},
};

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/hostile").join(name)
}

fn sampled(name: &str, samples: usize) -> Scene {
    let gltf = gltf::GltfOptions { samples, ..gltf::GltfOptions::default() };
    import(&file(name), &ImportOptions { gltf, ..ImportOptions::default() }).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn a_triangle_at_the_ends_of_the_range_of_floats() {
    let scene = sampled("hugepos.glb", 20_000);
    assert_eq!(scene.max_count(), 20_000);
    let largest = scene.instant(0).unwrap().gaussians.iter().map(|g| g.position[0]).fold(0.0, f32::max);
    assert!(largest > 1e38, "{largest}");
}

#[test]
fn three_thousand_nodes_show_one_triangle() {
    assert_eq!(sampled("nodes3000.glb", 20_000).max_count(), 20_000);
}

#[test]
fn all_points_lie_in_one_place() {
    let scene = import(&file("same20000.npz"), &ImportOptions::default()).unwrap();
    assert_eq!(scene.max_count(), 20_000);
    assert!(scene.instant(0).unwrap().gaussians.iter().all(|g| g.scale[0] > 0.0));
    // Ten times as many.
    let n = 200_000;
    let npy = |descr: &str, bytes: usize| {
        let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({n}, 3), }}\n");
        let start = [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()];
        [&start.concat()[..], &vec![0; n * 3 * bytes]].concat()
    };
    let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, bytes) in [("means3d.npy", npy("<f4", 4)), ("colors.npy", npy("|u1", 1))] {
        zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&bytes).unwrap();
    }
    let zipped = zip.finish().unwrap().into_inner();
    assert!(zipped.len() < 10_000);
    assert_eq!(points_npz::parse(&zipped, 30.0, &Limits::default()).unwrap().max_count(), n);
}
