//! Readers on real files. Where the files are not at hand the tests say so and pass;
//! `DGS_REQUIRE_DATA=1` turns that into a failure.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test stops where it fails")]

#[path = "import_real/direct.rs"]
mod direct;

use std::path::PathBuf;

use trainer_host::{
    Epoch, Scene,
    import::{Format, Identity, ImportOptions, Limits, gltf, import, nearest::Tree, ply, sniff},
    scene::Instant,
};

/// The folder of scenes, or `None` with a line that says so.
fn scenes(test: &str) -> Option<PathBuf> {
    let folder = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/scenes");
    if folder.is_dir() {
        return Some(folder);
    }
    let required = std::env::var("DGS_REQUIRE_DATA").is_ok_and(|v| v == "1");
    assert!(!required, "{test}: no scenes at {}", folder.display());
    println!("SKIPPED: {test}: no scenes at {}", folder.display());
    None
}

fn read(path: PathBuf) -> Scene {
    import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{e}"))
}

fn quantile(values: &mut [f32], q: f64) -> f32 {
    values.sort_by(f32::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}

/// The angle between two rotations, radians.
fn angle(a: [f32; 4], b: [f32; 4]) -> f32 {
    let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
    2.0 * dot.abs().min(1.0).acos()
}

fn bounds(instant: &Instant) -> ([f32; 3], [f32; 3]) {
    instant.gaussians.iter().fold(([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]), |(low, high), g| {
        ([0, 1, 2].map(|i| low[i].min(g.position[i])), [0, 1, 2].map(|i| high[i].max(g.position[i])))
    })
}

/// The same scene by two readers. The files list their Gaussians in the same order. SPZ has its axes
/// right-up-back, the PLY right-down-forward: half a turn about x lies between them, `(x, -y, -z)` for
/// points, `(w, x, -y, -z)` for rotations.
///
/// The SPZ was evidently made from the PLY, for every tolerance is SPZ's own rounding alone:
/// - position: half of 2^-12 units (12 fraction bits);
/// - log-scale: half of 1/16; below -10 SPZ has no step left and holds -10 (89 of 458,238 values);
/// - opacity: both hold the same byte;
/// - colour: half of 1/255 over 0.15, as display colour;
/// - rotation: e = half of √½/511 for each of three components, at most 3e for the one derived from
///   them: an angle of at most 2 √12 e. f32 `acos` adds 7e-4 near zero.
#[test]
fn two_encodings_of_the_biker_agree() {
    let Some(folder) = scenes("two_encodings_of_the_biker_agree") else { return };
    let ply = read(folder.join("splat-biker/biker.compressed.ply"));
    let spz = read(folder.join("splat-biker/biker.spz"));
    assert_eq!((ply.max_count(), spz.max_count()), (152_746, 152_746));
    let (a, b) = (ply.instant(0).unwrap().gaussians, spz.instant(0).unwrap().gaussians);
    let colour = |c: [f32; 3]| c.map(|v| 0.5 + 0.282_094_8 * v);
    let mut errors: [Vec<f32>; 5] = Default::default();
    for (x, y) in a.iter().zip(&b) {
        let ([px, py, pz], [w, qx, qy, qz]) = (x.position, x.rotation);
        let turned = [px, -py, -pz];
        let apart = |p: [f32; 3], q: [f32; 3]| [0, 1, 2].map(|i| (p[i] - q[i]).abs());
        errors[0].extend(apart(turned, y.position));
        errors[1].extend(apart(x.scale.map(|s| s.ln().max(-10.0)), y.scale.map(f32::ln)));
        errors[3].extend(apart(colour(x.sh0), colour(y.sh0)));
        errors[2].push((x.opacity - y.opacity).abs());
        errors[4].push(angle([w, qx, -qy, -qz], y.rotation));
    }
    let component = 0.5 * std::f32::consts::FRAC_1_SQRT_2 / 511.0;
    let tolerances = [
        ("position", 0.5 / 4096.0 + 1e-6),
        ("log-scale", 0.5 / 16.0 + 1e-4),
        ("opacity", 1e-6),
        ("display colour", 0.282_094_8 / 0.15 / 510.0 + 1e-5),
        ("angle", 2.0 * 12f32.sqrt() * component + 7e-4),
    ];
    for ((name, tolerance), errors) in tolerances.into_iter().zip(&mut errors) {
        let [median, high, worst] = [0.5, 0.99, 1.0].map(|q| quantile(errors, q));
        println!(
            "biker {name}: median {median:.2e}, 99 % {high:.2e}, worst {worst:.2e}, allowed {tolerance:.2e}"
        );
        assert!(worst <= tolerance, "{name}: {worst} above {tolerance}");
    }
    // The comparison can fail: without the half turn, nothing fits.
    let apart = a.iter().zip(&b).filter(|(x, y)| (x.position[1] - y.position[1]).abs() > 0.5 / 4096.0);
    assert!(apart.count() > 150_000);
}

#[test]
fn the_human_sequence_matches_its_decoded_sample() {
    let Some(folder) = scenes("the_human_sequence_matches_its_decoded_sample") else { return };
    let folder = folder.join("splat-seq-human");
    let scene = read(folder.clone());
    let counts: Vec<usize> = scene.epochs().iter().map(Epoch::count).collect();
    assert_eq!(counts, [59_580, 60_035, 60_654, 61_185, 62_416, 64_221, 65_712, 65_071]);
    assert!(scene.notes.iter().any(|n| n.contains("identity is not stored")), "{:?}", scene.notes);
    assert_eq!(scene.epochs()[0].attributes().sh_degree.get(), 3);
    assert_eq!(scene.epochs()[1].attributes().sh_degree.get(), 0);

    let bytes = std::fs::read(folder.join("000020_first256_decoded.ply")).unwrap();
    let sample = ply::parse(&bytes, &Limits::default()).unwrap().epoch.instant(0).gaussians;
    let frame = scene.instant(0).unwrap().gaussians;
    assert_eq!(sample.len(), 256);
    let mut worst = [0f32; 5];
    for (x, y) in sample.iter().zip(&frame) {
        let furthest = |p: [f32; 3], q: [f32; 3]| (0..3).map(|i| (p[i] - q[i]).abs()).fold(0.0, f32::max);
        let errors = [
            furthest(x.position, y.position),
            furthest(x.scale.map(f32::ln), y.scale.map(f32::ln)),
            angle(x.rotation, y.rotation),
            (x.opacity - y.opacity).abs(),
            furthest(x.sh0, y.sh0),
        ];
        worst = [0, 1, 2, 3, 4].map(|i| worst[i].max(errors[i]));
    }
    println!(
        "human: worst position {}, log-scale {}, angle {}, opacity {}, sh0 {}",
        worst[0], worst[1], worst[2], worst[3], worst[4]
    );
    // The same bytes decoded twice: rounding of f32 only; angles lose half their digits to acos.
    assert!(
        worst[0] < 1e-6 && worst[1] < 1e-4 && worst[2] < 2e-3 && worst[3] < 1e-5 && worst[4] < 1e-5,
        "{worst:?}"
    );
}

#[test]
fn playbot_levels_load_with_harmonics() {
    let Some(folder) = scenes("playbot_levels_load_with_harmonics") else { return };
    let folder = folder.join("splat-playbot-lod");
    let mut extents = Vec::new();
    for (level, count) in [(2, 125_000), (3, 31_000), (4, 8_406), (5, 3_000), (6, 1_873)] {
        let scene = read(folder.join(format!("{level}_0")));
        assert_eq!(scene.max_count(), count);
        let instant = scene.instant(0).unwrap();
        assert_eq!(instant.sh_degree.get(), 2);
        assert!(instant.sh_rest.iter().any(|v| v.abs() > 0.05), "harmonics are not all zero");
        let (low, high) = bounds(&instant);
        extents.push([0, 1, 2].map(|i| high[i] - low[i]));
        println!("playbot {level}: {low:?} to {high:?}");
    }
    // Bounds that the levels' own index declares: -1.03..1.04, -1.08..0.05, -1.04..1.04 for centres
    // and extents together; centres lie within.
    assert!(extents.iter().all(|e| e[0] < 2.07 && e[1] < 1.14 && e[2] < 2.09), "{extents:?}");
    let error = import(&folder, &ImportOptions::default()).unwrap_err();
    assert!(error.to_string().contains("folder of one level"), "{error}");
}

#[test]
fn garden_points_come_with_cameras() {
    let Some(folder) = scenes("garden_points_come_with_cameras") else { return };
    let scene = read(folder.join("gsplat-garden-points/test_garden.npz"));
    assert_eq!((scene.max_count(), scene.cameras.len()), (138_766, 3));
    assert_eq!((scene.cameras[0].width(), scene.cameras[0].height()), (648, 420));
    // The points were seen from there: most lie in front of each camera.
    let gaussians = scene.instant(0).unwrap().gaussians;
    for camera in &scene.cameras {
        let front = gaussians.iter().filter(|g| camera.to_camera(g.position)[2] > 0.0).count();
        assert!(front > gaussians.len() / 2, "{front} in front");
    }
    let mut sizes: Vec<f32> = gaussians.iter().map(|g| g.scale[0]).collect();
    println!("garden: size quantiles {:?}", [0.01, 0.5, 0.99].map(|q| quantile(&mut sizes, q)));
}

fn animated(path: PathBuf, clip: gltf::Clip, fps: f64) -> Scene {
    let gltf =
        gltf::GltfOptions { clip, samples: 5_000, frames_per_second: fps, ..gltf::GltfOptions::default() };
    import(&path, &ImportOptions { gltf, ..ImportOptions::default() }).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn the_fox_plays_three_clips() {
    let Some(folder) = scenes("the_fox_plays_three_clips") else { return };
    let path = folder.join("gltf-fox/Fox.glb");
    let bytes = std::fs::read(&path).unwrap();
    let nothing = |_: &str| unreachable!("everything is inside the file");
    assert_eq!(gltf::clips(&bytes, nothing, &Limits::default()).unwrap(), ["Survey", "Walk", "Run"]);
    for (clip, seconds) in [("Survey", 3.42), ("Walk", 0.71), ("Run", 1.16)] {
        let scene = animated(path.clone(), gltf::Clip::Name(clip.into()), 30.0);
        let expected = (seconds * 30.0) as usize + 1;
        assert!(scene.frames().abs_diff(expected) <= 1, "{clip}: {} frames", scene.frames());
        let (first, middle) = (scene.instant(0).unwrap(), scene.instant(scene.frames() / 2).unwrap());
        let (low, high) = bounds(&first);
        println!("fox {clip}: {low:?} to {high:?}, {} frames", scene.frames());
        // The mesh at rest is 25 x 79 x 155 units; a pose keeps its size within a third.
        assert!((100.0..=200.0).contains(&(high[2] - low[2])), "{low:?} {high:?}");
        assert!((50.0..=110.0).contains(&(high[1] - low[1])), "{low:?} {high:?}");
        assert!(low[1] > -12.0, "feet near the ground: {low:?}");
        let moved = first.gaussians.iter().zip(&middle.gaussians).filter(|(a, b)| a.position != b.position);
        assert!(moved.count() > 2_500, "most of the fox moves");
    }
}

/// The position of one vertex of the first primitive, skinned here from the file's bytes with nothing
/// of the importer: its own JSON, its own interpolation of the first key.
#[test]
fn skinned_samples_lie_on_the_directly_evaluated_surface() {
    let Some(folder) = scenes("skinned_samples_lie_on_the_directly_evaluated_surface") else { return };
    for file in ["gltf-fox/Fox.glb", "gltf-cesium-man/CesiumMan.glb"] {
        let bytes = std::fs::read(folder.join(file)).unwrap();
        let scene = animated(folder.join(file), gltf::Clip::First, 10.0);
        for frame in [0, scene.frames() / 2] {
            let vertices = direct::skinned(&bytes, frame as f64 / 10.0);
            let gaussians = scene.instant(frame).unwrap().gaussians;
            let worst = direct::furthest_from_triangles(&gaussians, &vertices);
            let size = vertices.iter().flatten().flatten().fold(0f64, |m, v| m.max(v.abs()));
            println!(
                "{file} frame {frame}: furthest sample from the direct surface {worst:.2e} of {size:.2}"
            );
            // f32 positions of magnitude `size`, and weights that the reader normalises.
            assert!(worst < 2e-4 * size, "{file}: {worst}");
        }
    }
}

#[test]
fn cesium_man_walks_with_his_texture() {
    let Some(folder) = scenes("cesium_man_walks_with_his_texture") else { return };
    let scene = animated(folder.join("gltf-cesium-man/CesiumMan.glb"), gltf::Clip::Index(0), 30.0);
    let instant = scene.instant(0).unwrap();
    let (low, high) = bounds(&instant);
    println!("cesium man: {low:?} to {high:?}, {} frames", scene.frames());
    assert!((1.3..=1.7).contains(&(high[1] - low[1])), "a man stands up along y: {low:?} {high:?}");
    let colours: Vec<[f32; 3]> =
        instant.gaussians.iter().map(|g| g.sh0.map(|c| 0.5 + 0.282_094_8 * c)).collect();
    let spread = |i: usize| {
        let (low, high) = colours.iter().fold((1f32, 0f32), |(l, h), c| (l.min(c[i]), h.max(c[i])));
        high - low
    };
    assert!(spread(0) > 0.3, "the texture has contrast");
    // Discs cover: the typical distance to a neighbour is below twice the disc's deviation.
    let points: Vec<[f32; 3]> = instant.gaussians.iter().map(|g| g.position).collect();
    let tree = Tree::new(&points);
    let mut ratio: Vec<f32> = (0..points.len())
        .map(|i| tree.nearest(points[i], 1, |j| j != i)[0].0.sqrt() as f32 / instant.gaussians[i].scale[0])
        .collect();
    assert!(quantile(&mut ratio, 0.99) < 2.2);
}

#[test]
fn content_is_recognised() {
    let Some(folder) = scenes("content_is_recognised") else { return };
    for (file, format) in [
        ("splat-biker/biker.compressed.ply", Format::CompressedPly),
        ("splat-biker/biker.spz", Format::Spz),
        ("splat-seq-human/000020.asset", Format::Unity),
        ("splat-seq-human/000020_first256_decoded.ply", Format::Ply),
        ("splat-playbot-lod/6_0/meta.json", Format::Sog),
        ("gsplat-garden-points/test_garden.npz", Format::PointsNpz),
        ("gltf-fox/Fox.glb", Format::Gltf),
    ] {
        let bytes = std::fs::read(folder.join(file)).unwrap();
        assert_eq!(sniff(&bytes, "unnamed".as_ref()), format, "{file}");
    }
    let stored = ImportOptions { identity: Identity::Stored, ..ImportOptions::default() };
    let error = import(&folder.join("splat-seq-human"), &stored).unwrap_err();
    assert!(error.to_string().contains("000021.asset"), "{error}");
}
